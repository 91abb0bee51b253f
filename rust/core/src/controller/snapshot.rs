//! Snapshot of a controller: its inputs and its state, to continue in another process.

use crate::batch::state::row_len;
use crate::error::{Error, Result};
use crate::model::{Payload, finite_vector};
use crate::pose::COORDINATE_BOUND;

/// Snapshot of a controller without model, settings and servos. Valid for the same version of this crate only.
#[derive(Debug, Clone, PartialEq)]
pub struct Snapshot {
    /// Current payload.
    pub payload: Option<Payload>,
    /// Current gravity vector [m/s²], base axes.
    pub gravity: [f64; 3],
    /// During a payload change: previous mass [kg] and first moment (3) [kg·m], time since the change [s].
    pub payload_ramp: Option<[f64; 5]>,
    /// Current delay T_d [s].
    pub delay: f64,
    /// 1/k_g (n) [rad/(N·m)] if the gravity offset was captured.
    pub captured: Option<Vec<f64>>,
    /// State between steps; empty before the first step if there was no reset.
    pub state: Vec<f64>,
}

impl Snapshot {
    /// Checks everything but the payload, which the controller checks, for an arm of `n` joints.
    pub(super) fn validate(&self, n: usize) -> Result<()> {
        let captured = self.captured.as_deref();
        if let Some(other) = captured.filter(|values| values.len() != n) {
            return Err(Error::length("captured", other.len(), n));
        }
        if let Some(&value) = captured.into_iter().flatten().find(|value| !(**value > 0.0 && value.is_finite())) {
            return Err(Error::out_of_range("captured [rad/(N·m)]", value, "(0, ∞)"));
        }
        finite_vector("gravity", "m/s²", &self.gravity)
    }

    /// Checks the state between steps and the ramp.
    pub(super) fn validate_state(&self, n: usize) -> Result<()> {
        if !self.state.is_empty() && self.state.len() != row_len(n) {
            return Err(Error::length("state", self.state.len(), row_len(n)));
        }
        if self.state.iter().any(|value| value.is_nan()) {
            return Err(Error::out_of_range("state", f64::NAN, "numbers"));
        }
        match self.payload_ramp.iter().flatten().find(|value| !(value.abs() <= COORDINATE_BOUND)) {
            Some(&value) => Err(Error::out_of_range("payload_ramp", value, format!("±{COORDINATE_BOUND:e}"))),
            None => Ok(()),
        }
    }
}
