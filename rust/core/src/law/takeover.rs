//! What a joint at its position limit cannot do, the others take over.
//!
//! The task is solved with all joints; then only the motion that was cut off is solved for anew, without those joints. A
//! joint that just touches its limit loses nothing, so nothing jumps when it gets there.

use crate::command::goal::scale_to_fit;
use crate::law::Motion;
use crate::law::cap::Demand;
use crate::law::inverse::{pseudo_inverse, transpose_times, weighted_gram};
use crate::plan::Plan;
use crate::settings::{Follow, Law};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// The motion that locked joints leave to the others.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Takeover<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) horizon: f64,
    /// Task rows, columns of locked joints zero.
    pub(crate) rows: &'a Rows,
    /// What the task has lost, per row [m, rad].
    pub(crate) lost: &'a AxisVec,
    /// Softness of each row.
    pub(crate) softness: &'a AxisVec,
    /// Torque that every joint gives already [N·m]; 0 for locked ones.
    pub(crate) torque: &'a JointVec,
    /// Lead that every joint has already [rad]; 0 for locked ones.
    pub(crate) lead: &'a JointVec,
}

/// What the others do in addition.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Addition {
    /// [rad]
    pub(crate) lead: JointVec,
    /// Wrench of the laws that speak of forces [N, N·m].
    pub(crate) wrench: AxisVec,
}

impl Takeover<'_> {
    /// Soft rows keep their force and ask for nothing where they are free; ceilings and joint speeds hold.
    #[cold]
    #[inline(never)]
    pub(crate) fn addition(&self) -> Addition {
        let plan = self.plan;
        let (k, n) = (plan.k, plan.n);
        let squared = plan.damping_scale.map(|scale| scale * plan.takeover_damping);
        let (mut lead, mut wrench) = if plan.law == Law::Paper && plan.follow == Follow::Hold {
            let pinv = pseudo_inverse(self.rows, &plan.joint_weight, &squared, k, n);
            (transpose_times(&pinv, self.lost, k, n), [0.0; MAX_AXES])
        } else {
            let rows_that_yield = if plan.follow == Follow::Free { *self.softness } else { [0.0; MAX_AXES] };
            let demand = Demand {
                compliance: &weighted_gram(self.rows, &plan.servos.compliance, k, n),
                damping: &squared.map(|squared| squared / plan.servos.kp_mean),
                step: self.lost,
                bounded_step: self.lost,
                softness: &rows_that_yield,
                cap: &[0.0; MAX_AXES],
            };
            let wrench = demand.stiff_force(k);
            let mut lead = transpose_times(self.rows, &wrench, k, n);
            (0..MAX_JOINTS).for_each(|i| lead[i] *= plan.servos.compliance[i]);
            (lead, wrench)
        };
        let mut factor: f64 = 1.0;
        if plan.law.by_force() {
            let mut torque = lead;
            (0..MAX_JOINTS).for_each(|i| torque[i] *= plan.servos.kp[i]);
            [factor] = scale_to_fit(self.torque, [&torque], &plan.servos.torque, n);
        }
        let reach = plan.joint_speed.map(|speed| speed * self.horizon);
        let [slower] = scale_to_fit(self.lead, [&lead], &reach, n);
        factor = factor.min(slower);
        lead.iter_mut().chain(&mut wrench).for_each(|value| *value *= factor);
        Addition { lead, wrench: if plan.law.by_force() { wrench } else { [0.0; MAX_AXES] } }
    }
}

impl Motion {
    /// The motion with locked joints at their `fixed` lead and what the others do instead.
    #[cold]
    pub(crate) fn with(&self, locked: &[bool; MAX_JOINTS], fixed: &JointVec, addition: &Addition) -> Self {
        let mut out = *self;
        for i in 0..MAX_JOINTS {
            if locked[i] {
                (out.lead[i], out.null[i]) = (fixed[i], 0.0);
            } else {
                out.lead[i] += addition.lead[i];
            }
        }
        for (value, more) in out.wrench.stiff.iter_mut().zip(addition.wrench) {
            *value += more;
        }
        out
    }
}
