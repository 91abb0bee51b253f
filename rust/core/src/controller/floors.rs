//! What a tick of one arm and of several side by side have in common: each floor of the staircase, called once.

use crate::MAX_AXES;
use crate::command::goal::fade_beyond;
use crate::command::limits::Load;
use crate::kinematics::View;
use crate::law::feedforward::Fed;
use crate::law::inverse::transpose_times;
use crate::law::singular::Condition;
use crate::law::{Motion, Pacing, Tick};
use crate::number::{Arithmetic, Axes, Lanes, Scalar, Spread};
use crate::plan::Plan;
use crate::settings::{Law, Settings};
use crate::task;
use crate::task::wish::Wish;

/// Lead [rad] allowed under law `paper` where nothing is known of the servos.
const LEAD_UNKNOWN: f64 = 0.3;

/// Line 2: the arm at the predicted positions.
#[derive(Clone, Copy)]
pub(crate) struct Seen<'a, J: Lanes> {
    /// q̂ [rad].
    pub(crate) q: J,
    /// Pose of the tool, Jacobian, torques that hold the arm.
    pub(crate) view: &'a View<J>,
    pub(crate) base_from_task: [[Scalar<J>; 3]; 3],
    /// Jacobian rows of the task's axes, in the task frame (k × n).
    pub(crate) rows: &'a [J; MAX_AXES],
    pub(crate) gravity_in_goal: J,
    pub(crate) gravity_in_limit: J,
}

impl<'a, J: Lanes> Seen<'a, J> {
    #[inline(always)]
    pub(crate) fn new(
        plan: &Plan,
        settings: &Settings,
        q: J,
        view: &'a View<J>,
        room: &'a mut Option<[J; MAX_AXES]>,
    ) -> Self {
        let base_from_task = plan.base_from_task::<J::One>(&view.tool);
        let rows = task::rows_in(&plan.frame, &view.world, &base_from_task, &plan.axes, room);
        let gravity = settings.gravity_use();
        let in_goal = J::splat(f64::from(u8::from(gravity.in_goal())));
        let in_limit = J::splat(f64::from(u8::from(gravity.in_limits())));
        let (gravity_in_goal, gravity_in_limit) = (in_goal * view.holding, in_limit * view.holding);
        Self { q, view, base_from_task, rows, gravity_in_goal, gravity_in_limit }
    }
}

/// What a tick starts from beside the arm's pose.
#[derive(Clone, Copy)]
pub(crate) struct Given<'a, J: Lanes> {
    /// Filtered velocity [rad/s].
    pub(crate) velocity: J,
    /// Gradient of the null-space cost.
    pub(crate) gradient: J,
    /// Lead that the integrating goal has stored [rad].
    pub(crate) integral: J,
    /// Task rows with translations divided by the arm's length.
    pub(crate) scaled_rows: &'a [J; MAX_AXES],
    pub(crate) condition: &'a Condition<Scalar<J>>,
    /// λ² of each row.
    pub(crate) damping: J::Axes,
    pub(crate) pacing: Pacing<J::Axes>,
}

/// What the law came to.
#[derive(Clone, Copy)]
pub(crate) struct Solution<J: Lanes> {
    pub(crate) motion: Motion<J>,
    /// τ^q of (11) [N·m], only where the law makes its limits from it.
    pub(crate) budget: Option<J>,
    /// Goals before the slew that move the arm [rad]: to be within the position limits.
    pub(crate) moving: J,
    /// What exerts a force and may point beyond them [rad].
    pub(crate) beside: J,
    /// What of the goals carries the weight [rad].
    pub(crate) weight: J,
    pub(crate) feed_forward: J,
}

/// λ² of each row.
#[inline(always)]
pub(crate) fn row_damping<J: Lanes>(plan: &Plan, condition: &Condition<Scalar<J>>) -> J::Axes {
    J::Axes::constant(&plan.lanes.damping_scale) * J::Axes::spread(condition.damping)
}

impl<'a, J: Lanes> Given<'a, J> {
    /// What the law is given.
    #[inline(always)]
    pub(crate) fn tick(
        &self,
        plan: &'a Plan,
        settings: &Settings,
        seen: &'a Seen<'_, J>,
        wish: &'a Wish<J::Axes>,
    ) -> Tick<'a, J> {
        Tick {
            plan,
            horizon: settings.paper_options.horizon,
            rows: seen.rows,
            scaled_rows: self.scaled_rows,
            condition: self.condition,
            damping: self.damping,
            pacing: self.pacing,
            wish,
            velocity: self.velocity,
            gradient: self.gradient,
            gravity: seen.gravity_in_goal,
            fed: fed::<J>(settings, self.condition.gamma),
            integral: self.integral,
        }
    }
}

