//! One tick, from reading to command.

use crate::command::dead_host::Dead;
use crate::command::goal::{at_least, at_most, clip, register_speed, slew};
use crate::command::integral::Addition;
use crate::command::limits::{Load, finish, within};
use crate::controller::input::Input;
use crate::controller::memory::Memory;
use crate::controller::record::Record;
use crate::controller::solve::{Solution, solve};
use crate::controller::{Command, Controller, StepInput};
use crate::error::{Error, Result};
use crate::kinematics::{Frames, Masses};
use crate::law::inverse::transpose_times;
use crate::model::Chain;
use crate::number::{Kernel, Machine};
use crate::plan::Plan;
use crate::pose::Pose;
use crate::settings::{Law, LimitRule, Settings};
use crate::task;
use crate::task::deviation::{into_frame, out_of_frame, pose_error};
use crate::task::deviation_limit::Pushed;
use crate::task::governor::Governor;
use crate::task::wish::Wish;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Longest time [s] for which a slew or the integrating goal is advanced at once: a stalled host must not lunge.
const LONGEST_SLEW: f64 = 0.1;

/// Lead [rad] allowed under law `paper` where nothing is known of the servos.
const LEAD_UNKNOWN: f64 = 0.3;

/// What a step works in; nothing of it outlives the step.
#[derive(Debug, Clone)]
pub(super) struct Scratch {
    frames: Frames,
    seen: Seen,
    /// Task rows, columns of locked joints zero.
    free: Rows,
}

impl Scratch {
    pub(super) fn new() -> Self {
        let (rows, joints) = ([[0.0; MAX_JOINTS]; MAX_AXES], [0.0; MAX_JOINTS]);
        let seen = Seen {
            q: joints,
            world: rows,
            base_from_task: Pose::IDENTITY.rotation,
            rows,
            error: [0.0; MAX_AXES],
            reference: Pose::IDENTITY,
            limited: [false; MAX_AXES],
            holding: joints,
            gravity_in_goal: joints,
            gravity_in_limit: joints,
        };
        Self { frames: Frames::default(), seen, free: rows }
    }
}

/// Line 2: the arm at the predicted positions.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    /// q̂ [rad].
    pub(super) q: JointVec,
    /// Jacobian in base axes (6 × n).
    pub(super) world: Rows,
    pub(super) base_from_task: [[f64; 3]; 3],
    /// Jacobian rows of the task's axes, in the task frame (k × n).
    pub(super) rows: Rows,
    /// Deviation (6,) in the task frame.
    error: AxisVec,
    reference: Pose,
    /// Which of x, y, z, roll, pitch, yaw met its deviation limit.
    limited: [bool; MAX_AXES],
    /// Torques that hold the arm [N·m].
    holding: JointVec,
    pub(super) gravity_in_goal: JointVec,
    gravity_in_limit: JointVec,
}

impl Controller {
    pub(super) fn restart(&mut self, q: &JointVec) {
        let mut frames = Frames::default();
        self.model.chain().forward(q, &mut frames);
        self.memory = Memory::at(q, frames.tool, true);
    }

