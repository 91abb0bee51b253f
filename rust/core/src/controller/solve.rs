//! Lines 7 to 11: the law, and what the other joints take over where one meets a position limit.

use crate::command::goal::{fade_beyond, lock};
use crate::controller::input::Input;
use crate::controller::memory::Memory;
use crate::controller::record::update_singular;
use crate::controller::step::Seen;
use crate::law::activation::Activation;
use crate::law::feedforward::{damping_squared, fade, resistance};
use crate::law::inverse::times;
use crate::law::takeover::Takeover;
use crate::law::{Motion, Tick, motion, weighted_manipulability};
use crate::plan::Plan;
use crate::settings::{Law, Settings};
use crate::task::wish::Wish;
use crate::{AxisVec, JointVec, MAX_JOINTS, Rows};

/// Iterations that find the extreme singular vectors from nothing, and that follow them from tick to tick.
const ITERATIONS: (usize, usize) = (30, 1);

/// What the law came to.
#[derive(Clone, Copy)]
pub(super) struct Solution {
    pub(super) motion: Motion,
    /// Only where the law makes its limits from it.
    pub(super) shares: Option<Activation>,
    /// Task rows, columns of locked joints zero.
    pub(super) rows: Rows,
    pub(super) locked: [bool; MAX_JOINTS],
    /// Goals before the slew [rad]: what moves the arm within the position limits, what exerts a force beyond them too.
    pub(super) goal: JointVec,
    pub(super) gradient: JointVec,
    pub(super) feed_forward: JointVec,
    /// λ².
    pub(super) damping: f64,
    /// λ² of each row.
    pub(super) row_damping: AxisVec,
}

/// Solves for the goals; `memory` gets the new γ and singular vectors.
pub(super) fn solve(
    plan: &Plan,
    settings: &Settings,
    input: &Input,
    seen: &Seen,
    wish: &Wish,
    memory: &mut Memory,
) -> Solution {
    let (k, n) = (plan.k, plan.n);
    let scaled = plan.scale_rows(&seen.rows);
    let damping = condition(plan, &scaled, memory);
    let row_damping = plan.damping_scale.map(|scale| scale * damping);
    let mut feed_forward = resist(plan, settings, memory);
    let gradient = cost_gradient(plan, input, seen, &scaled, memory);
    let (mut all_joints, shares) = motion(&Tick {
        plan,
        horizon: settings.horizon,
        rows: &seen.rows,
        scaled_rows: &scaled,
        singular: &memory.singular,
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
        feed_forward: &feed_forward,
        integral: &memory.integral,
    });
    let (mut without_lead, mut beside, mut carried) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
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
    let (mut motion, mut rows) = (all_joints, seen.rows);
    loop {
        let mut goal = without_lead;
        (0..n).for_each(|i| goal[i] += motion.lead[i] + motion.null[i]);
        if !lock(&goal, &without_lead, &plan.lower, &plan.upper, &mut locked, &mut fixed_lead, n) {
            (0..n).for_each(|i| goal[i] += beside[i]);
            return Solution { motion, shares, rows, locked, goal, gradient, feed_forward, damping, row_damping };
        }
        let (mut cut, mut lead, mut torque) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
        for i in 0..n {
            let whole = all_joints.lead[i] + all_joints.null[i];
            if locked[i] {
                cut[i] = whole - fixed_lead[i];
                for row in &mut rows {
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
            rows: &rows,
            lost: &times(&seen.rows, &cut, k),
            softness: &wish.softness,
            torque: &torque,
            lead: &lead,
        };
        motion = all_joints.with(&locked, &fixed_lead, &takeover.addition());
    }
}

/// Line 7: follows σ, sets γ, returns λ².
fn condition(plan: &Plan, scaled: &Rows, memory: &mut Memory) -> f64 {
    let iterations = if memory.cold { ITERATIONS.0 } else { ITERATIONS.1 };
    update_singular(&mut memory.singular, scaled, plan.k, plan.n, iterations);
    memory.cold = false;
    let (sigma, damping) = (memory.singular.smallest, plan.damping);
    memory.gamma = fade(sigma, damping.sigma_0);
    damping_squared(sigma, damping.lambda_0, damping.sigma_0, damping.lambda_max)
}

/// Line 10; law `paper` has no feed-forward.
fn resist(plan: &Plan, settings: &Settings, memory: &Memory) -> JointVec {
    if plan.law == Law::Paper {
        return [0.0; MAX_JOINTS];
    }
    let (servos, shares) = (&plan.servos, (settings.friction_share, settings.damping_share));
    let v = &memory.filter.velocity;
    resistance(v, &servos.friction, &servos.damping, shares, settings.friction_speed, memory.gamma, plan.n)
}

/// Gradient of the null-space cost, all its parts.
fn cost_gradient(plan: &Plan, input: &Input, seen: &Seen, scaled: &Rows, memory: &Memory) -> JointVec {
    let mut gradient = plan.cost.gradient(&seen.q, &input.rest, plan.n);
    if plan.cost.manipulability > 0.0 {
        let more = weighted_manipulability(plan, &seen.world, scaled, &seen.base_from_task, &memory.singular);
        (0..plan.n).for_each(|i| gradient[i] += more[i]);
    }
    (0..plan.n).for_each(|i| gradient[i] += input.gradient[i]);
    gradient
}
