//! The lead (goal − q) that exerts a wrench at the tool, within the limits of torque and joint speed; for the laws
//! `cap` and `impedance`.

use crate::law::scaling::scale_to_fit;
use crate::law::{ControlLaw, LawInput, LawOutput};
use crate::math::rows::{Mat6, tr_mul};
use crate::math::simd::{F64x8, JointVector, RealOps};

/// Wrench on the tool in task axes [N, N·m], in two parts, which torque and speed limits reduce separately.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wrench<W> {
    /// Part on the axes that yield.
    pub(crate) soft: W,
    /// Part on the axes that do not yield.
    pub(crate) stiff: W,
}

impl<W: F64x8> Wrench<W> {
    /// Returns a zero wrench.
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        Self { soft: W::splat(0.0), stiff: W::splat(0.0) }
    }

    /// Returns the sum of both parts.
    #[inline(always)]
    pub(crate) fn total(&self) -> W {
        self.soft + self.stiff
    }
}

/// Result of a law that computes a wrench.
#[derive(Debug, Clone, Copy)]
pub(crate) struct WrenchDemand<J: JointVector> {
    /// Wrench that the servos are to exert.
    pub(crate) wrench: Wrench<J::Axes>,
    /// Joint speeds [rad/s] at the velocity of the reference, toward which friction acts on joints at rest.
    pub(crate) ahead: J,
    /// Stiffness of the null-space motion; `None`: its speed is proportional to the gradient.
    pub(crate) null_stiffness: Option<f64>,
    /// Factor ≤ 1 on the gain of the stiff axes, required by delay and pose.
    pub(crate) gain_factor: f64,
}

/// A law that computes a wrench at the tool; [`LawInput::joint_offsets`] computes the leads that exert it.
pub(crate) trait WrenchLaw: ControlLaw {
    /// Returns the wrench of one step, not yet scaled to the usable torques and the speed limits. `compliance` is
    /// `C = J K_p⁻¹ Jᵀ` [m/N, rad/(N·m)].
    fn wrench<J: JointVector>(input: &LawInput<'_, J>, compliance: &Mat6) -> WrenchDemand<J>;
}

impl<J: JointVector> LawInput<'_, J> {
    /// Returns the lead of the goals [rad] that exerts the wrench of `demand`, plus the null-space motion. To keep the
    /// joint speed limits, the null-space part is reduced first, then the soft, then the stiff part; to keep the usable
    /// torques, the soft, then the stiff part.
    #[inline(always)]
    pub(crate) fn joint_offsets(&self, demand: &WrenchDemand<J>) -> LawOutput<J> {
        let (params, servos) = (self.params, &self.params.servos);
        let mut wrench = demand.wrench;
        if self.features.tool_speed
            && let Some(overspeed) = &self.pacing.overspeed
        {
            wrench = Wrench { soft: overspeed.limit(wrench.soft), stiff: overspeed.limit(wrench.stiff) };
        }
        let null = self.bound_null(self.null_motion(demand.null_stiffness));
        let friction = self.friction(demand.ahead);
        let (kp, compliance, torque) = (J::load(&servos.kp), J::load(&servos.compliance), J::load(&servos.torque));

        // Usable torques: reduce the soft part first, then the stiff part; never gravity.
        let soft = tr_mul(self.rows, &wrench.soft.to_axes());
        let stiff = tr_mul(self.rows, &wrench.stiff.to_axes());
        let mut feed_forward = friction.at_load(J::clamp_abs(self.gravity + soft + stiff, torque));
        if servos.estimated {
            feed_forward = feed_forward * J::splat(self.opposed_motion(demand.ahead, wrench.soft).share(feed_forward));
        }
        let base = J::fma(kp, null + self.integral, self.gravity + feed_forward);
        let [soft_torque, stiff_torque] = scale_to_fit(base, [soft, stiff], torque);
        // Joint speeds: reduce the null-space part first, then the soft, then the stiff part.
        let (soft, stiff) = (soft * J::splat(soft_torque), stiff * J::splat(stiff_torque));
        let [null_speed, soft_speed, stiff_speed] =
            scale_to_fit(J::splat(0.0), [null, soft * compliance, stiff * compliance], params.reach(self.horizon));
        let factors = [null_speed, soft_torque * soft_speed, stiff_torque * stiff_speed];
        let (soft, stiff) = (soft * J::splat(soft_speed), stiff * J::splat(stiff_speed));
        LawOutput {
            stiff_offset: stiff * compliance,
            soft_offset: soft * compliance,
            null: null * J::splat(null_speed),
            torque: soft + stiff,
            wrench: Wrench {
                soft: wrench.soft * J::Axes::splat(factors[1]),
                stiff: wrench.stiff * J::Axes::splat(factors[2]),
            },
            factors,
            feed_forward,
            gain_factor: demand.gain_factor,
        }
    }

    /// Scales the null-space motion [rad] to its bound on the total torque, `Σ k_p |null| ≤ τ₀`, and to its speed
    /// limit.
    #[inline(always)]
    fn bound_null(&self, null: J) -> J {
        let params = self.params;
        let torque = (J::load(&params.servos.kp) * J::abs(null)).sum();
        let max = params.null_torque;
        let null = if torque > max { null * J::splat(max / torque) } else { null };
        params.bound_null_speed(null, self.horizon)
    }
}
