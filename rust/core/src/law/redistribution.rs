//! Redistribution: the other joints make the motion that a joint at its position limit cannot make.
//!
//! The task is solved with all joints. Only the motion that was cut off is solved again, without those joints. A joint
//! that just touches its limit loses no motion, so the command does not jump there.

use crate::law::cap::Demand;
use crate::law::scaling::scale_to_fit;
use crate::law::{Motion, Tick};
use crate::math::ldlt6::factor_of;
use crate::math::rows::{times, transpose_times, weighted_gram, wide};
use crate::math::simd::{Arithmetic, Joints, Lanes, Packed};
use crate::params::{Follow, Law, Plan};
use crate::task::Seen;
use crate::{AxisVec, MAX_AXES, MAX_JOINTS, Rows};

/// Joints that have reached a position limit.
#[derive(Clone, Copy)]
struct Locks<J> {
    /// 1 for locked joints, 0 for the others.
    locked: J,
    /// Lead that brings each locked joint to its limit [rad].
    lead: J,
}

impl<J: Lanes> Locks<J> {
    /// No locked joints.
    #[inline(always)]
    fn none() -> Self {
        Self { locked: J::splat(0.0), lead: J::splat(0.0) }
    }

    /// Adds the joints whose `goal` exceeds a limit; returns true if there were any.
    ///
    /// A locked joint keeps the lead to its limit, and the others make the missing motion, so that the rest of the task
    /// stays correct. It is not unlocked within a step.
    #[inline(always)]
    fn add(&mut self, goal: J, without_lead: J, lower: J, upper: J) -> bool {
        let (zero, one) = (J::splat(0.0), J::splat(1.0));
        let beyond = J::if_less(upper, goal, one, J::if_less(goal, lower, one, zero));
        let new = beyond * (one - self.locked);
        if !zero.any_less(new) {
            return false;
        }
        let lead = J::at_least(J::at_most(goal, upper), lower) - without_lead;
        self.lead = J::if_less(zero, new, lead, self.lead);
        self.locked = self.locked + new;
        true
    }

    /// Selects `value` for locked joints, `other` for the rest.
    #[inline(always)]
    fn either(&self, value: J, other: J) -> J {
        J::if_less(J::splat(0.0), self.locked, value, other)
    }
}

/// Motion that locked joints leave to the others.
#[derive(Debug, Clone, Copy)]
struct Takeover<'a, J: Joints> {
    plan: &'a Plan,
    horizon: f64,
    /// Task rows of all joints.
    rows: &'a [J; MAX_AXES],
    /// 0 for locked joints, 1 for the others.
    free: J,
    /// Task motion that is missing, per row [m, rad].
    lost: &'a AxisVec,
    /// Softness of each row.
    softness: J::Axes,
    /// Torque that each joint already exerts [N·m].
    torque: J,
    /// Lead that each joint already has [rad].
    lead: J,
}

/// Additional motion of the other joints.
#[derive(Debug, Clone, Copy)]
struct Addition<J: Joints> {
    /// [rad]
    lead: J,
    /// Wrench of the laws that are defined by forces [N, N·m].
    wrench: J::Axes,
}

impl<J: Joints> Takeover<'_, J> {
    /// Computes the additional motion. Soft rows keep their force and demand nothing more; ceilings and joint speeds
    /// hold.
    #[inline(always)]
    fn addition(&self) -> Addition<J> {
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
struct Share<J: Joints> {
    /// [rad]
    lead: J,
    /// [rad]
    null: J,
    /// Wrench of the stiff axes [N, N·m].
    stiff: J::Axes,
}

impl<J: Joints> Share<J> {
    /// Returns the motion with locked joints at their remaining lead and the additional motion of the others.
    #[inline(always)]
    fn with(&self, locks: &Locks<J>, addition: &Addition<J>) -> Self {
        Self {
            lead: locks.either(locks.lead, self.lead + addition.lead),
            null: locks.either(J::splat(0.0), self.null),
            stiff: self.stiff + addition.wrench,
        }
    }
}

/// Locks the joints that would exceed their position limits until no other joint does, and changes `motion` accordingly.
/// Returns the goals without force offsets [rad], and 1 for locked joints, 0 for the others.
#[inline(always)]
pub(crate) fn redistribute<J: Joints>(
    tick: &Tick<'_, J>,
    seen: &Seen<'_, J>,
    feed_forward: J,
    motion: &mut Motion<J>,
) -> (J, J) {
    let plan = tick.plan;
    let all_joints = Share { lead: motion.lead, null: motion.null, stiff: motion.wrench.stiff };
    let (without_lead, nothing) = (seen.q + tick.integral, J::splat(0.0));
    let (lower, upper) = (J::load(&plan.lower), J::load(&plan.upper));
    let all = all_joints.lead + all_joints.null;
    let lead = all + motion.force_lead;
    let carried = seen.gravity_in_goal + feed_forward;
    let torque = J::fma(J::load(&plan.servos.kp), tick.integral + lead, carried);
    let (mut share, mut locks) = (all_joints, Locks::none());
    loop {
        let goal = without_lead + share.lead + share.null;
        if !locks.add(goal, without_lead, lower, upper) {
            (motion.lead, motion.null, motion.wrench.stiff) = (share.lead, share.null, share.stiff);
            return (goal, locks.locked);
        }
        let takeover = Takeover {
            plan,
            horizon: tick.horizon,
            rows: seen.rows,
            free: J::splat(1.0) - locks.locked,
            lost: &times(seen.rows, locks.either(all - locks.lead, nothing)),
            softness: tick.wish.softness,
            torque,
            lead,
        };
        share = all_joints.with(&locks, &takeover.addition());
    }
}

/// Task rows, columns of locked joints zero.
pub(crate) fn without_locked(rows: &Rows, locked: &[bool; MAX_JOINTS]) -> Rows {
    let mut free = *rows;
    for row in &mut free {
        for (value, &locked) in row.iter_mut().zip(locked) {
            *value = if locked { 0.0 } else { *value };
        }
    }
    free
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MAX_JOINTS;
    use crate::math::simd::{Arithmetic, EveryJoint};

    fn vector(values: &[f64]) -> EveryJoint {
        let mut out = [0.0; MAX_JOINTS];
        out[..values.len()].copy_from_slice(values);
        EveryJoint::load(&out)
    }

    #[test]
    fn a_locked_joint_keeps_the_lead_to_its_limit() {
        let (without, one) = (vector(&[0.7, 0.2, -0.7]), EveryJoint::splat(1.0));
        let mut locks = Locks::none();
        assert!(locks.add(vector(&[1.2, 0.3, 0.5]), without, -one, one));
        assert!(!locks.add(vector(&[1.3, 0.3, 0.5]), without, -one, one), "locked already");
        assert!(locks.add(vector(&[1.0, 0.3, -1.5]), without, -one, one), "another joint");
        let lead = locks.lead.array();
        assert_eq!(locks.locked.array()[..3].iter().map(|l| *l > 0.0).collect::<Vec<_>>(), [true, false, true]);
        assert!((lead[0] - 0.3).abs() < 1e-15 && lead[1].abs() < 1e-15 && (lead[2] + 0.3).abs() < 1e-15);
        let either = locks.either(vector(&[5.0; 3]), vector(&[7.0; 3])).array();
        assert_eq!(either[..3].iter().map(|l| *l > 6.0).collect::<Vec<_>>(), [false, true, false]);
    }
}
