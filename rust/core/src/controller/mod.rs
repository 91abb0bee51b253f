//! The controller: construction, settings and read-outs of the control step.

mod capture;
mod cold_paths;
mod command;
pub(crate) mod diagnostics;
pub(crate) mod input;
mod payload_ramp;
mod snapshot;
mod solve;
pub(crate) mod stages;
pub(crate) mod state;
pub(crate) mod state_vector;
mod step;

use std::sync::Arc;

use nalgebra::{DMatrix, DVector};

use crate::controller::payload_ramp::Fade;
use crate::error::{Error, Result};
use crate::kinematics::{Frames, LookScratch, Masses};
use crate::math::simd::Instructions;
use crate::model::{Model, Payload};
use crate::params::workspace::Surveyed;
use crate::params::{GravityUse, Law, Plan, Servos, Settings, workspace};
use crate::pose::Pose;
use crate::{JointVec, MAX_JOINTS};

pub use command::Command;
pub use diagnostics::Record;
pub use snapshot::Carried;

use state::Memory;

/// Optional inputs of one step.
#[derive(Debug, Clone, Copy, Default)]
pub struct StepInput<'a> {
    /// Time since the last step [s], at most 1; `None`: 1 / rate.
    pub dt: Option<f64>,
    /// Joint velocity [rad/s] in place of the filtered one.
    pub dq: Option<&'a [f64]>,
    /// Velocity of the target (6,) [m/s, rad/s], base axes.
    pub twist: Option<&'a [f64; 6]>,
    /// Gradient of a user's null-space cost, added to the others.
    pub gradient: Option<&'a [f64]>,
    /// Rest posture of this step [rad].
    pub posture: Option<&'a [f64]>,
}

/// Compliant task-space controller of one arm.
#[derive(Debug, Clone)]
pub struct Controller {
    pub(crate) model: Arc<Model>,
    pub(crate) settings: Settings,
    servos: Option<Servos>,
    surveyed: Surveyed,
    pub(crate) plan: Plan,
    pub(crate) masses: Masses,
    payload: Option<Payload>,
    /// `Some` during a payload change.
    fade: Option<Fade>,
    pub(crate) gravity: [f64; 3],
    /// 1/k_g if gravity was captured.
    captured: Option<JointVec>,
    delay: f64,
    pub(crate) memory: Memory,
    pub(crate) record: Record,
    pub(crate) command: Command,
    instructions: Instructions,
    scratch: LookScratch,
}

impl Controller {
    /// Validates everything and surveys the arm (a few milliseconds).
    ///
    /// # Errors
    /// [`Error::OutOfRange`], [`Error::Shape`] or [`Error::Config`], naming the setting and the remedy.
    pub fn new(model: Arc<Model>, settings: Settings, servos: Option<Servos>) -> Result<Self> {
        let controller = Self::made(model, settings, servos, None)?;
        controller.check_holding(controller.settings.gravity_use(), &controller.masses)?;
        Ok(controller)
    }

    /// Checks that servos which compensate gravity can hold the arm.
    fn check_holding(&self, known: GravityUse, masses: &Masses) -> Result<()> {
        match known {
            GravityUse::Off => Ok(()),
            _ => workspace::check_holding(&self.model, &self.plan.servos.torque, masses, self.gravity),
        }
    }

    /// As [`Controller::new`], with a captured gravity offset 1/k_g (n); does not check that the servos can hold the
    /// arm.
    #[inline(never)]
    fn made(model: Arc<Model>, settings: Settings, servos: Option<Servos>, captured: Option<&[f64]>) -> Result<Self> {
        let mut surveyed = Surveyed::default();
        let mut plan = Plan::new(&model, &settings, servos.as_ref(), captured.is_some(), &mut surveyed)?;
        plan.gravity_compliance.iter_mut().zip(captured.into_iter().flatten()).for_each(|(slot, &value)| *slot = value);
        let masses = model.chain().masses(model.payload());
        let zero = [0.0; MAX_JOINTS];
        let controller = Self {
            payload: model.payload().copied(),
            fade: None,
            gravity: model.gravity_vector(),
            delay: settings.delay,
            memory: Memory::new(),
            record: Record::empty(),
            command: Command { n: plan.n, goal: zero, torque_limit: zero, speed_limit: zero },
            captured: captured.map(|_| plan.gravity_compliance),
            instructions: Instructions::chosen(),
            scratch: LookScratch::new(),
            model,
            settings,
            servos,
            surveyed,
            plan,
            masses,
        };
        controller.check_posture(&controller.settings)?;
        Ok(controller)
    }

