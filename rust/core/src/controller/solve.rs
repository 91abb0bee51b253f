//! Lines 7 to 11: the law, and what the other joints take over where one meets a position limit.

use crate::command::goal::{fade_beyond, lock};
use crate::controller::input::Input;
use crate::controller::memory::Memory;
use crate::controller::step::Seen;
use crate::law::clearance::posture_share;
use crate::law::feedforward::{Filtered, Resistance, damping_squared, fade};
use crate::law::inverse::{Factor, Square, load_rows, rows_array, times, weighted_gram};
use crate::law::nullspace::fade_squared;
use crate::law::singular::{Condition, SingularValues};
use crate::law::takeover::{Share, Takeover};
use crate::law::wrench::Wrench;
use crate::law::{Motion, Tick, motion, weighted_manipulability};
use crate::number::{Arithmetic, EveryJoint, Lanes, Wide};
use crate::plan::Plan;
use crate::settings::{Law, Settings};
use crate::task::wish::Wish;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Iterations that find the extreme singular vectors from nothing, and that follow them from tick to tick.
const ITERATIONS: (usize, usize) = (30, 1);

/// What the law came to.
#[derive(Clone, Copy)]
pub(super) struct Solution<J: Lanes> {
    pub(super) motion: Motion<J>,
    /// τ^q of (11) [N·m], only where the law makes its limits from it.
    pub(super) budget: Option<J>,
    pub(super) locked: [bool; MAX_JOINTS],
    /// Goals before the slew [rad]: what moves the arm within the position limits, what exerts a force beyond them too.
    pub(super) goal: J,
    /// What of them carries the weight [rad].
    pub(super) weight: J,
    pub(super) gradient: J,
    pub(super) feed_forward: J,
    /// λ².
    pub(super) damping: f64,
    /// γ: how much of feed-forward and prediction is used.
    pub(super) gamma: f64,
    /// λ² of each row.
    pub(super) row_damping: J::Axes,
}

/// Solves for the goals; `singular` is followed where anybody asks for it.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "everything that the lines before came to")]
pub(super) fn solve<J: Lanes>(
    plan: &Plan,
    settings: &Settings,
    input: &Input,
    seen: &Seen<J>,
    wish: &Wish<J::Axes>,
    memory: &Memory,
    filtered: &Filtered<J>,
    singular: &mut SingularValues,
) -> Solution<J> {
    let scaled = plan.scale_rows(&seen.rows);
    let condition = condition(plan, &scaled, singular, memory.cold);
    let row_damping = J::Axes::of(&plan.lanes.damping_scale) * J::Axes::splat(condition.damping);
    let gradient = cost_gradient(plan, input, &memory.rest, seen, &scaled, condition.mu_squared);
    let integral = J::load(&memory.integral);
    let (all_joints, budget) = motion(&Tick {
        plan,
        horizon: settings.horizon,
        rows: &seen.rows,
        scaled_rows: &scaled,
        condition: &condition,
        damping: row_damping,
        wish,
        velocity: filtered.velocity,
        gradient,
        gravity: seen.gravity_in_goal,
        resistance: resist(plan, settings, filtered.velocity, condition.gamma),
        integral,
    });
    let (kp, compliance) = (J::load(&plan.servos.kp), J::load(&plan.servos.compliance));
    let (lower, upper) = (J::load(&plan.lower), J::load(&plan.upper));
    let force_lead = fade_beyond(all_joints.force_lead, seen.q, lower, upper, plan.stop_slope);
    let resistance = fade_beyond(all_joints.feed_forward * compliance, seen.q, lower, upper, plan.stop_slope);
    let feed_forward = kp * resistance;
    let without_lead = seen.q + integral;
    let weight = seen.gravity_in_goal / J::load(&plan.kg);
    let beside = force_lead + resistance + weight;
    let (mut lead, mut null, mut stiff) = (all_joints.lead, all_joints.null, all_joints.wrench.stiff);
    let (mut goal, mut locked) = (without_lead + lead + null, [false; MAX_JOINTS]);
    if upper.any_less(goal) | goal.any_less(lower) {
        let hands = Hands {
            plan,
            horizon: settings.horizon,
            rows: rows_array(&seen.rows),
            softness: <EveryJoint as Lanes>::Axes::of(&wish.softness.numbers()),
            without_lead: without_lead.array(),
            carried: (seen.gravity_in_goal + feed_forward + kp * (integral + force_lead)).array(),
            force_lead: force_lead.array(),
        };
        let stiff_wrench = <EveryJoint as Lanes>::Axes::of(&stiff.numbers());
        let mut share = Share { lead: lead.every(), null: null.every(), stiff: stiff_wrench };
        goal = J::load(&hands.over(&mut share, &mut locked));
        (lead, null) = (J::load(&share.lead.array()), J::load(&share.null.array()));
        stiff = J::Axes::of(&share.stiff.numbers());
    }
    let wrench = Wrench { soft: all_joints.wrench.soft, stiff };
    Solution {
        motion: Motion { lead, force_lead, null, wrench, ..all_joints },
        budget,
        locked,
        goal: goal + beside,
        weight,
        gradient,
        feed_forward,
        damping: condition.damping,
        gamma: condition.gamma,
        row_damping,
    }
}

