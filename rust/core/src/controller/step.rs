//! One control step of a single arm, from the measured positions to the command.
//!
//! Line numbers in the docs of the functions refer to the listing in `docs/derivations.md`, "The default law".

use crate::command::goal::{Goals, JointTargets, profile_velocity, slew};
use crate::command::host_loss::HostLossBound;
use crate::command::integrator::Integrator;
use crate::command::torque_limit::{SumRuleInput, bound_and_slew};
use crate::controller::diagnostics::Diagnostics;
use crate::controller::input::Input;
use crate::controller::state::State;
use crate::controller::{Command, Controller};
use crate::kinematics::velocity_filter::Filtered;
use crate::kinematics::{GroupMasses, KinematicScratch};
use crate::law::friction::FrictionGains;
use crate::law::nullspace::cost_gradient;
use crate::law::redistribution::{redistribute, without_locked};
use crate::law::singularity::{row_damping, singularity_state};
use crate::law::{self, LawInput, Pacing};
use crate::math::cold;
use crate::math::rows::store_rows;
use crate::math::simd::{F64x8, Isa, JointVec16, JointVector, Kernel, LANES, RealOps, SimdLevel, flush_subnormals};
use crate::math::singular_values::SingularValues;
use crate::model::Chain;
use crate::params::{Features, LimitRule, Params, Settings};
use crate::pose::Pose;
use crate::task::demand::AxisDemand;
use crate::task::deviation_limit::{DeviationLimiter, limit_deviation};
use crate::task::reference_governor::{ReferenceGovernor, ReferenceHold, hold_fraction};
use crate::task::{ArmState, frame_error};
use crate::{MAX_AXES, MAX_JOINTS};

/// Largest time step [s] of the rate limits and of the integrator: a longer `dt` is clamped to it, so that the arm does
/// not jump after the host has stalled.
const LONGEST_SLEW: f64 = 0.1;

/// Reference pose of the tool in this step, and the deviation from it.
struct StepReference<W> {
    reference: Pose,
    /// Deviation from the reference, one value per task row [m, rad].
    deviation: W,
}

/// A control step with any [`Features`].
pub(super) struct Step<'a> {
    pub(super) controller: &'a mut Controller,
    pub(super) q: &'a [f64],
    pub(super) target: &'a Pose,
    pub(super) input: &'a Input,
}

/// A control step with [`Features::PLAIN`], without optional inputs, for an arm of at most [`LANES`] joints.
pub(super) struct PlainStep<'a> {
    pub(super) controller: &'a mut Controller,
    pub(super) q: &'a [f64],
    pub(super) target: &'a Pose,
    /// Time since the last step [s].
    pub(super) dt: f64,
    /// True for the first step of an arm of which only the command is needed: the step sets the part of the state that it
    /// reads, and leaves the rest and the record undefined.
    pub(super) is_stateless: bool,
}

/// Inputs of one step, and the state that it changes.
struct StepContext<'a> {
    simd_level: SimdLevel,
    params: &'a Params,
    settings: &'a Settings,
    chain: &'a Chain,
    masses: &'a GroupMasses,
    gravity: &'a [f64; 3],
    delay: f64,
    q: &'a [f64],
    target: &'a Pose,
    input: &'a Input,
    /// True for [`PlainStep::is_stateless`].
    is_stateless: bool,
    state: &'a mut State,
    scratch: &'a mut KinematicScratch,
    diagnostics: &'a mut Diagnostics,
    command: &'a mut Command,
}

/// Joint targets of a step, with the quantities that later stages need.
#[derive(Clone, Copy)]
struct StepSolution<J: JointVector> {
    solution: JointTargets<J>,
    gradient: J,
    /// Damping λ².
    damping: f64,
    /// Factor γ on feed-forward and prediction.
    gamma: f64,
    /// Damping λ² of each task row.
    row_damping: J::Axes,
}