    /// Checks that the rest posture is a plausible joint position.
    fn check_posture(&self, settings: &Settings) -> Result<()> {
        settings
            .null_space
            .posture
            .as_ref()
            .map_or(Ok(()), |posture| self.positions("null_space.posture", posture).map(|_| ()))
    }

    /// The robot.
    pub fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// The current settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// The servos, if given.
    pub fn servos(&self) -> Option<&Servos> {
        self.servos.as_ref()
    }

    /// Number of task axes, k.
    pub fn task_len(&self) -> usize {
        self.plan.k
    }

    /// Returns soft, firm and hold of each task axis, defaults filled in; pairs are (pushed toward −, toward +).
    pub fn strengths(&self) -> Vec<([f64; 2], [f64; 2], f64)> {
        self.plan.rows.iter().take(self.plan.k).map(|row| (row.soft, row.firm, row.hold)).collect()
    }

    /// Returns stiffness [N/m, N·m/rad] and damping [N·s/m, N·m·s/rad] of each task axis, defaults filled in, pairs as
    /// in [`Controller::strengths`]. All are zero except under law `impedance`.
    pub fn impedances(&self) -> Vec<([f64; 2], [f64; 2])> {
        self.plan.rows.iter().take(self.plan.k).map(|row| (row.stiffness, row.viscosity)).collect()
    }

    /// Damping parameters: λ₀, σ₀, λ_max.
    pub fn damping(&self) -> [f64; 3] {
        let damping = self.plan.damping;
        [damping.lambda_0, damping.sigma_0, damping.lambda_max]
    }

    /// Intermediates of the last step.
    pub fn record(&self) -> Record {
        let mut record = self.record;
        if !self.plan.heavy {
            record.gravity = self.holding_torques(&record.q);
        }
        for i in 0..self.plan.n {
            record.saturated[i] = self.command.torque_limit[i] >= self.plan.servos.torque[i];
        }
        record
    }

    /// Smallest and largest singular value of the last step's task rows, with translations divided by the arm's length.
    pub fn sigma(&self) -> [f64; 2] {
        self.record.sigma(&self.plan)
    }

    /// The instruction set that steps run on.
    pub fn instructions(&self) -> Instructions {
        self.instructions
    }

    /// Sets an instruction set other than that of [`Instructions::chosen`]; results differ by rounding.
    pub fn set_instructions(&mut self, instructions: Instructions) {
        self.instructions = instructions;
    }

    /// The last command; `None` before the first step after construction or reset.
    pub fn last_command(&self) -> Option<&Command> {
        self.memory.limit.map(|_| &self.command)
    }

    /// Activation matrix A of the last step, n × (k + 1), the null-space column last.
    pub fn activation(&self) -> DMatrix<f64> {
        self.record.activation(&self.plan)
    }

    /// Responsibility R of the last step, n × (k + 1).
    pub fn responsibility(&self) -> DMatrix<f64> {
        self.record.responsibility(&self.plan)
    }

    /// Task rows of the last step, k × n, in the task frame.
    pub fn task_jacobian(&self) -> DMatrix<f64> {
        self.record.task_jacobian(&self.plan)
    }

    /// All singular values of the last step's scaled task rows, largest first.
    pub fn singular_values(&self) -> DVector<f64> {
        self.record.singular_values(&self.plan)
    }

    /// Clears velocity, slew and γ. Takes `q` as start of the goals and, unless the settings give one, as rest posture.
    ///
    /// A captured gravity offset stays.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::OutOfRange`] for `q`; the controller is then unchanged.
    pub fn reset(&mut self, q: &[f64]) -> Result<()> {
        let q = self.positions("q", q)?;
        self.restart(&q);
        Ok(())
    }

