//! Scalings and bounds of the step that are constants of the plan.

use crate::error::Result;
use crate::math::simd::{Arithmetic, Axes, Lanes};
use crate::math::spatial::{Mat3, splat_matrix};
use crate::model::Model;
use crate::params::{DampingPlan, Frame, Law, Plan, Projector, Settings};
use crate::pose::{COORDINATE_BOUND, Pose};
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

/// Largest distance of a plausible reading beyond a joint's position limits [rad]: half a turn. A larger one is in
/// degrees, or from another robot.
const BEYOND_LIMITS: f64 = std::f64::consts::PI;

/// Distance to the limit [rad] below which the posture task fades: upper bound, and share of the joint's range for
/// short ranges.
const ROOM: (f64, f64) = (0.05, 0.05);

/// Distance to the limit [rad or m] of each joint below which the posture task fades.
pub(super) fn clearance(lower: &JointVec, upper: &JointVec) -> JointVec {
    std::array::from_fn(|i| ROOM.0.min(ROOM.1 * (upper[i] - lower[i])))
}

/// Returns the bounds of plausible positions, ±1 as padding; a prismatic joint may exceed its limits by its travel.
pub(super) fn readable(model: &Model) -> [JointVec; 2] {
    let mut out = [[-1.0; MAX_JOINTS], [1.0; MAX_JOINTS]];
    for (i, (&lower, &upper)) in model.lower().iter().zip(model.upper()).enumerate().take(MAX_JOINTS) {
        let prismatic = model.prismatic().get(i).copied().unwrap_or(false);
        let beyond = if prismatic { upper - lower } else { BEYOND_LIMITS };
        out[0][i] = (lower - beyond).max(-COORDINATE_BOUND);
        out[1][i] = (upper + beyond).min(COORDINATE_BOUND);
    }
    out
}

/// Returns true if a step depends on the singular values of its rows.
pub(super) fn follows_sigma(settings: &Settings, damping: &DampingPlan) -> bool {
    settings.law != Law::Paper
        || damping.sigma_0 > 0.0
        || settings.paper_options.manipulability > 0.0
        || settings.null_space.projector == Projector::Exact
}

impl Plan {
    /// Reads joint positions: finite, and no farther beyond the position limits than a real joint can be.
    pub(crate) fn positions(&self, model: &Model, what: &str, values: &[f64]) -> Result<JointVec> {
        let [least, most] = &self.readable;
        model.joints_between(what, values, least, most)
    }

    /// Returns true if positions are plausible for a real arm, by the bounds of [`Plan::positions`].
    #[inline(always)]
    pub(crate) fn is_readable<J: Lanes>(&self, q: J) -> bool {
        let (nothing, one) = (J::splat(0.0), J::splat(1.0));
        let below = J::if_less(q, J::load(&self.readable[1]), nothing, one);
        !nothing.any_less(J::if_less(J::load(&self.readable[0]), q, below, one))
    }

    /// Returns the task's axes as columns, for a given pose of the tool.
    #[inline(always)]
    pub(crate) fn base_from_task<A: Arithmetic>(&self, tool: &Pose<A::Real>) -> Mat3<A::Real> {
        match self.frame {
            Frame::Tool => tool.rotation,
            Frame::Base | Frame::Rotation(_) => splat_matrix::<A>(&self.fixed_axes),
        }
    }

    /// Task rows with translations divided by the arm's length.
    #[inline(always)]
    pub(crate) fn scale_rows<J: Lanes>(&self, rows: &[J; MAX_AXES]) -> [J; MAX_AXES] {
        let mut out = *rows;
        for r in 0..MAX_AXES {
            out[r] = rows[r] * J::splat(self.row_scale[r]);
        }
        out
    }

    /// λ² of each row per mean stiffness, `λ²/k̄`.
    #[inline(always)]
    pub(crate) fn per_stiffness<W: Axes>(&self, squared: W) -> W {
        squared / W::splat(self.servos.kp_mean)
    }

    /// Returns the largest motion of each joint within a horizon [rad].
    #[inline(always)]
    pub(crate) fn reach<J: Lanes>(&self, horizon: f64) -> J {
        J::load(&self.joint_speed) * J::splat(horizon)
    }

    /// Scales a null-space motion [rad] to its speed limit.
    #[inline(always)]
    pub(crate) fn bound_null_speed<J: Lanes>(&self, null: J, horizon: f64) -> J {
        let most = self.null_speed * horizon;
        if !J::splat(most).any_less(J::abs(null)) {
            return null;
        }
        let most = J::One::splat(most);
        null * J::spread(most / J::One::at_least(J::abs(null).largest(), most))
    }
}
