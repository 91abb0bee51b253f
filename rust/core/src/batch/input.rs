//! Constructor of a batch's input.

use super::{BatchInput, Invalid, Targets};

impl<'a> BatchInput<'a> {
    /// Creates the input from measured joint positions `q` (`N` × n, row by row) [rad] and targets, without optional
    /// values.
    ///
    /// The step checks the lengths.
    pub fn new(q: &'a [f64], targets: Targets<'a>) -> Self {
        Self { q, targets, dt: None, dq: None, invalid: Invalid::default() }
    }
}
