//! The one error type of the crate.
//!
//! Every variant carries the thing, the value, the bound and the alternatives, so that a caller can print the error
//! alone and know what to do. The Python binding maps each variant to one exception class.

use std::fmt;

/// What went wrong, and what would be right.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The robot description cannot be used.
    #[error("{source_name}{at}: {message}")]
    Urdf {
        /// Path of the file, or `<string>`.
        source_name: String,
        /// Line and column where that is known.
        at: Position,
        /// What is wrong and how to mend it.
        message: String,
    },
    /// A link or frame of that name does not exist.
    #[error("frame '{frame}' not found; frames of this robot: {}", available.join(", "))]
    FrameNotFound {
        /// The name asked for.
        frame: String,
        /// The names there are.
        available: Vec<String>,
    },
    /// A number lies outside its bounds.
    #[error("{what} = {} is outside {bound}", Short(*value))]
    OutOfRange {
        /// The quantity, e.g. `q[3] (elbow_pitch)`.
        what: String,
        /// The value given.
        value: f64,
        /// The bound and, where there is one, the remedy.
        bound: String,
    },
    /// An array has the wrong size.
    #[error("{what} has shape {got}, expected {expected}")]
    Shape {
        /// The argument.
        what: String,
        /// The shape given, e.g. `(6,)`.
        got: String,
        /// The shape that fits, e.g. `(7,)`.
        expected: String,
    },
    /// Settings, servos and model do not go together.
    #[error("{key}: {message}")]
    Config {
        /// The setting, e.g. `axes.y.adaptation`.
        key: String,
        /// What is wrong and what would be right.
        message: String,
    },
}

/// A number as a message says it: one that nobody means, such as 1e300, must not fill the screen with its digits.
struct Short(f64);

impl fmt::Display for Short {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (value, size) = (self.0, self.0.abs());
        // What is not finite has a name, and zero one digit.
        let plain = size == 0.0 || (1e-4..=1e6).contains(&size) || !size.is_finite();
        if plain { write!(f, "{value}") } else { write!(f, "{value:e}") }
    }
}

/// Line and column in a text, when known; counted from one.
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

/// Result of everything in this crate that can fail.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// A [`Error::OutOfRange`].
    #[cold]
    #[inline(never)]
    pub(crate) fn out_of_range(what: impl Into<String>, value: f64, bound: impl Into<String>) -> Self {
        Self::OutOfRange { what: what.into(), value, bound: bound.into() }
    }

    /// A [`Error::Shape`] of a one-dimensional argument.
    #[cold]
    #[inline(never)]
    pub(crate) fn length(what: impl Into<String>, got: usize, expected: usize) -> Self {
        Self::Shape { what: what.into(), got: format!("({got},)"), expected: format!("({expected},)") }
    }

    /// A [`Error::Shape`] of rows (`N` × `size`) that stand one behind the other in `got` numbers.
    #[cold]
    #[inline(never)]
    pub(crate) fn rows(what: impl Into<String>, got: usize, size: usize) -> Self {
        let expected = format!("(N, {size}) row by row, a multiple of {size} numbers");
        Self::Shape { what: what.into(), got: format!("({got},)"), expected }
    }

    /// A [`Error::Config`].
    #[cold]
    #[inline(never)]
    pub(crate) fn config(key: impl Into<String>, message: impl Into<String>) -> Self {
        Self::Config { key: key.into(), message: message.into() }
    }

    /// What is wrong in row `row` of a batch.
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
