//! State of the oracle between ticks, and its velocity filter.

use pliant_core::{Pose, StepInput};

use super::{Oracle, Vector};

#[derive(Clone)]
pub(crate) struct State {
    pub(super) backlash_output: Vector,
    pub(super) velocity: Vector,
    pub(super) gamma: f64,
    pub(super) goal: Vector,
    /// Part of the goals that holds the arm against gravity [rad].
    pub(super) weight: Vector,
    pub(super) limit: Option<Vector>,
    pub(super) rest: Vector,
    /// Target of the last tick after the deviation limits.
    pub(super) reference: Pose,
}

impl State {
    /// Returns the state of an arm of `n` joints before the first tick.
    pub(super) fn new(n: usize) -> Self {
        let zero = Vector::zeros(n);
        Self {
            backlash_output: zero.clone(),
            velocity: zero.clone(),
            gamma: 1.0,
            goal: zero.clone(),
            weight: zero.clone(),
            limit: None,
            rest: zero,
            reference: Pose::IDENTITY,
        }
    }
}

impl Oracle {
    pub(crate) fn reset(&mut self, q: &[f64]) {
        let reference = self.model.forward_kinematics(q).unwrap();
        let q = Vector::from_column_slice(q);
        self.state = State { reference, backlash_output: q.clone(), goal: q.clone(), rest: q, ..State::new(self.n()) };
    }

    /// Filters the velocity: backlash of one encoder count in each direction, difference quotient, first-order low-pass
    /// with time constant T_f.
    pub(super) fn filter(&mut self, q: &Vector, input: &StepInput<'_>, dt: f64) {
        let state = &mut self.state;
        if let Some(dq) = input.dq {
            state.backlash_output.clone_from(q);
            state.velocity = Vector::from_column_slice(dq);
            return;
        }
        for i in 0..q.len() {
            let count = self.servos.as_ref().map_or(0.0, |s| s.encoder_step[i]);
            let before = state.backlash_output[i];
            if q[i] - before > count {
                state.backlash_output[i] = q[i] - count;
            } else if before - q[i] > count {
                state.backlash_output[i] = q[i] + count;
            }
            let rate = (state.backlash_output[i] - before) / dt;
            state.velocity[i] += dt / (self.settings.tracking.velocity_filter + dt) * (rate - state.velocity[i]);
        }
    }
}