/// What is known when joints are to move beyond their position limits.
///
/// Rare, hence compiled once and kept out of the step.
struct Hands<'a> {
    plan: &'a Plan,
    horizon: f64,
    rows: Rows,
    softness: <EveryJoint as Lanes>::Axes,
    /// Goals without any lead [rad].
    without_lead: JointVec,
    /// Torque of everything but lead and null-space motion [N·m].
    carried: JointVec,
    force_lead: JointVec,
}

impl Hands<'_> {
    /// Locks joints until none is left to lock; the goals then, without what exerts a force [rad].
    #[cold]
    #[inline(never)]
    fn over(&self, share: &mut Share, locked: &mut [bool; MAX_JOINTS]) -> JointVec {
        let (plan, all_joints, mut fixed_lead) = (self.plan, *share, [0.0; MAX_JOINTS]);
        let whole = all_joints.lead + all_joints.null;
        let (all, lead) = (whole.array(), (whole + EveryJoint::load(&self.force_lead)).array());
        let carried = EveryJoint::load(&self.carried);
        let torque = EveryJoint::fma(EveryJoint::load(&plan.servos.kp), whole, carried).array();
        loop {
            let goal = (EveryJoint::load(&self.without_lead) + share.lead + share.null).array();
            if !lock(&goal, &self.without_lead, &plan.lower, &plan.upper, locked, &mut fixed_lead) {
                return goal;
            }
            let (mut cut, mut lead, mut torque) = ([0.0; MAX_JOINTS], lead, torque);
            for i in 0..MAX_JOINTS {
                if locked[i] {
                    (cut[i], lead[i], torque[i]) = (all[i] - fixed_lead[i], 0.0, 0.0);
                }
            }
            let takeover = Takeover {
                plan,
                horizon: self.horizon,
                rows: &without_locked(&self.rows, locked),
                lost: &times(&load_rows(&self.rows), EveryJoint::load(&cut)),
                softness: self.softness,
                torque: EveryJoint::load(&torque),
                lead: EveryJoint::load(&lead),
            };
            *share = all_joints.with(locked, &fixed_lead, &takeover.addition());
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
fn condition<J: Lanes>(plan: &Plan, scaled: &[J; MAX_AXES], values: &mut SingularValues, cold: bool) -> Condition {
    let limits = plan.damping;
    if !plan.follows_sigma() {
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

/// Line 10; law `paper` has no feed-forward.
#[inline(always)]
fn resist<J: Lanes>(plan: &Plan, settings: &Settings, v: J, gamma: f64) -> Resistance<J> {
    if plan.law == Law::Paper {
        return Resistance::none();
    }
    Resistance::new(v, &plan.servos, (settings.friction_share, settings.damping_share), settings.friction_speed, gamma)
}

/// Gradient of the null-space cost, all its parts; `rest` is the posture where nobody gives another.
#[inline(always)]
fn cost_gradient<J: Lanes>(
    plan: &Plan,
    input: &Input,
    rest: &JointVec,
    seen: &Seen<J>,
    scaled: &[J; MAX_AXES],
    mu_squared: f64,
) -> J {
    let rest = input.rest.as_ref().or(plan.rest.as_ref()).unwrap_or(rest);
    let mut gradient = plan.cost.gradient(seen.q, J::load(rest), posture_share(plan, seen.q, rest));
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
