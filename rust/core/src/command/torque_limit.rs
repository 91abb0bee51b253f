//! Joint torque limits: three rules that compute them, their bounds, and the rate limit of their rise.

use crate::law::activation::Activation;
use crate::math::simd::{JointVec16, JointVector, RealOps};
use crate::params::Params;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Terms of the torque limits; vectors in N·m, one entry per joint.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LimitTerms<J> {
    /// Gravity torques g that the limits include; 0 if the settings exclude gravity from the limits.
    pub(crate) gravity: J,
    /// Feed-forward of friction and damping.
    pub(crate) feed_forward: J,
    /// Torque of the task, `JᵀW′`, with the wrench W′ bounded by the strengths of the axes.
    pub(crate) task: J,
    /// Torque of the other parts of the goal: null space, stored lead z and prediction, `K_p (null + z + q̂ − q)`.
    pub(crate) offset: J,
    /// Factor s_g on the gravity torques.
    pub(crate) gravity_scale: f64,
    /// Margin m of the limits above the demand.
    pub(crate) margin: J,
}

impl<J: JointVector> LimitTerms<J> {
    /// Returns the limits of the rule `Demand`: the torque that the law demands in this step, at least `s_g |g|`, plus
    /// the margin.
    #[inline(always)]
    pub(crate) fn demand(&self) -> J {
        let wanted = self.gravity + self.task + self.feed_forward + self.offset;
        J::max(J::abs(wanted), J::splat(self.gravity_scale) * J::abs(self.gravity)) + self.margin
    }

    /// Returns the limits of law `paper`: the budgets τ^q, equation (11) of the paper, plus `s_g |g|`.
    #[inline(always)]
    pub(crate) fn budget(&self, budget: J) -> J {
        J::fma(J::splat(self.gravity_scale), J::abs(self.gravity), budget)
    }

    /// Returns the limits of the rule `Sum`, which adds up the largest demands of all axes j:
    /// `s_g |g_i| + Σ_j |J_ji| max_j + null_i + |ff_i|`.
    #[cold]
    #[inline(never)]
    pub(crate) fn sum(&self, rows: &Rows, max: &AxisVec, null: &JointVec) -> JointVec {
        let mut out = J::fma(J::splat(self.gravity_scale), J::abs(self.gravity), J::abs(self.feed_forward)).to_joints();
        for i in 0..MAX_JOINTS {
            out[i] += null[i];
            for r in 0..MAX_AXES {
                out[i] += rows[r][i].abs() * max[r];
            }
        }
        out
    }
}

/// Inputs of the rule `Sum`.
pub(crate) struct SumRuleInput {
    pub(crate) rows: Rows,
    pub(crate) gradient: JointVec,
    pub(crate) damping: f64,
    pub(crate) sigma: [f64; 2],
    pub(crate) max: AxisVec,
    pub(crate) gravity: JointVec16,
    pub(crate) feed_forward: JointVec16,
}

impl SumRuleInput {
    #[cold]
    #[inline(never)]
    pub(crate) fn sum(&self, params: &Params, gravity_scale: f64) -> JointVec {
        let Self { rows, gradient, .. } = self;
        let null = Activation::of_step(params, rows, gradient, self.damping, || self.sigma)
            .null()
            .map(|share| share * params.null_torque);
        let zero = JointVec16::splat(0.0);
        let load = LimitTerms {
            gravity: self.gravity,
            feed_forward: self.feed_forward,
            task: zero,
            offset: zero,
            gravity_scale,
            margin: zero,
        };
        load.sum(&self.rows, &self.max, &null)
    }
}

/// Clamps the `wanted` limits between `floor` and `ceiling`. They may exceed the limits `before` of the last step by at
/// most `rise` (`None`: by any amount) and may fall immediately.
#[inline(always)]
pub(crate) fn bound_and_slew<J: JointVector>(wanted: J, before: Option<J>, floor: J, ceiling: J, rise: J) -> J {
    let mut limit = J::min(wanted, ceiling);
    if let Some(before) = before {
        limit = J::min(limit, before + rise);
    }
    // Apply the floor after the bound on the rise, so that a raised floor takes effect immediately.
    J::min(J::max(limit, floor), ceiling)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::simd::{JointVec16, RealOps};

    #[test]
    fn limits_fall_at_once_and_rise_slowly() {
        let at = |wanted, before| {
            let [wanted, before, floor, ceiling, rise] = [wanted, before, 0.2, 10.0, 0.5].map(JointVec16::splat);
            bound_and_slew(wanted, Some(before), floor, ceiling, rise).to_joints()[0]
        };
        assert!((at(3.0, 8.0) - 3.0).abs() < 1e-15);
        assert!((at(8.0, 3.0) - 3.5).abs() < 1e-15);
        assert!((at(0.0, 3.0) - 0.2).abs() < 1e-15);
        assert!((at(80.0, 9.9) - 10.0).abs() < 1e-15);
    }
}
