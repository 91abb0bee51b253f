//! One tick, from reading to command.

use crate::command::goal::{Goals, register_speed, slew};
use crate::command::integral::Addition;
use crate::command::limits::{Load, finish};
use crate::controller::input::Input;
use crate::controller::memory::Memory;
use crate::controller::rare::{Asked, Waiting, limit_deviation, strain};
use crate::controller::record::Record;
use crate::controller::solve::{Solution, solve, without_locked};
use crate::controller::{Command, Controller, StepInput};
use crate::error::{Error, Result};
use crate::kinematics::{Frames, LookScratch, Masses, View};
use crate::law::feedforward::Filtered;
use crate::law::inverse::{axes, rows_array, transpose_times};
use crate::law::singular::SingularValues;
use crate::model::Chain;
use crate::number::{Arithmetic, Kernel, LANES, Lanes, Machine, Pair, Wide};
use crate::plan::Plan;
use crate::pose::Pose;
use crate::settings::{Law, LimitRule, Settings};
use crate::task;
use crate::task::deviation::{into_frame, pose_error};
use crate::task::deviation_limit::Pushed;
use crate::task::wish::Wish;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS};

/// Longest time [s] for which a slew or the integrating goal is advanced at once: a stalled host must not lunge.
const LONGEST_SLEW: f64 = 0.1;

/// Lead [rad] allowed under law `paper` where nothing is known of the servos.
const LEAD_UNKNOWN: f64 = 0.3;

/// Line 2: the arm at the predicted positions.
#[derive(Clone, Copy)]
pub(super) struct Seen<J> {
    /// q̂ [rad].
    pub(super) q: J,
    /// Pose of the tool, Jacobian, torques that hold the arm.
    pub(super) view: View<J>,
    pub(super) base_from_task: [[f64; 3]; 3],
    /// Jacobian rows of the task's axes, in the task frame (k × n).
    pub(super) rows: [J; MAX_AXES],
    pub(super) gravity_in_goal: J,
    gravity_in_limit: J,
}

/// Where the tool is to go. Apart from [`Seen`], for deviation limits may change it: only what nobody else holds the
/// address of stays in registers.
pub(super) struct Aim {
    pub(super) reference: Pose,
    /// Deviation (6,) in the task frame.
    pub(super) error: AxisVec,
    /// Which of x, y, z, roll, pitch, yaw met its deviation limit.
    pub(super) limited: [bool; MAX_AXES],
}

impl Controller {
    pub(super) fn restart(&mut self, q: &JointVec) {
        let mut frames = Frames::default();
        self.model.chain().forward(q, &mut frames);
        self.memory = Memory::at(q, frames.tool, true);
    }

    pub(crate) fn advance(&mut self, q: &JointVec, target: &Pose, input: &StepInput<'_>) -> Result<&Command> {
        if !self.memory.started {
            return self.start(q, target, input);
        }
        let asked = input;
        let mut input = Input::default();
        self.read(asked, &mut input)?;
        let instructions = self.instructions;
        if instructions.run_single(self.cycle(q, target, &input)) {
            return Ok(&self.command);
        }
        Err(Error::config("step", "the command is not finite for this q, target and settings: nothing was sent"))
    }

    /// The first step, which resets.
    #[cold]
    fn start(&mut self, q: &JointVec, target: &Pose, input: &StepInput<'_>) -> Result<&Command> {
        let before = self.memory;
        self.restart(q);
        if let Err(error) = self.advance(q, target, input).map(|_| ()) {
            self.memory = before;
            return Err(error);
        }
        Ok(&self.command)
    }

    fn cycle<'a>(&'a mut self, q: &'a JointVec, target: &'a Pose, input: &'a Input) -> Cycle<'a> {
        Cycle {
            plan: &self.plan,
            settings: &self.settings,
            chain: self.model.chain(),
            masses: &self.masses,
            gravity: &self.gravity,
            delay: self.delay,
            q,
            target,
            input,
            memory: &mut self.memory,
            scratch: &mut self.scratch,
            record: &mut self.record,
            command: &mut self.command,
        }
    }
}

