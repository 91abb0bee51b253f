//! Controller of one arm: construction, control steps, changes while running, and results.

mod command;
mod diagnostics;
mod input;
mod payload_ramp;
mod reference_restart;
mod snapshot;
mod state;
mod step;

use std::mem::replace;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::batch::state::{RowStatus, row_len};
use crate::batch::{ArmInput, Batch, BatchCommand, BatchInput, BatchState, OnInvalid};
use crate::error::{Error, Result};
use crate::kinematics::velocity_filter::SPEED_BOUND;
use crate::kinematics::{GroupMasses, JointFrames, KinematicScratch};
use crate::law;
use crate::math::simd::SimdLevel;
use crate::math::singular_values::SingularValues;
use crate::model::{Model, Payload};
use crate::params::joint_space::{self, JointSpaceStats};
use crate::params::{
    AxisImpedance, AxisParams, AxisStrength, DampingParams, GravityOffset, GravityUse, Params, Servos, Settings,
    max_adaptation,
};
use crate::pose::{COORDINATE_BOUND, Pose};
use crate::{JointVec, MAX_JOINTS};

pub use command::Command;
pub use diagnostics::Diagnostics;
pub use input::StepInput;
pub(crate) use input::period;
pub use snapshot::Snapshot;

use input::Input;
use payload_ramp::{PayloadRamp, mass_moment};
use reference_restart::{Rules, restart_reference};
use state::State;
use step::{PlainStep, Step};

/// Upper bound on the torque that holds a joint after the payload of a running controller has changed, as a multiple
/// of the usable torque.
const LARGEST_LOAD: f64 = 2.0;

/// Compliant task-space controller of one arm.
#[derive(Debug, Clone)]
pub struct Controller {
    pub(crate) model: Arc<Model>,
    pub(crate) settings: Settings,
    servos: Option<Servos>,
    joint_space_stats: JointSpaceStats,
    pub(crate) params: Params,
    pub(crate) masses: GroupMasses,
    payload: Option<Payload>,
    /// Ramp from the previous payload to the present one; `None` without a recent change.
    payload_ramp: Option<PayloadRamp>,
    pub(crate) gravity: [f64; 3],
    /// Captured gravity offset.
    captured: Option<GravityOffset>,
    delay: f64,
    pub(crate) state: State,
    pub(crate) diagnostics: Diagnostics,
    pub(crate) command: Command,
    pub(crate) simd_level: SimdLevel,
    scratch: KinematicScratch,
}

impl Controller {
    /// Creates a controller: validates settings and servos, and computes defaults from sampled configurations of the
    /// arm. Takes a few milliseconds.
    ///
    /// # Errors
    /// [`Error::OutOfRange`], [`Error::Shape`] or [`Error::Config`], naming the setting and the remedy.
    pub fn new(model: Arc<Model>, settings: Settings, servos: Option<Servos>) -> Result<Self> {
        let controller = Self::build(model, settings, servos, None)?;
        controller.check_holding(controller.settings.gravity_use(), &controller.masses)?;
        Ok(controller)
    }

    /// Runs one control step toward a pose of the tool.
    ///
    /// Allocates nothing. The first step resets the controller to `q`.
    ///
    /// # Errors
    /// [`Error::Shape`], [`Error::OutOfRange`] or [`Error::Config`] for an invalid input; the controller and its last
    /// command are then unchanged.
    ///
    /// ```
    /// # use pliant_core::{Controller, Model, ModelOptions, Servos, Settings, StepInput};
    /// # fn main() -> pliant_core::Result<()> {
    /// # let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
    /// # let model = std::sync::Arc::new(Model::from_urdf_str(include_str!("../../robots/arm7.urdf"), &options)?);
    /// # let servos = Servos::new(vec![150.0], vec![10.7]);
    /// # let mut controller = Controller::new(model.clone(), Settings::default(), Some(servos))?;
    /// let q = [-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17]; // measured [rad]
    /// let target = model.forward_kinematics(&q)?;
    /// let input = StepInput { dt: Some(0.01), ..StepInput::default() }; // [s]
    /// let command = controller.step(&q, &target, &input)?;
    /// assert!(command.goal().iter().zip(&q).all(|(goal, q)| (goal - q).abs() < 0.1)); // [rad]
    ///
    /// let error = controller.step(&q[..6], &target, &input).unwrap_err();
    /// assert_eq!(error.to_string(), "q has shape (6,), expected (7,)");
    /// # Ok(())
    /// # }
    /// ```
    pub fn step(&mut self, q: &[f64], target: &Pose, input: &StepInput<'_>) -> Result<&Command> {
        self.step_impl(q, target, input)
    }

