//! Lead of the goals for a wrench, within torque ceilings and joint speeds: shared by the laws that are defined by
//! forces.

use crate::law::friction::Resistance;
use crate::law::scaling::scale_to_fit;
use crate::law::{Motion, Tick};
use crate::math::rows::transpose_times;
use crate::math::simd::{Arithmetic, Axes, Lanes, Spread};

/// Wrench on the target [N, N·m], in two parts that are scaled separately at a limit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wrench<W> {
    pub(crate) soft: W,
    pub(crate) stiff: W,
}

impl<W: Axes> Wrench<W> {
    /// Zero wrench.
    #[inline(always)]
    pub(crate) fn none() -> Self {
        Self { soft: W::splat(0.0), stiff: W::splat(0.0) }
    }

    /// Returns the sum of both parts.
    #[inline(always)]
    pub(crate) fn whole(&self) -> W {
        self.soft + self.stiff
    }
}

impl<J: Lanes> Tick<'_, J> {
    /// Returns the lead of the goals that exerts `wrench`, plus `null` [rad]; if it exceeds the limits, the parts are
    /// reduced in the order below.
    #[inline(always)]
    pub(crate) fn exert(&self, wrench: Wrench<J::Axes>, null: J, resistance: Resistance<J>) -> Motion<J> {
        let (plan, servos) = (self.plan, &self.plan.servos);
        let null = self.bound_null(null);
        let (kp, compliance, torque) = (J::load(&servos.kp), J::load(&servos.compliance), J::load(&servos.torque));

        // Torque ceilings: reduce the soft part first, then the stiff part, gravity never.
        let soft = transpose_times(self.rows, &wrench.soft.axes());
        let stiff = transpose_times(self.rows, &wrench.stiff.axes());
        let feed_forward = resistance.under(J::clip(self.gravity + soft + stiff, torque));
        let base = J::fma(kp, null + self.integral, self.gravity + feed_forward);
        let [soft_torque, stiff_torque] = scale_to_fit(base, [soft, stiff], torque);
        // Joint speeds: reduce the null-space part first.
        let (soft, stiff) = (soft * compliance * J::spread(soft_torque), stiff * compliance * J::spread(stiff_torque));
        let [null_speed, soft_speed, stiff_speed] =
            scale_to_fit(J::splat(0.0), [null, soft, stiff], plan.reach(self.horizon));
        let factors = [null_speed, soft_torque * soft_speed, stiff_torque * stiff_speed];
        Motion {
            lead: stiff * J::spread(stiff_speed),
            force_lead: soft * J::spread(soft_speed),
            null: null * J::spread(null_speed),
            wrench: Wrench {
                soft: wrench.soft * J::Axes::spread(factors[1]),
                stiff: wrench.stiff * J::Axes::spread(factors[2]),
            },
            factors,
            feed_forward,
            gain_factor: J::One::splat(plan.kx_derating),
        }
    }

    /// Scales the null-space motion to its torque, `Σ k_p |null| ≤ τ₀`, and to its speed limit.
    #[inline(always)]
    fn bound_null(&self, null: J) -> J {
        let plan = self.plan;
        let torque = (J::load(&plan.servos.kp) * J::abs(null)).sum();
        let most = J::One::splat(plan.null_torque);
        let null = if J::One::less_anywhere(most, torque) {
            null * J::spread(most / J::One::at_least(torque, most))
        } else {
            null
        };
        plan.bound_null_speed(null, self.horizon)
    }
}
