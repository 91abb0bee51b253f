//! Scalings and bounds of the control step that change only with the settings.

use crate::error::Result;
use crate::math::simd::{F64x8, JointVector, RealOps};
use crate::math::spatial::Mat3;
use crate::model::Model;
use crate::params::{DampingParams, Frame, Params, Projector, Settings};
use crate::pose::{COORDINATE_BOUND, Pose};
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

/// Largest plausible distance [rad] of a reading beyond a joint's position limits: half a turn. A reading farther out
/// is probably in degrees, or from another robot.
const MAX_OVERTRAVEL: f64 = std::f64::consts::PI;

/// Largest distance to a position limit [rad or m] below which the posture task fades.
const MAX_CLEARANCE: f64 = 0.05;

/// For short joint ranges, this share of the range replaces [`MAX_CLEARANCE`].
const CLEARANCE_SHARE: f64 = 0.05;

/// Returns the distance of each joint to its limit [rad or m] below which the posture task fades.
pub(super) fn clearance(lower: &JointVec, upper: &JointVec) -> JointVec {
    std::array::from_fn(|i| MAX_CLEARANCE.min(CLEARANCE_SHARE * (upper[i] - lower[i])))
}

/// Returns the smallest and the largest plausible position reading of each joint [rad or m], ±1 in the padding. A
/// prismatic joint may exceed its limits by its travel.
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

/// Returns true if a step uses the singular values of its task rows.
pub(super) fn tracks_sigma(settings: &Settings, damping: &DampingParams) -> bool {
    settings.law.by_force()
        || damping.sigma_0 > 0.0
        || settings.paper_options.manipulability > 0.0
        || settings.null_space.projector == Projector::Exact
}

impl Params {
    /// Checks that joint positions are finite and plausible (see [`q_plausible`]); returns them padded.
    pub(crate) fn positions(&self, model: &Model, what: &str, values: &[f64]) -> Result<JointVec> {
        let [lowest, highest] = &self.q_plausible;
        model.joints_between(what, values, lowest, highest)
    }

    /// Returns true if [`Params::positions`] would accept these positions.
    #[inline(always)]
    pub(crate) fn is_plausible<J: JointVector>(&self, q: J) -> bool {
        let [lowest, highest] = &self.q_plausible;
        !(J::load(lowest).is_any_not_lt(q) | q.is_any_not_lt(J::load(highest)))
    }

    /// Returns `base_from_task` for this pose of the tool: its columns are the task axes in the base frame.
    #[inline(always)]
    pub(crate) fn base_from_task(&self, tool: &Pose) -> Mat3 {
        match self.frame {
            Frame::Tool => tool.rotation,
            Frame::Base | Frame::Rotation(_) => self.fixed_axes,
        }
    }

    /// Returns the task rows with translations divided by the arm's length scale.
    #[inline(always)]
    pub(crate) fn scale_rows<J: JointVector>(&self, rows: &[J; MAX_AXES]) -> [J; MAX_AXES] {
        let mut out = *rows;
        for r in 0..MAX_AXES {
            out[r] = rows[r] * J::splat(self.row_scale[r]);
        }
        out
    }

    /// Returns `λ²/k̄`: the squared damping of each row divided by the servos' mean stiffness.
    #[inline(always)]
    pub(crate) fn per_stiffness<W: F64x8>(&self, squared: W) -> W {
        squared / W::splat(self.servos.kp_mean)
    }

    /// Returns the largest motion of each joint within `horizon` [s] at its speed limit [rad].
    #[inline(always)]
    pub(crate) fn reach<J: JointVector>(&self, horizon: f64) -> J {
        J::load(&self.joint_speed) * J::splat(horizon)
    }

    /// Scales a null-space motion [rad] down to the null-space speed limit over `horizon` [s], if it is larger.
    #[inline(always)]
    pub(crate) fn bound_null_speed<J: JointVector>(&self, null: J, horizon: f64) -> J {
        let highest = self.null_speed * horizon;
        if !J::splat(highest).is_any_lt(J::abs(null)) {
            return null;
        }
        null * J::splat(highest / J::Elem::max(J::abs(null).max_element(), highest))
    }
}
