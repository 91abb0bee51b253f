//! One control step, from reading to command.

use crate::command::goal::{Goals, register_speed, slew};
use crate::command::integrator::Addition;
use crate::command::torque_limit::finish;
use crate::controller::cold_paths::{Asked, Waiting, limit_deviation, strain};
use crate::controller::diagnostics::Record;
use crate::controller::input::{Input, readable, without_negligible};
use crate::controller::solve::{Solved, solve, without_locked};
use crate::controller::stages::Seen;
use crate::controller::state::Memory;
use crate::controller::{Command, Controller, StepInput};
use crate::error::{Error, Result};
use crate::kinematics::velocity_filter::Filtered;
use crate::kinematics::{Frames, LookScratch, Masses};
use crate::law::Pacing;
use crate::math::rows::{axes, rows_array, times, wide};
use crate::math::simd::{Arithmetic, Axes, EveryJoint, Joints, Kernel, LANES, Machine};
use crate::math::singular_values::SingularValues;
use crate::model::Chain;
use crate::params::{LimitRule, Plan, Settings};
use crate::pose::Pose;
use crate::task::demand::Wish;
use crate::task::deviation_limit::Pushed;
use crate::task::pose_error_by;
use crate::task::reference_governor::Governor;
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

/// Longest time [s] by which one step advances a slew or the integrating goal: after a stall of the host the arm must
/// not lunge.
const LONGEST_SLEW: f64 = 0.1;

/// Reference pose of the tool in this step, and the error to it.
struct Aim<W> {
    reference: Pose,
    /// Deviation, one value per task row.
    deviation: W,
    /// Which of x, y, z, roll, pitch, yaw is at its deviation limit.
    limited: [bool; MAX_AXES],
}

impl Controller {
    pub(super) fn restart(&mut self, q: &JointVec) {
        let mut frames = Frames::default();
        self.model.chain().forward(q, &mut frames);
        self.memory = Memory::at(q, frames.tool, true);
        self.fade = None;
    }

    /// Runs a step; validates positions and target.
    pub(crate) fn advance(&mut self, q: &[f64], target: &Pose, input: &StepInput<'_>) -> Result<&Command> {
        if q.len() != self.plan.n {
            return Err(Error::length("q", q.len(), self.plan.n));
        }
        if !self.memory.started {
            return self.start(q, target, input);
        }
        let asked = input;
        let mut input = Input::default();
        self.read(asked, &mut input)?;
        let instructions = self.instructions;
        if instructions.run_single(self.cycle(q, target, &input)) {
            if self.fade.is_some() {
                self.fade_on(input.dt);
            }
            return Ok(&self.command);
        }
        Err(self.refusal(q, target))
    }

    /// Runs the first step, which resets the controller.
    #[cold]
    fn start(&mut self, q: &[f64], target: &Pose, input: &StepInput<'_>) -> Result<&Command> {
        let before = self.memory;
        self.restart(&self.positions("q", q)?);
        if let Err(error) = self.advance(q, target, input).map(|_| ()) {
            self.memory = before;
            return Err(error);
        }
        Ok(&self.command)
    }

    fn cycle<'a>(&'a mut self, q: &'a [f64], target: &'a Pose, input: &'a Input) -> Cycle<'a> {
        Cycle {
            plan: &self.plan,
            settings: &self.settings,
            chain: self.model.chain(),
            masses: match &self.fade {
                Some(fade) => &fade.masses,
                None => &self.masses,
            },
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

/// Context of one step: its inputs and the state that it changes.
pub(super) struct Cycle<'a> {
    pub(super) plan: &'a Plan,
    pub(super) settings: &'a Settings,
    pub(super) chain: &'a Chain,
    pub(super) masses: &'a Masses,
    pub(super) gravity: &'a [f64; 3],
    delay: f64,
    q: &'a [f64],
    target: &'a Pose,
    input: &'a Input,
    memory: &'a mut Memory,
    scratch: &'a mut LookScratch,
    record: &'a mut Record,
    command: &'a mut Command,
}

impl Kernel for Cycle<'_> {
    /// False if positions, target or command are invalid: state, record and command are then those of the last step.
    type Output = bool;

    #[inline(always)]
    fn run<M: Machine>(mut self) -> bool {
        if self.plan.n <= LANES { self.tick::<M::Eight>() } else { self.tick_of_many() }
    }
}

impl Cycle<'_> {
    /// [`Cycle::tick`] for an arm with more joints than one register row holds, compiled once for all instruction sets.
    #[inline(never)]
    fn tick_of_many(&mut self) -> bool {
        self.tick::<EveryJoint>()
    }

