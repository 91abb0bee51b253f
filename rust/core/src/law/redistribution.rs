//! Redistribution of the motion that joints at their position limits cannot make to the other joints.
//!
//! The law solves the task with all joints. The motion that position limits cut off is solved again without the joints
//! at their limits. A joint that just reaches its limit loses no motion, so the command is continuous there.

use crate::law::cap::CapProblem;
use crate::law::scaling::scale_to_fit;
use crate::law::{LawInput, LawOutput};
use crate::math::ldlt6::factor_gram;
use crate::math::rows::{mul, tr_mul, weighted_gram};
use crate::math::simd::{F64x8, JointVector, RealOps};
use crate::params::{Follow, Law, Params};
use crate::task::ArmState;
use crate::{AxisVec, MAX_AXES, MAX_JOINTS, Rows};

/// Joints whose goals have reached a position limit.
#[derive(Clone, Copy)]
struct JointLocks<J> {
    /// 1 for locked joints, 0 for the others.
    locked: J,
    /// Lead (goal − q) that puts the goal of each locked joint at its limit [rad].
    offset: J,
}

impl<J: JointVector> JointLocks<J> {
    /// Returns a state without locked joints.
    #[inline(always)]
    fn none() -> Self {
        Self { locked: J::splat(0.0), offset: J::splat(0.0) }
    }

    /// Locks the joints whose `goal` [rad] exceeds a position limit; returns false if this locks no further joint.
    ///
    /// The lead of a locked joint becomes its limit minus `without_lead`. A joint stays locked for the rest of the
    /// step.
    #[inline(always)]
    fn lock_violations(&mut self, goal: J, without_lead: J, lower: J, upper: J) -> bool {
        let (zero, one) = (J::splat(0.0), J::splat(1.0));
        let violates = J::select_lt(upper, goal, one, J::select_lt(goal, lower, one, zero));
        let new = violates * (one - self.locked);
        if !zero.is_any_lt(new) {
            return false;
        }
        let offset = J::max(J::min(goal, upper), lower) - without_lead;
        self.offset = J::select_lt(zero, new, offset, self.offset);
        self.locked = self.locked + new;
        true
    }

    /// Returns `value` for locked joints and `other` for the rest.
    #[inline(always)]
    fn select(&self, value: J, other: J) -> J {
        J::select_lt(J::splat(0.0), self.locked, value, other)
    }
}

/// Inputs for the motion that the unlocked joints make in place of the locked ones.
#[derive(Debug, Clone, Copy)]
struct Redistribution<'a, J: JointVector> {
    params: &'a Params,
    /// Horizon h [s].
    horizon: f64,
    /// Jacobian rows of the task axes, all joints.
    rows: &'a [J; MAX_AXES],
    /// 0 for locked joints, 1 for the others.
    unlocked: J,
    /// Task motion that the limits cut off, per row [m, rad].
    missing: &'a AxisVec,
    /// Softness w of each row, 0 to 1.
    softness: J::Axes,
    /// Torque that each joint already exerts [N·m], gravity included.
    torque: J,
    /// Lead that each joint already has [rad].
    offset: J,
}

/// Additional motion of the joints that are not locked.
#[derive(Debug, Clone, Copy)]
struct Correction<J: JointVector> {
    /// Additional lead of the goals [rad].
    offset: J,
    /// Wrench that the additional lead exerts [N, N·m]; 0 under law `paper`.
    wrench: J::Axes,
}

impl<J: JointVector> Redistribution<'_, J> {
    /// Computes the additional motion, within the usable torques and the joint speeds. Under [`Follow::Free`], soft
    /// rows keep their force and require no motion.
    #[inline(always)]
    fn correction(&self) -> Correction<J> {
        let (params, zero) = (self.params, J::Axes::splat(0.0));
        let squared = &params.redistribution_damping;
        let (mut offset, mut wrench) = if params.law == Law::Paper && params.follow == Follow::Hold {
            // Apply the damped pseudo-inverse to one vector without forming it.
            let weight = J::load(&params.joint_weight_inv) * self.unlocked;
            let factor = factor_gram(self.rows, weight, squared);
            (weight * tr_mul(self.rows, &factor.solve::<J::Elem>(self.missing)), zero)
        } else {
            let compliance = J::load(&params.servos.compliance) * self.unlocked;
            let problem = CapProblem {
                compliance: &weighted_gram(self.rows, compliance),
                damping: params.per_stiffness(J::Axes::from_axes(squared)),
                step: J::Axes::from_axes(self.missing),
                bounded_step: J::Axes::from_axes(self.missing),
                softness: if params.follow == Follow::Free { self.softness } else { zero },
                cap: zero,
            };
            let wrench = problem.stiff_force();
            (tr_mul(self.rows, &wrench.to_axes()) * compliance, wrench)
        };
        let mut factor: f64 = 1.0;
        if params.law.by_force() {
            let torque = offset * J::load(&params.servos.kp);
            [factor] = scale_to_fit(self.torque, [torque], J::load(&params.servos.torque));
        }
        let [slower] = scale_to_fit(self.offset, [offset], params.reach(self.horizon));
        factor = factor.min(slower);
        offset = offset * J::splat(factor);
        wrench = if params.law.by_force() { wrench * J::Axes::splat(factor) } else { zero };
        Correction { offset, wrench }
    }
}