    /// Replaces the settings while running: goals continue from their present values, within their slew.
    ///
    /// # Errors
    /// As [`Controller::new`]; the controller is then unchanged.
    pub fn update(&mut self, settings: Settings) -> Result<()> {
        let mut plan =
            Plan::new(&self.model, &settings, self.servos.as_ref(), self.captured.is_some(), &mut self.surveyed)?;
        self.check_posture(&settings)?;
        if self.settings.gravity_use() == GravityUse::Off {
            self.check_holding(settings.gravity_use(), &self.masses)?;
        }
        if let Some(compliance) = self.captured {
            plan.gravity_compliance = compliance;
        }
        // Keep a measured delay unless the new settings have another delay than the old ones.
        if settings.delay.to_bits() != self.settings.delay.to_bits() {
            self.delay = settings.delay;
        }
        plan.derate(self.delay, &settings);
        self.settings = settings;
        self.plan = plan;
        self.adapt_memory();
        Ok(())
    }

    /// Resets the parts of the state that depend on the previous settings.
    pub(crate) fn adapt_memory(&mut self) {
        if self.settings.tracking.integrate <= 0.0 {
            self.memory.integral = [0.0; MAX_JOINTS];
        }
        self.memory.singular = crate::math::singular_values::SingularValues::start();
        self.memory.cold = true;
    }

    /// Removes all rate limits of the goals and of the tool's target.
    pub(crate) fn forget_bounds(&mut self) {
        self.settings.tracking.goal_slew = f64::INFINITY;
        self.settings.max_tool_speed = [f64::INFINITY; 2];
    }

    /// Sets the payload: mass [kg] and centre of mass in the tool frame [m]; `None` for no payload.
    ///
    /// Takes effect at once before the first step, otherwise over half a second, so that a wrong or mistimed payload
    /// does not make the arm jump.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a negative or non-finite value and, if gravity is compensated, for a load that the
    /// servos cannot hold in any pose.
    pub fn set_payload(&mut self, payload: Option<&Payload>) -> Result<()> {
        if let Some(payload) = payload {
            payload.validate()?;
        }
        let masses = self.model.chain().masses(payload);
        self.check_holding(self.settings.gravity_use(), &masses)?;
        self.take(payload.copied(), &masses);
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

    /// Sets the measured delay T_d [s] from reading to arrival of the goal.
    ///
    /// If the stiff axes' gain is too high for this delay, the gain is reduced (see [`Controller::gain_factor`]).
    ///
    /// # Errors
    /// [`Error::OutOfRange`] outside [0, 0.5].
    pub fn set_delay(&mut self, delay: f64) -> Result<()> {
        if !(0.0..=0.5).contains(&delay) {
            return Err(Error::out_of_range("delay [s]", delay, "[0, 0.5]"));
        }
        self.delay = delay;
        self.plan.derate(delay, &self.settings);
        Ok(())
    }

    /// Delay T_d [s] from reading to arrival of the goal, as set or measured.
    pub const fn delay(&self) -> f64 {
        self.delay
    }

    /// Factor ≤ 1 on K_x that the delay requires. Under law `impedance`, factor on the stiffness at the last step,
    /// which also depends on the pose.
    pub fn gain_factor(&self) -> f64 {
        if self.plan.law == Law::Impedance { self.record.gain_factor } else { self.plan.kx_derating }
    }

    /// Factor ≤ 1 on the damping of law `impedance` that delay and pose required at the last step.
    pub fn damping_factor(&self) -> f64 {
        if self.plan.law == Law::Impedance {
            crate::law::impedance::damping_factor(&self.plan, &self.record.rows)
        } else {
            1.0
        }
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
        self.advance(q, target, input)
    }

    /// Runs one control step toward joint positions. The target pose is their forward kinematics; the rest posture is
    /// the joint positions.
    ///
    /// # Errors
    /// As [`Controller::step`].
    pub fn step_joints(&mut self, q: &[f64], q_target: &[f64], input: &StepInput<'_>) -> Result<&Command> {
        let wanted = self.joint_target("q_target", q_target)?;
        let mut frames = Frames::default();
        self.model.chain().forward(&wanted, &mut frames);
        self.advance(q, &frames.tool, &StepInput { posture: Some(q_target), ..*input })
    }

    /// Returns the gravity torques at `q` with the present payload and gravity vector [N·m].
    fn holding_torques(&self, q: &JointVec) -> JointVec {
        let mut frames = Frames::default();
        let mut holding = [0.0; MAX_JOINTS];
        self.model.chain().forward(q, &mut frames);
        self.model.chain().gravity(&frames, &self.masses, self.gravity, &mut holding);
        holding
    }
}
