//! Lines 7 to 11: the law, and what the other joints take over where one meets a position limit.

use crate::command::goal::{fade_beyond, lock};
use crate::controller::input::Input;
use crate::controller::memory::Memory;
use crate::controller::step::Seen;
use crate::law::feedforward::{Resistance, damping_squared, fade};
use crate::law::inverse::{Cholesky, Square, times, weighted_gram};
use crate::law::nullspace::fade_squared;
use crate::law::singular::{Condition, SingularValues};
use crate::law::takeover::Takeover;
use crate::law::{Motion, Tick, motion, weighted_manipulability};
use crate::plan::Plan;
use crate::settings::{Law, Settings};
use crate::task::wish::Wish;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Iterations that find the extreme singular vectors from nothing, and that follow them from tick to tick.
const ITERATIONS: (usize, usize) = (30, 1);

/// What the law came to.
#[derive(Clone, Copy)]
pub(super) struct Solution {
    pub(super) motion: Motion,
    /// τ^q of (11) [N·m], only where the law makes its limits from it.
    pub(super) budget: Option<JointVec>,
    pub(super) locked: [bool; MAX_JOINTS],
    /// Goals before the slew [rad]: what moves the arm within the position limits, what exerts a force beyond them too.
    pub(super) goal: JointVec,
    pub(super) gradient: JointVec,
    pub(super) feed_forward: JointVec,
    pub(super) condition: Condition,
    /// λ² of each row.
    pub(super) row_damping: AxisVec,
}

/// Solves for the goals; `memory` gets the new γ and singular vectors, `free` the task rows without the columns of locked
/// joints, if there are any. `k` and `n` are those of [`Tick`].
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "everything that the lines before came to")]
pub(super) fn solve(
    plan: &Plan,
    settings: &Settings,
    (k, n): (usize, usize),
    input: &Input,
    seen: &Seen,
    wish: &Wish,
    memory: &mut Memory,
    free: &mut Rows,
) -> Solution {
    let scaled = plan.scale_rows(&seen.rows, n);
    let condition = condition(plan, n, &scaled, memory);
    let mut row_damping = [0.0; MAX_AXES];
    for r in 0..k.min(MAX_AXES) {
        row_damping[r] = plan.damping_scale[r] * condition.damping;
    }
    let resistance = resist(plan, settings, memory, n);
    let gradient = cost_gradient(plan, n, input, seen, &scaled, condition.mu_squared);
    let (mut all_joints, budget) = motion(&Tick {
        plan,
        k,
        n,
        horizon: settings.horizon,
        rows: &seen.rows,
        scaled_rows: &scaled,
        condition: &condition,
        damping: &row_damping,
        softness: &wish.softness,
        strength: &wish.strength,
        most: &wish.most,
        step: &wish.step,
        bounded_step: &wish.bounded,
        adapted: &wish.adapted,
        stiffness: &wish.stiffness,
        viscosity: &wish.viscosity,
        twist: &wish.twist,
        velocity: &memory.filter.velocity,
        gradient: &gradient,
        gravity: &seen.gravity_in_goal,
        resistance: &resistance,
        integral: &memory.integral,
    });
    let (mut without_lead, mut beside, mut carried) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
    let mut feed_forward = all_joints.feed_forward;
    for i in 0..n {
        let (kp, compliance) = (plan.servos.kp[i], plan.servos.compliance[i]);
        let fade = |lead| fade_beyond(lead, seen.q[i], plan.lower[i], plan.upper[i], plan.stop_slope);
        all_joints.force_lead[i] = fade(all_joints.force_lead[i]);
        let resistance = fade(feed_forward[i] * compliance);
        feed_forward[i] = kp * resistance;
        without_lead[i] = seen.q[i] + memory.integral[i];
        beside[i] = all_joints.force_lead[i] + resistance + seen.gravity_in_goal[i] / plan.kg[i];
        carried[i] = seen.gravity_in_goal[i] + feed_forward[i] + kp * (memory.integral[i] + all_joints.force_lead[i]);
    }
    let (mut locked, mut fixed_lead) = ([false; MAX_JOINTS], [0.0; MAX_JOINTS]);
    let mut others: Option<Motion> = None;
    let goal = loop {
        let motion = others.as_ref().unwrap_or(&all_joints);
        let mut goal = without_lead;
        for i in 0..n {
            goal[i] += motion.lead[i] + motion.null[i];
        }
        if !lock(&goal, &without_lead, &plan.lower, &plan.upper, &mut locked, &mut fixed_lead, n) {
            for i in 0..n {
                goal[i] += beside[i];
            }
            break goal;
        }
        *free = seen.rows;
        let (mut cut, mut lead, mut torque) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
        for i in 0..plan.n {
            let whole = all_joints.lead[i] + all_joints.null[i];
            if locked[i] {
                cut[i] = whole - fixed_lead[i];
                for row in &mut *free {
                    row[i] = 0.0;
                }
            } else {
                lead[i] = whole + all_joints.force_lead[i];
                torque[i] = carried[i] + plan.servos.kp[i] * whole;
            }
        }
        let takeover = Takeover {
            plan,
            horizon: settings.horizon,
            rows: free,
            lost: &times(&seen.rows, &cut, k, n),
            softness: &wish.softness,
            torque: &torque,
            lead: &lead,
        };
        others = Some(all_joints.with(&locked, &fixed_lead, &takeover.addition()));
    };
    if let Some(others) = others {
        all_joints = others;
    }
    Solution { motion: all_joints, budget, locked, goal, gradient, feed_forward, condition, row_damping }
}

