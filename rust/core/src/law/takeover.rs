//! What a joint at its position limit cannot do, the others take over.
//!
//! The task is solved with all joints; then only the motion that was cut off is solved for anew, without those joints. A
//! joint that just touches its limit loses nothing, so nothing jumps when it gets there.

use crate::command::goal::scale_to_fit;
use crate::law::cap::Demand;
use crate::law::inverse::{Factor, axes, damped, load_rows, transpose_times, weighted_gram, wide};
use crate::number::{Arithmetic, EveryJoint, Lanes};
use crate::plan::Plan;
use crate::settings::{Follow, Law};
use crate::{AxisVec, JointVec, MAX_JOINTS, Rows};

type Axes = <EveryJoint as Lanes>::Axes;
type One = <EveryJoint as Lanes>::One;

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
    pub(crate) softness: Axes,
    /// Torque that every joint gives already [N·m]; 0 for locked ones.
    pub(crate) torque: EveryJoint,
    /// Lead that every joint has already [rad]; 0 for locked ones.
    pub(crate) lead: EveryJoint,
}

/// What the others do in addition.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Addition {
    /// [rad]
    lead: EveryJoint,
    /// Wrench of the laws that speak of forces [N, N·m].
    wrench: Axes,
}

impl Takeover<'_> {
    /// Soft rows keep their force and ask for nothing where they are free; ceilings and joint speeds hold.
    pub(crate) fn addition(&self) -> Addition {
        let plan = self.plan;
        let squared = plan.damping_scale.map(|scale| scale * plan.takeover_damping);
        let compliance = EveryJoint::load(&plan.servos.compliance);
        let (mut lead, mut wrench) = if plan.law == Law::Paper && plan.follow == Follow::Hold {
            // The damped pseudo-inverse of (3), of which one product is wanted and not the whole.
            let (rows, weight) = (load_rows(self.rows), EveryJoint::load(&plan.joint_weight));
            let factor = Factor::new::<One>(&damped(weighted_gram(&rows, weight), &squared));
            (weight * transpose_times(&rows, &factor.solve::<One>(self.lost)), Axes::splat(0.0))
        } else {
            let rows = load_rows(self.rows);
            let demand = Demand {
                compliance: &weighted_gram(&rows, compliance),
                damping: plan.per_stiffness(wide(&squared)),
                step: wide(self.lost),
                bounded_step: wide(self.lost),
                softness: if plan.follow == Follow::Free { self.softness } else { Axes::splat(0.0) },
                cap: Axes::splat(0.0),
            };
            let wrench = demand.stiff_force();
            (transpose_times(&rows, &axes(wrench)) * compliance, wrench)
        };
        let mut factor: f64 = 1.0;
        if plan.law.by_force() {
            let torque = lead * EveryJoint::load(&plan.servos.kp);
            [factor] = scale_to_fit(self.torque, [torque], EveryJoint::load(&plan.servos.torque));
        }
        let [slower] = scale_to_fit(self.lead, [lead], plan.reach(self.horizon));
        factor = factor.min(slower);
        lead = lead * EveryJoint::splat(factor);
        wrench = if plan.law.by_force() { wrench * Axes::splat(factor) } else { Axes::splat(0.0) };
        Addition { lead, wrench }
    }
}

/// What of a motion locked joints change.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Share {
    /// [rad]
    pub(crate) lead: EveryJoint,
    /// [rad]
    pub(crate) null: EveryJoint,
    /// Wrench of the stiff axes [N, N·m].
    pub(crate) stiff: Axes,
}

impl Share {
    /// With locked joints at their `fixed` lead and what the others do instead.
    pub(crate) fn with(&self, locked: &[bool; MAX_JOINTS], fixed: &JointVec, addition: &Addition) -> Self {
        let (mut lead, mut null) = ((self.lead + addition.lead).array(), self.null.array());
        for i in 0..MAX_JOINTS {
            if locked[i] {
                (lead[i], null[i]) = (fixed[i], 0.0);
            }
        }
        Self { lead: EveryJoint::load(&lead), null: EveryJoint::load(&null), stiff: self.stiff + addition.wrench }
    }
}
