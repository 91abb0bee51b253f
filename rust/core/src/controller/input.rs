//! Validation of the inputs of a control step, on which the code after it relies.

use crate::error::{Error, Result};
use crate::kinematics::velocity_filter::SPEED_BOUND;
use crate::model::Model;
use crate::params::Params;
use crate::pose::COORDINATE_BOUND;
use crate::{AxisVec, JointVec};

/// Optional inputs of one step.
#[derive(Debug, Clone, Copy, Default)]
pub struct StepInput<'a> {
    /// Time since the last step [s], at most 1; `None`: 1 / rate.
    pub dt: Option<f64>,
    /// Velocity of each joint [rad/s]; `None`: filtered from the positions.
    pub dq: Option<&'a [f64]>,
    /// Velocity of the target, linear then angular, in base axes [m/s, rad/s]; `None`: zero. Law `paper` adds it to the
    /// task velocity; the others aim at where the target will be after the delay.
    pub twist: Option<&'a [f64; 6]>,
    /// Gradient, one entry per joint, of the user's null-space cost, added to the gradient of the settings' cost.
    pub gradient: Option<&'a [f64]>,
    /// Rest posture for this step [rad]; `None`: that of the settings, or the positions at the last reset.
    pub posture: Option<&'a [f64]>,
}

impl StepInput<'_> {
    /// Returns true if all inputs except the period are absent.
    #[inline]
    pub(super) fn has_period_only(&self) -> bool {
        self.dq.is_none() & self.twist.is_none() & self.gradient.is_none() & self.posture.is_none()
    }
}

/// Lower bound on the time between two readings [s], so that two readings at the same time do not give an infinite
/// speed.
const SHORTEST_PERIOD: f64 = 1e-6;

/// Longest valid time between two steps [s]; a larger value is probably in milliseconds.
const LONGEST_PERIOD: f64 = 1.0;

/// Validated inputs of a step; an absent input is `None`.
pub(super) struct Input {
    pub(super) dt: f64,
    pub(super) dq: Option<JointVec>,
    pub(super) twist: Option<AxisVec>,
    pub(super) gradient: Option<JointVec>,
    pub(super) rest: Option<JointVec>,
}

impl Input {
    /// Creates the input of a step without optional inputs; `dt` is the time since the last step [s].
    #[inline(always)]
    pub(super) fn new(dt: f64) -> Self {
        Self { dt, dq: None, twist: None, gradient: None, rest: None }
    }

    /// Checks the input of a step and stores it in `self`. Returning the large, mostly empty struct by value would copy
    /// it.
    #[inline]
    pub(super) fn read(&mut self, model: &Model, params: &Params, input: &StepInput<'_>) -> Result<()> {
        if let Some(twist) = input.twist {
            self.twist = Some(checked_twist(twist)?);
        }
        if let Some(posture) = input.posture {
            self.rest = Some(params.positions(model, "posture", posture)?);
        }
        if let Some(dq) = input.dq {
            self.dq = Some(model.joints_within("dq", dq, SPEED_BOUND)?);
        }
        if let Some(gradient) = input.gradient {
            self.gradient = Some(model.joints_within("gradient", gradient, COORDINATE_BOUND)?);
        }
        Ok(())
    }
}

/// Returns the time since the last step or reading [s], raised to at least 1 µs; an error outside (0, 1] s.
#[inline]
pub(crate) fn period(dt: f64) -> Result<f64> {
    if dt > 0.0 && dt <= LONGEST_PERIOD { Ok(dt.max(SHORTEST_PERIOD)) } else { Err(no_period(dt)) }
}

#[cold]
#[inline(never)]
fn no_period(dt: f64) -> Error {
    let hint = if dt > LONGEST_PERIOD { "; is it in milliseconds?" } else { "" };
    Error::out_of_range("dt [s]", dt, format!("(0, {LONGEST_PERIOD}]{hint}"))
}

fn checked_twist(twist: &AxisVec) -> Result<AxisVec> {
    for value in twist {
        if !(value.abs() <= SPEED_BOUND) {
            return Err(Error::out_of_range("twist [m/s, rad/s]", *value, format!("±{SPEED_BOUND}")));
        }
    }
    Ok(*twist)
}
