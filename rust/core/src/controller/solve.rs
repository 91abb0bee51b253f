//! Lines 7 to 11: the law, and the redistribution of motion to the other joints at position limits.

use crate::controller::input::Input;
use crate::controller::stages::{Given, Seen, Solution, row_damping};
use crate::controller::state::Memory;
use crate::kinematics::velocity_filter::Filtered;
use crate::law::nullspace::fade_squared;
use crate::law::posture_fade::posture_share;
use crate::law::redistribution::{Locks, Share, Takeover};
use crate::law::singularity::{Condition, damping_squared, fade};
use crate::law::{Pacing, motion, weighted_manipulability};
use crate::math::ldlt6::Factor;
use crate::math::rows::{Square, rows_array, times, weighted_gram};
use crate::math::simd::Joints;
use crate::math::singular_values::SingularValues;
use crate::params::{Plan, Settings};
use crate::task::demand::Wish;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Iterations for the extreme singular vectors: from scratch, and per step when tracked.
const ITERATIONS: (usize, usize) = (30, 1);

/// Solution with the quantities that only the step of a single arm has.
#[derive(Clone, Copy)]
pub(super) struct Solved<J: Joints> {
    pub(super) solution: Solution<J>,
    pub(super) gradient: J,
    /// λ².
    pub(super) damping: f64,
    /// γ: factor on feed-forward and prediction.
    pub(super) gamma: f64,
    /// λ² of each row.
    pub(super) row_damping: J::Axes,
    pub(super) locked: [bool; MAX_JOINTS],
}

/// Solves for the goals; updates `singular` if the settings need it.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "everything that the lines before came to")]
pub(super) fn solve<J: Joints>(
    plan: &Plan,
    settings: &Settings,
    input: &Input,
    seen: &Seen<'_, J>,
    wish: &Wish<J::Axes>,
    memory: &Memory,
    filtered: &Filtered<J>,
    pacing: Pacing<J::Axes>,
    singular: &mut SingularValues,
) -> Solved<J> {
    let scaled;
    let scaled_rows = if plan.follows_sigma {
        scaled = plan.scale_rows(seen.rows);
        &scaled
    } else {
        seen.rows // scaled rows are not used
    };
    let condition = condition(plan, scaled_rows, singular, memory.cold);
    let gradient = cost_gradient(plan, input, &memory.rest, seen, wish, scaled_rows, condition.mu_squared);
    let integral = J::load(&memory.integral);
    let damping = row_damping::<J>(plan, &condition);
    let given =
        Given { velocity: filtered.velocity, gradient, integral, scaled_rows, condition: &condition, damping, pacing };
    let law = motion(&given.tick(plan, settings, seen, wish));
    let mut solved = Solved {
        solution: Solution::new(plan, &given, seen, law),
        gradient,
        damping: condition.damping,
        gamma: condition.gamma,
        row_damping: damping,
        locked: [false; MAX_JOINTS],
    };
    let solution = &mut solved.solution;
    let (lower, upper) = (J::load(&plan.lower), J::load(&plan.upper));
    if upper.any_less(solution.moving) | solution.moving.any_less(lower) {
        rare();
        let locked = solution.hold(plan, settings, seen, wish, integral).array();
        for (slot, locked) in solved.locked.iter_mut().zip(locked) {
            *slot = locked > 0.0;
        }
    }
    solved
}

/// Marks its caller's branch as cold, so that the compiler places it behind the others.
#[cold]
#[inline(never)]
fn rare() {}

