//! Error type of the crate.
//!
//! Each variant contains what its message needs, e.g. quantity, value and bound, so that the message says how to fix
//! the call. The Python binding maps each variant to one exception class.

use std::fmt;

/// Errors of this crate.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The robot description is invalid.
    #[error("{source_name}{at}: {message}")]
    Urdf {
        /// Path of the file, or `<string>`.
        source_name: String,
        /// Line and column of the defect, if known.
        at: Position,
        /// Cause and remedy.
        message: String,
    },
    /// A link or frame of that name does not exist.
    #[error("frame '{frame}' not found; frames of this robot: {}", available.join(", "))]
    FrameNotFound {
        /// The requested name.
        frame: String,
        /// The existing names.
        available: Vec<String>,
    },
    /// A number is outside its bounds.
    #[error("{what} = {} is outside {bound}", Short(*value))]
    OutOfRange {
        /// The quantity, e.g. `q[3] (elbow_pitch)`.
        what: String,
        /// The value given.
        value: f64,
        /// The bound and, if there is one, the remedy.
        bound: String,
    },
    /// An array has the wrong size.
    #[error("{what} has shape {got}, expected {expected}")]
    Shape {
        /// The argument.
        what: String,
        /// The shape given, e.g. `(6,)`.
        got: String,
        /// The expected shape, e.g. `(7,)`.
        expected: String,
    },
    /// Settings, servos and model are inconsistent.
    #[error("{key}: {message}")]
    Config {
        /// The setting, e.g. `axes.y.adaptation`.
        key: String,
        /// Cause and remedy.
        message: String,
    },
}

/// Formats a number for a message, in exponential notation outside 1e-4 to 1e6, so that 1e300 does not fill a page.
struct Short(f64);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (value, size) = (self.0, self.0.abs());
        // Zero, infinities and NaN are short without an exponent.
        let plain = size == 0.0 || (1e-4..=1e6).contains(&size) || !size.is_finite();
        if plain { write!(f, "{value}") } else { write!(f, "{value:e}") }
    }
}

/// Line and column in a text, counted from 1; `None` if unknown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Position(pub Option<(u32, u32)>);

impl fmt::Display for Position {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some((line, column)) => write!(f, ":{line}:{column}"),
            None => Ok(()),
        }
    }
}

/// Result type of this crate.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// Creates an [`Error::OutOfRange`].
    #[cold]
    #[inline(never)]
    pub(crate) fn out_of_range(what: impl Into<String>, value: f64, bound: impl Into<String>) -> Self {
        Self::OutOfRange { what: what.into(), value, bound: bound.into() }
    }

    /// Creates an [`Error::Shape`] for a one-dimensional argument.
    #[cold]
    #[inline(never)]
    pub(crate) fn length(what: impl Into<String>, got: usize, expected: usize) -> Self {
        Self::Shape { what: what.into(), got: format!("({got},)"), expected: format!("({expected},)") }
    }

    /// Creates an [`Error::Shape`] for an `N` × `size` array, row-major, whose length `got` is not a multiple of
    /// `size`.
    #[cold]
    #[inline(never)]
    pub(crate) fn rows(what: impl Into<String>, got: usize, size: usize) -> Self {
        let expected = format!("(N, {size}) row by row, a multiple of {size} numbers");
        Self::Shape { what: what.into(), got: format!("({got},)"), expected }
    }

    /// Creates an [`Error::Config`].
    #[cold]
    #[inline(never)]
    pub(crate) fn config(key: impl Into<String>, message: impl Into<String>) -> Self {
        Self::Config { key: key.into(), message: message.into() }
    }

    /// Creates the [`Error::Config`] of a step that rejects its own command.
    #[cold]
    #[inline(never)]
    pub(crate) fn command_not_finite() -> Self {
        Self::config("step", "the command is not finite for this q, target and settings: nothing was sent")
    }

    /// Adds the prefix `batch[row]` to the quantity or setting; leaves other variants unchanged.
    #[cold]
    #[inline(never)]
    pub(crate) fn in_row(self, batch: &str, row: usize) -> Self {
        match self {
            Self::OutOfRange { what, value, bound } => {
                Self::OutOfRange { what: format!("{batch}[{row}]: {what}"), value, bound }
            }
            Self::Config { key, message } => Self::Config { key: format!("{batch}[{row}]: {key}"), message },
            other => other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_messages_stay_short() {
        let said = |value| Error::out_of_range("x", value, "[0, 1]").to_string();
        for (value, text) in [
            (0.0, "0"),
            (-0.25, "-0.25"),
            (1e6, "1000000"),
            (1e-4, "0.0001"),
            (1.5e-5, "1.5e-5"),
            (-1.5e6, "-1.5e6"),
            (1e300, "1e300"),
            (f64::MIN_POSITIVE, "2.2250738585072014e-308"),
            (f64::NAN, "NaN"),
            (f64::NEG_INFINITY, "-inf"),
        ] {
            assert_eq!(said(value), format!("x = {text} is outside [0, 1]"));
        }
    }
}