impl<J: Lanes> Solution<J> {
    /// Lines 7 to 11 from what the law came to, as if no joint had a position limit.
    #[inline(always)]
    pub(crate) fn new(
        plan: &Plan,
        given: &Given<'_, J>,
        seen: &Seen<'_, J>,
        (motion, budget): (Motion<J>, Option<J>),
    ) -> Self {
        let (kp, compliance) = (J::load(&plan.servos.kp), J::load(&plan.servos.compliance));
        let (mut force_lead, mut resistance) = (motion.force_lead, motion.feed_forward);
        // Law `paper` has neither.
        if plan.law.by_force() {
            let (lower, upper) = (J::load(&plan.lower), J::load(&plan.upper));
            force_lead = fade_beyond(force_lead, seen.q, lower, upper, plan.stop_slope);
            resistance = fade_beyond(resistance * compliance, seen.q, lower, upper, plan.stop_slope);
        }
        let weight = seen.gravity_in_goal * J::load(&plan.gravity_compliance);
        Self {
            motion: Motion { force_lead, ..motion },
            budget,
            moving: seen.q + given.integral + motion.lead + motion.null,
            beside: force_lead + resistance + weight,
            weight,
            feed_forward: kp * resistance,
        }
    }

    /// What line 12 makes the limits from under the rule of demand, given measured positions and the stored lead [rad].
    #[inline(always)]
    pub(crate) fn load(
        &self,
        plan: &Plan,
        settings: &Settings,
        (q, integral): (J, J),
        seen: &Seen<'_, J>,
        wish: &Wish<J::Axes>,
    ) -> Load<J> {
        let motion = &self.motion;
        let wrench = motion.wrench.whole();
        let pull = transpose_times(seen.rows, &wrench.axes());
        // The null space, and what a position limit has taken of the joint's part of the wrench.
        let lead = J::fnma(J::load(&plan.servos.compliance), pull, motion.lead + motion.force_lead + motion.null);
        let ahead = seen.q - q;
        Load {
            gravity: seen.gravity_in_limit,
            feed_forward: self.feed_forward,
            task: transpose_times(seen.rows, &J::Axes::clip(wrench, wish.most).axes()),
            offset: J::load(&plan.servos.kp) * (lead + integral + ahead),
            gravity_scale: settings.paper_options.gravity_scale,
            margin: J::load(&plan.margin),
        }
    }

    /// Goals before the slew [rad], given the limits: under law `paper` they lead no farther than these can use.
    #[inline(always)]
    pub(crate) fn goal(&self, plan: &Plan, settings: &Settings, limit: J) -> J {
        let mut goal = self.moving + self.beside;
        if plan.law == Law::Paper {
            let lead = self.motion.lead + self.motion.null;
            goal = goal + (J::clip(lead, lead_limit(plan, settings, limit)) - lead);
        }
        let beyond = J::load(&plan.beyond);
        let (lower, upper) = (J::load(&plan.lower) - beyond, J::load(&plan.upper) + beyond);
        J::at_most(J::at_least(goal, lower), upper)
    }
}

/// What of line 10 is fed forward; law `paper` does not ask.
#[inline(always)]
fn fed<J: Lanes>(settings: &Settings, gamma: Scalar<J>) -> Fed<Scalar<J>> {
    let share = |of: f64| gamma * J::One::splat(of);
    Fed {
        friction: share(settings.compensation.friction),
        damping: share(settings.compensation.damping),
        speed: settings.paper_options.friction_speed,
    }
}

/// How far the goals may lead under law `paper` [rad]: what the limit can use and a little more.
#[inline(always)]
fn lead_limit<J: Lanes>(plan: &Plan, settings: &Settings, limit: J) -> J {
    match settings.paper_options.lead_limit {
        Some(lead) => J::splat(lead),
        None if plan.servos.has_kp => (limit + J::load(&plan.margin)) * J::load(&plan.servos.compliance),
        None => J::splat(LEAD_UNKNOWN),
    }
}