    /// Lines 1 to 12.
    #[inline(always)]
    fn tick<J: Joints>(&mut self) -> bool {
        let (plan, settings) = (self.plan, self.settings);
        let dt = self.input.dt.min(LONGEST_SLEW);

        let measured = without_negligible(J::read(self.q));
        if !readable(plan, measured) || self.target.is_refused::<J::One>(&plan.target_region) {
            return false;
        }
        let filtered = self.filter(measured);
        let q = self.predict(measured, &filtered);
        let speed = settings.max_tool_speed;
        let mut governor = self.memory.governor;
        let reference = governor.follow::<J::One>(self.target, speed, settings.max_tool_acceleration, dt);
        let view = self.chain.look(q, plan.heavy.then_some((self.masses, self.gravity)), self.scratch);
        let mut turned = None;
        let seen = Seen::new(plan, settings, q, &view, &mut turned);
        let error = pose_error_by::<J::One>(&seen.view.tool, &reference);
        let deviation = plan.in_rows(&seen.base_from_task, &error);
        let mut aim = Aim { reference, deviation, limited: [false; MAX_AXES] };
        if !plan.deviation_limits.is_empty() {
            let (tool, base_from_task) = (seen.view.tool, seen.base_from_task);
            let pushed = Pushed { tool: &tool, base_from_task: &base_from_task, before: &self.memory.governor.pose() };
            if let Some(kept) = limit_deviation(plan, &pushed, &mut governor) {
                // A reference that stays where it was leaves the deviation bit-identical.
                let still = kept.reference == aim.reference;
                let deviation = if still { aim.deviation } else { plan.of_rows(&kept.error) };
                aim = Aim { reference: kept.reference, deviation, limited: kept.met };
            }
        }
        let twist = match &self.input.twist {
            // A reference that was held back is not where its target is.
            Some(_) if aim.limited.contains(&true) => plan.in_rows(&seen.base_from_task, &governor.own_velocity()),
            Some(twist) => plan.in_rows(&seen.base_from_task, &governor.velocity(twist, speed)),
            None => J::Axes::splat(0.0),
        };
        let wish = Wish::new(plan, settings, aim.deviation, twist);
        let pacing = self.pacing(&seen, &filtered, &governor, dt);
        let mut singular = self.memory.singular;
        let solved = solve(plan, settings, self.input, &seen, &wish, self.memory, &filtered, pacing, &mut singular);
        let solution = &solved.solution;

        let wanted = self.wanted_limits(measured, &seen, &wish, &solved, &singular);
        let (floor, ceiling) = (J::load(&plan.floor), J::load(&plan.servos.torque));
        let rise = J::load(&plan.rise) * J::splat(dt);
        let before = self.memory.limit.as_ref().map(J::load);
        let mut limit = finish(wanted, before, floor, ceiling, rise);
        let to = Goals { goal: solution.goal(plan, settings, limit), weight: solution.weight };
        let from = Goals { goal: J::load(&self.memory.goal), weight: J::load(&self.memory.weight) };
        let (Goals { goal, weight }, share) = slew(from, to, settings.tracking.goal_slew * dt);
        let strain = strain(solution.motion.factors[2].min(share));
        if strain > 0.0 && governor.behind(speed) != [false; 2] {
            let lag = axes(wish.deviation * (J::Axes::splat(1.0) - wish.softness));
            let bounds = [speed, settings.max_tool_acceleration];
            let waiting = Waiting { plan, bounds, base_from_task: &seen.base_from_task, lag: &lag, strain, dt };
            waiting.of(&self.memory.governor.pose(), &mut governor);
        }
        if let Some(most) = plan.max_host_loss_force {
            let (holding, in_limit) = (seen.view.holding.array(), seen.gravity_in_limit.array());
            let at = [&measured.array(), &goal.array(), &limit.array()];
            let spared = self.spare(most, at, [&holding, &in_limit], seen.base_from_task);
            limit = J::load(&spared);
        }
        // Reject a command with an infinite or NaN entry: `x < ∞` is false for both.
        let (endless, nothing) = (J::splat(f64::INFINITY), J::splat(0.0));
        let size = J::abs(goal) + J::abs(limit);
        if nothing.any_less(J::if_less(size, endless, nothing, endless)) {
            return false;
        }
        self.memory.filter.keep(filtered);
        self.memory.gamma = solved.gamma;
        if plan.follows_sigma {
            (self.memory.singular, self.memory.cold) = (singular, false);
        }
        self.memory.governor = governor;
        // Do not integrate a deviation that a limit maintains.
        if settings.tracking.integrate > 0.0 && !aim.limited.contains(&true) {
            self.integrate(dt, &seen, &wish, &solved);
        }
        goal.store(&mut self.memory.goal);
        weight.store(&mut self.memory.weight);
        limit.store(self.memory.limit.get_or_insert([0.0; MAX_JOINTS]));
        goal.store(&mut self.command.goal);
        limit.store(&mut self.command.torque_limit);
        let profile = register_speed(&seen.view.world, speed, settings.tracking.goal_slew, J::load(&plan.joint_speed));
        profile.store(&mut self.command.speed_limit);
        self.note(&seen, &aim, &wish, &solved, &filtered);
        true
    }

