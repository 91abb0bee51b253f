//! How a batch's input is made.

use super::{BatchInput, Invalid, Targets};

impl<'a> BatchInput<'a> {
    /// Of measured joint positions `q` (`N` × n, row by row) [rad] and where the arms are to go; nothing else given.
    ///
    /// Lengths are checked by the step.
    pub fn new(q: &'a [f64], targets: Targets<'a>) -> Self {
        Self { q, targets, dt: None, dq: None, invalid: Invalid::default() }
    }
}