impl<J: Joints> Solution<J> {
    /// Locks the joints that would exceed their position limits until no other joint does. Returns 1 for locked joints,
    /// 0 for the others.
    #[inline(always)]
    fn hold(&mut self, plan: &Plan, settings: &Settings, seen: &Seen<'_, J>, wish: &Wish<J::Axes>, integral: J) -> J {
        let motion = &mut self.motion;
        let all_joints = Share { lead: motion.lead, null: motion.null, stiff: motion.wrench.stiff };
        let (without_lead, nothing) = (seen.q + integral, J::splat(0.0));
        let (lower, upper) = (J::load(&plan.lower), J::load(&plan.upper));
        let all = all_joints.lead + all_joints.null;
        let lead = all + motion.force_lead;
        let carried = seen.gravity_in_goal + self.feed_forward;
        let torque = J::fma(J::load(&plan.servos.kp), integral + lead, carried);
        let (mut share, mut locks) = (all_joints, Locks::none());
        loop {
            let goal = without_lead + share.lead + share.null;
            if !locks.add(goal, without_lead, lower, upper) {
                self.moving = goal;
                (motion.lead, motion.null, motion.wrench.stiff) = (share.lead, share.null, share.stiff);
                return locks.locked;
            }
            let takeover = Takeover {
                plan,
                horizon: settings.paper_options.horizon,
                rows: seen.rows,
                free: J::splat(1.0) - locks.locked,
                lost: &times(seen.rows, locks.either(all - locks.lead, nothing)),
                softness: wish.softness,
                torque,
                lead,
            };
            share = all_joints.with(&locks, &takeover.addition());
        }
    }
}

/// Task rows, columns of locked joints zero.
pub(super) fn without_locked(rows: &Rows, locked: &[bool; MAX_JOINTS]) -> Rows {
    let mut free = *rows;
    for row in &mut free {
        for (value, &locked) in row.iter_mut().zip(locked) {
            *value = if locked { 0.0 } else { *value };
        }
    }
    free
}

/// Line 7: updates σ, sets γ, returns λ².
#[inline(always)]
fn condition<J: Joints>(plan: &Plan, scaled: &[J; MAX_AXES], values: &mut SingularValues, cold: bool) -> Condition {
    let limits = plan.damping;
    if !plan.follows_sigma {
        return Condition { damping: limits.lambda_0 * limits.lambda_0, mu_squared: 0.0, factor: None, gamma: 1.0 };
    }
    let (redundant, axes) = (plan.k <= plan.n, plan.k.min(plan.n));
    let gram = if redundant { weighted_gram(scaled, J::splat(1.0)) } else { joint_gram(&rows_array(scaled)) };
    let factor = Factor::new::<J::One>(&gram);
    if cold {
        values.restrict(axes);
    }
    values.update::<J::One>(&gram, &factor, axes, if cold { ITERATIONS.0 } else { ITERATIONS.1 });
    let sigma = values.smallest;
    Condition {
        damping: damping_squared(sigma, limits.lambda_0, limits.sigma_0, limits.lambda_max),
        mu_squared: fade_squared(sigma, values.largest),
        factor: redundant.then_some(factor),
        gamma: fade(sigma, limits.sigma_0),
    }
}

/// Returns `JᵀJ`, for fewer joints than axes: it has the same nonzero singular values, without the zeros that `JJᵀ`
/// always has.
#[cold]
#[inline(never)]
fn joint_gram(scaled: &Rows) -> Square {
    let mut gram = [[0.0; MAX_AXES]; MAX_AXES];
    for (i, row) in gram.iter_mut().enumerate() {
        for (j, value) in row.iter_mut().enumerate() {
            *value = scaled.iter().map(|r| r[i] * r[j]).sum();
        }
    }
    gram
}

/// Returns the gradient of the null-space cost, all parts; `rest` is the default posture.
#[inline(always)]
fn cost_gradient<J: Joints>(
    plan: &Plan,
    input: &Input,
    rest: &JointVec,
    seen: &Seen<'_, J>,
    wish: &Wish<J::Axes>,
    scaled: &[J; MAX_AXES],
    mu_squared: f64,
) -> J {
    let rest = input.rest.as_ref().or(plan.rest.as_ref()).unwrap_or(rest);
    let rest = J::load(rest);
    let mut gradient = plan.cost.gradient(seen.q, rest, posture_share(plan, seen.q, rest, wish));
    if plan.cost.manipulability > 0.0 {
        let (world, scaled) = (rows_array(&seen.view.world), rows_array(scaled));
        let more = weighted_manipulability(plan, &world, &scaled, &seen.base_from_task, mu_squared);
        gradient = gradient + J::load(&more);
    }
    match &input.gradient {
        Some(own) => gradient + J::load(own),
        None => gradient,
    }
}
