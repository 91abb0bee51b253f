//! Contact estimation with position servos: wrench at the tool, error bound and events.
//!
//! The torques of the servos are computed from goals, limits and positions. The external force F follows from the
//! residual of their balance with gravity torque g, acceleration, friction τ_f and damping d:
//!
//! `JᵀF = g + M q̈ + τ_f tanh(v/v₀) + d v − clip(k_p (goal − q) − k_v v, ±limit)`
//!
//! with the Jacobian J, the mass matrix M, the joint velocity v, the speed v₀ at which friction saturates, and the
//! servos' stiffness k_p and derivative gain k_v.
//!
//! The estimate runs beside the controller's steps and does not change them.

mod events;
mod options;
mod residual;
mod update;
mod wrench;

use crate::controller::Controller;
use crate::error::{Error, Result};
use crate::kinematics::velocity_filter::VelocityFilter;
use crate::math::rows::pad;
use crate::params::AXIS_NAMES;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS};

pub use options::ContactOptions;

use events::Events;
use residual::{ModelErrors, ServoModel};

/// Number of stored commands. A goal acts after the delay T_d, so the present torque results from an older command.
const HISTORY: usize = 64;

/// Optional inputs of an update besides the positions.
#[derive(Debug, Clone, Copy, Default)]
pub struct ContactInput<'a> {
    /// Time since the last reading [s]; `None`: 1 / rate of the controller's settings.
    pub dt: Option<f64>,
    /// Velocity of each joint [rad/s]; `None`: filtered from the positions.
    pub dq: Option<&'a [f64]>,
    /// Measured torque of each servo [N·m]; `None`: computed from `current`, if given, else from goal, position
    /// and limit.
    pub load: Option<&'a [f64]>,
    /// Current of each motor [A], used if `load` is `None`; needs [`ContactOptions::torque_constant`].
    pub current: Option<&'a [f64]>,
    /// Goals [rad], then torque limits [N·m] last sent to the n servos; `None`: the controller's last command.
    pub sent: Option<[&'a [f64]; 2]>,
}

/// Estimated wrench at the tool, and its uncertainty.
///
/// Forces [N] and torques [N·m] of the surroundings on the tool, at the tool point: a push toward + is positive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WrenchEstimate {
    /// Number of joints.
    pub n: usize,
    /// Wrench along the axes of the task frame [N, N·m]; 0 along axes that are not estimated.
    pub force: AxisVec,
    /// Bound on the error of `force` [N, N·m], valid if the options describe the arm correctly; ∞ along axes that are
    /// not estimated.
    pub uncertainty: AxisVec,
    /// Wrench along the base axes [N, N·m].
    pub force_base: AxisVec,
    /// Bound on the error of `force_base` [N, N·m].
    pub uncertainty_base: AxisVec,
    /// Torque of the surroundings on each joint, low-passed, relative to the tare if there is one [N·m].
    pub torque_residual: JointVec,
    /// Bound on the error of `torque_residual` [N·m]. Unlike `uncertainty`, it does not include `payload_error`.
    pub torque_uncertainty: JointVec,
    /// Largest |`torque_residual`| / `torque_uncertainty` over the joints, with the possible effect of `payload_error`
    /// subtracted. A value above 1 proves a contact somewhere on the arm.
    pub residual_ratio: f64,
    /// Torque of each servo [N·m], measured or computed from goal, position and limit.
    pub torque: JointVec,
    /// Joint velocity used for the estimate [rad/s].
    pub velocity: JointVec,
    /// True for joints whose servo is at its torque limit; false for all if torques are measured.
    pub saturated: [bool; MAX_JOINTS],
    /// True for axes with a touch event.
    pub touch: [bool; MAX_AXES],
    /// True for axes with a stop event.
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

/// Goals [rad] and torque limits [N·m] of one command to the servos.
#[derive(Debug, Clone, Copy)]
struct Sent {
    goal: JointVec,
    limit: JointVec,
}

/// Quantities at the time of the tare, to which later estimates are relative; all 0 without a tare.
#[derive(Debug, Clone, Copy)]
struct Tare {
    /// Residual at the tare [N·m].
    residual: JointVec,
    /// Servo torques at the tare [N·m]. The error of a later servo torque is proportional to its change since then.
    servo_torque: JointVec,
    /// Gravity torques at the tare [N·m]. The error of a later gravity torque is proportional to its change since then.
    gravity: JointVec,
    /// Bound on the friction torque contained in `residual` [N·m].
    friction_bound: JointVec,
    /// Gravity torques per kg of mass at the tool, at the tare [N·m/kg].
    payload: JointVec,
}

impl Tare {
    const NONE: Self = Self {
        residual: [0.0; MAX_JOINTS],
        servo_torque: [0.0; MAX_JOINTS],
        gravity: [0.0; MAX_JOINTS],
        friction_bound: [0.0; MAX_JOINTS],
        payload: [0.0; MAX_JOINTS],
    };
}

/// Last commands, in a ring buffer.
#[derive(Debug, Clone)]
struct History {
    sent: [Sent; HISTORY],
    /// Index of the newest command in `sent`.
    newest: usize,
    /// Number of commands in `sent`.
    count: usize,
}