    pub(crate) fn advance(&mut self, q: &JointVec, target: &Pose, input: &StepInput<'_>) -> Result<&Command> {
        let before = self.memory;
        if !before.started {
            self.restart(q);
        }
        let done = self.read(input).and_then(|input| {
            let instructions = self.instructions;
            if instructions.run_single(self.cycle(q, target, &input)) {
                Ok(())
            } else {
                Err(Error::config(
                    "step",
                    "the command is not finite for this q, target and settings: nothing was sent",
                ))
            }
        });
        if let Err(error) = done {
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
struct Cycle<'a> {
    plan: &'a Plan,
    settings: &'a Settings,
    chain: &'a Chain,
    masses: &'a Masses,
    gravity: &'a [f64; 3],
    delay: f64,
    q: &'a JointVec,
    target: &'a Pose,
    input: &'a Input,
    memory: &'a mut Memory,
    scratch: &'a mut Scratch,
    record: &'a mut Record,
    command: &'a mut Command,
}

impl Kernel for Cycle<'_> {
    /// Whether the command can be sent: record and command are the last tick's where it cannot, memory is spoilt.
    type Output = bool;

    #[inline(always)]
    fn run<M: Machine>(mut self) -> bool {
        // Loops over a constant number of joints become straight vector code.
        if self.plan.n <= 8 { self.tick::<M>(8) } else { self.tick::<M>(self.plan.n) }
    }
}

impl Cycle<'_> {
    /// Lines 1 to 12; `n` and the number of rows are constants where this is compiled, see [`crate::law::Tick`].
    #[inline(always)]
    fn tick<M: Machine>(&mut self, n: usize) -> bool {
        let (plan, settings, k) = (self.plan, self.settings, MAX_AXES);
        let dt = self.input.dt.min(LONGEST_SLEW);

        let predicted = self.predict(n);
        let speed = settings.max_tool_speed;
        let before = self.memory.governor.pose();
        let reference = self.memory.governor.follow(self.target, speed, settings.max_tool_acceleration, dt);
        self.look::<M>(&predicted, reference, n);
        let Scratch { frames, seen, free } = &mut *self.scratch;
        if !plan.deviation_limits.is_empty() {
            limit_deviation(plan, &before, &frames.tool, seen, &mut self.memory.governor);
        }
        let twist = match &self.input.twist {
            Some(twist) => into_frame(&seen.base_from_task, &self.memory.governor.velocity(twist, speed)),
            None => [0.0; MAX_AXES],
        };
        let wish = Wish::new(plan, settings, &seen.error, &twist);
        let solution = solve(plan, settings, (k, n), self.input, seen, &wish, self.memory, free);
        let mut wrench = [0.0; MAX_AXES];
        for r in 0..k {
            wrench[r] = solution.motion.wrench.soft[r] + solution.motion.wrench.stiff[r];
        }

        let wanted = self.wanted_limits(&wish, &solution, &wrench, n);
        let mut rise = [0.0; MAX_JOINTS];
        for i in 0..n {
            rise[i] = plan.rise[i] * dt;
        }
        let mut limit = finish(&wanted, self.memory.limit.as_ref(), &plan.floor, &plan.servos.torque, &rise, n);
        let mut goal = solution.goal;
        if plan.law == Law::Paper {
            for i in 0..n {
                let (lead, most) = (solution.motion.lead[i] + solution.motion.null[i], self.lead_limit(i, limit[i]));
                goal[i] += clip(lead, most) - lead;
            }
        }
        let (mut saturated, mut finite, mut weight) = ([false; MAX_JOINTS], true, [0.0; MAX_JOINTS]);
        for i in 0..n {
            goal[i] = at_most(at_least(goal[i], plan.lower[i] - plan.beyond[i]), plan.upper[i] + plan.beyond[i]);
            weight[i] = self.scratch.seen.gravity_in_goal[i] / plan.kg[i];
        }
        let before = (&self.memory.goal, &self.memory.weight);
        let weight = slew(before, &mut goal, &weight, settings.goal_slew * dt, n);
        if let Some(most) = plan.dead_host_max {
            limit = self.spare(most, &goal, &limit);
        }
        for i in 0..plan.n {
            saturated[i] = limit[i] >= plan.servos.torque[i];
            finite &= goal[i].is_finite() & limit[i].is_finite();
        }
        if !finite {
            return false;
        }
        // A deviation that a limit keeps up is not to be worked off.
        if settings.integrate > 0.0 && !self.scratch.seen.limited.contains(&true) {
            self.integrate(dt, &wish, &solution);
        }
        (self.memory.goal, self.memory.weight) = (goal, weight);
        self.memory.limit = Some(limit);
        let seen = &self.scratch.seen;
        note(self.record, plan, seen, &wish, &solution, self.memory, settings.horizon, &wrench);
        self.record.saturated = saturated;
        self.command.goal = goal;
        self.command.torque_limit = limit;
        self.command.velocity = register_speed(&seen.world, speed, &plan.joint_speed, n);
        true
    }