    /// Adds the lead of stiff axes and null space to the stored lead.
    #[inline(always)]
    fn integrate<J: Joints>(&mut self, dt: f64, seen: &Seen<'_, J>, wish: &Wish<J::Axes>, solved: &Solved<J>) {
        let (solution, locked) = (&solved.solution, &solved.locked);
        let mut lead = (solution.motion.lead + solution.motion.null).array();
        for (value, &locked) in lead.iter_mut().zip(locked) {
            *value = if locked { 0.0 } else { *value };
        }
        let addition = Addition {
            lead: &lead,
            share: self.settings.tracking.integrate * dt,
            gravity: &(seen.view.holding * J::splat(self.settings.paper_options.gravity_scale)).array(),
            softness: &axes(wish.softness),
            rows: &without_locked(&rows_array(seen.rows), locked),
            damping: &axes(solved.row_damping),
        };
        addition.store(&mut self.memory.integral, self.plan);
    }

    /// Line 1: filtered velocity.
    #[inline(always)]
    fn filter<J: Joints>(&self, q: J) -> Filtered<J> {
        if let Some(dq) = &self.input.dq {
            return Filtered { held: q, velocity: J::load(dq) };
        }
        let encoder_step = J::load(&self.plan.servos.encoder_step);
        self.memory.filter.after(q, encoder_step, self.settings.tracking.velocity_filter, self.input.dt)
    }

    /// Line 1: predicted positions at the arrival of the goal.
    #[inline(always)]
    fn predict<J: Joints>(&self, q: J, filtered: &Filtered<J>) -> J {
        if !self.plan.law.by_force() {
            return q;
        }
        let ahead = self.memory.gamma * self.settings.compensation.delay * self.delay;
        J::fma(J::splat(ahead), filtered.velocity, q)
    }

