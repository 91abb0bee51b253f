//! What pushes at the tool, felt through position servos: estimate, bound and events.
//!
//! The servos' torques follow from goals, limits and positions; what they exert beyond gravity, friction and acceleration,
//! the surroundings must exert too: `JᵀF = g + M q̈ + τ_f tanh(v/v₀) + d v − clip(k_p (goal − q) − k_v v, ±limit)`.
//! Beside the controller's steps, in none of them.

mod events;
mod options;
mod residual;
mod update;
mod wrench;

use crate::controller::Controller;
use crate::error::{Error, Result};
use crate::law::feedforward::VelocityFilter;
use crate::task::axes::AXIS_NAMES;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS};

pub use options::ContactOptions;

use events::Events;
use residual::{Errors, Joints};

/// Ticks for which commands are remembered: a goal acts T_d after the reading it was made from.
const HISTORY: usize = 64;

/// What is measured beside positions.
#[derive(Debug, Clone, Copy, Default)]
pub struct ContactInput<'a> {
    /// Time since the last reading [s]; `None`: 1 / rate of the controller's settings.
    pub dt: Option<f64>,
    /// Joint velocity (n) [rad/s] in place of the filtered one.
    pub dq: Option<&'a [f64]>,
    /// Torques (n) that the servos say they exert [N·m], in place of those from lead and limit.
    pub load: Option<&'a [f64]>,
    /// Currents (n) of the motors [A]; needs [`ContactOptions::torque_constant`].
    pub current: Option<&'a [f64]>,
    /// Goals [rad] and limits [N·m] (n) that the servos were sent last, where they are not the controller's last command.
    pub sent: Option<[&'a [f64]; 2]>,
}

/// What pushes at the tool, and how sure that is.
///
/// Forces [N] and torques [N·m] of the surroundings on the tool, taken at the tool: a push toward + is positive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WrenchEstimate {
    /// Number of joints.
    pub n: usize,
    /// Along the axes of the task frame; 0 along axes that are not looked at.
    pub force: AxisVec,
    /// `|force − truth|` is at most this, if the options tell the truth about the arm; ∞ along axes not looked at.
    pub uncertainty: AxisVec,
    /// The same in base axes.
    pub force_base: AxisVec,
    /// The same in base axes.
    pub uncertainty_base: AxisVec,
    /// What the surroundings add to each joint [N·m], filtered.
    pub torque_residual: JointVec,
    /// How far that can be off [N·m]; an unknown payload is counted in `uncertainty` alone.
    pub torque_uncertainty: JointVec,
    /// Largest of |residual| / uncertainty over the joints: above 1 something pushes, wherever it does.
    pub residual_ratio: f64,
    /// Torque of each servo [N·m], from lead and limit or as measured.
    pub torque: JointVec,
    /// Joint velocity [rad/s] that the estimate used.
    pub velocity: JointVec,
    /// Joints whose servo is at its limit: their torque is the limit.
    pub saturated: [bool; MAX_JOINTS],
    /// Axes that are touched.
    pub touch: [bool; MAX_AXES],
    /// Axes whose force asks for a stop.
    pub stop: [bool; MAX_AXES],
}

impl WrenchEstimate {
    fn empty(n: usize) -> Self {
        Self {
            n,
            force: [0.0; MAX_AXES],
            uncertainty: [f64::INFINITY; MAX_AXES],
            force_base: [0.0; MAX_AXES],
            uncertainty_base: [f64::INFINITY; MAX_AXES],
            torque_residual: [0.0; MAX_JOINTS],
            torque_uncertainty: [0.0; MAX_JOINTS],
            residual_ratio: 0.0,
            torque: [0.0; MAX_JOINTS],
            velocity: [0.0; MAX_JOINTS],
            saturated: [false; MAX_JOINTS],
            touch: [false; MAX_AXES],
            stop: [false; MAX_AXES],
        }
    }
}