/// One tick's work: what it reads, and what it changes.
pub(super) struct Cycle<'a> {
    pub(super) plan: &'a Plan,
    pub(super) settings: &'a Settings,
    pub(super) chain: &'a Chain,
    pub(super) masses: &'a Masses,
    pub(super) gravity: &'a [f64; 3],
    delay: f64,
    pub(super) q: &'a JointVec,
    target: &'a Pose,
    input: &'a Input,
    memory: &'a mut Memory,
    scratch: &'a mut LookScratch,
    record: &'a mut Record,
    command: &'a mut Command,
}

impl Kernel for Cycle<'_> {
    /// Whether the command can be sent: memory, record and command are the last tick's where it cannot.
    type Output = bool;

    #[inline(always)]
    fn run<M: Machine>(mut self) -> bool {
        if self.plan.n <= LANES { self.tick::<M::Eight>() } else { self.tick::<Pair<M::Eight>>() }
    }
}

impl Cycle<'_> {
    /// Lines 1 to 12.
    #[inline(always)]
    fn tick<J: Lanes>(&mut self) -> bool {
        let (plan, settings) = (self.plan, self.settings);
        let dt = self.input.dt.min(LONGEST_SLEW);

        let filtered = self.filter::<J>();
        let q = self.predict(&filtered);
        let speed = settings.max_tool_speed;
        let mut governor = self.memory.governor;
        let reference = governor.follow(self.target, speed, settings.max_tool_acceleration, dt);
        let seen = self.look(q);
        let error = into_frame(&seen.base_from_task, &pose_error(&seen.view.tool, &reference));
        let mut aim = Aim { reference, error, limited: [false; MAX_AXES] };
        if !plan.deviation_limits.is_empty() {
            let (tool, base_from_task) = (seen.view.tool, seen.base_from_task);
            let pushed = Pushed { tool: &tool, base_from_task: &base_from_task, before: &self.memory.governor.pose() };
            limit_deviation(plan, &pushed, &mut aim, &mut governor);
        }
        let twist = match &self.input.twist {
            Some(twist) => into_frame(&seen.base_from_task, &governor.velocity(twist, speed)),
            None => [0.0; MAX_AXES],
        };
        let wish = Wish::new(plan, settings, &aim.error, &twist);
        let mut singular = self.memory.singular;
        let solution = solve(plan, settings, self.input, &seen, &wish, self.memory, &filtered, &mut singular);

        let wanted = self.wanted_limits(&seen, &wish, &solution, &singular);
        let (floor, ceiling) = (J::load(&plan.floor), J::load(&plan.servos.torque));
        let rise = J::load(&plan.rise) * J::splat(dt);
        let before = self.memory.limit.as_ref().map(J::load);
        let mut limit = finish(wanted, before, floor, ceiling, rise);
        let mut goal = solution.goal;
        if plan.law == Law::Paper {
            let lead = solution.motion.lead + solution.motion.null;
            goal = goal + (J::clip(lead, self.lead_limit(limit)) - lead);
        }
        let beyond = J::load(&plan.beyond);
        let (lower, upper) = (J::load(&plan.lower) - beyond, J::load(&plan.upper) + beyond);
        let to = Goals { goal: J::at_most(J::at_least(goal, lower), upper), weight: solution.weight };
        let from = Goals { goal: J::load(&self.memory.goal), weight: J::load(&self.memory.weight) };
        let (Goals { goal, weight }, share) = slew(from, to, settings.goal_slew * dt);
        let strain = strain(solution.motion.factors[2].min(share));
        if strain > 0.0 {
            let lag = axes(wish.deviation * (J::Axes::splat(1.0) - wish.softness));
            let waiting = Waiting { plan, speed, base_from_task: &seen.base_from_task, lag: &lag, strain, dt };
            waiting.of(&self.memory.governor.pose(), &mut governor);
        }
        if let Some(most) = plan.dead_host_max {
            let (holding, in_limit) = (seen.view.holding.array(), seen.gravity_in_limit.array());
            let spared = self.spare(most, [&goal.array(), &limit.array()], [&holding, &in_limit], seen.base_from_task);
            limit = J::load(&spared);
        }
        // Neither an infinity nor what is not a number is less than infinity.
        let (endless, nothing) = (J::splat(f64::INFINITY), J::splat(0.0));
        let size = J::abs(goal) + J::abs(limit);
        if nothing.any_less(J::if_less(size, endless, nothing, endless)) {
            return false;
        }
        self.memory.filter.keep(filtered);
        self.memory.gamma = solution.gamma;
        (self.memory.singular, self.memory.cold) = (singular, self.memory.cold && !plan.follows_sigma());
        self.memory.governor = governor;
        // A deviation that a limit keeps up is not to be worked off.
        if settings.integrate > 0.0 && !aim.limited.contains(&true) {
            self.integrate(dt, &seen, &wish, &solution);
        }
        goal.store(&mut self.memory.goal);
        weight.store(&mut self.memory.weight);
        let mut kept = [0.0; MAX_JOINTS];
        limit.store(&mut kept);
        self.memory.limit = Some(kept);
        goal.store(&mut self.command.goal);
        limit.store(&mut self.command.torque_limit);
        register_speed(&seen.view.world, speed, J::load(&plan.joint_speed)).store(&mut self.command.velocity);
        self.note(&seen, &aim, &wish, &solution, &filtered);
        for i in 0..plan.n.min(MAX_JOINTS) {
            self.record.saturated[i] = kept[i] >= plan.servos.torque[i];
        }
        true
    }

    /// What the stiff axes and the null space add to the stored lead.
    #[inline(always)]
    fn integrate<J: Lanes>(&mut self, dt: f64, seen: &Seen<J>, wish: &Wish<J::Axes>, solution: &Solution<J>) {
        let mut lead = (solution.motion.lead + solution.motion.null).array();
        for (value, &locked) in lead.iter_mut().zip(&solution.locked) {
            *value = if locked { 0.0 } else { *value };
        }
        let addition = Addition {
            lead: &lead,
            share: self.settings.integrate * dt,
            gravity: &(seen.view.holding * J::splat(self.settings.gravity_scale)).array(),
            softness: &axes(wish.softness),
            rows: &without_locked(&rows_array(&seen.rows), &solution.locked),
            damping: &axes(solution.row_damping),
        };
        addition.store(&mut self.memory.integral, self.plan);
    }

    /// Line 1: filtered velocity.
    #[inline(always)]
    fn filter<J: Lanes>(&self) -> Filtered<J> {
        let q = J::load(self.q);
        if let Some(dq) = &self.input.dq {
            return Filtered { held: q, velocity: J::load(dq) };
        }
        let count = J::load(&self.plan.servos.count);
        self.memory.filter.after(q, count, self.settings.velocity_filter, self.input.dt)
    }

    /// Line 1: the positions at which the goal will arrive.
    #[inline(always)]
    fn predict<J: Lanes>(&self, filtered: &Filtered<J>) -> J {
        let q = J::load(self.q);
        if !self.plan.law.by_force() {
            return q;
        }
        let ahead = self.memory.gamma * self.settings.prediction_share * self.delay;
        J::fma(J::splat(ahead), filtered.velocity, q)
    }

    /// Line 2: kinematics and gravity.
    #[inline(always)]
    fn look<J: Lanes>(&mut self, q: J) -> Seen<J> {
        let plan = self.plan;
        let view = self.chain.look(q, self.masses, self.gravity, self.scratch);
        let base_from_task = task::base_from_task(&plan.frame, &view.tool);
        let rows = task::rows_in(&plan.frame, &view.world, &base_from_task, &plan.axes);
        let gravity = self.settings.gravity;
        let in_goal = J::splat(f64::from(u8::from(gravity.in_goal())));
        let in_limit = J::splat(f64::from(u8::from(gravity.in_limits())));
        let (gravity_in_goal, gravity_in_limit) = (in_goal * view.holding, in_limit * view.holding);
        Seen { q, view, base_from_task, rows, gravity_in_goal, gravity_in_limit }
    }

    /// Line 12 before floor, ceiling and slew, or (11).
    #[inline(always)]
    fn wanted_limits<J: Lanes>(
        &self,
        seen: &Seen<J>,
        wish: &Wish<J::Axes>,
        solution: &Solution<J>,
        singular: &SingularValues,
    ) -> J {
        let (plan, motion) = (self.plan, &solution.motion);
        let wrench = motion.wrench.whole();
        let pull = transpose_times(&seen.rows, &wrench.numbers());
        // The null space, and what a position limit has taken of the joint's part of the wrench.
        let lead = J::fnma(J::load(&plan.servos.compliance), pull, motion.lead + motion.force_lead + motion.null);
        let ahead = seen.q - J::load(self.q);
        let load = Load {
            gravity: seen.gravity_in_limit,
            feed_forward: solution.feed_forward,
            task: transpose_times(&seen.rows, &J::Axes::clip(wrench, wish.most).numbers()),
            offset: J::load(&plan.servos.kp) * (lead + J::load(&self.memory.integral) + ahead),
            gravity_scale: self.settings.gravity_scale,
            margin: J::load(&plan.margin),
        };
        match (solution.budget, plan.limits) {
            (Some(budget), _) => load.budget(budget),
            (None, LimitRule::Demand) => load.demand(),
            (None, LimitRule::Sum) => {
                let asked = Asked {
                    rows: rows_array(&seen.rows),
                    gradient: solution.gradient.array(),
                    damping: solution.damping.sqrt(),
                    sigma: [singular.smallest, singular.largest],
                    most: axes(wish.most),
                    gravity: seen.gravity_in_limit.every(),
                    feed_forward: solution.feed_forward.every(),
                };
                J::load(&asked.sum(plan, self.settings.gravity_scale))
            }
        }
    }

    /// How far the goals may lead under law `paper` [rad]: what the limit can use and a little more.
    #[inline(always)]
    fn lead_limit<J: Lanes>(&self, limit: J) -> J {
        let plan = self.plan;
        match self.settings.lead_limit {
            Some(lead) => J::splat(lead),
            None if plan.servos.has_kp => (limit + J::load(&plan.margin)) * J::load(&plan.servos.compliance),
            None => J::splat(LEAD_UNKNOWN),
        }
    }

    /// Everything that a tick came to.
    #[inline(always)]
    fn note<J: Lanes>(
        &mut self,
        seen: &Seen<J>,
        aim: &Aim,
        wish: &Wish<J::Axes>,
        solution: &Solution<J>,
        filtered: &Filtered<J>,
    ) {
        let (plan, record, motion) = (self.plan, &mut *self.record, &solution.motion);
        seen.q.store(&mut record.q);
        filtered.velocity.store(&mut record.velocity);
        record.deviation = axes(wish.deviation);
        record.adapted_deviation = axes(wish.adapted);
        record.dx = axes(wish.bounded * J::Axes::splat(1.0 / self.settings.horizon));
        record.softness = axes(wish.softness);
        record.compliance = axes(wish.compliance);
        record.holding_torque = axes(wish.most);
        record.wrench = axes(motion.wrench.whole());
        seen.view.holding.store(&mut record.gravity);
        solution.feed_forward.store(&mut record.feed_forward);
        solution.gradient.store(&mut record.gradient);
        for r in 0..MAX_AXES {
            seen.rows[r].store(&mut record.rows[r]);
        }
        let SingularValues { smallest, largest, .. } = self.memory.singular;
        record.followed_sigma = plan.follows_sigma().then_some([smallest, largest]);
        record.damping = solution.damping.sqrt();
        record.gamma = solution.gamma;
        record.factors = motion.factors;
        record.gain_factor = motion.gain_factor;
        record.locked = solution.locked;
        record.deviation_limited = [false; MAX_AXES];
        if !plan.deviation_limits.is_empty() {
            for (slot, &axis) in record.deviation_limited.iter_mut().zip(&plan.axes) {
                *slot = aim.limited[axis];
            }
        }
        record.reference = aim.reference;
    }
}