    /// Runs one control step toward the joint positions `q_target` [rad]: their tool pose is the target, and
    /// `q_target` is the rest posture.
    ///
    /// # Errors
    /// As [`Controller::step`].
    pub fn step_joints(&mut self, q: &[f64], q_target: &[f64], input: &StepInput<'_>) -> Result<&Command> {
        let wanted = self.joint_target("q_target", q_target)?;
        let mut frames = JointFrames::default();
        self.model.chain().forward(&wanted, &mut frames);
        self.step_impl(q, &frames.tool, &StepInput { posture: Some(q_target), ..*input })
    }

    /// Runs one control step of `N` arms; the controller's own state and diagnostics do not change.
    ///
    /// With a `state`, each row of the result is bit-identical to that of a separate controller. Without `state`, each
    /// row is the first step of a controller that was just reset to its q, with unbounded `goal_slew` and
    /// `max_tool_speed`.
    ///
    /// With `caps` or `adaptation` in the input, each row equals that of a controller whose yielding axes have `soft` =
    /// `firm` = cap, and this adaptation. These values may change from step to step: torque limits and goals stay
    /// rate-limited.
    ///
    /// # Errors
    /// [`Error::Shape`] for inconsistent lengths; [`Error::Config`] for positions as targets of a task with rotations.
    /// With [`OnInvalid::Error`], the error of [`Controller::step`] for the first invalid row; `state` is then
    /// unchanged and the content of `out` is undefined. A command that is not finite is detected only after other arms
    /// have been stepped; the state of its arm is unchanged.
    ///
    /// ```
    /// # use pliant_core::{BatchCommand, BatchInput, BatchState, Controller, Model, ModelOptions, Servos, Settings, Targets};
    /// # fn main() -> pliant_core::Result<()> {
    /// # let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
    /// # let model = std::sync::Arc::new(Model::from_urdf_str(include_str!("../../robots/arm7.urdf"), &options)?);
    /// # let servos = Servos::new(vec![150.0], vec![10.7]);
    /// # let controller = Controller::new(model.clone(), Settings::default(), Some(servos))?;
    /// let q = [-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17].repeat(100); // [rad], row by row
    /// let target = model.forward_kinematics(&q[..7])?;
    /// let mut state = BatchState::new(7, 100)?;
    /// let (mut goal, mut torque_limit, mut velocity) = (q.clone(), q.clone(), q.clone());
    /// let out = BatchCommand { goal: &mut goal, torque_limit: &mut torque_limit, velocity: &mut velocity };
    /// controller.step_batch(&BatchInput::new(&q, Targets::One(&target)), Some(&mut state), out)?;
    /// assert!(torque_limit.iter().all(|limit| (0.0..=10.7).contains(limit))); // [N·m]
    /// # Ok(())
    /// # }
    /// ```
    pub fn step_batch(
        &self,
        input: &BatchInput<'_>,
        mut state: Option<&mut BatchState>,
        out: BatchCommand<'_>,
    ) -> Result<()> {
        let (n, batch) = (self.params.n, self.batch(input));
        let count = batch.check(&out)?;
        let dt = self.period(input.dt)?;
        let before = state.as_ref().and_then(|state| state.settings.clone()).filter(|old| **old != self.settings);
        let changed = before.is_some();
        // `None` also if the settings of the last step do not fit this arm.
        let before = before.and_then(|old| Some((self.params_of(&old)?, old)));
        let rows = state.as_mut().map(|state| state.rows_of(n, count)).transpose()?;
        let is_checked = rows.is_some() && input.invalid == OnInvalid::Error;
        if let Some(rows) = &rows
            && is_checked
        {
            batch.check_rows(rows)?;
        }
        let (is_free, is_stateless) = (rows.is_none(), self.params.is_plain && input.dq.is_none());
        let make = || {
            let mut arm = self.clone();
            arm.payload_ramp = None;
            if is_free {
                arm.settings.tracking.goal_slew = f64::INFINITY;
                arm.settings.max_tool_speed = [f64::INFINITY; 2];
            }
            arm
        };
        let step = |arm: &mut Self, one: &ArmInput<'_>, row: Option<&mut [f64]>, out: [&mut [f64]; 3]| {
            let Some(row) = row else {
                return (is_stateless || arm.start_row(one)) && arm.step_row(one, dt, is_stateless, out);
            };
            let is_ready = match RowStatus::of(row, n) {
                RowStatus::Running => {
                    arm.state.read_from(n, row);
                    true
                }
                RowStatus::New => arm.reset(one.q).is_ok(),
                RowStatus::Reset(q) => arm.reset(q).is_ok(),
            };
            if changed {
                if let Some((params, settings)) = &before {
                    arm.restart_reference(Rules { params, settings });
                }
                arm.reset_dependent_state();
            }
            if !(is_ready && arm.step_row(one, dt, false, out)) {
                return false;
            }
            arm.state.write_to(n, row);
            true
        };
        batch.run(is_checked, rows, out, make, step)?;
        if let Some(state) = state
            && (changed || state.settings.is_none())
        {
            state.settings = Some(Box::new(self.settings.clone()));
        }
        Ok(())
    }

    /// Resets the state to an arm at rest in `q` [rad]: the goals start there, and `q` is the rest posture unless
    /// the settings have one.
    ///
    /// A payload change takes full effect immediately; a captured gravity offset stays.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::OutOfRange`] for `q`; the controller is then unchanged.
    pub fn reset(&mut self, q: &[f64]) -> Result<()> {
        let q = self.positions("q", q)?;
        self.restart(&q);
        Ok(())
    }

    /// Replaces the settings while running. Goals and torque limits continue from their present values, rate-limited.
    ///
    /// If an axis would exert more force at its present deviation than before, e.g. because it becomes stiff, its
    /// reference restarts nearer to the tool, where the force is unchanged. From there it approaches the target at no
    /// more than `max_tool_speed`, as after a step of the target. Without this limit there is no reference.
    ///
    /// # Errors
    /// As [`Controller::new`]; the controller is then unchanged.
    pub fn update(&mut self, settings: Settings) -> Result<()> {
        let mut params = Params::new(
            &self.model,
            &settings,
            self.servos.as_ref(),
            self.captured.is_some(),
            &mut self.joint_space_stats,
        )?;
        self.check_posture(&settings)?;
        if self.settings.gravity_use() == GravityUse::Off {
            self.check_holding(settings.gravity_use(), &self.masses)?;
        }
        if let Some(offset) = self.captured {
            params.gravity_offset = offset;
        }
        // Complete the record now: the last step had the previous settings.
        self.diagnostics = self.record();
        // Keep a measured delay unless the new settings change the delay.
        if settings.delay.to_bits() != self.settings.delay.to_bits() {
            self.delay = settings.delay;
        }
        params.set_delay(self.delay, &settings);
        let (settings, params) = (replace(&mut self.settings, settings), replace(&mut self.params, params));
        self.restart_reference(Rules { params: &params, settings: &settings });
        self.reset_dependent_state();
        Ok(())
    }

    /// Sets the payload: mass [kg] and centre of mass in the tool frame [m]; `None` for no payload.
    ///
    /// Before the first step, it takes effect immediately; later, over half a second, so that a wrong or mistimed
    /// payload does not make the arm jump.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for an invalid payload and, if gravity is compensated, for a load that the servos cannot
    /// hold in any of the sampled configurations, or that needs more than twice their torque at the present goals.
    pub fn set_payload(&mut self, payload: Option<&Payload>) -> Result<()> {
        if let Some(payload) = payload {
            payload.validate()?;
        }
        let masses = self.model.chain().masses(payload);
        self.check_holding(self.settings.gravity_use(), &masses)?;
        self.check_load(&masses)?;
        let from = match &self.payload_ramp {
            Some(payload_ramp) => payload_ramp.current(self.payload.as_ref()),
            None => mass_moment(self.payload.as_ref()),
        };
        self.payload_ramp = self.state.started.then_some(PayloadRamp::start(from, self.current_masses()));
        (self.payload, self.masses) = (payload.copied(), masses);
        Ok(())
    }

    /// Sets the gravity vector [m/s²] in base axes, for a base that tilts.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a component beyond ±100 m/s².
    pub fn set_gravity(&mut self, vector: [f64; 3]) -> Result<()> {
        for (name, value) in ["x", "y", "z"].iter().zip(vector) {
            if !(value.abs() <= 100.0) {
                return Err(Error::out_of_range(format!("gravity {name} [m/s²]"), value, "±100"));
            }
        }
        self.gravity = vector;
        Ok(())
    }

    /// Sets the measured delay T_d [s] from the reading of the positions to the arrival of the goal.
    ///
    /// If the gain of the stiff axes is too high for this delay, the factor [`Controller::gain_factor`] reduces it.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] outside [0, 0.5].
    pub fn set_delay(&mut self, delay: f64) -> Result<()> {
        if !(0.0..=0.5).contains(&delay) {
            return Err(Error::out_of_range("delay [s]", delay, "[0, 0.5]"));
        }
        self.diagnostics = self.record();
        self.delay = delay;
        self.params.set_delay(delay, &self.settings);
        Ok(())
    }

    /// Sets the instruction set of the steps, by default that of [`SimdLevel::detect`]; results differ by rounding.
    pub fn set_simd_level(&mut self, simd_level: SimdLevel) {
        self.simd_level = simd_level;
    }

    /// Measures the stiffness k_g for the gravity offset on an arm that the goals `goal` [rad] hold still at `q` [rad].
    /// Set [`Tracking::integrate`](crate::params::Tracking::integrate) above 0 before, so that the arm has come to rest
    /// at its target. Returns k_g of each joint [N·m/rad].
    ///
    /// `k_g,i = g_i / (goal_i − q_i)`, clamped to 0.3 to 3 times the configured `k_p`. A joint whose |g_i| is at most
    /// three times its friction, or three times the servo torque of one encoder count, keeps the configured `k_p`. k_g
    /// is used for the gravity offset only.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::OutOfRange`] for `q` or `goal`; [`Error::Config`] without `k_p`.
    pub fn capture_gravity(&mut self, q: &[f64], goal: &[f64]) -> Result<Vec<f64>> {
        let q = self.positions("q", q)?;
        let goal = self.model.joints_within("goal", goal, COORDINATE_BOUND)?;
        if !self.params.servos.has_kp {
            return Err(Error::config("servos", "capturing gravity needs an assumed k_p: give servos"));
        }
        let holding = self.holding_torques(&q, &self.masses);
        let captured = self.params.servos.gravity_offset(self.params.n, &q, &goal, &holding);
        let before = self.params.gravity_offset;
        // Subtract the change of the gravity offset from the integrator, which holds it already.
        if self.settings.gravity_use().in_goal() {
            for i in 0..self.params.n {
                let more = holding[i] * (captured.compliance[i] - before.compliance[i]);
                let more = more + captured.lead[i] - before.lead[i];
                self.state.integral[i] -= more;
                self.state.gravity_offset[i] += more;
            }
        }
        self.captured = Some(captured);
        self.params.max_adaptation = max_adaptation(&self.settings, true);
        self.params.gravity_offset = captured;
        Ok(captured.compliance[..self.params.n].iter().map(|compliance| 1.0 / compliance).collect())
    }

    /// Returns a snapshot for [`Controller::from_snapshot`].
    pub fn snapshot(&self) -> Snapshot {
        let n = self.params.n;
        let mut state = vec![0.0; if self.state.started { row_len(n) } else { 0 }];
        self.state.clone().write_to(n, &mut state);
        Snapshot {
            payload: self.payload,
            gravity: self.gravity,
            payload_ramp: self.payload_ramp.map(|payload_ramp| payload_ramp.state()),
            delay: self.delay,
            captured: self.captured.map(|offset| [offset.compliance, offset.lead].map(|list| list[..n].to_vec())),
            state,
        }
    }

    /// Creates a controller from a snapshot. Its next step is bit-identical to that of the original if both use the
    /// same instruction set. The diagnostics of the last step are not part of the snapshot.
    ///
    /// # Errors
    /// As [`Controller::new`], without the check that the servos can hold the arm, and as [`Controller::set_delay`];
    /// [`Error::Shape`] for a snapshot of an arm of another size, [`Error::OutOfRange`] for impossible values.
    pub fn from_snapshot(
        model: Arc<Model>,
        settings: Settings,
        servos: Option<Servos>,
        snapshot: &Snapshot,
    ) -> Result<Self> {
        let n = model.n();
        snapshot.validate(n)?;
        let mut controller = Self::build(model, settings, servos, snapshot.captured.as_ref())?;
        if let Some(payload) = &snapshot.payload {
            payload.validate()?;
        }
        // Not checked again: `set_payload` has checked that the servos can hold the payload.
        controller.payload = snapshot.payload;
        controller.masses = controller.model.chain().masses(snapshot.payload.as_ref());
        controller.gravity = snapshot.gravity;
        controller.set_delay(snapshot.delay)?;
        snapshot.validate_state(n)?;
        if !snapshot.state.is_empty() {
            controller.state.read_from(n, &snapshot.state);
        }
        if let Some(payload_ramp) = snapshot.payload_ramp {
            controller.payload_ramp = Some(PayloadRamp::resume(payload_ramp, &controller.masses));
            controller.advance_payload_ramp(0.0);
        }
        Ok(controller)
    }

    /// Returns the model of the arm.
    pub fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// Returns the present payload: that of [`Controller::set_payload`], or of the model.
    pub const fn payload(&self) -> Option<&Payload> {
        self.payload.as_ref()
    }

    /// Returns the current settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Returns the servos; `None` if none were given.
    pub fn servos(&self) -> Option<&Servos> {
        self.servos.as_ref()
    }

    /// Returns the delay T_d from reading to arrival of the goal [s], from the settings or [`Controller::set_delay`].
    pub const fn delay(&self) -> f64 {
        self.delay
    }

    /// Returns the instruction set that the steps use.
    pub fn simd_level(&self) -> SimdLevel {
        self.simd_level
    }

    /// Returns the last command; `None` before the first step after construction or reset.
    pub fn last_command(&self) -> Option<&Command> {
        self.state.limit.map(|_| &self.command)
    }

    /// Returns the record of the last step. If that was a plain step, runs a full step of a copy at the same positions
    /// and reference to complete the record.
    fn record(&self) -> Diagnostics {
        let mut record = self.diagnostics;
        if record.is_partial {
            let (mut whole, input) = (self.clone(), Input::new(1.0 / self.settings.rate));
            let (q, target) = (&record.q[..self.params.n], &record.reference);
            self.simd_level.dispatch_narrow(Step { controller: &mut whole, q, target, input: &input });
            record.complete(&whole.diagnostics);
        }
        record
    }

    /// Returns the intermediate results of the last step.
    pub fn diagnostics(&self) -> Diagnostics {
        let mut diagnostics = self.record();
        if !self.params.features.gravity {
            diagnostics.gravity = self.holding_torques(&diagnostics.q, &self.masses);
        }
        for i in 0..self.params.n {
            diagnostics.saturated[i] = self.command.torque_limit[i] >= self.params.servos.torque[i];
        }
        diagnostics
    }

    /// Returns the number k of task axes.
    pub fn task_dim(&self) -> usize {
        self.params.k
    }

    /// Returns the strengths of each task axis, with defaults filled in.
    pub fn axis_strengths(&self) -> Vec<AxisStrength> {
        let strength = |axis: &AxisParams| AxisStrength { soft: axis.soft, firm: axis.firm, hold: axis.hold };
        self.params.per_axis.iter().take(self.params.k).map(strength).collect()
    }

    /// Returns stiffness and damping of each task axis, with defaults filled in; all zero except under law `impedance`.
    pub fn axis_impedances(&self) -> Vec<AxisImpedance> {
        let impedance = |axis: &AxisParams| AxisImpedance { stiffness: axis.stiffness, damping: axis.damping };
        self.params.per_axis.iter().take(self.params.k).map(impedance).collect()
    }

    /// Returns the constants of the inverse kinematics' damping, with defaults filled in.
    pub fn singularity_damping(&self) -> DampingParams {
        self.params.damping
    }

    /// Returns the factor ≤ 1 on the gain K_x, required by the delay; under law `impedance`, the factor on the
    /// stiffness in the last step, required by delay and pose.
    pub fn gain_factor(&self) -> f64 {
        law::gain_factor(&self.params, self.record().gain_factor)
    }

    /// Returns the factor ≤ 1 on the damping of law `impedance` in the last step, required by delay and pose; 1 under
    /// the other laws.
    pub fn damping_factor(&self) -> f64 {
        law::damping_factor(&self.params, &self.record().rows)
    }

    /// Returns the smallest and the largest singular value of the last step's task rows, with translations divided by
    /// the arm's length.
    pub fn sigma_range(&self) -> [f64; 2] {
        self.record().sigma(&self.params)
    }

    /// Returns all singular values of the last step's task rows, with translations divided by the arm's length, largest
    /// first.
    pub fn singular_values(&self) -> DVector<f64> {
        self.record().singular_values(&self.params)
    }

    /// Returns the rows of the Jacobian for the task axes in the last step, k × n, in the task frame.
    pub fn task_jacobian(&self) -> DMatrix<f64> {
        self.record().task_jacobian(&self.params)
    }

    /// Returns the activation matrix A of the last step, n × (k + 1): the share of each joint in each of the k task
    /// axes, and in the null space (last column). Equation (10) of the paper.
    pub fn activation(&self) -> DMatrix<f64> {
        self.record().activation(&self.params)
    }

    /// Returns the responsibility R of the last step, n × (k + 1): the contribution of each of the k task velocities to
    /// the velocity of each joint, then that of the null-space motion. Equations (6), (7) of the paper.
    pub fn responsibility(&self) -> DMatrix<f64> {
        self.record().responsibility(&self.params)
    }

    /// Creates a controller as [`Controller::new`], without the check that the servos can hold the arm. `captured` is
    /// that of a [`Snapshot`].
    #[inline(never)]
    fn build(
        model: Arc<Model>,
        settings: Settings,
        servos: Option<Servos>,
        captured: Option<&[Vec<f64>; 2]>,
    ) -> Result<Self> {
        let mut joint_space_stats = JointSpaceStats::default();
        let mut params = Params::new(&model, &settings, servos.as_ref(), captured.is_some(), &mut joint_space_stats)?;
        if let Some([compliance, lead]) = captured {
            params.gravity_offset.compliance[..compliance.len()].copy_from_slice(compliance);
            params.gravity_offset.lead[..lead.len()].copy_from_slice(lead);
        }
        let masses = model.chain().masses(model.payload());
        let zero = [0.0; MAX_JOINTS];
        let controller = Self {
            payload: model.payload().copied(),
            payload_ramp: None,
            gravity: model.gravity_vector(),
            delay: settings.delay,
            state: State::new(),
            diagnostics: Diagnostics::empty(),
            command: Command { n: params.n, goal: zero, torque_limit: zero, speed_limit: zero },
            captured: captured.map(|_| params.gravity_offset),
            simd_level: SimdLevel::detect(),
            scratch: KinematicScratch::new(),
            model,
            settings,
            servos,
            joint_space_stats,
            params,
            masses,
        };
        controller.check_posture(&controller.settings)?;
        Ok(controller)
    }

    /// Checks that the servos can hold the arm, unless gravity is not compensated.
    fn check_holding(&self, known: GravityUse, masses: &GroupMasses) -> Result<()> {
        match known {
            GravityUse::Off => Ok(()),
            _ => joint_space::check_holding(&self.model, &self.params.servos.torque, masses, self.gravity),
        }
    }

    /// Checks that no joint of a running controller needs more than [`LARGEST_LOAD`] times its usable torque to hold a
    /// new load at the present goals.
    ///
    /// Such a load is a mistake, e.g. a mass in grams, and would throw the arm upward. A load that is smaller than the
    /// present one is accepted.
    fn check_load(&self, masses: &GroupMasses) -> Result<()> {
        if !self.state.started || self.settings.gravity_use() == GravityUse::Off {
            return Ok(());
        }
        let usable = &self.params.servos.torque;
        let [new, present] =
            [masses, self.current_masses()].map(|masses| self.holding_torques(&self.state.goal, masses));
        let is_excessive = |&i: &usize| new[i].abs() > LARGEST_LOAD * usable[i] && new[i].abs() > present[i].abs();
        (0..self.params.n).find(is_excessive).map_or(Ok(()), |i| {
            Err(Error::out_of_range(
                format!("torque that holds the payload at joint {} [N·m]", self.model.joint_names()[i]),
                new[i],
                format!(
                    "±{:.3}, {LARGEST_LOAD} times the torque of its servo, in the present pose: check mass [kg] and com [m] \
                     of the payload",
                    LARGEST_LOAD * usable[i]
                ),
            ))
        })
    }

    /// Checks that the rest posture of the settings, if any, consists of plausible joint positions.
    fn check_posture(&self, settings: &Settings) -> Result<()> {
        settings
            .null_space
            .posture
            .as_ref()
            .map_or(Ok(()), |posture| self.positions("null_space.posture", posture).map(|_| ()))
    }

    /// Returns the parameters of this arm with the settings `old` of an earlier step; `None` if they do not fit it.
    fn params_of(&self, old: &Settings) -> Option<Params> {
        let mut stats = self.joint_space_stats.clone();
        let mut params =
            Params::new(&self.model, old, self.servos.as_ref(), self.captured.is_some(), &mut stats).ok()?;
        let delay = if old.delay.to_bits() == self.settings.delay.to_bits() { self.delay } else { old.delay };
        params.set_delay(delay, old);
        Some(params)
    }

    /// Moves the reference of a running arm toward the tool along the axes that the present settings make firmer than
    /// those `before`.
    fn restart_reference(&mut self, before: Rules<'_>) {
        if self.state.started && self.params.features.tool_speed {
            let arm = (self.model.chain(), self.simd_level, &self.state.filter.backlash_output);
            let now = Rules { params: &self.params, settings: &self.settings };
            restart_reference(arm, (before, now), &mut self.state.governor);
        }
    }

    /// Resets the parts of the state that depend on the previous settings.
    fn reset_dependent_state(&mut self) {
        if self.settings.tracking.integrate <= 0.0 {
            self.state.integral = [0.0; MAX_JOINTS];
        }
        self.state.singular = SingularValues::start();
        self.state.cold = true;
    }

    /// Returns the torques [N·m] that hold an arm with `masses` at `q` with the present gravity vector.
    fn holding_torques(&self, q: &JointVec, masses: &GroupMasses) -> JointVec {
        let mut frames = JointFrames::default();
        let mut holding = [0.0; MAX_JOINTS];
        self.model.chain().forward(q, &mut frames);
        self.model.chain().gravity(&frames, masses, self.gravity, &mut holding);
        holding
    }

    /// Runs one control step; the first one resets the controller to `q`.
    fn step_impl(&mut self, q: &[f64], target: &Pose, input: &StepInput<'_>) -> Result<&Command> {
        if q.len() != self.params.n {
            return Err(Error::length("q", q.len(), self.params.n));
        }
        if !self.state.started {
            return self.start(q, target, input);
        }
        let dt = self.period(input.dt)?;
        let simd_level = self.simd_level;
        let succeeded = if self.params.is_plain && input.has_period_only() {
            simd_level.dispatch_narrow(PlainStep { controller: self, q, target, dt, is_stateless: false })
        } else {
            let mut optional = Input::new(dt);
            optional.read(&self.model, &self.params, input)?;
            simd_level.dispatch_narrow(Step { controller: self, q, target, input: &optional })
        };
        if !succeeded {
            return Err(self.diagnose(q, target));
        }
        if self.payload_ramp.is_some() {
            self.advance_payload_ramp(dt);
        }
        Ok(&self.command)
    }

    /// Returns the time since the last step [s], by default the period of the settings; an error if it is invalid.
    #[inline]
    fn period(&self, dt: Option<f64>) -> Result<f64> {
        input::period(dt.unwrap_or(1.0 / self.settings.rate))
    }

    /// Resets the controller to `q` and runs its first step; restores the state if that fails.
    #[cold]
    fn start(&mut self, q: &[f64], target: &Pose, input: &StepInput<'_>) -> Result<&Command> {
        let before = self.state;
        self.restart(&self.positions("q", q)?);
        if let Err(error) = self.step_impl(q, target, input).map(|_| ()) {
            self.state = before;
            return Err(error);
        }
        Ok(&self.command)
    }

    fn restart(&mut self, q: &JointVec) {
        let mut frames = JointFrames::default();
        self.model.chain().forward(q, &mut frames);
        self.state = State::at(q, frames.tool, true);
        self.payload_ramp = None;
    }

    /// Returns the error of a step that rejected the positions `q`, the target or its own command.
    #[cold]
    fn diagnose(&self, q: &[f64], target: &Pose) -> Error {
        match self.positions("q", q).map(|_| ()).and_then(|()| self.check_target("target", target)) {
            Err(error) => error,
            Ok(()) => Error::command_not_finite(),
        }
    }

    /// Returns the batch of `input` with model, parameters and settings of this controller.
    fn batch<'a>(&'a self, input: &'a BatchInput<'a>) -> Batch<'a> {
        Batch { input, model: &self.model, params: &self.params, settings: &self.settings }
    }

    /// Resets the state to that before the first step of an arm of a batch without a state; returns false if its
    /// positions are invalid.
    fn start_row(&mut self, one: &ArmInput<'_>) -> bool {
        let Ok(q) = self.positions("q", one.q) else { return false };
        // In this call the reference may jump to the target, so it starts there. With deviation limits it starts at the
        // tool, where these limits may keep it.
        if self.params.deviation_limits.is_empty() {
            self.state = State::at(&q, one.target, true);
        } else {
            self.restart(&q);
        }
        true
    }

    /// Steps one arm of a batch from the present state, `dt` [s] after the last step, and writes its command; returns
    /// false if input or command are invalid. `is_stateless` as [`PlainStep::is_stateless`].
    fn step_row(
        &mut self,
        one: &ArmInput<'_>,
        dt: f64,
        is_stateless: bool,
        [goal, limit, speed]: [&mut [f64]; 3],
    ) -> bool {
        self.params.set_row_axes(one.axes);
        let (ArmInput { q, ref target, dq, .. }, simd_level) = (*one, self.simd_level);
        let succeeded = if self.params.is_plain && dq.is_none() {
            simd_level.dispatch_narrow(PlainStep { controller: self, q, target, dt, is_stateless })
        } else {
            let mut input = Input::new(dt);
            if let Some(dq) = dq {
                let Ok(checked) = self.model.joints_within("dq", dq, SPEED_BOUND) else { return false };
                input.dq = Some(checked);
            }
            simd_level.dispatch_narrow(Step { controller: self, q, target, input: &input })
        };
        if !succeeded {
            return false;
        }
        goal.copy_from_slice(self.command.goal());
        limit.copy_from_slice(self.command.torque_limit());
        speed.copy_from_slice(self.command.speed_limit());
        true
    }

    /// Returns the masses of the arm for the next step; during a payload change, those of the ramp.
    fn current_masses(&self) -> &GroupMasses {
        self.payload_ramp.as_ref().map_or(&self.masses, |payload_ramp| &payload_ramp.masses)
    }

    /// Advances the payload ramp, if there is one, by `dt` [s]; removes it at its end.
    fn advance_payload_ramp(&mut self, dt: f64) {
        if let Some(payload_ramp) = &mut self.payload_ramp
            && !payload_ramp.advance(dt, self.model.chain(), self.payload.as_ref())
        {
            self.payload_ramp = None;
        }
    }

    /// Returns measured joint positions; an error if one is not finite or implausibly far beyond its position limit.
    pub(crate) fn positions(&self, what: &str, values: &[f64]) -> Result<JointVec> {
        self.params.positions(&self.model, what, values)
    }

    /// Returns target joint positions; an error if one is implausibly far beyond its position limit.
    pub(crate) fn joint_target(&self, what: &str, values: &[f64]) -> Result<JointVec> {
        let [lowest, highest] = &self.params.joint_targets;
        self.model.joints_between(what, values, lowest, highest)
    }

    /// Checks that a tool pose can be a target of this task.
    pub(crate) fn check_target(&self, what: &str, target: &Pose) -> Result<()> {
        self.model.check_target_in(what, target, &self.params.target_region)
    }
}
