//! Validation of a step's inputs; the code after it does not check again.

use crate::controller::{Controller, StepInput};
use crate::error::{Error, Result};
use crate::kinematics::velocity_filter::SPEED_BOUND;
use crate::math::simd::{Lanes, NEGLIGIBLE};
use crate::params::Plan;
use crate::pose::{COORDINATE_BOUND, Pose};
use crate::{AxisVec, JointVec, MAX_JOINTS};

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

impl Controller {
    /// Checks the input of a step.
    pub(crate) fn check_input(&self, input: &StepInput<'_>) -> Result<()> {
        self.read(input, &mut Input::default())
    }

    /// Reads the input into `out`. An out-parameter avoids a copy of the large, usually almost empty struct.
    #[inline]
    pub(super) fn read(&self, input: &StepInput<'_>, out: &mut Input) -> Result<()> {
        out.dt = period(input.dt.unwrap_or(1.0 / self.settings.rate))?;
        if let Some(twist) = input.twist {
            out.twist = Some(checked_twist(twist)?);
        }
        if let Some(posture) = input.posture {
            out.rest = Some(self.positions("posture", posture)?);
        }
        if let Some(dq) = input.dq {
            out.dq = Some(self.joints("dq", dq, SPEED_BOUND)?);
        }
        if let Some(gradient) = input.gradient {
            out.gradient = Some(self.joints("gradient", gradient, COORDINATE_BOUND)?);
        }
        Ok(())
    }

    /// Reads joint positions: finite, and no farther beyond the position limits than a real joint can be.
    pub(crate) fn positions(&self, what: &str, values: &[f64]) -> Result<JointVec> {
        let [least, most] = &self.plan.readable;
        self.model.joints_between(what, values, least, most)
    }

    /// Checks that a tool pose can be a target of this task.
    pub(crate) fn check_target(&self, what: &str, target: &Pose) -> Result<()> {
        self.model.check_target_in(what, target, &self.plan.target_region)
    }

    /// Reads target joint positions.
    pub(crate) fn joint_target(&self, what: &str, values: &[f64]) -> Result<JointVec> {
        let [least, most] = &self.plan.joint_targets;
        self.model.joints_between(what, values, least, most)
    }

    /// Returns the reason why a step refused these positions and this target.
    #[cold]
    pub(super) fn refusal(&self, q: &[f64], target: &Pose) -> Error {
        match self.positions("q", q).map(|_| ()).and_then(|()| self.check_target("target", target)) {
            Err(error) => error,
            Ok(()) => {
                Error::config("step", "the command is not finite for this q, target and settings: nothing was sent")
            }
        }
    }

    /// Reads `values` as one finite number per joint within ±`bound`.
    pub(crate) fn joints(&self, what: &str, values: &[f64], bound: f64) -> Result<JointVec> {
        if values.len() != self.plan.n {
            return Err(Error::length(what, values.len(), self.plan.n));
        }
        let mut out = [0.0; MAX_JOINTS];
        for (i, (slot, &value)) in out.iter_mut().zip(values).enumerate() {
            if !(value.abs() <= bound) {
                let name = self.model.joint_names().get(i).map_or("", String::as_str);
                return Err(Error::out_of_range(format!("{what}[{i}] ({name})"), value, format!("±{bound:e}")));
            }
            *slot = if value.abs() < NEGLIGIBLE { 0.0 } else { value };
        }
        Ok(out)
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

/// Returns true if positions are plausible for a real arm, by the bounds of [`Controller::positions`].
#[inline(always)]
pub(super) fn readable<J: Lanes>(plan: &Plan, q: J) -> bool {
    let (nothing, one) = (J::splat(0.0), J::splat(1.0));
    let below = J::if_less(q, J::load(&plan.readable[1]), nothing, one);
    !nothing.any_less(J::if_less(J::load(&plan.readable[0]), q, below, one))
}

/// Flushes negligibly small positions to 0.
#[inline(always)]
pub(super) fn without_negligible<J: Lanes>(q: J) -> J {
    J::if_less(J::abs(q), J::splat(NEGLIGIBLE), J::splat(0.0), q)
}

fn checked_twist(twist: &AxisVec) -> Result<AxisVec> {
    for value in twist {
        if !(value.abs() <= SPEED_BOUND) {
            return Err(Error::out_of_range("twist [m/s, rad/s]", *value, format!("±{SPEED_BOUND}")));
        }
    }
    Ok(*twist)
}
