//! One control step of a single arm, from the measured positions to the command.
//!
//! Line numbers in the docs of the functions refer to the listing in `docs/derivations.md`, "The default law".

use crate::command::goal::{Goals, JointTargets, profile_velocity, slew};
use crate::command::host_loss::HostLossBound;
use crate::command::integrator::Integrator;
use crate::command::torque_limit::{SumRuleInput, bound_and_slew};
use crate::controller::Command;
use crate::controller::diagnostics::Diagnostics;
use crate::controller::input::{Input, flush_subnormals};
use crate::controller::state::State;
use crate::kinematics::velocity_filter::Filtered;
use crate::kinematics::{GroupMasses, KinematicScratch};
use crate::law::friction::FrictionGains;
use crate::law::nullspace::cost_gradient;
use crate::law::redistribution::{redistribute, without_locked};
use crate::law::singularity::{row_damping, singularity_state};
use crate::law::{self, LawInput, Pacing};
use crate::math::rows::store_rows;
use crate::math::simd::{F64x8, Isa, JointVec16, JointVector, Kernel, LANES, RealOps, SimdLevel};
use crate::math::singular_values::SingularValues;
use crate::model::Chain;
use crate::params::{LimitRule, Params, Settings};
use crate::pose::Pose;
use crate::task::demand::AxisDemand;
use crate::task::deviation_limit::{DeviationLimiter, limit_deviation};
use crate::task::reference_governor::{ReferenceGovernor, ReferenceHold, hold_fraction};
use crate::task::{ArmState, pose_error_by};
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

/// Inputs of one step, and the state that it changes.
pub(super) struct StepContext<'a> {
    pub(super) simd_level: SimdLevel,
    pub(super) params: &'a Params,
    pub(super) settings: &'a Settings,
    pub(super) chain: &'a Chain,
    pub(super) masses: &'a GroupMasses,
    pub(super) gravity: &'a [f64; 3],
    pub(super) delay: f64,
    pub(super) q: &'a [f64],
    pub(super) target: &'a Pose,
    pub(super) input: &'a Input,
    pub(super) state: &'a mut State,
    pub(super) scratch: &'a mut KinematicScratch,
    pub(super) diagnostics: &'a mut Diagnostics,
    pub(super) command: &'a mut Command,
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

/// Marks the branch that calls it as unlikely, so that the compiler places that branch out of line.
#[cold]
#[inline(never)]
fn cold() {}

impl Kernel for StepContext<'_> {
    /// True if the step succeeded; false if positions, target or command are invalid. In that case state, diagnostics
    /// and command do not change.
    type Output = bool;

    #[inline(always)]
    fn run<M: Isa>(mut self) -> bool {
        if self.params.n <= LANES { self.step_generic::<M::F64x8>() } else { self.step_large_arm() }
    }
}