    /// Returns the terms that give the tool the velocity and acceleration of its reference.
    #[inline(always)]
    fn pacing<J: Joints>(
        &self,
        seen: &Seen<'_, J>,
        filtered: &Filtered<J>,
        governor: &Governor,
        dt: f64,
    ) -> Pacing<J::Axes> {
        let (plan, pace) = (self.plan, &self.plan.pace);
        let governed = self.settings.max_tool_speed.iter().any(|speed| speed.is_finite());
        if !(pace.on && governed) {
            return Pacing::none();
        }
        let (velocity, before) = (governor.own_velocity(), self.memory.governor.own_velocity());
        let change: [f64; 6] = std::array::from_fn(|i| (velocity[i] - before[i]) / dt);
        let speed: J::Axes = plan.in_rows(&seen.base_from_task, &velocity);
        let acceleration: J::Axes = plan.in_rows(&seen.base_from_task, &change);
        let own: J::Axes = wide(&times(seen.rows, filtered.velocity));
        let driven = J::Axes::constant(&pace.inertia) * J::Axes::clip(acceleration, J::Axes::constant(&pace.driven));
        let displacement = J::Axes::fma(J::Axes::constant(&pace.damping), speed - own, driven);
        Pacing { displacement, velocity: speed }
    }

    /// Line 12 before minimum, ceiling and slew, or (11).
    #[inline(always)]
    fn wanted_limits<J: Joints>(
        &self,
        q: J,
        seen: &Seen<'_, J>,
        wish: &Wish<J::Axes>,
        solved: &Solved<J>,
        singular: &SingularValues,
    ) -> J {
        let (plan, solution) = (self.plan, &solved.solution);
        let held = (q, J::load(&self.memory.integral));
        let load = solution.load(plan, self.settings, held, seen, wish);
        match (solution.budget, plan.limits) {
            (Some(budget), _) => load.budget(budget),
            (None, LimitRule::Demand) => load.demand(),
            (None, LimitRule::Sum) => {
                let asked = Asked {
                    rows: rows_array(seen.rows),
                    gradient: solved.gradient.array(),
                    damping: solved.damping.sqrt(),
                    sigma: [singular.smallest, singular.largest],
                    most: axes(wish.most),
                    gravity: seen.gravity_in_limit.every(),
                    feed_forward: solution.feed_forward.every(),
                };
                J::load(&asked.sum(plan, self.settings.paper_options.gravity_scale))
            }
        }
    }

    /// Records the intermediates of the step.
    #[inline(always)]
    fn note<J: Joints>(
        &mut self,
        seen: &Seen<'_, J>,
        aim: &Aim<J::Axes>,
        wish: &Wish<J::Axes>,
        solved: &Solved<J>,
        filtered: &Filtered<J>,
    ) {
        let solution = &solved.solution;
        let (plan, record, motion) = (self.plan, &mut *self.record, &solution.motion);
        seen.q.store(&mut record.q);
        filtered.velocity.store(&mut record.velocity);
        record.deviation = axes(wish.deviation);
        record.adapted_deviation = axes(wish.adapted);
        record.task_velocity = axes(wish.bounded * J::Axes::splat(1.0 / self.settings.paper_options.horizon));
        record.softness = axes(wish.softness);
        record.compliance = axes(wish.compliance);
        record.axis_strength = axes(wish.most);
        record.wrench = axes(motion.wrench.whole());
        seen.view.holding.store(&mut record.gravity);
        solution.feed_forward.store(&mut record.feed_forward);
        solved.gradient.store(&mut record.gradient);
        for r in 0..MAX_AXES {
            seen.rows[r].store(&mut record.rows[r]);
        }
        let SingularValues { smallest, largest, .. } = self.memory.singular;
        record.followed_sigma = plan.follows_sigma.then_some([smallest, largest]);
        record.damping = solved.damping.sqrt();
        record.gamma = solved.gamma;
        record.factors = motion.factors;
        record.gain_factor = motion.gain_factor;
        record.locked = solved.locked;
        record.deviation_limited = [false; MAX_AXES];
        if !plan.deviation_limits.is_empty() {
            for (slot, &axis) in record.deviation_limited.iter_mut().zip(&plan.axes) {
                *slot = aim.limited[axis];
            }
        }
        record.reference = aim.reference;
    }
}
