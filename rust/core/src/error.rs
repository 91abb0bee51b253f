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
    #[error("{what} = {value} is outside {bound}")]
    Limit {
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
        /// The setting, e.g. `axes.y.eta`.
        key: String,
        /// What is wrong and what would be right.
        message: String,
    },
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
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// A [`Error::Limit`].
    #[cold]
    #[inline(never)]
    pub(crate) fn limit(what: impl Into<String>, value: f64, bound: impl Into<String>) -> Self {
        Self::Limit { what: what.into(), value, bound: bound.into() }
    }

    /// A [`Error::Shape`] of a one-dimensional argument.
    #[cold]
    #[inline(never)]
    pub(crate) fn length(what: impl Into<String>, got: usize, expected: usize) -> Self {
        Self::Shape { what: what.into(), got: format!("({got},)"), expected: format!("({expected},)") }
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
            Self::Limit { what, value, bound } => Self::Limit { what: format!("{batch}[{row}]: {what}"), value, bound },
            Self::Config { key, message } => Self::Config { key: format!("{batch}[{row}]: {key}"), message },
            other => other,
        }
    }
}