/// A goal and a limit that the servos have or will get.
#[derive(Debug, Clone, Copy)]
struct Sent {
    goal: JointVec,
    limit: JointVec,
}

/// What a tare has seen.
#[derive(Debug, Clone, Copy)]
struct Tare {
    /// Residual then [N·m].
    residual: JointVec,
    /// Torques of servos and gravity then [N·m]: their errors count from there.
    given: JointVec,
    gravity: JointVec,
    /// What friction may have hidden in it.
    hidden: JointVec,
    /// Torques per mass at the tool [N·m/kg].
    payload: JointVec,
}

impl Tare {
    const NONE: Self = Self {
        residual: [0.0; MAX_JOINTS],
        given: [0.0; MAX_JOINTS],
        gravity: [0.0; MAX_JOINTS],
        hidden: [0.0; MAX_JOINTS],
        payload: [0.0; MAX_JOINTS],
    };
}

/// State between readings.
#[derive(Debug, Clone, Copy)]
struct Memory {
    filter: VelocityFilter,
    /// Reading before this one [rad], and velocity behind the low-pass of the residual [rad/s].
    before: JointVec,
    slow: JointVec,
    /// `g − τ`, as late as the velocities; residual without acceleration behind the low-pass; with it [N·m].
    held: JointVec,
    low_passed: JointVec,
    residual: JointVec,
    uncertainty: JointVec,
    /// Whether the filter has seen a reading.
    started: bool,
    /// Whether residual and uncertainty hold anything.
    warm: bool,
    sent: [Sent; HISTORY],
    /// Entry of the newest command, and how many there are.
    newest: usize,
    count: usize,
    touch: Events,
    stop: Events,
    estimate: WrenchEstimate,
    /// What a tare now would remember.
    here: Tare,
}

/// Feels contacts of one arm; call [`update`](ContactEstimator::update) once per tick, before the controller's step.
///
/// ```
/// # use pliant_core::{ContactEstimator, ContactInput, ContactOptions, Controller, Model, ModelOptions, Servos, Settings, StepInput};
/// # fn main() -> pliant_core::Result<()> {
/// # let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
/// # let model = std::sync::Arc::new(Model::from_urdf_str(include_str!("../../robots/arm7.urdf"), &options)?);
/// # let servos = Servos::new(vec![150.0], vec![10.7]);
/// # let mut controller = Controller::new(model.clone(), Settings::default(), Some(servos))?;
/// let mut contact = ContactEstimator::new(&controller, ContactOptions::default())?;
/// let q = [-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17]; // measured [rad], here always the same
/// let target = model.forward_kinematics(&q)?;
/// for _ in 0..50 {
///     let felt = contact.update(&controller, &q, &ContactInput::default())?;
///     let _push = felt.force[1]; // along y [N], wrong by at most felt.uncertainty[1]
///     controller.step(&q, &target, &StepInput::default())?;
/// }
/// let felt = contact.estimate();
/// assert!(felt.force[1].abs() <= felt.uncertainty[1], "nothing pushes at this arm");
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct ContactEstimator {
    options: ContactOptions,
    joints: Joints,
    /// Indices of the axes looked at.
    axes: Vec<usize>,
    most: AxisVec,
    errors: Errors,
    constants: Option<JointVec>,
    tare: Tare,
    tared: bool,
    memory: Memory,
}