/// Parts of the law's motion that locking joints changes.
#[derive(Debug, Clone, Copy)]
struct MotionParts<J: JointVector> {
    /// Lead of the goals that moves the arm [rad].
    offset: J,
    /// Null-space part of the goals [rad].
    null: J,
    /// Wrench on the stiff axes [N, N·m].
    stiff: J::Axes,
}

impl<J: JointVector> MotionParts<J> {
    /// Returns the motion in which locked joints go to their limits and the others add `correction`.
    #[inline(always)]
    fn with(&self, locks: &JointLocks<J>, correction: &Correction<J>) -> Self {
        Self {
            offset: locks.select(locks.offset, self.offset + correction.offset),
            null: locks.select(J::splat(0.0), self.null),
            stiff: self.stiff + correction.wrench,
        }
    }
}

/// Locks joints and redistributes their motion, repeatedly, until no goal exceeds its position limit; updates the parts
/// of `motion`. Returns the goals without force offsets [rad], and a mask: 1 for locked joints, 0 for the others.
#[inline(always)]
pub(crate) fn redistribute<J: JointVector>(
    input: &LawInput<'_, J>,
    arm: &ArmState<'_, J>,
    feed_forward: J,
    motion: &mut LawOutput<J>,
) -> (J, J) {
    let params = input.params;
    let all_joints = MotionParts { offset: motion.stiff_offset, null: motion.null, stiff: motion.wrench.stiff };
    let (without_lead, zero) = (arm.q + input.integral, J::splat(0.0));
    let (lower, upper) = (J::load(&params.lower), J::load(&params.upper));
    let all = all_joints.offset + all_joints.null;
    let offset = all + motion.soft_offset;
    let load = arm.gravity_in_goal + feed_forward;
    let torque = J::fma(J::load(&params.servos.kp), input.integral + offset, load);
    let (mut parts, mut locks) = (all_joints, JointLocks::none());
    loop {
        let goal = without_lead + parts.offset + parts.null;
        if !locks.lock_violations(goal, without_lead, lower, upper) {
            (motion.stiff_offset, motion.null, motion.wrench.stiff) = (parts.offset, parts.null, parts.stiff);
            motion.torque = tr_mul(arm.rows, &motion.wrench.total().to_axes());
            return (goal, locks.locked);
        }
        let redistribution = Redistribution {
            params,
            horizon: input.horizon,
            rows: arm.rows,
            unlocked: J::splat(1.0) - locks.locked,
            missing: &mul(arm.rows, locks.select(all - locks.offset, zero)),
            softness: input.demand.softness,
            torque,
            offset,
        };
        parts = all_joints.with(&locks, &redistribution.correction());
    }
}

/// Returns the task rows with the columns of locked joints set to zero.
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
    use crate::math::simd::{JointVec16, RealOps};

    fn vector(values: &[f64]) -> JointVec16 {
        let mut out = [0.0; MAX_JOINTS];
        out[..values.len()].copy_from_slice(values);
        JointVec16::load(&out)
    }

    #[test]
    fn a_locked_joint_keeps_the_lead_to_its_limit() {
        let (without, one) = (vector(&[0.7, 0.2, -0.7]), JointVec16::splat(1.0));
        let mut locks = JointLocks::none();
        assert!(locks.lock_violations(vector(&[1.2, 0.3, 0.5]), without, -one, one));
        assert!(!locks.lock_violations(vector(&[1.3, 0.3, 0.5]), without, -one, one), "locked already");
        assert!(locks.lock_violations(vector(&[1.0, 0.3, -1.5]), without, -one, one), "another joint");
        let offset = locks.offset.to_joints();
        assert_eq!(locks.locked.to_joints()[..3].iter().map(|l| *l > 0.0).collect::<Vec<_>>(), [true, false, true]);
        assert!((offset[0] - 0.3).abs() < 1e-15 && offset[1].abs() < 1e-15 && (offset[2] + 0.3).abs() < 1e-15);
        let select = locks.select(vector(&[5.0; 3]), vector(&[7.0; 3])).to_joints();
        assert_eq!(select[..3].iter().map(|l| *l > 6.0).collect::<Vec<_>>(), [false, true, false]);
    }
}
