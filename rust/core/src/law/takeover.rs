//! Redistribution: the other joints make the motion that a joint at its position limit cannot make.
//!
//! The task is solved with all joints. Only the motion that was cut off is solved again, without those joints. A joint
//! that just touches its limit loses no motion, so the command does not jump there.

use crate::command::goal::{Locks, scale_to_fit};
use crate::law::cap::Demand;
use crate::law::inverse::{factor_of, transpose_times, weighted_gram, wide};
use crate::number::{Arithmetic, Joints, Packed};
use crate::plan::Plan;
use crate::settings::{Follow, Law};
use crate::{AxisVec, MAX_AXES};

/// Motion that locked joints leave to the others.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Takeover<'a, J: Joints> {
    pub(crate) plan: &'a Plan,
    pub(crate) horizon: f64,
    /// Task rows of all joints.
    pub(crate) rows: &'a [J; MAX_AXES],
    /// 0 for locked joints, 1 for the others.
    pub(crate) free: J,
    /// Task motion that is missing, per row [m, rad].
    pub(crate) lost: &'a AxisVec,
    /// Softness of each row.
    pub(crate) softness: J::Axes,
    /// Torque that each joint already exerts [N·m].
    pub(crate) torque: J,
    /// Lead that each joint already has [rad].
    pub(crate) lead: J,
}

/// Additional motion of the other joints.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Addition<J: Joints> {
    /// [rad]
    lead: J,
    /// Wrench of the laws that are defined by forces [N, N·m].
    wrench: J::Axes,
}

impl<J: Joints> Takeover<'_, J> {
    /// Computes the additional motion. Soft rows keep their force and demand nothing more; ceilings and joint speeds
    /// hold.
    #[inline(always)]
    pub(crate) fn addition(&self) -> Addition<J> {
        let (plan, nothing) = (self.plan, J::Axes::splat(0.0));
        let squared = &plan.takeover_damping;
        let (mut lead, mut wrench) = if plan.law == Law::Paper && plan.follow == Follow::Hold {
            // Apply the damped pseudo-inverse of (3) to one vector without forming it.
            let weight = J::load(&plan.inverse_weight) * self.free;
            let factor = factor_of(self.rows, weight, squared);
            (weight * transpose_times(self.rows, &factor.solve::<J::One>(self.lost)), nothing)
        } else {
            let compliance = J::load(&plan.servos.compliance) * self.free;
            let demand = Demand {
                compliance: &weighted_gram(self.rows, compliance),
                damping: plan.per_stiffness(wide(squared)),
                step: wide(self.lost),
                bounded_step: wide(self.lost),
                softness: if plan.follow == Follow::Free { self.softness } else { nothing },
                cap: nothing,
            };
            let wrench = demand.stiff_force();
            (transpose_times(self.rows, &wrench.numbers()) * compliance, wrench)
        };
        let mut factor: f64 = 1.0;
        if plan.law.by_force() {
            let torque = lead * J::load(&plan.servos.kp);
            [factor] = scale_to_fit(self.torque * self.free, [torque], J::load(&plan.servos.torque));
        }
        let [slower] = scale_to_fit(self.lead * self.free, [lead], plan.reach(self.horizon));
        factor = factor.min(slower);
        lead = lead * J::splat(factor);
        wrench = if plan.law.by_force() { wrench * J::Axes::splat(factor) } else { nothing };
        Addition { lead, wrench }
    }
}

/// Parts of a motion that locked joints change.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Share<J: Joints> {
    /// [rad]
    pub(crate) lead: J,
    /// [rad]
    pub(crate) null: J,
    /// Wrench of the stiff axes [N, N·m].
    pub(crate) stiff: J::Axes,
}

impl<J: Joints> Share<J> {
    /// Returns the motion with locked joints at their remaining lead and the additional motion of the others.
    #[inline(always)]
    pub(crate) fn with(&self, locks: &Locks<J>, addition: &Addition<J>) -> Self {
        Self {
            lead: locks.either(locks.lead, self.lead + addition.lead),
            null: locks.either(J::splat(0.0), self.null),
            stiff: self.stiff + addition.wrench,
        }
    }
}
