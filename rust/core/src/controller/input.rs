//! Validation of a step's inputs; the code after it does not check again.

use crate::error::{Error, Result};
use crate::kinematics::velocity_filter::SPEED_BOUND;
use crate::math::simd::{JointVector, NEGLIGIBLE};
use crate::model::Model;
use crate::params::Params;
use crate::pose::COORDINATE_BOUND;
use crate::{AxisVec, JointVec};

/// Optional inputs of one step.
#[derive(Debug, Clone, Copy, Default)]
pub struct StepInput<'a> {
    /// Time since the last step [s], at most 1; `None`: 1 / rate.
    pub dt: Option<f64>,
    /// Joint velocity [rad/s] in place of the filtered one.
    pub dq: Option<&'a [f64]>,
    /// Velocity of the target (6,) [m/s, rad/s], base axes.
    pub twist: Option<&'a [f64; 6]>,
    /// Gradient of a user's null-space cost, added to the others.
    pub gradient: Option<&'a [f64]>,
    /// Rest posture of this step [rad].
    pub posture: Option<&'a [f64]>,
}

/// Shortest time [s] used as a divisor: two readings of one instant must not give infinite speeds.
const SHORTEST_PERIOD: f64 = 1e-6;

/// Longest time between two steps [s], that of the lowest rate. A larger value is usually given in milliseconds.
const LONGEST_PERIOD: f64 = 1.0;

/// Validated input of a step; `None` for optional inputs that are absent.
#[derive(Default)]
pub(super) struct Input {
    pub(super) dt: f64,
    pub(super) dq: Option<JointVec>,
    pub(super) twist: Option<AxisVec>,
    pub(super) gradient: Option<JointVec>,
    pub(super) rest: Option<JointVec>,
}

impl Input {
    /// Reads and checks the input of a step into `self`: the struct is large and usually almost empty, so it is not
    /// returned by value.
    #[inline]
    pub(super) fn read(&mut self, model: &Model, params: &Params, rate: f64, input: &StepInput<'_>) -> Result<()> {
        self.dt = period(input.dt.unwrap_or(1.0 / rate))?;
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

/// Reads the time [s] since the last step or reading, at least the shortest divisor.
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

/// Flushes negligibly small positions to 0.
#[inline(always)]
pub(super) fn flush_subnormals<J: JointVector>(q: J) -> J {
    J::select_lt(J::abs(q), J::splat(NEGLIGIBLE), J::splat(0.0), q)
}

fn checked_twist(twist: &AxisVec) -> Result<AxisVec> {
    for value in twist {
        if !(value.abs() <= SPEED_BOUND) {
            return Err(Error::out_of_range("twist [m/s, rad/s]", *value, format!("±{SPEED_BOUND}")));
        }
    }
    Ok(*twist)
}
