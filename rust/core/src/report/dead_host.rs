//! What a hand meets once the host has died: the servos keep their last goals and limits.

use super::statics::static_force;
use crate::kinematics::{Frames, Masses};
use crate::model::Model;
use crate::plan::Plan;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// How far a hand is followed [m, rad].
pub(super) const TRAVEL: [f64; 2] = [0.15, 0.4];

/// Steps on that way, most steps in all, and the longest of one joint [rad or m].
const STEPS: (f64, usize, f64) = (15.0, 24, 0.15);

/// An arm whose limits stay as they are.
pub(super) struct Dead<'a> {
    pub(super) model: &'a Model,
    pub(super) plan: &'a Plan,
    pub(super) masses: &'a Masses,
    pub(super) gravity: [f64; 3],
    pub(super) base_from_task: [[f64; 3]; 3],
    pub(super) q: &'a JointVec,
    /// Limits plus dry friction [N·m].
    pub(super) limit: &'a JointVec,
}

impl Dead<'_> {
    /// The largest static force on the way along one task axis, toward `sign`.
    ///
    /// The joint that gives way first is the one that turns; the others keep their place until their turn comes. Measured
    /// against dead arms that were dragged, this predicts the peak within a few newtons, where a path that keeps the
    /// tool's other axes in place finds half of it. A joint at a position limit gives way no farther.
    pub(super) fn largest(&self, row: usize, sign: f64) -> f64 {
        let (plan, chain) = (self.plan, self.model.chain());
        let axis = plan.rows[row].axis;
        let step = TRAVEL[usize::from(axis >= 3)] / STEPS.0;
        let mut frames = Frames::default();
        let (mut world, mut holding): (Rows, JointVec) = ([[0.0; MAX_JOINTS]; MAX_AXES], [0.0; MAX_JOINTS]);
        let (mut q, mut limit, mut largest, mut moved) = (*self.q, *self.limit, f64::NEG_INFINITY, 0.0);
        for _ in 0..STEPS.1 {
            chain.forward(&q, &mut frames);
            chain.jacobian(&frames, &mut world);
            chain.gravity(&frames, self.masses, self.gravity, &mut holding);
            let lever = crate::task::rows(&world, &self.base_from_task, &[axis])[0];
            let (force, weakest) = static_force(&lever, sign, &limit, &holding, plan.n);
            if force.is_infinite() {
                break;
            }
            largest = force.max(largest);
            if moved > STEPS.0 * step {
                break;
            }
            let arm = lever[weakest];
            let turn = (step / arm.abs()).min(STEPS.2);
            let next = q[weakest] + turn.copysign(sign * arm);
            if next < plan.lower[weakest] || next > plan.upper[weakest] {
                limit[weakest] = f64::INFINITY;
            } else {
                q[weakest] = next;
                moved += turn * arm.abs();
            }
        }
        if largest > f64::NEG_INFINITY { largest } else { f64::INFINITY }
    }
}
