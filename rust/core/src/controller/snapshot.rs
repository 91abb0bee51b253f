//! Snapshot of a controller, from which another process can continue.

use crate::batch::state::row_len;
use crate::error::{Error, Result};
use crate::model::{Payload, finite_vector};
use crate::pose::COORDINATE_BOUND;

/// State and running parameters of a controller, without model, settings and servos. Only the same version of this
/// crate can read it.
#[derive(Debug, Clone, PartialEq)]
pub struct Snapshot {
    /// Current payload; `None`: no payload.
    pub payload: Option<Payload>,
    /// Current gravity vector [m/s²], base axes.
    pub gravity: [f64; 3],
    /// During a payload change: mass [kg] and first moment (3) [kg·m] of the previous payload, and time since the
    /// change [s]. Otherwise `None`.
    pub payload_ramp: Option<[f64; 5]>,
    /// Current delay T_d [s].
    pub delay: f64,
    /// Captured gravity offset of each joint: compliance 1/k_g [rad/(N·m)] and constant lead [rad]; `None`: not captured.
    pub captured: Option<[Vec<f64>; 2]>,
    /// State between steps; empty before the first step or reset.
    pub state: Vec<f64>,
}

impl Snapshot {
    /// Checks captured compliance and gravity for an arm of `n` joints.
    pub(super) fn validate(&self, n: usize) -> Result<()> {
        let lists = self.captured.as_ref();
        if let Some(other) = lists.into_iter().flatten().find(|values| values.len() != n) {
            return Err(Error::length("captured", other.len(), n));
        }
        if let Some([compliance, lead]) = lists {
            if let Some(&value) = compliance.iter().find(|value| !(**value > 0.0 && value.is_finite())) {
                return Err(Error::out_of_range("captured [rad/(N·m)]", value, "(0, ∞)"));
            }
            if let Some(&value) = lead.iter().find(|value| !(value.abs() <= COORDINATE_BOUND)) {
                return Err(Error::out_of_range("captured lead [rad]", value, format!("±{COORDINATE_BOUND:e}")));
            }
        }
        finite_vector("gravity", "m/s²", &self.gravity)
    }

    /// Checks the state between steps and the payload ramp for an arm of `n` joints.
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