    /// What the stiff axes and the null space add to the stored lead.
    fn integrate(&mut self, dt: f64, wish: &Wish, solution: &Solution) {
        let Scratch { seen, free, .. } = &*self.scratch;
        let mut lead = solution.motion.lead;
        for i in 0..self.plan.n {
            lead[i] = if solution.locked[i] { 0.0 } else { lead[i] + solution.motion.null[i] };
        }
        let addition = Addition {
            lead: &lead,
            share: self.settings.integrate * dt,
            gravity: &seen.holding.map(|g| self.settings.gravity_scale * g),
            softness: &wish.softness,
            rows: if solution.locked.contains(&true) { free } else { &seen.rows },
            damping: &solution.row_damping,
        };
        addition.store(&mut self.memory.integral, self.plan);
    }

    /// Line 1: filtered velocity, and the positions at which the goal will arrive.
    #[inline(always)]
    fn predict(&mut self, n: usize) -> JointVec {
        let (plan, filter) = (self.plan, &mut self.memory.filter);
        match &self.input.dq {
            Some(dq) => filter.set(self.q, dq),
            None => filter.update(self.q, &plan.servos.count, self.settings.velocity_filter, self.input.dt, n),
        }
        let mut predicted = *self.q;
        if plan.law.by_force() {
            let ahead = self.memory.gamma * self.settings.prediction_share * self.delay;
            for i in 0..n {
                predicted[i] += ahead * filter.velocity[i];
            }
        }
        predicted
    }

    /// Line 2: kinematics, gravity and deviation.
    #[inline(always)]
    fn look<M: Machine>(&mut self, q: &JointVec, reference: Pose, n: usize) {
        let (chain, Scratch { frames, seen, .. }) = (self.chain, &mut *self.scratch);
        chain.forward_by::<M::One>(q, frames);
        chain.jacobian_by::<M::One>(frames, &mut seen.world);
        chain.gravity_by::<M::One>(frames, self.masses, self.gravity, &mut seen.holding);
        seen.q = *q;
        seen.base_from_task = task::base_from_task(&self.plan.frame, &frames.tool);
        task::rows_into(&seen.world, &seen.base_from_task, &self.plan.axes, n, &mut seen.rows);
        seen.error = into_frame(&seen.base_from_task, &pose_error(&frames.tool, &reference));
        seen.reference = reference;
        seen.limited = [false; MAX_AXES];
        let gravity = self.settings.gravity;
        let (in_goal, in_limits) = (f64::from(u8::from(gravity.in_goal())), f64::from(u8::from(gravity.in_limits())));
        for i in 0..n {
            seen.gravity_in_goal[i] = in_goal * seen.holding[i];
            seen.gravity_in_limit[i] = in_limits * seen.holding[i];
        }
    }

    /// Line 12 before floor, ceiling and slew, or (11).
    #[inline(always)]
    fn wanted_limits(&self, wish: &Wish, solution: &Solution, wrench: &AxisVec, n: usize) -> JointVec {
        let (plan, k, motion, seen) = (self.plan, MAX_AXES, &solution.motion, &self.scratch.seen);
        let (pull, mut offset) = (transpose_times(&seen.rows, wrench, k, n), [0.0; MAX_JOINTS]);
        for i in 0..n {
            // The null space, and what a position limit has taken of the joint's part of the wrench.
            let lead = motion.lead[i] + motion.force_lead[i] + motion.null[i] - plan.servos.compliance[i] * pull[i];
            offset[i] = plan.servos.kp[i] * (lead + self.memory.integral[i] + seen.q[i] - self.q[i]);
        }
        let load = Load {
            gravity: &seen.gravity_in_limit,
            feed_forward: &solution.feed_forward,
            task: &transpose_times(&seen.rows, &within(wrench, &wish.most, k), k, n),
            offset: &offset,
            gravity_scale: self.settings.gravity_scale,
            margin: &plan.margin,
        };
        match (&solution.budget, plan.limits) {
            (Some(budget), _) => load.budget(budget, n),
            (None, LimitRule::Demand) => load.demand(n),
            (None, LimitRule::Sum) => {
                let mut record = Record::empty();
                note(&mut record, plan, seen, wish, solution, self.memory, self.settings.horizon, wrench);
                let null = record.shares(plan).null.map(|share| share * plan.null_torque);
                load.sum(&seen.rows, &wish.most, &null, k, n)
            }
        }
    }

