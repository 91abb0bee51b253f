//! The integrating goal of stiff axes, with anti-windup.

use crate::math::ldlt6::Factor;
use crate::math::rows::{damped, load_rows, times, transpose_times, weighted_gram};
use crate::math::simd::{Arithmetic, EveryJoint, Lanes, Plain};
use crate::params::Plan;
use crate::{AxisVec, JointVec, Rows};

/// Lead [rad] that may be stored without known servos.
const LEAD_UNKNOWN: f64 = 0.3;

/// Addition of one step to the stored lead.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Addition<'a> {
    /// Lead of the stiff axes and of the null space [rad].
    pub(crate) lead: &'a JointVec,
    /// Share of the lead that is stored: rate × dt.
    pub(crate) share: f64,
    /// Gravity in the limits, with its factor [N·m].
    pub(crate) gravity: &'a JointVec,
    /// Softness of each axis.
    pub(crate) softness: &'a AxisVec,
    /// Task rows.
    pub(crate) rows: &'a Rows,
    /// λ² of each row.
    pub(crate) damping: &'a AxisVec,
}

impl Addition<'_> {
    /// Adds to `stored` [rad] and removes the part that would act on soft axes: these store nothing. If strengths are
    /// forces, also removes the part that exceeds the strength of the stiff axes.
    pub(crate) fn store(&self, stored: &mut JointVec, plan: &Plan) {
        let (k, n, servos) = (plan.k, plan.n, &plan.servos);
        for i in 0..n {
            let room = servos.torque[i] - self.gravity[i].abs();
            let usable = room.is_finite() && servos.has_kp;
            let leash = if usable { room.max(0.0) * servos.compliance[i] } else { LEAD_UNKNOWN };
            stored[i] = Plain::clip(stored[i] + self.share * self.lead[i], leash);
        }
        let by_force = plan.law.by_force();
        if !by_force && self.softness.iter().all(|&w| w <= 0.0) {
            return;
        }
        // Wrench that the stored lead exerts, W = (C + λ²/k̄)⁻¹ J z, minus the part that may stay.
        let (rows, compliance) = (load_rows(self.rows), EveryJoint::load(&servos.compliance));
        let c = damped(weighted_gram(&rows, compliance), &self.damping.map(|squared| squared / servos.kp_mean));
        let mut wrench = Factor::new::<Plain>(&c).solve::<Plain>(&times(&rows, EveryJoint::load(stored)));
        for (r, row) in plan.rows.iter().enumerate().take(k) {
            let most = if by_force { row.hold } else { f64::INFINITY };
            wrench[r] -= (1.0 - self.softness[r]) * wrench[r].clamp(-most, most);
        }
        let torque = transpose_times(&rows, &wrench).array();
        (0..n).for_each(|i| stored[i] -= servos.compliance[i] * torque[i]);
    }
}
