//! One tick, from reading to command.

use crate::command::goal::{lock, slew};
use crate::command::limits::{Load, finish, within};
use crate::controller::memory::Memory;
use crate::controller::record::{Record, update_singular};
use crate::controller::{Command, Controller, LONGEST_PERIOD, SPEED_BOUND, StepInput};
use crate::error::{Error, Result};
use crate::kinematics::Frames;
use crate::law::activation::Activation;
use crate::law::cap::Wrench;
use crate::law::feedforward::{damping_squared, fade, resistance};
use crate::law::inverse::{Cholesky, times, transpose_times, weighted_gram};
use crate::law::{Motion, Tick, cap, paper, weighted_manipulability};
use crate::pose::{COORDINATE_BOUND, Pose};
use crate::settings::{Law, LimitRule};
use crate::task::deviation::{into_frame, pose_error};
use crate::task::{self, adapt, compliance};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Iterations that find the extreme singular vectors from nothing, and that follow them from tick to tick.
const ITERATIONS: (usize, usize) = (30, 2);

/// Longest time [s] for which a slew or the integrating goal is advanced at once: a stalled host must not lunge.
const LONGEST_SLEW: f64 = 0.1;

/// Lead [rad] allowed where nothing is known of the servos.
const LEAD_UNKNOWN: f64 = 0.3;

/// A step's input, read and checked.
struct Input {
    dt: f64,
    dq: Option<JointVec>,
    twist: Option<AxisVec>,
    gradient: JointVec,
    rest: JointVec,
}

