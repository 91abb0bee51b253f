//! Options of the contact estimator, including the errors of the arm's model.

use crate::error::{Error, Result};
use crate::params::AXIS_NAMES;
use crate::{MAX_AXES, MAX_JOINTS};

/// Upper bound on the options `filter` and `min_time` [s].
const LONGEST: f64 = 10.0;

/// Largest accepted force [N], torque [N·m] or torque constant [N·m/A] in the options.
const FORCE_BOUND: f64 = 1e6;

/// Options of a [`ContactEstimator`](crate::ContactEstimator). Relative errors are fractions: 0.3 is 30 %.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactOptions {
    /// Axes of the task frame to estimate; the wrench along the others is assumed zero. `None`: all six if the arm has
    /// at least six joints, else those of the task.
    pub axes: Option<[bool; MAX_AXES]>,
    /// Time constant of the low-pass on the joints' residual torques [s]; 0 for no filter.
    pub filter: f64,
    /// Relative error of friction and damping.
    pub friction_error: f64,
    /// Relative error of `k_p` and the torque limits; `None`: 0.1 if `stiffness_known`, else 0.25.
    pub kp_error: Option<f64>,
    /// Relative error of the gravity torques.
    pub gravity_error: f64,
    /// Largest unknown mass at the tool, in addition to the payload [kg].
    pub payload_error: f64,
    /// Relative error of the acceleration torques `M q̈`.
    pub inertia_error: f64,
    /// Relative error of a measured load or current.
    pub load_error: f64,
    /// Torque per motor current of each joint, gears included [N·m/A]; needed if currents are given.
    pub torque_constant: Option<Vec<f64>>,
    /// Largest plausible force [N] and torque [N·m] of the surroundings. It is the uncertainty along unobservable axes.
    pub max_wrench: [f64; 2],
    /// Threshold of a touch event for each axis [N, N·m]; `None`: no event.
    pub touch: [Option<f64>; MAX_AXES],
    /// Threshold of a stop event for each axis [N, N·m]; `None`: no event.
    pub stop: [Option<f64>; MAX_AXES],
    /// Share of its threshold by which the force must fall below it to end an event.
    pub hysteresis: f64,
    /// Time for which the force must be beyond a threshold before an event begins or ends [s].
    pub min_time: f64,
    /// Lower bound on the threshold of an event, as a share (0 to 1) of the uncertainty. With 1, every event proves a
    /// contact.
    pub guard: f64,
    /// True to accept thresholds below the uncertainty; `guard` then has no effect.
    pub accept_thresholds: bool,
}

impl Default for ContactOptions {
    fn default() -> Self {
        Self {
            axes: None,
            filter: 0.04,
            friction_error: 0.3,
            kp_error: None,
            gravity_error: 0.05,
            payload_error: 0.0,
            inertia_error: 0.3,
            load_error: 0.2,
            torque_constant: None,
            max_wrench: [100.0, 20.0],
            touch: [None; MAX_AXES],
            stop: [None; MAX_AXES],
            hysteresis: 0.3,
            min_time: 0.02,
            guard: 1.0,
            accept_thresholds: false,
        }
    }
}

impl ContactOptions {
    /// Checks every value for an arm of `n` joints.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] or [`Error::Config`] naming the option, [`Error::Shape`] for the torque constants.
    pub fn validate(&self, n: usize) -> Result<()> {
        let within = |what: &str, value: f64, max_wrench: f64| {
            if (0.0..=max_wrench).contains(&value) {
                Ok(())
            } else {
                Err(Error::out_of_range(what, value, format!("[0, {max_wrench}]")))
            }
        };
        within("filter [s]", self.filter, LONGEST)?;
        within("min_time [s]", self.min_time, LONGEST)?;
        within("friction_error", self.friction_error, 10.0)?;
        within("kp_error", self.kp_error.unwrap_or(0.0), 10.0)?;
        within("gravity_error", self.gravity_error, 10.0)?;
        within("payload_error [kg]", self.payload_error, 1e3)?;
        within("inertia_error", self.inertia_error, 10.0)?;
        within("load_error", self.load_error, 10.0)?;
        within("hysteresis", self.hysteresis, 0.95)?;
        within("guard", self.guard, 1.0)?;
        for (what, max_wrench) in
            ["max_wrench (force) [N]", "max_wrench (torque) [N·m]"].into_iter().zip(self.max_wrench)
        {
            if !(max_wrench > 0.0 && max_wrench <= FORCE_BOUND) {
                return Err(Error::out_of_range(what, max_wrench, format!("(0, {FORCE_BOUND:e}]")));
            }
        }
        for (name, thresholds) in [("touch", &self.touch), ("stop", &self.stop)] {
            for (axis, threshold) in thresholds.iter().enumerate() {
                let Some(value) = *threshold else { continue };
                if !(value > 0.0 && value <= FORCE_BOUND) {
                    return Err(Error::out_of_range(format!("{name}.{}", AXIS_NAMES[axis]), value, "(0, 1e6]"));
                }
            }
        }
        for (axis, (touch, stop)) in self.touch.iter().zip(&self.stop).enumerate() {
            if let (Some(touch), Some(stop)) = (touch, stop)
                && stop < touch
            {
                let bound = format!("[{touch}, ∞): a stop lies at or above the touch of its axis");
                return Err(Error::out_of_range(format!("stop.{}", AXIS_NAMES[axis]), *stop, bound));
            }
        }
        self.check_constants(n)
    }

    /// Returns the lower bound on thresholds, as a share of the uncertainty; 0 with `accept_thresholds`.
    pub(super) const fn guard(&self) -> f64 {
        if self.accept_thresholds { 0.0 } else { self.guard }
    }

    fn check_constants(&self, n: usize) -> Result<()> {
        let Some(constants) = &self.torque_constant else { return Ok(()) };
        if constants.len() != n.min(MAX_JOINTS) {
            return Err(Error::length("torque_constant", constants.len(), n));
        }
        for (i, &constant) in constants.iter().enumerate() {
            if !(constant > 0.0 && constant <= FORCE_BOUND) {
                return Err(Error::out_of_range(format!("torque_constant[{i}] [N·m/A]"), constant, "(0, 1e6]"));
            }
        }
        Ok(())
    }
}
