//! Output of a control step: goals, torque limits and speed limits of the servos.

use std::fmt;

use crate::{JointVec, MAX_JOINTS};

/// Command to the servos, one entry per joint.
#[derive(Clone, Copy, PartialEq)]
pub struct Command {
    pub(super) n: usize,
    pub(super) goal: JointVec,
    pub(super) torque_limit: JointVec,
    pub(super) speed_limit: JointVec,
}

impl Command {
    pub(crate) const fn new(n: usize, goal: JointVec, torque_limit: JointVec, speed_limit: JointVec) -> Self {
        Self { n, goal, torque_limit, speed_limit }
    }

    /// Returns the goal of each position servo [rad].
    pub fn goal(&self) -> &[f64] {
        &self.goal[..self.n.min(MAX_JOINTS)]
    }

    /// Returns the largest torque that each servo may exert in either direction [N·m].
    pub fn torque_limit(&self) -> &[f64] {
        &self.torque_limit[..self.n.min(MAX_JOINTS)]
    }

    /// Returns the speed for the profile velocity register of each servo [rad/s]: the largest speed at which the joint
    /// alone keeps the tool within its speed limit, but at least `Tracking::goal_slew` and at most the speed limit of
    /// the joint. ∞ if neither tool nor joint has a speed limit.
    pub fn speed_limit(&self) -> &[f64] {
        &self.speed_limit[..self.n.min(MAX_JOINTS)]
    }
}

/// Formats the first n entries only, without the padding.
impl fmt::Debug for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Command")
            .field("goal", &self.goal())
            .field("torque_limit", &self.torque_limit())
            .field("speed_limit", &self.speed_limit())
            .finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_joints_of_the_arm_are_printed() {
        let numbers = std::array::from_fn(|i| i as f64);
        let command = Command { n: 2, goal: numbers, torque_limit: numbers, speed_limit: numbers };
        let said = "Command { goal: [0.0, 1.0], torque_limit: [0.0, 1.0], speed_limit: [0.0, 1.0] }";
        assert_eq!(format!("{command:?}"), said);
    }
}
