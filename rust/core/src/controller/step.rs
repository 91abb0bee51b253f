//! One tick, from reading to command.

use crate::command::goal::{clip, register_speed, slew};
use crate::command::integral::Addition;
use crate::command::limits::{Load, finish, within};
use crate::controller::input::Input;
use crate::controller::memory::Memory;
use crate::controller::record::Record;
use crate::controller::solve::{Solution, solve};
use crate::controller::{Command, Controller, StepInput};
use crate::error::{Error, Result};
use crate::kinematics::Frames;
use crate::law::inverse::transpose_times;
use crate::plan::Plan;
use crate::pose::Pose;
use crate::settings::{Law, LimitRule};
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

/// Line 2: the arm at the predicted positions.
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
    tool: Pose,
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

    pub(super) fn advance(&mut self, q: &JointVec, target: &Pose, input: &StepInput<'_>) -> Result<&Command> {
        let before = self.memory;
        if !before.started {
            self.restart(q);
        }
        let outcome = self.read(input).and_then(|input| {
            let (command, record, memory) = self.compute(q, target, &input);
            if command.goal.iter().chain(&command.torque_limit).all(|x| x.is_finite()) {
                Ok((command, record, memory))
            } else {
                Err(Error::config(
                    "step",
                    "the command is not finite for this q, target and settings: nothing was sent",
                ))
            }
        });
        match outcome {
            Ok((command, record, memory)) => {
                self.memory = memory;
                self.record = record;
                self.command = command;
                Ok(&self.command)
            }
            Err(error) => {
                self.memory = before;
                Err(error)
            }
        }
    }

    /// Lines 1 to 12. Touches nothing: a result that cannot be sent is thrown away.
    fn compute(&self, q: &JointVec, target: &Pose, input: &Input) -> (Command, Record, Memory) {
        let (plan, settings) = (&self.plan, &self.settings);
        let mut memory = self.memory;
        let dt = input.dt.min(LONGEST_SLEW);

        let predicted = self.predict(q, input, &mut memory);
        let speed = settings.max_tool_speed;
        let before = memory.governor.pose();
        let reference = memory.governor.follow(target, speed, settings.max_tool_acceleration, dt);
        let mut seen = self.look(&predicted, reference);
        if !plan.deviation_limits.is_empty() {
            limit_deviation(plan, &before, &mut seen, &mut memory.governor);
        }
        let twist = input.twist.map_or([0.0; MAX_AXES], |twist| memory.governor.velocity(&twist, speed));
        let wish = Wish::new(plan, settings, &seen.error, &into_frame(&seen.base_from_task, &twist));
        let solution = solve(plan, settings, input, &seen, &wish, &mut memory);
        let mut record = note(plan, &seen, &wish, &solution, &memory, settings.horizon);

        let wanted = self.wanted_limits(q, &seen, &wish, &solution, &record, &memory);
        let rise = plan.rise.map(|per_second| per_second * dt);
        let limit = finish(&wanted, memory.limit.as_ref(), &plan.floor, &plan.servos.torque, &rise, plan.n);
        let mut goal = solution.goal;
        for i in 0..plan.n {
            if plan.law == Law::Paper {
                let (lead, most) = (solution.motion.lead[i] + solution.motion.null[i], self.lead_limit(i, limit[i]));
                goal[i] += clip(lead, most) - lead;
            }
            let (lower, upper) = (plan.lower[i] - plan.beyond[i], plan.upper[i] + plan.beyond[i]);
            goal[i] = slew(memory.goal[i], goal[i], settings.goal_slew * dt, lower, upper);
            record.saturated[i] = limit[i] >= plan.servos.torque[i];
        }
        // A deviation that a limit keeps up is not to be worked off.
        if settings.integrate > 0.0 && !seen.limited.contains(&true) {
            let mut lead = solution.motion.lead;
            (0..plan.n)
                .for_each(|i| lead[i] = if solution.locked[i] { 0.0 } else { lead[i] + solution.motion.null[i] });
            let addition = Addition {
                lead: &lead,
                share: settings.integrate * dt,
                gravity: &seen.holding.map(|g| settings.gravity_scale * g),
                softness: &wish.softness,
                rows: &solution.rows,
                damping: &solution.row_damping,
            };
            addition.store(&mut memory.integral, plan);
        }
        memory.goal = goal;
        memory.limit = Some(limit);
        let velocity = register_speed(&seen.world, speed, &plan.joint_speed, plan.n);
        (Command { n: plan.n, goal, torque_limit: limit, velocity }, record, memory)
    }

    /// Line 1: filtered velocity, and the positions at which the goal will arrive.
    fn predict(&self, q: &JointVec, input: &Input, memory: &mut Memory) -> JointVec {
        match &input.dq {
            Some(dq) => memory.filter.set(q, dq),
            None => memory.filter.update(q, &self.plan.servos.count, self.settings.velocity_filter, input.dt),
        }
        let mut predicted = *q;
        if self.plan.law.by_force() {
            let ahead = memory.gamma * self.settings.prediction_share * self.delay;
            (0..self.plan.n).for_each(|i| predicted[i] += ahead * memory.filter.velocity[i]);
        }
        predicted
    }

    /// Line 2: kinematics, gravity and deviation.
    fn look(&self, q: &JointVec, reference: Pose) -> Seen {
        let chain = self.model.chain();
        let mut frames = Frames::default();
        let mut world = [[0.0; MAX_JOINTS]; MAX_AXES];
        let mut holding = [0.0; MAX_JOINTS];
        chain.forward(q, &mut frames);
        chain.jacobian(&frames, &mut world);
        chain.gravity(&frames, &self.masses, self.gravity, &mut holding);
        let base_from_task = task::base_from_task(&self.plan.frame, &frames.tool);
        let gravity = self.settings.gravity;
        let nothing = [0.0; MAX_JOINTS];
        Seen {
            q: *q,
            rows: task::rows(&world, &base_from_task, &self.plan.axes),
            error: into_frame(&base_from_task, &pose_error(&frames.tool, &reference)),
            tool: frames.tool,
            reference,
            limited: [false; MAX_AXES],
            gravity_in_goal: if gravity.in_goal() { holding } else { nothing },
            gravity_in_limit: if gravity.in_limits() { holding } else { nothing },
            holding,
            world,
            base_from_task,
        }
    }

    /// Line 12 before floor, ceiling and slew, or (11).
    fn wanted_limits(
        &self,
        q: &JointVec,
        seen: &Seen,
        wish: &Wish,
        solution: &Solution,
        record: &Record,
        memory: &Memory,
    ) -> JointVec {
        let (plan, k, n) = (&self.plan, self.plan.k, self.plan.n);
        let (pull, mut offset) = (transpose_times(&seen.rows, &record.wrench, k), [0.0; MAX_JOINTS]);
        for i in 0..n {
            // The null space, and what a position limit has taken of the joint's part of the wrench.
            let lead = solution.motion.lead[i] + solution.motion.force_lead[i] + solution.motion.null[i]
                - plan.servos.compliance[i] * pull[i];
            offset[i] = plan.servos.kp[i] * (lead + memory.integral[i] + seen.q[i] - q[i]);
        }
        let load = Load {
            gravity: &seen.gravity_in_limit,
            feed_forward: &solution.feed_forward,
            task: &transpose_times(&seen.rows, &within(&record.wrench, &wish.most, k), k),
            offset: &offset,
            gravity_scale: self.settings.gravity_scale,
            margin: &plan.margin,
        };
        match (&solution.shares, plan.limits) {
            (Some(shares), _) => load.budget(&shares.distribute(&wish.most, plan.null_torque, k), n),
            (None, LimitRule::Demand) => load.demand(n),
            (None, LimitRule::Sum) => {
                let null = record.shares(plan).null.map(|share| share * plan.null_torque);
                load.sum(&seen.rows, &wish.most, &null, k, n)
            }
        }
    }

    /// How far the goal of joint i may lead under law `paper` [rad]: what the limit can use and a little more.
    fn lead_limit(&self, i: usize, limit: f64) -> f64 {
        let plan = &self.plan;
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
fn limit_deviation(plan: &Plan, before: &Pose, seen: &mut Seen, governor: &mut Governor) {
    let pushed = Pushed { tool: &seen.tool, base_from_task: &seen.base_from_task, before };
    if let Some(kept) = pushed.keep(&plan.deviation_limits, &seen.reference) {
        let mut velocity = into_frame(&seen.base_from_task, &governor.own_velocity());
        for (value, met) in velocity.iter_mut().zip(kept.met) {
            *value *= if met { 0.0 } else { kept.advance };
        }
        governor.put(kept.reference, out_of_frame(&seen.base_from_task, &velocity));
        (seen.reference, seen.error, seen.limited) = (kept.reference, kept.error, kept.met);
    }
}

fn note(plan: &Plan, seen: &Seen, wish: &Wish, solution: &Solution, memory: &Memory, horizon: f64) -> Record {
    let mut wrench = solution.motion.wrench.soft;
    for (value, stiff) in wrench.iter_mut().zip(solution.motion.wrench.stiff) {
        *value += stiff;
    }
    Record {
        q: seen.q,
        velocity: memory.filter.velocity,
        deviation: wish.deviation,
        adapted_deviation: wish.adapted,
        dx: wish.bounded.map(|s| s / horizon),
        softness: wish.softness,
        compliance: wish.compliance,
        holding_torque: wish.most,
        wrench,
        gravity: seen.holding,
        feed_forward: solution.feed_forward,
        gradient: solution.gradient,
        rows: seen.rows,
        sigma_min: memory.singular.smallest,
        sigma_max: memory.singular.largest,
        damping: solution.damping.sqrt(),
        gamma: memory.gamma,
        factors: solution.motion.factors,
        gain_factor: solution.motion.gain_factor,
        saturated: [false; MAX_JOINTS],
        locked: solution.locked,
        deviation_limited: std::array::from_fn(|r| plan.axes.get(r).is_some_and(|&axis| seen.limited[axis])),
        reference: seen.reference,
    }
}
