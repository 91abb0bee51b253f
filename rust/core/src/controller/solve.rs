//! Lines 7 to 11: the law, and what the other joints take over where one meets a position limit.

use crate::command::goal::Locks;
use crate::controller::floors::{Given, Seen, Solution, row_damping};
use crate::controller::input::Input;
use crate::controller::memory::Memory;
use crate::law::clearance::posture_share;
use crate::law::feedforward::{Filtered, damping_squared, fade};
use crate::law::inverse::{Factor, Square, load_rows, rows_array, times, weighted_gram};
use crate::law::nullspace::fade_squared;
use crate::law::singular::{Condition, SingularValues};
use crate::law::takeover::{Share, Takeover};
use crate::law::{motion, weighted_manipulability};
use crate::number::{EveryJoint, Instructions, Joints, Kernel, LANES, Machine, Packed};
use crate::plan::Plan;
use crate::settings::Settings;
use crate::task::wish::Wish;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Iterations that find the extreme singular vectors from nothing, and that follow them from tick to tick.
const ITERATIONS: (usize, usize) = (30, 1);

/// What of a solution one arm alone has.
#[derive(Clone, Copy)]
pub(super) struct Solved<J: Joints> {
    pub(super) solution: Solution<J>,
    pub(super) gradient: J,
    /// λ².
    pub(super) damping: f64,
    /// γ: how much of feed-forward and prediction is used.
    pub(super) gamma: f64,
    /// λ² of each row.
    pub(super) row_damping: J::Axes,
    pub(super) locked: [bool; MAX_JOINTS],
}

/// Solves for the goals; `singular` is followed where anybody asks for it.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "everything that the lines before came to")]
pub(super) fn solve<J: Joints>(
    plan: &Plan,
    settings: &Settings,
    instructions: Instructions,
    input: &Input,
    seen: &Seen<'_, J>,
    wish: &Wish<J::Axes>,
    memory: &Memory,
    filtered: &Filtered<J>,
    singular: &mut SingularValues,
) -> Solved<J> {
    let scaled;
    let scaled_rows = if plan.follows_sigma {
        scaled = plan.scale_rows(seen.rows);
        &scaled
    } else {
        seen.rows // nobody asks for the others
    };
    let condition = condition(plan, scaled_rows, singular, memory.cold);
    let gradient = cost_gradient(plan, input, &memory.rest, seen, scaled_rows, condition.mu_squared);
    let integral = J::load(&memory.integral);
    let damping = row_damping::<J>(plan, &condition);
    let given = Given { velocity: filtered.velocity, gradient, integral, scaled_rows, condition: &condition, damping };
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
        let (kp, motion) = (J::load(&plan.servos.kp), &mut solution.motion);
        let carried = seen.gravity_in_goal + solution.feed_forward + kp * (integral + motion.force_lead);
        let hands = Hands {
            plan,
            horizon: settings.horizon,
            rows: rows_array(seen.rows),
            softness: wish.softness.numbers(),
            without_lead: (seen.q + integral).array(),
            carried: carried.array(),
            force_lead: motion.force_lead.array(),
            share: Shares {
                lead: motion.lead.array(),
                null: motion.null.array(),
                stiff: motion.wrench.stiff.numbers(),
            },
        };
        let held = hands.over(instructions);
        for (slot, locked) in solved.locked.iter_mut().zip(held.locked) {
            *slot = locked > 0.0;
        }
        solution.moving = J::load(&held.goal);
        (motion.lead, motion.null) = (J::load(&held.share.lead), J::load(&held.share.null));
        motion.wrench.stiff = J::Axes::of(&held.share.stiff);
    }
    solved
}

/// A [`Share`] in memory.
struct Shares {
    lead: JointVec,
    null: JointVec,
    stiff: [f64; LANES],
}

/// What is known when joints are to move beyond their position limits.
///
/// Rare, hence kept out of the step, with an entry of its own for each set of instructions.
struct Hands<'a> {
    plan: &'a Plan,
    horizon: f64,
    rows: Rows,
    /// Of each task axis.
    softness: [f64; LANES],
    /// Goals without any lead [rad].
    without_lead: JointVec,
    /// Torque of everything but lead and null-space motion [N·m].
    carried: JointVec,
    force_lead: JointVec,
    /// With all joints.
    share: Shares,
}

/// What the joints do once none is left to lock.
struct Held {
    share: Shares,
    /// 1 for locked joints.
    locked: JointVec,
    /// Goals without what exerts a force [rad].
    goal: JointVec,
}

impl Kernel for Hands<'_> {
    type Output = Held;

    #[inline(always)]
    fn run<M: Machine>(self) -> Held {
        if self.plan.n <= LANES { self.hold::<M::Eight>() } else { self.hold_many() }
    }
}

impl Hands<'_> {
    #[cold]
    #[inline(never)]
    fn over(self, instructions: Instructions) -> Held {
        instructions.run_single(self)
    }

    /// [`Hands::hold`] of an arm with more joints than one has lanes.
    #[inline(never)]
    fn hold_many(&self) -> Held {
        self.hold::<EveryJoint>()
    }

    /// Locks joints until none is left to lock.
    #[inline(always)]
    fn hold<J: Joints>(&self) -> Held {
        let (plan, rows) = (self.plan, load_rows::<J>(&self.rows));
        let all_joints = Share {
            lead: J::load(&self.share.lead),
            null: J::load(&self.share.null),
            stiff: J::Axes::of(&self.share.stiff),
        };
        let (without_lead, nothing) = (J::load(&self.without_lead), J::splat(0.0));
        let (lower, upper) = (J::load(&plan.lower), J::load(&plan.upper));
        let all = all_joints.lead + all_joints.null;
        let lead = all + J::load(&self.force_lead);
        let torque = J::fma(J::load(&plan.servos.kp), all, J::load(&self.carried));
        let (mut share, mut locks) = (all_joints, Locks::none());
        loop {
            let goal = without_lead + share.lead + share.null;
            if !locks.add(goal, without_lead, lower, upper) {
                let share = Shares { lead: share.lead.array(), null: share.null.array(), stiff: share.stiff.numbers() };
                return Held { share, locked: locks.locked.array(), goal: goal.array() };
            }
            let takeover = Takeover {
                plan,
                horizon: self.horizon,
                rows: &rows,
                free: J::splat(1.0) - locks.locked,
                lost: &times(&rows, locks.either(all - locks.lead, nothing)),
                softness: J::Axes::of(&self.softness),
                torque: locks.either(nothing, torque),
                lead: locks.either(nothing, lead),
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

/// Line 7: follows σ, sets γ, says λ².
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

/// `JᵀJ`, for fewer joints than axes: it has the same singular values and no zero among them by construction.
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

/// Gradient of the null-space cost, all its parts; `rest` is the posture where nobody gives another.
#[inline(always)]
fn cost_gradient<J: Joints>(
    plan: &Plan,
    input: &Input,
    rest: &JointVec,
    seen: &Seen<'_, J>,
    scaled: &[J; MAX_AXES],
    mu_squared: f64,
) -> J {
    let rest = input.rest.as_ref().or(plan.rest.as_ref()).unwrap_or(rest);
    let rest = J::load(rest);
    let mut gradient = plan.cost.gradient(seen.q, rest, posture_share(plan, seen.q, rest));
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