/// State between readings. An update copies it, so it does not contain the command history.
#[derive(Debug, Clone, Copy)]
struct State {
    filter: VelocityFilter,
    /// Positions of the previous reading [rad].
    previous_q: JointVec,
    /// Low-passed velocity [rad/s], from which the acceleration is computed.
    lowpassed_velocity: JointVec,
    /// Gravity torque minus servo torque [N·m], delayed by the filter of the velocities.
    static_residual: JointVec,
    /// Low-passed residual torques without the acceleration term [N·m].
    low_passed: JointVec,
    /// Residual torques with the acceleration term [N·m].
    residual: JointVec,
    /// Low-passed bound on the error of `residual`, without noise and unknown payload [N·m].
    uncertainty: JointVec,
    /// True after the first reading.
    started: bool,
    /// True if residual and uncertainty are valid.
    filters_ready: bool,
    touch: Events,
    stop: Events,
    estimate: WrenchEstimate,
    /// Quantities of the present reading, which [`ContactEstimator::tare`] stores.
    tare_candidate: Tare,
}

/// Contact estimator of one arm; call [`update`](ContactEstimator::update) once per cycle, before the controller's
/// step.
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
///     let estimate = contact.update(&controller, &q, &ContactInput::default())?;
///     let _push = estimate.force[1]; // along y [N], wrong by at most estimate.uncertainty[1]
///     controller.step(&q, &target, &StepInput::default())?;
/// }
/// let estimate = contact.estimate();
/// assert!(estimate.force[1].abs() <= estimate.uncertainty[1], "nothing pushes this arm");
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone)]
pub struct ContactEstimator {
    options: ContactOptions,
    joints: ServoModel,
    /// Indices of the estimated axes among x, y, z, roll, pitch, yaw.
    axes: Vec<usize>,
    max_wrench: AxisVec,
    errors: ModelErrors,
    constants: Option<JointVec>,
    tare: Tare,
    tared: bool,
    history: History,
    state: State,
}

impl ContactEstimator {
    /// Creates an estimator for the arm, the task frame and the servos of a controller.
    ///
    /// # Errors
    /// [`Error::OutOfRange`], [`Error::Config`] or [`Error::Shape`] naming the option: a value out of range, no servos,
    /// more axes than joints, or a threshold too low to distinguish from friction.
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
        let mut max_wrench = [0.0; MAX_AXES];
        for (slot, &axis) in max_wrench.iter_mut().zip(&axes) {
            *slot = options.max_wrench[usize::from(axis >= 3)];
        }
        let kp_error = options.kp_error.unwrap_or(if servos.stiffness_known { 0.1 } else { 0.25 });
        let errors = ModelErrors {
            friction: options.friction_error,
            servo_torque: kp_error,
            gravity: options.gravity_error,
            inertia: options.inertia_error,
        };
        let joints = ServoModel::new(servos, &controller.params.servos, n)?;
        let (hysteresis, min_time, guard) = (options.hysteresis, options.min_time, options.guard());
        let constants = options.torque_constant.as_ref().map(|values| pad(values, 0.0));
        let resting = [0.0; MAX_JOINTS];
        let contact = Self {
            tare: Tare::NONE,
            tared: false,
            history: History { sent: [Sent { goal: resting, limit: resting }; HISTORY], newest: 0, count: 0 },
            state: State {
                filter: VelocityFilter::new(&resting),
                previous_q: resting,
                lowpassed_velocity: resting,
                static_residual: resting,
                low_passed: resting,
                residual: resting,
                uncertainty: resting,
                started: false,
                filters_ready: false,
                touch: Events::new(&options.touch, hysteresis, min_time, guard),
                stop: Events::new(&options.stop, hysteresis, min_time, guard),
                estimate: WrenchEstimate::empty(n),
                tare_candidate: Tare::NONE,
            },
            constants,
            joints,
            axes,
            max_wrench,
            errors,
            options,
        };
        contact.check_thresholds(controller)?;
        Ok(contact)
    }

    /// Returns the options of this estimator.
    pub const fn options(&self) -> &ContactOptions {
        &self.options
    }

    /// Returns the names of the estimated axes.
    pub fn axes(&self) -> Vec<&'static str> {
        self.axes.iter().map(|&axis| AXIS_NAMES[axis]).collect()
    }

    /// Returns the last estimate; before the first reading its force is 0 and its uncertainty ∞.
    pub const fn estimate(&self) -> &WrenchEstimate {
        &self.state.estimate
    }

    /// Returns true while a tare is set.
    pub const fn is_tared(&self) -> bool {
        self.tared
    }

    /// Clears velocities, filters, stored commands, events and the estimate; keeps the tare.
    pub fn reset(&mut self) {
        let state = &mut self.state;
        (state.started, state.filters_ready, self.history.count) = (false, false, 0);
        state.touch.reset();
        state.stop.reset();
        state.estimate = WrenchEstimate::empty(self.joints.n);
    }

    /// Defines the present residual as zero; later estimates are relative to it.
    ///
    /// Afterwards, the errors of k_p and gravity are proportional to the change of the torques since the tare. The dry
    /// friction that the stored residual may contain is added to the uncertainty.
    ///
    /// # Errors
    /// [`Error::Config`] before the first estimate, see [`update`](Self::update).
    pub fn tare(&mut self) -> Result<()> {
        if !self.state.filters_ready {
            return Err(Error::config("tare", "there is no estimate yet: call update first"));
        }
        (self.tare, self.tared) = (self.state.tare_candidate, true);
        Ok(())
    }

    /// Removes the tare; later estimates are absolute.
    pub const fn clear_tare(&mut self) {
        (self.tare, self.tared) = (Tare::NONE, false);
    }

    /// Returns the typical time from a change at the joints to an event [s]: the sum of the controller's delay, the
    /// time constant of the low-pass and the minimum time of events.
    pub fn latency(&self, controller: &Controller) -> f64 {
        controller.delay() + self.options.filter + self.options.min_time
    }
}