impl ContactEstimator {
    /// For the arm, the task frame and the servos of a controller.
    ///
    /// # Errors
    /// [`Error::OutOfRange`], [`Error::Config`] or [`Error::Shape`] naming the option: a value out of range, no servos, more
    /// axes than joints, or a threshold below what the arm can tell from a touch.
    pub fn new(controller: &Controller, options: ContactOptions) -> Result<Self> {
        let n = controller.model().n();
        options.validate(n)?;
        let Some(servos) = controller.servos() else {
            return Err(Error::config(
                "servos",
                "a contact is felt through the stiffness of the servos: give the controller servos=Servos(kp=[...], max_torque=[...])",
            ));
        };
        let task = controller.settings().task.axes;
        let chosen = options.axes.unwrap_or(if n >= MAX_AXES { [true; MAX_AXES] } else { task });
        let axes: Vec<usize> = (0..MAX_AXES).filter(|&axis| chosen[axis]).collect();
        if axes.is_empty() {
            return Err(Error::config("axes", "no axis given; e.g. \"xyz rpy\", \"xyz\", \"z\""));
        }
        let mut most = [0.0; MAX_AXES];
        for (slot, &axis) in most.iter_mut().zip(&axes) {
            *slot = options.most[usize::from(axis >= 3)];
        }
        let kp_error = options.kp_error.unwrap_or(if servos.stiffness_known { 0.1 } else { 0.25 });
        let errors = Errors {
            friction: options.friction_error,
            given: kp_error,
            gravity: options.gravity_error,
            inertia: options.inertia_error,
        };
        let joints = Joints::new(servos, &controller.plan.servos, n)?;
        let (hysteresis, min_time, guard) = (options.hysteresis, options.min_time, options.guard());
        let constants = options.torque_constant.as_ref().map(|values| {
            let mut out = [0.0; MAX_JOINTS];
            out.iter_mut().zip(values).for_each(|(slot, value)| *slot = *value);
            out
        });
        let resting = [0.0; MAX_JOINTS];
        let contact = Self {
            tare: Tare::NONE,
            tared: false,
            memory: Memory {
                filter: VelocityFilter::new(&resting),
                before: resting,
                slow: resting,
                held: resting,
                low_passed: resting,
                residual: resting,
                uncertainty: resting,
                started: false,
                warm: false,
                sent: [Sent { goal: resting, limit: resting }; HISTORY],
                newest: 0,
                count: 0,
                touch: Events::new(&options.touch, hysteresis, min_time, guard),
                stop: Events::new(&options.stop, hysteresis, min_time, guard),
                estimate: WrenchEstimate::empty(n),
                here: Tare::NONE,
            },
            constants,
            joints,
            axes,
            most,
            errors,
            options,
        };
        contact.check_thresholds(controller)?;
        Ok(contact)
    }

    /// The options in force.
    pub const fn options(&self) -> &ContactOptions {
        &self.options
    }

    /// Names of the axes looked at.
    pub fn axes(&self) -> Vec<&'static str> {
        self.axes.iter().map(|&axis| AXIS_NAMES[axis]).collect()
    }

    /// The last estimate.
    pub const fn estimate(&self) -> &WrenchEstimate {
        &self.memory.estimate
    }

    /// Whether a tare is in force.
    pub const fn is_tared(&self) -> bool {
        self.tared
    }

    /// Forgets velocity, filter, commands and events; a tare stays.
    pub fn reset(&mut self) {
        let memory = &mut self.memory;
        (memory.started, memory.warm, memory.count) = (false, false, 0);
        memory.touch.reset();
        memory.stop.reset();
        memory.estimate = WrenchEstimate::empty(self.joints.n);
    }

    /// Takes the present residual for zero: what is felt from now on is the change.
    ///
    /// Errors of k_p and gravity count from here only; what dry friction may have hidden in the tare counts in addition.
    ///
    /// # Errors
    /// [`Error::Config`] before the first reading.
    pub fn tare(&mut self) -> Result<()> {
        if !self.memory.warm {
            return Err(Error::config("tare", "nothing has been felt yet: update with a reading first"));
        }
        (self.tare, self.tared) = (self.memory.here, true);
        Ok(())
    }

    /// Undoes a tare.
    pub const fn clear_tare(&mut self) {
        (self.tare, self.tared) = (Tare::NONE, false);
    }

    /// How long a change takes from the joints to an event [s]: the controller's delay, the low-pass, the shortest time.
    pub fn latency(&self, controller: &Controller) -> f64 {
        controller.delay() + self.options.filter + self.options.min_time
    }
}