/// Line 7: follows σ, sets γ, says λ².
#[inline(always)]
fn condition(plan: &Plan, n: usize, scaled: &Rows, memory: &mut Memory) -> Condition {
    let limits = plan.damping;
    if !plan.follows_sigma() {
        memory.gamma = 1.0;
        return Condition { damping: limits.lambda_0 * limits.lambda_0, mu_squared: 0.0, factor: None };
    }
    let iterations = if memory.cold { ITERATIONS.0 } else { ITERATIONS.1 };
    memory.cold = false;
    let values = &mut memory.singular;
    let ones = [1.0; MAX_JOINTS];
    let factor = match plan.k {
        MAX_AXES if plan.n >= MAX_AXES => {
            let gram = weighted_gram(scaled, &ones, MAX_AXES, n);
            let factor = Cholesky::new(&gram, MAX_AXES);
            values.update(&gram, &factor, MAX_AXES, iterations);
            Some(factor)
        }
        k if k <= plan.n => {
            follow(values, &weighted_gram(scaled, &ones, k, n), k, iterations);
            None
        }
        _ => {
            follow(values, &joint_gram(scaled, plan.n), plan.n, iterations);
            None
        }
    };
    let sigma = values.smallest;
    memory.gamma = fade(sigma, limits.sigma_0);
    let mu_squared = fade_squared(sigma, values.largest);
    let damping = damping_squared(sigma, limits.lambda_0, limits.sigma_0, limits.lambda_max);
    Condition { damping, mu_squared, factor }
}

/// Follows the singular values of fewer rows than six.
#[inline(never)]
fn follow(values: &mut SingularValues, gram: &Square, k: usize, iterations: usize) {
    values.update(gram, &Cholesky::new(gram, k), k, iterations);
}

/// `JᵀJ`, for fewer joints than axes: it has the same singular values and no zero among them by construction.
fn joint_gram(scaled: &Rows, n: usize) -> Square {
    let mut gram = [[0.0; MAX_AXES]; MAX_AXES];
    for (i, row) in gram.iter_mut().enumerate().take(n) {
        for (j, value) in row.iter_mut().enumerate().take(n) {
            *value = scaled.iter().map(|r| r[i] * r[j]).sum();
        }
    }
    gram
}

/// Line 10; law `paper` has no feed-forward.
#[inline(always)]
fn resist(plan: &Plan, settings: &Settings, memory: &Memory, n: usize) -> Resistance {
    if plan.law == Law::Paper {
        return Resistance::NONE;
    }
    let (v, shares) = (&memory.filter.velocity, (settings.friction_share, settings.damping_share));
    Resistance::new(v, &plan.servos, shares, settings.friction_speed, memory.gamma, n)
}

/// Gradient of the null-space cost, all its parts.
#[inline(always)]
fn cost_gradient(plan: &Plan, n: usize, input: &Input, seen: &Seen, scaled: &Rows, mu_squared: f64) -> JointVec {
    let mut gradient = plan.cost.gradient(&seen.q, &input.rest, n);
    if plan.cost.manipulability > 0.0 {
        let more = weighted_manipulability(plan, &seen.world, scaled, &seen.base_from_task, mu_squared);
        (0..plan.n).for_each(|i| gradient[i] += more[i]);
    }
    for i in 0..n {
        gradient[i] += input.gradient[i];
    }
    gradient
}
