//! Stages of a step that the step of one arm and the step of several interleaved arms share.

use crate::command::goal::fade_beyond;
use crate::command::torque_limit::Load;
use crate::kinematics::View;
use crate::law::friction::Fed;
use crate::law::singularity::Condition;
use crate::law::{Motion, Pacing, Tick};
use crate::math::rows::transpose_times;
use crate::math::simd::{Arithmetic, Axes, Lanes, Scalar, Spread};
use crate::params::{Law, Plan, Settings};
use crate::task::demand::Wish;
use crate::{MAX_AXES, task};

/// Largest lead [rad] under law `paper` without known servos.
const LEAD_UNKNOWN: f64 = 0.3;

/// Line 2: state of the arm at the predicted positions.
#[derive(Clone, Copy)]
pub(crate) struct Seen<'a, J: Lanes> {
    /// q̂ [rad].
    pub(crate) q: J,
    /// Pose of the tool, Jacobian, gravity torques.
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

/// Inputs of the law besides the arm's state.
#[derive(Clone, Copy)]
pub(crate) struct Given<'a, J: Lanes> {
    /// Filtered velocity [rad/s].
    pub(crate) velocity: J,
    /// Gradient of the null-space cost.
    pub(crate) gradient: J,
    /// Lead stored by the integrating goal [rad].
    pub(crate) integral: J,
    /// Task rows with translations divided by the arm's length.
    pub(crate) scaled_rows: &'a [J; MAX_AXES],
    pub(crate) condition: &'a Condition<Scalar<J>>,
    /// λ² of each row.
    pub(crate) damping: J::Axes,
    pub(crate) pacing: Pacing<J::Axes>,
}

/// Result of the law.
#[derive(Clone, Copy)]
pub(crate) struct Solution<J: Lanes> {
    pub(crate) motion: Motion<J>,
    /// τ^q of (11) [N·m]; `None` under laws whose torque limits do not use it.
    pub(crate) budget: Option<J>,
    /// Part of the goals that moves the arm, before the slew [rad]; it stays within the position limits.
    pub(crate) moving: J,
    /// Part of the goals that exerts a force; it may exceed the position limits [rad].
    pub(crate) beside: J,
    /// Part of the goals that carries gravity [rad].
    pub(crate) weight: J,
    pub(crate) feed_forward: J,
}

/// λ² of each row.
#[inline(always)]
pub(crate) fn row_damping<J: Lanes>(plan: &Plan, condition: &Condition<Scalar<J>>) -> J::Axes {
    J::Axes::constant(&plan.lanes.damping_scale) * J::Axes::spread(condition.damping)
}

impl<'a, J: Lanes> Given<'a, J> {
    /// Returns the input of the law.
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
    /// Lines 7 to 11 from the law's result, as if no joint had a position limit.
    #[inline(always)]
    pub(crate) fn new(
        plan: &Plan,
        given: &Given<'_, J>,
        seen: &Seen<'_, J>,
        (motion, budget): (Motion<J>, Option<J>),
    ) -> Self {
        let (kp, compliance) = (J::load(&plan.servos.kp), J::load(&plan.servos.compliance));
        let (mut force_lead, mut resistance) = (motion.force_lead, motion.feed_forward);
        // Both are zero under law `paper`.
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

    /// Returns the terms from which line 12 computes the limits under the rule of demand, for measured positions and
    /// the stored lead [rad].
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
        // Null-space part, and the joint's part of the wrench that a position limit removed.
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

    /// Returns the goals before the slew [rad]. Under law `paper` they lead no farther than the limits can use.
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

/// Returns the part of line 10 that is fed forward; not used by law `paper`.
#[inline(always)]
fn fed<J: Lanes>(settings: &Settings, gamma: Scalar<J>) -> Fed<Scalar<J>> {
    let share = |of: f64| gamma * J::One::splat(of);
    Fed {
        friction: share(settings.compensation.friction),
        damping: share(settings.compensation.damping),
        speed: settings.paper_options.friction_speed,
    }
}

/// Returns the largest lead of the goals under law `paper` [rad]: slightly more than the torque limit can use.
#[inline(always)]
fn lead_limit<J: Lanes>(plan: &Plan, settings: &Settings, limit: J) -> J {
    match settings.paper_options.lead_limit {
        Some(lead) => J::splat(lead),
        None if plan.servos.has_kp => (limit + J::load(&plan.margin)) * J::load(&plan.servos.compliance),
        None => J::splat(LEAD_UNKNOWN),
    }
}