impl Kernel for Step<'_> {
    /// True if the step succeeded; false if positions, target or command are invalid. In that case state, diagnostics
    /// and command do not change.
    type Output = bool;

    #[inline(always)]
    fn run<M: Isa>(self) -> bool {
        let features = Features { inputs: true, ..self.controller.params.features };
        let mut context = StepContext::new(self.controller, self.q, self.target, self.input, false);
        if context.params.n <= LANES {
            context.step_generic::<M::F64x8>(features)
        } else {
            context.step_large_arm(features)
        }
    }
}

impl Kernel for PlainStep<'_> {
    /// As for [`Step`].
    type Output = bool;

    #[inline(always)]
    fn run<M: Isa>(self) -> bool {
        if self.is_stateless {
            let state = &mut self.controller.state;
            flush_subnormals(M::F64x8::load_slice(self.q)).store(&mut state.rest);
            state.limit = None;
        }
        let input = Input::new(self.dt);
        StepContext::new(self.controller, self.q, self.target, &input, self.is_stateless)
            .step_generic::<M::F64x8>(Features::PLAIN)
    }
}

impl<'a> StepContext<'a> {
    #[inline(always)]
    fn new(
        controller: &'a mut Controller,
        q: &'a [f64],
        target: &'a Pose,
        input: &'a Input,
        is_stateless: bool,
    ) -> Self {
        Self {
            simd_level: controller.simd_level,
            params: &controller.params,
            settings: &controller.settings,
            chain: controller.model.chain(),
            masses: match &controller.payload_ramp {
                Some(payload_ramp) => &payload_ramp.masses,
                None => &controller.masses,
            },
            gravity: &controller.gravity,
            delay: controller.delay,
            q,
            target,
            input,
            is_stateless,
            state: &mut controller.state,
            scratch: &mut controller.scratch,
            diagnostics: &mut controller.diagnostics,
            command: &mut controller.command,
        }
    }
}