impl StepContext<'_> {
    /// Runs the step of an arm with more than [`LANES`] joints; compiled once for all instruction sets.
    #[inline(never)]
    fn step_large_arm(&mut self) -> bool {
        self.step_generic::<JointVec16>()
    }

    /// Runs the step, lines 1 to 12 of the listing; returns false if positions, target or command are invalid.
    #[inline(always)]
    fn step_generic<J: JointVector>(&mut self) -> bool {
        let (params, settings) = (self.params, self.settings);
        let dt = self.input.dt.min(LONGEST_SLEW);

        let measured = flush_subnormals(J::load_slice(self.q));
        if !params.is_plausible(measured) || self.target.is_invalid::<J::Elem>(&params.target_region) {
            return false;
        }
        let filtered = self.filter(measured);
        let q = self.predict(measured, &filtered);
        let speed = settings.max_tool_speed;
        let mut governor = self.state.governor;
        let reference = governor.update::<J::Elem>(self.target, speed, settings.max_tool_acceleration, dt);
        let view = self.chain.evaluate(q, params.uses_gravity.then_some((self.masses, self.gravity)), self.scratch);
        let mut row_storage = None;
        let arm = ArmState::new(params, settings, q, &view, &mut row_storage);
        let error = pose_error_by::<J::Elem>(&arm.view.tool, &reference);
        let deviation = params.to_task_rows(&arm.base_from_task, &error);
        let mut step_reference = StepReference { reference, deviation };
        // True for axes (x, y, z, roll, pitch, yaw) at their deviation limit. A local, because an array that is indexed
        // at run time is kept in memory, and so is the whole struct that contains it.
        let mut limited_axes = [false; MAX_AXES];
        if !params.deviation_limits.is_empty() {
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
            Some(_) if limited_axes.contains(&true) => {
                params.to_task_rows(&arm.base_from_task, &governor.reference_velocity())
            }
            Some(twist) => params.to_task_rows(&arm.base_from_task, &governor.velocity(twist, speed)),
            None => J::Axes::splat(0.0),
        };
        let demand = AxisDemand::new(params, settings, step_reference.deviation, twist);
        let pacing = self.pacing(&arm, &filtered, &governor, dt);
        let mut singular = self.state.singular;
        let mut locked = [false; MAX_JOINTS];
        let solved = self.solve(&arm, &demand, &filtered, pacing, (&mut singular, &mut locked));
        let solution = &solved.solution;

        let wanted = self.wanted_limits(measured, &arm, &demand, &solved, &singular);
        let (floor, ceiling) = (J::load(&params.min_torque_limit), J::load(&params.servos.torque));
        let rise = J::load(&params.max_limit_rate) * J::splat(dt);
        let before = self.state.limit.as_ref().map(J::load);
        let mut limit = bound_and_slew(wanted, before, floor, ceiling, rise);
        let to = Goals { goal: solution.goal(params, settings, limit), gravity_offset: solution.q_gravity_offset };
        let from = Goals { goal: J::load(&self.state.goal), gravity_offset: J::load(&self.state.gravity_offset) };
        let (Goals { goal, gravity_offset }, share) = slew(from, to, settings.tracking.goal_slew * dt);
        let hold_fraction = hold_fraction(solution.motion.factors[2].min(share));
        if hold_fraction > 0.0 && governor.lags(speed) != [false; 2] {
            let lag = (demand.deviation * (J::Axes::splat(1.0) - demand.softness)).to_axes();
            let bounds = [speed, settings.max_tool_acceleration];
            let hold =
                ReferenceHold { params, bounds, base_from_task: &arm.base_from_task, lag: &lag, hold_fraction, dt };
            hold.apply(&self.state.governor.pose(), &mut governor);
        }
        if let Some(max) = params.max_host_loss_force {
            let bound = HostLossBound {
                simd_level: self.simd_level,
                chain: self.chain,
                params,
                masses: self.masses,
                gravity: self.gravity,
                gravity_scale: settings.paper_options.gravity_scale,
                base_from_task: arm.base_from_task,
                q: measured.to_joints(),
                goal: goal.to_joints(),
                limit: limit.to_joints(),
                holding: arm.view.holding.to_joints(),
                in_limit: arm.gravity_in_limit.to_joints(),
            };
            limit = J::load(&bound.limits(max));
        }
        // Reject a command with an infinite or NaN entry: `x < ∞` is false for both.
        let (endless, zero) = (J::splat(f64::INFINITY), J::splat(0.0));
        let size = J::abs(goal) + J::abs(limit);
        if zero.is_any_lt(J::select_lt(size, endless, zero, endless)) {
            return false;
        }
        self.state.filter.set(filtered);
        self.state.gamma = solved.gamma;
        if params.tracks_sigma {
            (self.state.singular, self.state.cold) = (singular, false);
        }
        self.state.governor = governor;
        // Do not integrate at a deviation limit: the reference moves with the tool, so the deviation would not
        // decrease.
        if settings.tracking.integrate > 0.0 && !limited_axes.contains(&true) {
            self.integrate(dt, &arm, &demand, &solved, &locked);
        }
        goal.store(&mut self.state.goal);
        gravity_offset.store(&mut self.state.gravity_offset);
        limit.store(self.state.limit.get_or_insert([0.0; MAX_JOINTS]));
        goal.store(&mut self.command.goal);
        limit.store(&mut self.command.torque_limit);
        let profile =
            profile_velocity(&arm.view.j_base, speed, settings.tracking.goal_slew, J::load(&params.joint_speed));
        profile.store(&mut self.command.speed_limit);
        self.record_diagnostics(&arm, &step_reference, &demand, &solved, &filtered, (&locked, &limited_axes));
        true
    }

    /// Computes the joint targets, lines 7 to 11 of the listing. Evaluates the law, locks the joints that would exceed
    /// a position limit (true in `locked`) and redistributes their motion to the others. Updates `singular` if the
    /// settings need it.
    #[inline(always)]
    fn solve<J: JointVector>(
        &self,
        arm: &ArmState<'_, J>,
        demand: &AxisDemand<J::Axes>,
        filtered: &Filtered<J>,
        pacing: Pacing<J::Axes>,
        (singular, locked): (&mut SingularValues, &mut [bool; MAX_JOINTS]),
    ) -> StepSolution<J> {
        let (params, settings, input, state) = (self.params, self.settings, self.input, &*self.state);
        let scaled;
        let scaled_rows = if params.tracks_sigma {
            scaled = params.scale_rows(arm.rows);
            &scaled
        } else {
            arm.rows // scaled rows are not used
        };
        let singularity = singularity_state(params, scaled_rows, singular, state.cold);
        let rest = input.rest.as_ref().or(params.posture.as_ref()).unwrap_or(&state.rest);
        let gradient =
            cost_gradient(params, rest, input.gradient.as_ref(), arm, demand, scaled_rows, singularity.mu_squared);
        let damping = row_damping::<J>(params, &singularity);
        let law_input = LawInput {
            params,
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
    fn filter<J: JointVector>(&self, q: J) -> Filtered<J> {
        if let Some(dq) = &self.input.dq {
            return Filtered { backlash_output: q, velocity: J::load(dq) };
        }
        let encoder_step = J::load(&self.params.servos.encoder_step);
        self.state.filter.update(q, encoder_step, self.settings.tracking.velocity_filter, self.input.dt)
    }

    /// Returns the predicted positions at the arrival of the goal, line 1 of the listing; under law `paper` the
    /// measured positions.
    #[inline(always)]
    fn predict<J: JointVector>(&self, q: J, filtered: &Filtered<J>) -> J {
        if !self.params.law.by_force() {
            return q;
        }
        let ahead = self.state.gamma * self.settings.compensation.delay * self.delay;
        J::fma(J::splat(ahead), filtered.velocity, q)
    }

    /// Returns the feed-forward terms for velocity and acceleration of the reference; zero if the settings do not limit
    /// the tool's speed.
    #[inline(always)]
    fn pacing<J: JointVector>(
        &self,
        arm: &ArmState<'_, J>,
        filtered: &Filtered<J>,
        governor: &ReferenceGovernor,
        dt: f64,
    ) -> Pacing<J::Axes> {
        let governed = self.settings.max_tool_speed.iter().any(|speed| speed.is_finite());
        if !(self.params.pace.on && governed) {
            return Pacing::zero();
        }
        let (velocity, before) = (governor.reference_velocity(), self.state.governor.reference_velocity());
        let change: [f64; 6] = std::array::from_fn(|i| (velocity[i] - before[i]) / dt);
        Pacing::new(self.params, arm, filtered.velocity, &velocity, &change)
    }

    /// Returns the torque limits before floor, ceiling and rate limit: equation (11) of the paper under law `paper`,
    /// otherwise line 12 of the listing or the rule `Sum`.
    #[inline(always)]
    fn wanted_limits<J: JointVector>(
        &self,
        q: J,
        arm: &ArmState<'_, J>,
        demand: &AxisDemand<J::Axes>,
        solved: &StepSolution<J>,
        singular: &SingularValues,
    ) -> J {
        let (params, solution) = (self.params, &solved.solution);
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

    /// Stores the intermediate results of the step in the diagnostics.
    #[inline(always)]
    fn record_diagnostics<J: JointVector>(
        &mut self,
        arm: &ArmState<'_, J>,
        step_reference: &StepReference<J::Axes>,
        demand: &AxisDemand<J::Axes>,
        solved: &StepSolution<J>,
        filtered: &Filtered<J>,
        (locked, limited_axes): (&[bool; MAX_JOINTS], &[bool; MAX_AXES]),
    ) {
        let solution = &solved.solution;
        let (params, record, motion) = (self.params, &mut *self.diagnostics, &solution.motion);
        arm.q.store(&mut record.q);
        filtered.velocity.store(&mut record.velocity);
        record.deviation = demand.deviation.to_axes();
        record.adapted_deviation = demand.adapted.to_axes();
        record.task_velocity =
            (demand.clamped_displacement * J::Axes::splat(1.0 / self.settings.paper_options.horizon)).to_axes();
        record.softness = demand.softness.to_axes();
        record.compliance = demand.compliance.to_axes();
        record.axis_strength = demand.max_strength.to_axes();
        record.wrench = motion.wrench.total().to_axes();
        arm.view.holding.store(&mut record.gravity);
        solution.feed_forward.store(&mut record.feed_forward);
        solved.gradient.store(&mut record.gradient);
        for r in 0..MAX_AXES {
            arm.rows[r].store(&mut record.rows[r]);
        }
        let SingularValues { smallest, largest, .. } = self.state.singular;
        record.followed_sigma = params.tracks_sigma.then_some([smallest, largest]);
        record.damping = solved.damping.sqrt();
        record.gamma = solved.gamma;
        record.factors = motion.factors;
        record.gain_factor = motion.gain_factor;
        record.locked = *locked;
        record.deviation_limited = [false; MAX_AXES];
        if !params.deviation_limits.is_empty() {
            for (slot, &axis) in record.deviation_limited.iter_mut().zip(&params.axes) {
                *slot = limited_axes[axis];
            }
        }
        record.reference = step_reference.reference;
    }
}
