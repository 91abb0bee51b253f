//! Joint torque limits.

use crate::command::goal::{at_least, at_most, clip};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// What the limits are made from; all torques in N·m, one per joint.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Load<'a> {
    /// Torques that hold the arm.
    pub(crate) gravity: &'a JointVec,
    /// Feed-forward of friction and damping.
    pub(crate) feed_forward: &'a JointVec,
    /// Torque of the task, `JᵀW′`.
    pub(crate) task: &'a JointVec,
    /// Torque of everything else the goal contains: `K_p (null + q̂ − q)`.
    pub(crate) offset: &'a JointVec,
    /// Factor s_g on gravity.
    pub(crate) gravity_scale: f64,
    /// Margin m.
    pub(crate) margin: &'a JointVec,
}

impl Load<'_> {
    /// Line 12: what the law wants at this tick, at least gravity, plus a margin.
    #[inline(always)]
    pub(crate) fn demand(&self, n: usize) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..n.min(MAX_JOINTS) {
            let wanted = self.gravity[i] + self.task[i] + self.feed_forward[i] + self.offset[i];
            out[i] = at_least(wanted.abs(), self.gravity_scale * self.gravity[i].abs()) + self.margin[i];
        }
        out
    }

    /// (11) with gravity: the budgets of law `paper` on top of what holds the arm.
    #[inline(always)]
    pub(crate) fn budget(&self, budget: &JointVec, n: usize) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..n.min(MAX_JOINTS) {
            out[i] = budget[i] + self.gravity_scale * self.gravity[i].abs();
        }
        out
    }

    /// The sum over all axes of what each may ask for: `s_g |g| + Σ_j |J_ji| most_j + null_i + |ff|`.
    #[inline(always)]
    pub(crate) fn sum(&self, rows: &Rows, most: &AxisVec, null: &JointVec, k: usize, n: usize) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..n.min(MAX_JOINTS) {
            let mut sum = self.gravity_scale * self.gravity[i].abs() + null[i] + self.feed_forward[i].abs();
            for r in 0..k.min(MAX_AXES) {
                sum += rows[r][i].abs() * most[r];
            }
            out[i] = sum;
        }
        out
    }
}

/// The wrench within what its axes may ask for: ±(w F + (1 − w) hold).
#[inline(always)]
pub(crate) fn within(wrench: &AxisVec, most: &AxisVec, k: usize) -> AxisVec {
    let mut out = [0.0; MAX_AXES];
    for r in 0..k.min(MAX_AXES) {
        out[r] = clip(wrench[r], most[r]);
    }
    out
}

/// Floor, ceiling, and a slew that lets limits fall at once but rise within the stiffening time.
#[inline(always)]
pub(crate) fn finish(
    wanted: &JointVec,
    before: Option<&JointVec>,
    floor: &JointVec,
    ceiling: &JointVec,
    rise: &JointVec,
    n: usize,
) -> JointVec {
    let mut out = [0.0; MAX_JOINTS];
    for i in 0..n.min(MAX_JOINTS) {
        let mut limit = at_most(wanted[i], ceiling[i]);
        if let Some(before) = before {
            limit = at_most(limit, before[i] + rise[i]);
        }
        // The floor comes last: one that was raised holds at once.
        limit = at_most(at_least(limit, floor[i]), ceiling[i]);
        out[i] = limit;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_fall_at_once_and_rise_slowly() {
        let constant = |value| [value; MAX_JOINTS];
        let at = |wanted, before| {
            finish(&constant(wanted), Some(&constant(before)), &constant(0.2), &constant(10.0), &constant(0.5), 1)[0]
        };
        assert!((at(3.0, 8.0) - 3.0).abs() < 1e-15);
        assert!((at(8.0, 3.0) - 3.5).abs() < 1e-15);
        assert!((at(0.0, 3.0) - 0.2).abs() < 1e-15);
        assert!((at(80.0, 9.9) - 10.0).abs() < 1e-15);
    }
}
