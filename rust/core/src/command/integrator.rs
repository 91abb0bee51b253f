//! Integral action of the stiff axes: their lead (goal − q) accumulates in a stored lead of the goals, with
//! anti-windup.

use crate::command::DEFAULT_OFFSET_LIMIT;
use crate::math::ldlt6::Ldlt6;
use crate::math::rows::{damped, load_rows, mul, tr_mul, weighted_gram};
use crate::math::simd::{BaselineF64, JointVec16, JointVector, RealOps};
use crate::params::Params;
use crate::{AxisVec, JointVec, Rows};

/// Inputs with which one step updates the stored lead.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Integrator<'a> {
    /// Lead of the stiff axes and of the null space in this step [rad].
    pub(crate) offset: &'a JointVec,
    /// Share of `offset` that is added to the stored lead: `Tracking::integrate` times dt.
    pub(crate) share: f64,
    /// Gravity torques times their factor s_g in the limits [N·m].
    pub(crate) gravity: &'a JointVec,
    /// Softness w of each task axis, 0 (stiff) to 1 (soft).
    pub(crate) softness: &'a AxisVec,
    /// Task rows of the Jacobian.
    pub(crate) rows: &'a Rows,
    /// Damping λ² of each task row.
    pub(crate) damping: &'a AxisVec,
}

impl Integrator<'_> {
    /// Adds `share` of the lead of this step to `stored` [rad], then removes the part that acts on soft axes. Under the
    /// laws `cap` and `impedance`, also removes the part that exerts more than `hold` on stiff axes.
    pub(crate) fn update(&self, stored: &mut JointVec, params: &Params) {
        let (k, n, servos) = (params.k, params.n, &params.servos);
        for i in 0..n {
            let room = servos.torque[i] - self.gravity[i].abs();
            let usable = room.is_finite() && servos.has_kp;
            let anti_windup_limit = if usable { room.max(0.0) * servos.compliance[i] } else { DEFAULT_OFFSET_LIMIT };
            stored[i] = BaselineF64::clamp_abs(stored[i] + self.share * self.offset[i], anti_windup_limit);
        }
        let by_force = params.law.by_force();
        if !by_force && self.softness.iter().all(|&w| w <= 0.0) {
            return;
        }
        // The stored lead z exerts the wrench W = (C + λ²/k̄)⁻¹ J z, with the compliance C = J K_p⁻¹ Jᵀ, the damping λ²
        // and the mean stiffness k̄. Remove all of W except the part that may stay.
        let (rows, compliance) = (load_rows(self.rows), JointVec16::load(&servos.compliance));
        let c = damped(weighted_gram(&rows, compliance), &self.damping.map(|squared| squared / servos.kp_mean));
        let mut wrench = Ldlt6::new::<BaselineF64>(&c).solve::<BaselineF64>(&mul(&rows, JointVec16::load(stored)));
        for (r, row) in params.per_axis.iter().enumerate().take(k) {
            let max = if by_force { row.hold } else { f64::INFINITY };
            wrench[r] -= (1.0 - self.softness[r]) * wrench[r].clamp(-max, max);
        }
        let torque = tr_mul(&rows, &wrench).to_joints();
        (0..n).for_each(|i| stored[i] -= servos.compliance[i] * torque[i]);
    }
}
