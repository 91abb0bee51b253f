//! What is asked of a contact estimate, and how well the arm is known.

use crate::error::{Error, Result};
use crate::task::axes::AXIS_NAMES;
use crate::{MAX_AXES, MAX_JOINTS};

/// Longest filter and shortest time of an event [s].
const LONGEST: f64 = 10.0;

/// Largest force and torque that are taken for real ones [N, N·m].
const FORCE_BOUND: f64 = 1e6;

/// How a contact is felt. Shares are of the quantity's own size: 0.3 is 30 %.
#[derive(Debug, Clone, PartialEq)]
pub struct ContactOptions {
    /// Axes of the task frame along which the surroundings can push; along the others nothing is taken to push. `None`:
    /// all six where the arm has six joints or more, else those of the task.
    pub axes: Option<[bool; MAX_AXES]>,
    /// Time constant of the low-pass on the joints' residual torques [s]; 0 for none.
    pub filter: f64,
    /// How wrong friction and damping may be, as a share.
    pub friction_error: f64,
    /// How wrong `k_p` and the torque limits may be, as a share; `None`: 0.1 where `stiffness_known`, else 0.25.
    pub kp_error: Option<f64>,
    /// How wrong the gravity torques may be, as a share.
    pub gravity_error: f64,
    /// Mass at the tool that may be there unknown [kg].
    pub payload_error: f64,
    /// How wrong the acceleration torques of the point masses may be, as a share.
    pub inertia_error: f64,
    /// How wrong a measured load or current may be, as a share.
    pub load_error: f64,
    /// Torque of the motors, gears included, per current [N·m/A]; needed where a current is given.
    pub torque_constant: Option<Vec<f64>>,
    /// Largest force [N] and torque [N·m] that the surroundings can be thought to exert: what is not observable is
    /// uncertain by that much.
    pub most: [f64; 2],
    /// Force [N] ([N·m]) that counts as a touch, per axis.
    pub touch: [Option<f64>; MAX_AXES],
    /// Force [N] ([N·m]) at which to stop, per axis.
    pub stop: [Option<f64>; MAX_AXES],
    /// Share of its threshold by which a force must fall to end an event.
    pub hysteresis: f64,
    /// Time [s] for which a threshold must be passed before an event begins or ends.
    pub min_time: f64,
    /// Share of the uncertainty that a force must exceed to count, whatever the threshold: at 1 an event is proven.
    pub guard: f64,
    /// Whether thresholds below the uncertainty are taken as they are, without a guard.
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
            most: [100.0, 20.0],
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
        let within = |what: &str, value: f64, most: f64| {
            if (0.0..=most).contains(&value) {
                Ok(())
            } else {
                Err(Error::out_of_range(what, value, format!("[0, {most}]")))
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
        for (what, most) in ["most (force) [N]", "most (torque) [N·m]"].into_iter().zip(self.most) {
            if !(most > 0.0 && most <= FORCE_BOUND) {
                return Err(Error::out_of_range(what, most, format!("(0, {FORCE_BOUND:e}]")));
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

    /// Share of the uncertainty that guards the thresholds.
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