    /// The limits with which a hand meets at most `most` [N] should the host die now.
    ///
    /// Kept out of the step: it follows the hand along every axis.
    #[cold]
    #[inline(never)]
    fn spare(&self, most: f64, goal: &JointVec, limit: &JointVec) -> JointVec {
        let (plan, seen, nothing) = (self.plan, &self.scratch.seen, [0.0; MAX_JOINTS]);
        let (mut friction, mut base) = (nothing, nothing);
        for i in 0..plan.n {
            friction[i] = plan.servos.friction_at_rest(i, seen.holding[i]);
            base[i] = at_least(self.settings.gravity_scale * seen.gravity_in_limit[i].abs(), plan.floor[i]);
        }
        let dead = Dead {
            chain: self.chain,
            plan,
            masses: self.masses,
            gravity: *self.gravity,
            base_from_task: seen.base_from_task,
            q: self.q,
            goal,
            limit,
            friction: &friction,
        };
        let by_demand = plan.law.by_force() && plan.limits == LimitRule::Demand;
        dead.spared(most, &base, if by_demand { &plan.margin } else { &nothing })
    }

    /// How far the goal of joint i may lead under law `paper` [rad]: what the limit can use and a little more.
    #[inline(always)]
    fn lead_limit(&self, i: usize, limit: f64) -> f64 {
        let plan = self.plan;
        match self.settings.lead_limit {
            Some(lead) => lead,
            None if plan.servos.has_kp => (limit + plan.margin[i]) * plan.servos.compliance[i],
            None => LEAD_UNKNOWN,
        }
    }
}

/// Bounds the deviation of stiff axes by moving the reference; its speed along these axes is then spent.
///
/// Kept out of the step, which mostly has no such axis.
#[cold]
#[inline(never)]
fn limit_deviation(plan: &Plan, before: &Pose, tool: &Pose, seen: &mut Seen, governor: &mut Governor) {
    let pushed = Pushed { tool, base_from_task: &seen.base_from_task, before };
    if let Some(kept) = pushed.keep(&plan.deviation_limits, &seen.reference) {
        let mut velocity = into_frame(&seen.base_from_task, &governor.own_velocity());
        for (value, met) in velocity.iter_mut().zip(kept.met) {
            *value *= if met { 0.0 } else { kept.advance };
        }
        governor.put(kept.reference, out_of_frame(&seen.base_from_task, &velocity));
        (seen.reference, seen.error, seen.limited) = (kept.reference, kept.error, kept.met);
    }
}

#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "everything that a tick came to")]
fn note(
    record: &mut Record,
    plan: &Plan,
    seen: &Seen,
    wish: &Wish,
    solution: &Solution,
    memory: &Memory,
    horizon: f64,
    wrench: &AxisVec,
) {
    let per_second = 1.0 / horizon;
    for r in 0..MAX_AXES {
        record.dx[r] = wish.bounded[r] * per_second;
    }
    record.deviation_limited = [false; MAX_AXES];
    for (slot, &axis) in record.deviation_limited.iter_mut().zip(&plan.axes) {
        *slot = seen.limited[axis];
    }
    record.q = seen.q;
    record.velocity = memory.filter.velocity;
    record.deviation = wish.deviation;
    record.adapted_deviation = wish.adapted;
    record.softness = wish.softness;
    record.compliance = wish.compliance;
    record.holding_torque = wish.most;
    record.wrench = *wrench;
    record.gravity = seen.holding;
    record.feed_forward = solution.feed_forward;
    record.gradient = solution.gradient;
    record.rows = seen.rows;
    record.followed_sigma = plan.follows_sigma().then_some([memory.singular.smallest, memory.singular.largest]);
    record.damping = solution.condition.damping.sqrt();
    record.gamma = memory.gamma;
    record.factors = solution.motion.factors;
    record.gain_factor = solution.motion.gain_factor;
    record.locked = solution.locked;
    record.reference = seen.reference;
}