/// What lines 3 to 6 make of the deviation; one entry per task row.
#[derive(Clone, Copy)]
struct Wish {
    deviation: AxisVec,
    adapted: AxisVec,
    softness: AxisVec,
    compliance: AxisVec,
    /// F: strength where the axis yields.
    strength: AxisVec,
    /// w F + (1 − w) hold.
    most: AxisVec,
    /// h (K_x ẽ + twist).
    step: AxisVec,
    /// The same within the per-axis limits.
    bounded: AxisVec,
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
            let finite = command.goal.iter().chain(&command.torque_limit).all(|x| x.is_finite());
            if finite {
                Ok((command, record, memory))
            } else {
                Err(Error::config("step", "the command is not finite for this q, target and settings: nothing was sent"))
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

    fn read(&self, input: &StepInput<'_>) -> Result<Input> {
        let dt = input.dt.unwrap_or(1.0 / self.settings.rate);
        if !(dt > 0.0 && dt <= LONGEST_PERIOD) {
            return Err(Error::limit("dt [s]", dt, format!("(0, {LONGEST_PERIOD}]")));
        }
        for value in input.twist.into_iter().flatten() {
            if !(value.abs() <= SPEED_BOUND) {
                return Err(Error::limit("twist [m/s, rad/s]", *value, format!("±{SPEED_BOUND} and finite")));
            }
        }
        let rest = match (input.posture, &self.settings.posture) {
            (Some(posture), _) => self.joints("posture", posture, COORDINATE_BOUND)?,
            (None, Some(posture)) => self.joints("posture", posture, COORDINATE_BOUND)?,
            (None, None) => self.memory.rest,
        };
        Ok(Input {
            dt,
            dq: input.dq.map(|dq| self.joints("dq", dq, SPEED_BOUND)).transpose()?,
            twist: input.twist.copied(),
            gradient: match input.gradient {
                Some(gradient) => self.joints("gradient", gradient, COORDINATE_BOUND)?,
                None => [0.0; MAX_JOINTS],
            },
            rest,
        })
    }

    /// Lines 1 to 12. Touches nothing: a result that cannot be sent is thrown away.
    fn compute(&self, q: &JointVec, target: &Pose, input: &Input) -> (Command, Record, Memory) {
        let (plan, settings) = (&self.plan, &self.settings);
        let (k, n, h) = (plan.k, plan.n, settings.horizon);
        let by_cap = plan.law == Law::Cap;
        let mut memory = self.memory;

        match &input.dq {
            Some(dq) => memory.filter.set(q, dq),
            None => memory.filter.update(q, &plan.servos.count, settings.velocity_filter, input.dt),
        }
        let velocity = memory.filter.velocity;
        let ahead = if by_cap { memory.gamma * settings.prediction_share * self.delay } else { 0.0 };
        let mut predicted = *q;
        for i in 0..n {
            predicted[i] += ahead * velocity[i];
        }
        let governed = settings.max_tool_speed.iter().any(|speed| speed.is_finite());
        let reference =
            memory.governor.follow(target, settings.max_tool_speed, settings.max_tool_acceleration, input.dt.min(LONGEST_SLEW));
        let twist = match &input.twist {
            Some(_) if governed => *memory.governor.velocity(),
            Some(twist) => *twist,
            None => [0.0; MAX_AXES],
        };

        let mut frames = Frames::default();
        let mut world = [[0.0; MAX_JOINTS]; MAX_AXES];
        let mut holding = [0.0; MAX_JOINTS];
        self.model.chain().forward(&predicted, &mut frames);
        self.model.chain().jacobian(&frames, &mut world);
        self.model.chain().gravity(&frames, &self.masses, self.gravity, &mut holding);
        let base_from_task = task::base_from_task(&plan.frame, &frames.tool);
        let all_rows = task::rows(&world, &base_from_task, &plan.axes);
        let error = into_frame(&base_from_task, &pose_error(&frames.tool, &reference));
        let wish = self.wish(&error, &into_frame(&base_from_task, &twist));

        let gravity_in_goal = if settings.gravity.in_goal() { holding } else { [0.0; MAX_JOINTS] };
        let gravity_in_limit = if settings.gravity.in_limits() { holding } else { [0.0; MAX_JOINTS] };
        let (mut locked, mut fixed_lead) = ([false; MAX_JOINTS], [0.0; MAX_JOINTS]);
        let mut rows = all_rows;
        let (mut gradient, mut damping, mut feed_forward, mut goal);
        let mut motion: Motion;
        let mut shares: Option<Activation>;
        loop {
            let scaled = plan.scale_rows(&rows);
            let iterations = if memory.cold { ITERATIONS.0 } else { ITERATIONS.1 };
            update_singular(&mut memory.singular, &scaled, k, n, iterations);
            memory.cold = false;
            let (sigma, adaptive) = (memory.singular.smallest, plan.damping);
            memory.gamma = fade(sigma, adaptive.sigma_0);
            damping = damping_squared(sigma, adaptive.lambda_0, adaptive.sigma_0, adaptive.lambda_max);
            feed_forward = if by_cap {
                let share = (settings.friction_share, settings.damping_share);
                let servos = &plan.servos;
                resistance(&velocity, &servos.friction, &servos.damping, share, settings.friction_speed, memory.gamma, n)
            } else {
                [0.0; MAX_JOINTS]
            };
            gradient = self.gradient(&predicted, input, &world, &scaled, &base_from_task, &memory);
            let done = times(&all_rows, &fixed_lead, k);
            let mut bounded = wish.bounded;
            (0..k).for_each(|r| bounded[r] -= done[r]);
            let tick = Tick {
                plan,
                horizon: h,
                rows: &rows,
                scaled_rows: &scaled,
                singular: &memory.singular,
                damping: &plan.damping_scale.map(|scale| scale * damping),
                softness: &wish.softness,
                strength: &wish.strength,
                step: &wish.step,
                bounded_step: &bounded,
                gradient: &gradient,
                locked: &locked,
                fixed_lead: &fixed_lead,
                gravity: &gravity_in_goal,
                feed_forward: &feed_forward,
                integral: &memory.integral,
            };
            (motion, shares) = match plan.law {
                Law::Cap => (cap::motion(&tick), None),
                Law::Paper => {
                    let (motion, shares) = paper::motion(&tick, &wish.most, settings.budget_on_goal);
                    (motion, Some(shares))
                }
            };
            let mut without_lead = [0.0; MAX_JOINTS];
            goal = [0.0; MAX_JOINTS];
            for i in 0..n {
                without_lead[i] = predicted[i]
                    + feed_forward[i] * plan.servos.compliance[i]
                    + gravity_in_goal[i] / plan.kg[i]
                    + memory.integral[i];
                goal[i] = without_lead[i] + motion.lead[i] + motion.null[i];
            }
            if !lock(&goal, &without_lead, &plan.lower, &plan.upper, &mut locked, &mut fixed_lead, n) {
                break;
            }
            for row in &mut rows {
                (0..n).filter(|&i| locked[i]).for_each(|i| row[i] = 0.0);
            }
        }

        let mut record = Record {
            q: predicted,
            velocity,
            deviation: wish.deviation,
            adapted_deviation: wish.adapted,
            dx: wish.bounded.map(|s| s / h),
            softness: wish.softness,
            compliance: wish.compliance,
            holding_torque: wish.most,
            wrench: sum(&motion.wrench),
            gravity: holding,
            feed_forward,
            gradient,
            rows,
            sigma_min: memory.singular.smallest,
            sigma_max: memory.singular.largest,
            damping: damping.sqrt(),
            gamma: memory.gamma,
            factors: motion.factors,
            saturated: [false; MAX_JOINTS],
            locked,
        };

        let offset = {
            let mut offset = [0.0; MAX_JOINTS];
            for i in 0..n {
                let lead = motion.null[i] + memory.integral[i] + fixed_lead[i] + predicted[i] - q[i];
                offset[i] = plan.servos.kp[i] * lead;
            }
            offset
        };
        let load = Load {
            gravity: &gravity_in_limit,
            feed_forward: &feed_forward,
            task: &transpose_times(&rows, &within(&record.wrench, &wish.most, k), k),
            offset: &offset,
            gravity_scale: settings.gravity_scale,
            margin: &plan.margin,
        };
        let wanted = match (plan.law, shares) {
            (Law::Paper, Some(shares)) => {
                let budget = shares.distribute(&wish.most, plan.null_torque, k);
                let mut wanted = [0.0; MAX_JOINTS];
                for i in 0..n {
                    wanted[i] = budget[i] + settings.gravity_scale * gravity_in_limit[i].abs();
                }
                wanted
            }
            _ if plan.limits == LimitRule::Sum => {
                let null = record.activation_null(plan).map(|share| share * plan.null_torque);
                load.sum(&rows, &wish.most, &null, k, n)
            }
            _ => load.demand(n),
        };
        let dt = input.dt.min(LONGEST_SLEW);
        let rise = plan.rise.map(|per_second| per_second * dt);
        let limit = finish(&wanted, memory.limit.as_ref(), &plan.floor, &plan.servos.torque, &rise, n);

        if plan.law == Law::Paper {
            for i in 0..n {
                let most = self.lead_limit(i, limit[i]);
                let lead = (motion.lead[i] + motion.null[i]).clamp(-most, most);
                goal[i] += lead - motion.lead[i] - motion.null[i];
            }
        }
        for i in 0..n {
            goal[i] = slew(memory.goal[i], goal[i], settings.goal_slew * dt, plan.lower[i], plan.upper[i]);
            record.saturated[i] = limit[i] >= plan.servos.torque[i];
        }
        if settings.integrate > 0.0 {
            self.integrate(&mut memory, &motion, &record, settings.integrate * dt);
        }
        memory.goal = goal;
        memory.limit = Some(limit);
        let command = Command { n, goal, torque_limit: limit, velocity: self.register_speed(&world) };
        (command, record, memory)
    }

    /// Lines 3 to 6: deviation → softness, compliance, strength, step.
    fn wish(&self, error: &AxisVec, twist: &AxisVec) -> Wish {
        let (plan, h) = (&self.plan, self.settings.horizon);
        let zero = [0.0; MAX_AXES];
        let mut wish = Wish {
            deviation: zero,
            adapted: zero,
            softness: zero,
            compliance: zero,
            strength: zero,
            most: zero,
            step: zero,
            bounded: zero,
        };
        let mut target_velocity = zero;
        for (r, row) in plan.rows.iter().enumerate().take(plan.k) {
            let e = error[row.axis];
            let plus = adapt::plus_share(e, row.band);
            let between = |pair: [f64; 2]| (1.0 - plus) * pair[0] + plus * pair[1];
            let w = between(row.yields);
            let adapted = adapt::adapt_deviation(e, row.eta, w);
            let seen = if self.settings.raw_deviation { e } else { adapted };
            let c = compliance::compliance(seen, row.d_minus, row.d_plus);
            let strength = compliance::strength(c, between(row.soft), between(row.firm), row.profile);
            target_velocity[r] = twist[row.axis];
            wish.deviation[r] = e;
            wish.adapted[r] = adapted;
            wish.softness[r] = w;
            wish.compliance[r] = c;
            wish.strength[r] = strength;
            wish.most[r] = w * strength + (1.0 - w) * row.hold;
        }
        for (r, row) in plan.rows.iter().enumerate().take(plan.k) {
            let pull: f64 = (0..plan.k).map(|c| plan.kx[r][c] * wish.adapted[c]).sum();
            let step = h * (plan.kx_derating * pull + target_velocity[r]);
            let w = wish.softness[r];
            let soft_most = h * row.soft_step_limit;
            let most = if row.soft_step_limit.is_finite() {
                h * ((1.0 - w) * row.step_limit.min(1e9) + w * row.soft_step_limit)
            } else if w < 1.0 {
                h * row.step_limit
            } else {
                soft_most
            };
            wish.step[r] = step.clamp(-soft_most, soft_most);
            wish.bounded[r] = step.clamp(-most, most);
        }
        wish
    }

    /// Gradient of the null-space cost, all its parts.
    fn gradient(
        &self,
        q: &JointVec,
        input: &Input,
        world: &Rows,
        scaled_rows: &Rows,
        base_from_task: &[[f64; 3]; 3],
        memory: &Memory,
    ) -> JointVec {
        let plan = &self.plan;
        let mut gradient = plan.cost.gradient(q, &input.rest, plan.n);
        if plan.cost.manipulability > 0.0 {
            let more = weighted_manipulability(plan, world, scaled_rows, base_from_task, &memory.singular);
            (0..plan.n).for_each(|i| gradient[i] += more[i]);
        }
        (0..plan.n).for_each(|i| gradient[i] += input.gradient[i]);
        gradient
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

    /// Stores part of what the stiff axes still lead, within what the limits can use; on soft axes nothing is stored.
    fn integrate(&self, memory: &mut Memory, motion: &Motion, record: &Record, share: f64) {
        let plan = &self.plan;
        let (k, n, servos) = (plan.k, plan.n, &plan.servos);
        for i in 0..n {
            let room = servos.torque[i] - self.settings.gravity_scale * record.gravity[i].abs();
            let leash = if room.is_finite() && servos.has_kp { room.max(0.0) * servos.compliance[i] } else { LEAD_UNKNOWN };
            let stored = memory.integral[i] + share * (motion.stiff_lead[i] + motion.null[i]);
            memory.integral[i] = stored.clamp(-leash, leash);
        }
        if record.softness.iter().all(|&w| w <= 0.0) {
            return;
        }
        let mut compliance = weighted_gram(&record.rows, &servos.compliance, k, n);
        for (r, row) in compliance.iter_mut().enumerate().take(k) {
            row[r] += plan.damping_scale[r] * record.damping * record.damping / servos.kp_mean;
        }
        let mut pull = Cholesky::new(&compliance, k).solve(&times(&record.rows, &memory.integral, k));
        (0..k).for_each(|r| pull[r] *= record.softness[r]);
        let torque = transpose_times(&record.rows, &pull, k);
        (0..n).for_each(|i| memory.integral[i] -= servos.compliance[i] * torque[i]);
    }

    /// Joint speeds that keep the tool within its own by one joint alone.
    fn register_speed(&self, world: &Rows) -> JointVec {
        let [linear, angular] = self.settings.max_tool_speed;
        let mut out = self.plan.joint_speed;
        for (i, speed) in out.iter_mut().enumerate().take(self.plan.n) {
            let size = |from: usize| (from..from + 3).map(|r| world[r][i] * world[r][i]).sum::<f64>().sqrt();
            *speed = speed.min(linear / size(0).max(1e-9)).min(angular / size(3).max(1e-9));
        }
        out
    }
}

fn sum(wrench: &Wrench) -> AxisVec {
    let mut out = wrench.soft;
    for (value, stiff) in out.iter_mut().zip(wrench.stiff) {
        *value += stiff;
    }
    out
}
