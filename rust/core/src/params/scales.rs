//! Scalings and bounds of the step that are constants of the plan.

use crate::error::Result;
use crate::math::simd::{JointVector, RealOps, TaskVector};
use crate::math::spatial::{Mat3, splat_matrix};
use crate::model::Model;
use crate::params::{DampingParams, Frame, Params, Projector, Settings};
use crate::pose::{COORDINATE_BOUND, Pose};
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

/// Largest distance of a plausible reading beyond a joint's position limits [rad]: half a turn. A larger one is in
/// degrees, or from another robot.
const MAX_OVERTRAVEL: f64 = std::f64::consts::PI;

/// Distance to the limit [rad] below which the posture task fades: upper bound, and share of the joint's range for
/// short ranges.
const CLEARANCE: (f64, f64) = (0.05, 0.05);

/// Distance to the limit [rad or m] of each joint below which the posture task fades.
pub(super) fn clearance(lower: &JointVec, upper: &JointVec) -> JointVec {
    std::array::from_fn(|i| CLEARANCE.0.min(CLEARANCE.1 * (upper[i] - lower[i])))
}

/// Returns the bounds of plausible positions, ±1 as padding; a prismatic joint may exceed its limits by its travel.
pub(super) fn q_plausible(model: &Model) -> [JointVec; 2] {
    let mut out = [[-1.0; MAX_JOINTS], [1.0; MAX_JOINTS]];
    for (i, (&lower, &upper)) in model.lower().iter().zip(model.upper()).enumerate().take(MAX_JOINTS) {
        let prismatic = model.prismatic().get(i).copied().unwrap_or(false);
        let overtravel = if prismatic { upper - lower } else { MAX_OVERTRAVEL };
        out[0][i] = (lower - overtravel).max(-COORDINATE_BOUND);
        out[1][i] = (upper + overtravel).min(COORDINATE_BOUND);
    }
    out
}

/// Returns true if a step depends on the singular values of its rows.
pub(super) fn tracks_sigma(settings: &Settings, damping: &DampingParams) -> bool {
    settings.law.by_force()
        || damping.sigma_0 > 0.0
        || settings.paper_options.manipulability > 0.0
        || settings.null_space.projector == Projector::Exact
}

impl Params {
    /// Reads joint positions: finite, and no farther beyond the position limits than a real joint can be.
    pub(crate) fn positions(&self, model: &Model, what: &str, values: &[f64]) -> Result<JointVec> {
        let [lowest, highest] = &self.q_plausible;
        model.joints_between(what, values, lowest, highest)
    }

    /// Returns true if positions are plausible for a real arm, by the bounds of [`Params::positions`].
    #[inline(always)]
    pub(crate) fn is_plausible<J: JointVector>(&self, q: J) -> bool {
        let (zero, one) = (J::splat(0.0), J::splat(1.0));
        let below = J::select_lt(q, J::load(&self.q_plausible[1]), zero, one);
        !zero.is_any_lt(J::select_lt(J::load(&self.q_plausible[0]), q, below, one))
    }

    /// Returns the task's axes as columns, for a given pose of the tool.
    #[inline(always)]
    pub(crate) fn base_from_task<A: RealOps>(&self, tool: &Pose<A::Real>) -> Mat3<A::Real> {
        match self.frame {
            Frame::Tool => tool.rotation,
            Frame::Base | Frame::Rotation(_) => splat_matrix::<A>(&self.fixed_axes),
        }
    }

    /// Task rows with translations divided by the arm's length.
    #[inline(always)]
    pub(crate) fn scale_rows<J: JointVector>(&self, rows: &[J; MAX_AXES]) -> [J; MAX_AXES] {
        let mut out = *rows;
        for r in 0..MAX_AXES {
            out[r] = rows[r] * J::splat(self.row_scale[r]);
        }
        out
    }

    /// λ² of each row per mean stiffness, `λ²/k̄`.
    #[inline(always)]
    pub(crate) fn per_stiffness<W: TaskVector>(&self, squared: W) -> W {
        squared / W::splat(self.servos.kp_mean)
    }

    /// Returns the largest motion of each joint within a horizon [rad].
    #[inline(always)]
    pub(crate) fn reach<J: JointVector>(&self, horizon: f64) -> J {
        J::load(&self.joint_speed) * J::splat(horizon)
    }

    /// Scales a null-space motion [rad] to its speed limit.
    #[inline(always)]
    pub(crate) fn bound_null_speed<J: JointVector>(&self, null: J, horizon: f64) -> J {
        let highest = self.null_speed * horizon;
        if !J::splat(highest).is_any_lt(J::abs(null)) {
            return null;
        }
        let highest = J::Elem::splat(highest);
        null * J::broadcast(highest / J::Elem::max(J::abs(null).max_element(), highest))
    }
}