impl StepContext<'_> {
    /// Runs the step of an arm with more than [`LANES`] joints; compiled once for all instruction sets.
    #[inline(never)]
    fn step_large_arm(&mut self, features: Features) -> bool {
        // With a constant, the compiler omits the code of plain steps.
        self.step_generic::<JointVec16>(Features { inputs: true, ..features })
    }

    /// Runs the step, lines 1 to 12 of the listing; returns false if positions, target or command are invalid.
    #[inline(always)]
    fn step_generic<J: JointVector>(&mut self, features: Features) -> bool {
        let (params, settings) = (self.params, self.settings);
        let dt = self.input.dt.min(LONGEST_SLEW);

        let measured = flush_subnormals(J::load_slice(self.q));
        if !params.is_plausible(measured) || self.target.is_invalid::<J::Elem>(&params.target_region) {
            return false;
        }
        let filtered = self.filter(features, measured);
        let q = self.predict(features, measured, &filtered);
        let speed = settings.max_tool_speed;
        let mut governor;
        let reference = if features.tool_speed {
            governor = self.state.governor;
            governor.update::<J::Elem>(self.target, speed, settings.max_tool_acceleration, dt)
        } else {
            governor = ReferenceGovernor::new(*self.target);
            *self.target
        };
        let weight = features.gravity.then_some((self.masses, self.gravity));
        let view = self.chain.evaluate(features.any_chain, q, weight, self.scratch);
        let mut row_storage = None;
        let arm = ArmState::new(params, settings, features, q, &view, &mut row_storage);
        let error = frame_error(&arm.view.frame, &reference);
        let deviation = params.to_task_rows(features, &arm.base_from_task, &error);
        let mut step_reference = StepReference { reference, deviation };
        // True for axes (x, y, z, roll, pitch, yaw) at their deviation limit. A local, because an array that is indexed
        // at run time is kept in memory, and so is the whole struct that contains it.
        let mut limited_axes = [false; MAX_AXES];
        if features.deviation_limits {
            let (tool, base_from_task) = (arm.view.tool, arm.base_from_task);
            let limiter =
                DeviationLimiter { tool: &tool, base_from_task: &base_from_task, before: &self.state.governor.pose() };
            if let Some(limited) = limit_deviation(params, &limiter, &mut governor) {
                // If the limit does not change the reference, keep the deviation bit-identical.
                let still = limited.reference == step_reference.reference;
                let deviation = if still { step_reference.deviation } else { params.select_rows(&limited.error) };
                step_reference = StepReference { reference: limited.reference, deviation };
                limited_axes = limited.active;
            }
        }
        let twist = match &self.input.twist {
            // At a deviation limit, the velocity of the reference differs from that of the target.
            Some(_) if features.inputs && limited_axes.contains(&true) => {
                params.to_task_rows(features, &arm.base_from_task, &governor.reference_velocity())
            }
            Some(twist) if features.inputs => {
                params.to_task_rows(features, &arm.base_from_task, &governor.velocity(twist, speed))
            }
            _ => J::Axes::splat(0.0),
        };
        let demand =
            AxisDemand::new(params, settings, features, step_reference.deviation, twist, self.prediction_time());
        let pacing = self.pacing(features, &arm, &filtered, &governor, dt);
        let mut singular = self.state.singular;
        let mut locked = [false; MAX_JOINTS];
        let solved = self.solve(features, &arm, &demand, &filtered, pacing, (&mut singular, &mut locked));
        let solution = &solved.solution;

        let wanted = self.wanted_limits(features, measured, &arm, &demand, &solved, &singular);
        let (floor, ceiling) = (J::load(&params.min_torque_limit), J::load(&params.servos.torque));
        let rise = J::load(&params.max_limit_rate) * J::splat(dt);
        let before = self.state.limit.as_ref().map(J::load);
        let mut limit = bound_and_slew(wanted, before, floor, ceiling, rise);
        let to =
            Goals { goal: solution.goal(params, settings, features, limit), gravity_offset: solution.q_gravity_offset };
        let from = Goals { goal: J::load(&self.state.goal), gravity_offset: J::load(&self.state.gravity_offset) };
        let (Goals { goal, gravity_offset }, share) = slew(from, to, settings.tracking.goal_slew * dt);
        let hold_fraction = hold_fraction(solution.motion.factors[2].min(share));
        if features.tool_speed && hold_fraction > 0.0 && governor.lags(speed) != [false; 2] {
            let lag = (demand.deviation * (J::Axes::splat(1.0) - demand.softness)).to_axes();
            let bounds = [speed, settings.max_tool_acceleration];
            let hold =
                ReferenceHold { params, bounds, base_from_task: &arm.base_from_task, lag: &lag, hold_fraction, dt };
            hold.apply(&self.state.governor.pose(), &mut governor);
        }
        if features.host_loss
            && let Some(max) = params.max_host_loss_force
        {
            limit = self.bound_host_loss(max, &arm, measured, goal, limit);
        }
        // Reject a command with an infinite or NaN entry: `x < ∞` is false for both.
        if (J::abs(goal) + J::abs(limit)).is_any_not_lt(J::splat(f64::INFINITY)) {
            return false;
        }
        let (mut filtered, mut reference) = (filtered, step_reference.reference);
        if features == Features::PLAIN {
            self.store_goals(features, &arm, Goals { goal, gravity_offset }, limit);
            if self.is_stateless {
                return true;
            }
            // Compute velocity and reference only now: the step did not need them, so they occupied no registers.
            (filtered, reference) = (self.filter(features, measured), *self.target);
            governor = ReferenceGovernor::new(reference);
        }
        self.state.filter.set(filtered);
        self.state.gamma = solved.gamma;
        if features.singular_values {
            (self.state.singular, self.state.cold) = (singular, false);
        }
        self.state.governor = governor;
        // Do not integrate at a deviation limit: the reference moves with the tool, so the deviation would not
        // decrease.
        if features.integral && !limited_axes.contains(&true) {
            self.integrate(dt, &arm, &demand, &solved, &locked);
        }
        if features != Features::PLAIN {
            self.store_goals(features, &arm, Goals { goal, gravity_offset }, limit);
        }
        self.record_diagnostics(features, &arm, (reference, &filtered), &demand, &solved, (&locked, &limited_axes));
        true
    }

    /// Computes the joint targets before the goal slew, lines 7 to 11 of the listing. Joints that would exceed a
    /// position limit are locked (true in `locked`), and the others take over their motion. Updates `singular` if the
    /// settings need it.
    #[inline(always)]
    fn solve<J: JointVector>(
        &self,
        features: Features,
        arm: &ArmState<'_, J>,
        demand: &AxisDemand<J::Axes>,
        filtered: &Filtered<J>,
        pacing: Pacing<J::Axes>,
        (singular, locked): (&mut SingularValues, &mut [bool; MAX_JOINTS]),
    ) -> StepSolution<J> {
        let (params, settings, input, state) = (self.params, self.settings, self.input, &*self.state);
        let scaled;
        let scaled_rows = if features.singular_values {
            scaled = params.scale_rows(arm.rows);
            &scaled
        } else {
            arm.rows // scaled rows are not used
        };
        let singularity = singularity_state(params, features, scaled_rows, singular, state.cold);
        let rest = input.rest.as_ref().or(params.posture.as_ref()).unwrap_or(&state.rest);
        let given = input.gradient.as_ref();
        let gradient = cost_gradient(params, features, rest, given, arm, demand, scaled_rows, singularity.mu_squared);
        let damping = row_damping::<J>(params, &singularity);
        let law_input = LawInput {
            params,
            features,
            horizon: settings.paper_options.horizon,
            rows: arm.rows,
            scaled_rows,
            singularity: &singularity,
            damping,
            pacing,
            demand,
            velocity: filtered.velocity,
            gradient,
            gravity: arm.gravity_in_goal,
            friction_gains: FrictionGains::new(settings, singularity.gamma),
            integral: J::load(&state.integral),
        };
        let mut solved = StepSolution {
            solution: JointTargets::new(params, &law_input, arm, law::solve(&law_input)),
            gradient,
            damping: singularity.damping,
            gamma: singularity.gamma,
            row_damping: damping,
        };
        let solution = &mut solved.solution;
        let (lower, upper) = (J::load(&params.lower), J::load(&params.upper));
        if upper.is_any_lt(solution.q_goal) | solution.q_goal.is_any_lt(lower) {
            cold();
            let (q_goal, at_limit) = redistribute(&law_input, arm, solution.feed_forward, &mut solution.motion);
            solution.q_goal = q_goal;
            for (slot, at_limit) in locked.iter_mut().zip(at_limit.to_joints()) {
                *slot = at_limit > 0.0;
            }
        }
        solved
    }

    /// Lowers the torque limits `limit` so that a hand meets at most the force `max` [N] if the host stops after this
    /// command.
    #[inline(always)]
    fn bound_host_loss<J: JointVector>(&self, max: f64, arm: &ArmState<'_, J>, measured: J, goal: J, limit: J) -> J {
        let bound = HostLossBound {
            simd_level: self.simd_level,
            chain: self.chain,
            params: self.params,
            masses: self.masses,
            gravity: self.gravity,
            gravity_scale: self.settings.paper_options.gravity_scale,
            base_from_task: arm.base_from_task,
            q: measured.to_joints(),
            goal: goal.to_joints(),
            limit: limit.to_joints(),
            holding: arm.view.holding.to_joints(),
            in_limit: arm.gravity_in_limit.to_joints(),
        };
        J::load(&bound.limits(max))
    }

    /// Returns the speeds for the servos' motion profiles [rad/s]; without limits on the tool's speed, those of the
    /// joints.
    #[inline(always)]
    fn profile<J: JointVector>(&self, features: Features, arm: &ArmState<'_, J>) -> J {
        let (settings, joint_speed) = (self.settings, J::load(&self.params.joint_speed));
        if !features.tool_speed {
            return joint_speed;
        }
        profile_velocity(&arm.view.j_base, settings.max_tool_speed, settings.tracking.goal_slew, joint_speed)
    }

    /// Integrates the lead of the stiff axes and of the null space, except that of locked joints, into the stored lead.
    #[inline(always)]
    fn integrate<J: JointVector>(
        &mut self,
        dt: f64,
        arm: &ArmState<'_, J>,
        demand: &AxisDemand<J::Axes>,
        solved: &StepSolution<J>,
        locked: &[bool; MAX_JOINTS],
    ) {
        let solution = &solved.solution;
        let mut offset = (solution.motion.stiff_offset + solution.motion.null).to_joints();
        for (value, &locked) in offset.iter_mut().zip(locked) {
            *value = if locked { 0.0 } else { *value };
        }
        let integrator = Integrator {
            offset: &offset,
            share: self.settings.tracking.integrate * dt,
            gravity: &(arm.view.holding * J::splat(self.settings.paper_options.gravity_scale)).to_joints(),
            softness: &demand.softness.to_axes(),
            rows: &without_locked(&store_rows(arm.rows), locked),
            damping: &solved.row_damping.to_axes(),
        };
        integrator.update(&mut self.state.integral, self.params);
    }

    /// Returns the filtered joint velocity, or the one given as input; line 1 of the listing.
    #[inline(always)]
    fn filter<J: JointVector>(&self, features: Features, q: J) -> Filtered<J> {
        if features.inputs
            && let Some(dq) = &self.input.dq
        {
            return Filtered { backlash_output: q, velocity: J::load(dq) };
        }
        let encoder_step = J::load(&self.params.servos.encoder_step);
        self.state.filter.update(q, encoder_step, self.settings.tracking.velocity_filter, self.input.dt)
    }

    /// Returns the predicted positions at the arrival of the goal, line 1 of the listing; under law `paper` the
    /// measured positions.
    #[inline(always)]
    fn predict<J: JointVector>(&self, features: Features, q: J, filtered: &Filtered<J>) -> J {
        if !features.law.by_force() {
            return q;
        }
        J::fma(J::splat(self.prediction_time()), filtered.velocity, q)
    }

    /// Returns the time for which positions and target are predicted, γ b_p T_d [s].
    #[inline(always)]
    fn prediction_time(&self) -> f64 {
        self.state.gamma * self.settings.compensation.delay * self.delay
    }

    /// Returns the feed-forward terms for velocity and acceleration of the reference; zero if the settings do not limit
    /// the tool's speed.
    #[inline(always)]
    fn pacing<J: JointVector>(
        &self,
        features: Features,
        arm: &ArmState<'_, J>,
        filtered: &Filtered<J>,
        governor: &ReferenceGovernor,
        dt: f64,
    ) -> Pacing<J::Axes> {
        if !(features.tool_speed && self.is_paced()) {
            return Pacing::zero();
        }
        let (velocity, before) = (governor.reference_velocity(), self.state.governor.reference_velocity());
        let change: [f64; 6] = std::array::from_fn(|i| (velocity[i] - before[i]) / dt);
        Pacing::new(self.params, features, arm, filtered.velocity, &velocity, &change)
    }

    /// Returns true if the stiff axes track the velocity of their reference.
    #[inline(always)]
    fn is_paced(&self) -> bool {
        self.params.pace.on && self.settings.max_tool_speed.iter().any(|speed| speed.is_finite())
    }

    /// Returns the torque limits before floor, ceiling and rate limit: equation (11) of the paper under law `paper`,
    /// otherwise line 12 of the listing or the rule `Sum`.
    #[inline(always)]
    fn wanted_limits<J: JointVector>(
        &self,
        features: Features,
        q: J,
        arm: &ArmState<'_, J>,
        demand: &AxisDemand<J::Axes>,
        solved: &StepSolution<J>,
        singular: &SingularValues,
    ) -> J {
        let (params, solution) = (self.params, &solved.solution);
        if let Some(budget) = solution.budget
            && !features.gravity
        {
            return budget;
        }
        let held = (q, J::load(&self.state.integral));
        let terms = solution.limit_terms(params, self.settings, held, arm, demand);
        match (solution.budget, params.limits) {
            (Some(budget), _) => terms.budget(budget),
            (None, LimitRule::Demand) => terms.demand(),
            (None, LimitRule::Sum) => {
                let sum_rule = SumRuleInput {
                    rows: store_rows(arm.rows),
                    gradient: solved.gradient.to_joints(),
                    damping: solved.damping.sqrt(),
                    sigma: [singular.smallest, singular.largest],
                    max: demand.max_strength.to_axes(),
                    gravity: arm.gravity_in_limit.to_joint_vec16(),
                    feed_forward: solution.feed_forward.to_joint_vec16(),
                };
                J::load(&sum_rule.sum(params, self.settings.paper_options.gravity_scale))
            }
        }
    }

    /// Stores the goals and the torque limits for the next step, and the command.
    #[inline(always)]
    fn store_goals<J: JointVector>(&mut self, features: Features, arm: &ArmState<'_, J>, goals: Goals<J>, limit: J) {
        let Goals { goal, gravity_offset } = goals;
        goal.store(&mut self.state.goal);
        gravity_offset.store(&mut self.state.gravity_offset);
        limit.store(self.state.limit.get_or_insert([0.0; MAX_JOINTS]));
        goal.store(&mut self.command.goal);
        limit.store(&mut self.command.torque_limit);
        self.profile(features, arm).store(&mut self.command.speed_limit);
    }

    /// Stores the intermediate results of the step in the diagnostics; of a plain step only those from which
    /// [`PlainRecord`] computes the others.
    #[inline(always)]
    fn record_diagnostics<J: JointVector>(
        &mut self,
        features: Features,
        arm: &ArmState<'_, J>,
        (reference, filtered): (Pose, &Filtered<J>),
        demand: &AxisDemand<J::Axes>,
        solved: &StepSolution<J>,
        (locked, limited_axes): (&[bool; MAX_JOINTS], &[bool; MAX_AXES]),
    ) {
        let solution = &solved.solution;
        let (params, record, motion) = (self.params, &mut *self.diagnostics, &solution.motion);
        arm.q.store(&mut record.q);
        filtered.velocity.store(&mut record.velocity);
        record.deviation = demand.deviation.to_axes();
        solved.gradient.store(&mut record.gradient);
        record.factors = motion.factors;
        record.locked = *locked;
        record.reference = reference;
        record.is_partial = features == Features::PLAIN;
        if record.is_partial {
            return;
        }
        record.adapted_deviation = demand.adapted.to_axes();
        let horizon = self.settings.paper_options.horizon;
        record.task_velocity = (demand.clamped_displacement * J::Axes::splat(1.0 / horizon)).to_axes();
        record.softness = demand.softness.to_axes();
        record.compliance = demand.compliance.to_axes();
        record.axis_strength = demand.max_strength.to_axes();
        for r in 0..MAX_AXES {
            arm.rows[r].store(&mut record.rows[r]);
        }
        record.wrench = motion.wrench.total().to_axes();
        arm.view.holding.store(&mut record.gravity);
        solution.feed_forward.store(&mut record.feed_forward);
        let SingularValues { smallest, largest, .. } = self.state.singular;
        record.followed_sigma = features.singular_values.then_some([smallest, largest]);
        record.damping = solved.damping.sqrt();
        record.gamma = solved.gamma;
        record.gain_factor = motion.gain_factor;
        record.deviation_limited = [false; MAX_AXES];
        if features.deviation_limits {
            for (slot, &axis) in record.deviation_limited.iter_mut().zip(&params.axes) {
                *slot = limited_axes[axis];
            }
        }
    }
}
