//! One control step, from reading to command.

use crate::command::goal::{Goals, Solution, register_speed, slew};
use crate::command::host_loss::HostLossBound;
use crate::command::integrator::Addition;
use crate::command::torque_limit::{Asked, finish};
use crate::controller::Command;
use crate::controller::diagnostics::Record;
use crate::controller::input::{Input, without_negligible};
use crate::controller::state::Memory;
use crate::kinematics::velocity_filter::Filtered;
use crate::kinematics::{LookScratch, Masses};
use crate::law::friction::Fed;
use crate::law::nullspace::cost_gradient;
use crate::law::redistribution::{redistribute, without_locked};
use crate::law::singularity::{condition, row_damping};
use crate::law::{Pacing, Tick, motion};
use crate::math::rows::{axes, rows_array};
use crate::math::simd::{Arithmetic, EveryJoint, Joints, Kernel, LANES, Machine};
use crate::math::singular_values::SingularValues;
use crate::model::Chain;
use crate::params::{LimitRule, Plan, Settings};
use crate::pose::Pose;
use crate::task::demand::Wish;
use crate::task::deviation_limit::{Pushed, limit_deviation};
use crate::task::reference_governor::{Governor, Waiting, strain};
use crate::task::{Seen, pose_error_by};
use crate::{MAX_AXES, MAX_JOINTS};

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

/// Context of one step: its inputs and the state that it changes.
pub(super) struct Cycle<'a> {
    pub(super) plan: &'a Plan,
    pub(super) settings: &'a Settings,
    pub(super) chain: &'a Chain,
    pub(super) masses: &'a Masses,
    pub(super) gravity: &'a [f64; 3],
    pub(super) delay: f64,
    pub(super) q: &'a [f64],
    pub(super) target: &'a Pose,
    pub(super) input: &'a Input,
    pub(super) memory: &'a mut Memory,
    pub(super) scratch: &'a mut LookScratch,
    pub(super) record: &'a mut Record,
    pub(super) command: &'a mut Command,
}

/// Solution with the quantities that only the step of a single arm has.
#[derive(Clone, Copy)]
struct Solved<J: Joints> {
    solution: Solution<J>,
    gradient: J,
    /// λ².
    damping: f64,
    /// γ: factor on feed-forward and prediction.
    gamma: f64,
    /// λ² of each row.
    row_damping: J::Axes,
    locked: [bool; MAX_JOINTS],
}

/// Marks its caller's branch as cold, so that the compiler places it behind the others.
#[cold]
#[inline(never)]
fn rare() {}

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
        if !plan.is_readable(measured) || self.target.is_refused::<J::One>(&plan.target_region) {
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
        let solved = self.solve(&seen, &wish, &filtered, pacing, &mut singular);
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
            let bound = HostLossBound {
                chain: self.chain,
                plan,
                masses: self.masses,
                gravity: self.gravity,
                gravity_scale: settings.paper_options.gravity_scale,
                base_from_task: seen.base_from_task,
                q: measured.array(),
                goal: goal.array(),
                limit: limit.array(),
                holding: seen.view.holding.array(),
                in_limit: seen.gravity_in_limit.array(),
            };
            limit = J::load(&bound.limits(most));
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

    /// Lines 7 to 11: the law, and the redistribution of motion to the other joints at position limits; updates
    /// `singular` if the settings need it.
    #[inline(always)]
    fn solve<J: Joints>(
        &self,
        seen: &Seen<'_, J>,
        wish: &Wish<J::Axes>,
        filtered: &Filtered<J>,
        pacing: Pacing<J::Axes>,
        singular: &mut SingularValues,
    ) -> Solved<J> {
        let (plan, settings, input, memory) = (self.plan, self.settings, self.input, &*self.memory);
        let scaled;
        let scaled_rows = if plan.follows_sigma {
            scaled = plan.scale_rows(seen.rows);
            &scaled
        } else {
            seen.rows // scaled rows are not used
        };
        let condition = condition(plan, scaled_rows, singular, memory.cold);
        let rest = input.rest.as_ref().or(plan.rest.as_ref()).unwrap_or(&memory.rest);
        let gradient =
            cost_gradient(plan, rest, input.gradient.as_ref(), seen, wish, scaled_rows, condition.mu_squared);
        let damping = row_damping::<J>(plan, &condition);
        let tick = Tick {
            plan,
            horizon: settings.paper_options.horizon,
            rows: seen.rows,
            scaled_rows,
            condition: &condition,
            damping,
            pacing,
            wish,
            velocity: filtered.velocity,
            gradient,
            gravity: seen.gravity_in_goal,
            fed: Fed::new::<J::One>(settings, condition.gamma),
            integral: J::load(&memory.integral),
        };
        let mut solved = Solved {
            solution: Solution::new(plan, &tick, seen, motion(&tick)),
            gradient,
            damping: condition.damping,
            gamma: condition.gamma,
            row_damping: damping,
            locked: [false; MAX_JOINTS],
        };
        let solution = &mut solved.solution;
        let (lower, upper) = (J::load(&plan.lower), J::load(&plan.upper));
        if upper.any_less(solution.moving) | solution.moving.any_less(lower) {
            rare();
            let (moving, locked) = redistribute(&tick, seen, solution.feed_forward, &mut solution.motion);
            solution.moving = moving;
            for (slot, locked) in solved.locked.iter_mut().zip(locked.array()) {
                *slot = locked > 0.0;
            }
        }
        solved
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
        let governed = self.settings.max_tool_speed.iter().any(|speed| speed.is_finite());
        if !(self.plan.pace.on && governed) {
            return Pacing::none();
        }
        let (velocity, before) = (governor.own_velocity(), self.memory.governor.own_velocity());
        let change: [f64; 6] = std::array::from_fn(|i| (velocity[i] - before[i]) / dt);
        Pacing::new(self.plan, seen, filtered.velocity, &velocity, &change)
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
