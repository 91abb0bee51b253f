//! From a wrench to the goals' lead, within torque ceilings and joint speeds: shared by the laws that speak of forces.

use crate::command::goal::{clip, scale_to_fit};
use crate::law::inverse::transpose_times;
use crate::law::{Motion, Tick};
use crate::{AxisVec, JointVec, MAX_JOINTS};

/// Wrench on the target, in two parts that are scaled apart when a limit is met [N, N·m].
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Wrench {
    pub(crate) soft: AxisVec,
    pub(crate) stiff: AxisVec,
}

impl Tick<'_> {
    /// Goals' lead that exerts `wrench`, with `null` [rad] beside it; what does not fit gives way in its order.
    #[inline(always)]
    pub(crate) fn exert(&self, mut wrench: Wrench, mut null: JointVec) -> Motion {
        let plan = self.plan;
        let (k, n, servos) = (self.k, self.n.min(MAX_JOINTS), &plan.servos);
        self.bound_null(&mut null);

        // Torque ceilings: the soft part gives way first, then the stiff one, gravity never.
        let mut soft = transpose_times(self.rows, &wrench.soft, k, n);
        let mut stiff = transpose_times(self.rows, &wrench.stiff, k, n);
        let (mut base, mut feed_forward) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
        for i in 0..n {
            let lead = null[i] + self.integral[i];
            feed_forward[i] = self.resistance.under(i, clip(self.gravity[i] + soft[i] + stiff[i], servos.torque[i]));
            base[i] = self.gravity[i] + feed_forward[i] + servos.kp[i] * lead;
        }
        let [soft_torque, stiff_torque] = scale_to_fit(&base, [&soft, &stiff], &servos.torque, n);
        // Joint speeds: the null part first.
        for i in 0..n {
            soft[i] *= soft_torque * servos.compliance[i];
            stiff[i] *= stiff_torque * servos.compliance[i];
        }
        let reach = plan.reach(self.horizon, n);
        let [null_speed, soft_speed, stiff_speed] = scale_to_fit(&[0.0; MAX_JOINTS], [&null, &soft, &stiff], &reach, n);
        let factors = [null_speed, soft_torque * soft_speed, stiff_torque * stiff_speed];

        for i in 0..n {
            soft[i] *= soft_speed;
            stiff[i] *= stiff_speed;
            null[i] *= null_speed;
        }
        for r in 0..k {
            wrench.soft[r] *= factors[1];
            wrench.stiff[r] *= factors[2];
        }
        Motion { lead: stiff, force_lead: soft, null, wrench, factors, feed_forward, gain_factor: plan.kx_derating }
    }

    /// Scales the null-space motion to its torque, `Σ k_p |null| ≤ τ₀`, and to its speed limit.
    #[inline(always)]
    fn bound_null(&self, null: &mut JointVec) {
        let plan = self.plan;
        let n = self.n.min(MAX_JOINTS);
        let torque: f64 = (0..n).map(|i| plan.servos.kp[i] * null[i].abs()).sum();
        if torque > plan.null_torque {
            let scale = plan.null_torque / torque;
            for i in 0..n {
                null[i] *= scale;
            }
        }
        plan.bound_null_speed(null, self.horizon, n);
    }
}
