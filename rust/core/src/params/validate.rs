//! Validation of the settings by themselves, without arm and servos.

use crate::error::{Error, Result};
use crate::params::{
    AXIS_NAMES, Axis, Compensation, Damping, Follow, Gain, NullSpace, PaperOptions, Settings, TorqueLimits, Tracking,
};

/// Largest finite limits of the tool's speed [m/s, rad/s]: larger numbers are in mm/s or degrees per second.
const MAX_TOOL_SPEED: [f64; 2] = [20.0, 80.0];

impl Settings {
    /// Checks every value that can be checked without arm and servos.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] names the setting, its value and the bound; [`Error::Config`] an inconsistent combination.
    pub fn validate(&self) -> Result<()> {
        self.task.validate()?;
        for (axis, name) in self.axes.iter().zip(AXIS_NAMES) {
            axis.validate(&format!("axes.{name}"))?;
        }
        for ((axis, name), on) in self.axes.iter().zip(AXIS_NAMES).zip(self.task.axes) {
            if !on && *axis != Axis::default() {
                return Err(Error::config(
                    format!("axes.{name}"),
                    format!("'{name}' is not an axis of the task; add it to task.axes or leave it out"),
                ));
            }
        }
        self.validate_impedance()?;
        within("rate [Hz]", self.rate, 1.0, 1e5)?;
        within("delay [s]", self.delay, 0.0, 0.5)?;
        let speeds = self.max_tool_speed.into_iter().zip(MAX_TOOL_SPEED);
        for ((speed, max), acceleration) in speeds.zip(self.max_tool_acceleration) {
            if !(1e-3..=max).contains(&speed) && speed != f64::INFINITY {
                let allowed = format!("0.001 to {max}, or ∞ for no limit");
                return Err(Error::out_of_range("max_tool_speed [m/s, rad/s]", speed, allowed));
            }
            within("max_tool_acceleration [m/s², rad/s²]", acceleration, 1e-2, f64::INFINITY)?;
        }
        self.tracking.validate()?;
        self.null_space.validate()?;
        self.compensation.validate()?;
        self.torque_limits.validate()?;
        self.paper_options.validate()
    }

    /// Returns an error for springs or dampers under a law other than `impedance`, and for [`Follow::Hold`] under law
    /// `impedance`, which has no inverse kinematics.
    fn validate_impedance(&self) -> Result<()> {
        if self.law.has_springs() {
            return match self.paper_options.follow {
                Some(Follow::Hold) => Err(Error::config(
                    "paper_options.follow",
                    "law=\"impedance\" has no inverse kinematics to apply this to: leave it out, or use law=\"cap\"",
                )),
                _ => Ok(()),
            };
        }
        let wrong = |key: String| {
            let message = "belongs to law=\"impedance\": set that law, or leave it out; under the others soft, firm and hold \
                           say how strong an axis is";
            Err(Error::config(key, message))
        };
        for (axis, name) in self.axes.iter().zip(AXIS_NAMES) {
            for (field, user) in [("stiffness", axis.stiffness), ("damping", axis.damping)] {
                if user.is_some() {
                    return wrong(format!("axes.{name}.{field}"));
                }
            }
        }
        if self.null_space.stiffness.is_some() { wrong("null_space.stiffness".into()) } else { Ok(()) }
    }
}

impl Tracking {
    /// Checks every value that can be checked without arm and servos.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] names the setting, its value and the bound.
    pub fn validate(&self) -> Result<()> {
        within_gain("tracking.gain [1/s]", &self.gain, 100.0)?;
        within("tracking.velocity_filter [s]", self.velocity_filter, 0.0, 1.0)?;
        within("tracking.goal_slew [rad/s]", self.goal_slew, 1e-3, f64::INFINITY)?;
        within("tracking.integrate [1/s]", self.integrate, 0.0, 20.0)?;
        all_within("tracking.joint_speed [rad/s]", self.joint_speed.as_deref(), 1e-6, f64::INFINITY)?;
        match self.damping {
            Damping::Auto => Ok(()),
            Damping::Fixed(lambda) => within("tracking.damping", lambda, 0.0, 10.0),
            Damping::Adaptive { lambda_0, sigma_0, lambda_max } => {
                within("tracking.damping.lambda_0", lambda_0, 1e-6, 10.0)?;
                within("tracking.damping.sigma_0", sigma_0, 0.0, 10.0)?;
                within("tracking.damping.lambda_max", lambda_max, 0.0, 10.0)
            }
        }
    }
}

impl NullSpace {
    /// Checks every value that can be checked without arm and servos.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] names the setting, its value and the bound.
    pub fn validate(&self) -> Result<()> {
        within("null_space.gain [1/s]", self.gain.unwrap_or(0.0), 0.0, 100.0)?;
        within("null_space.limit_avoidance", self.limit_avoidance, 0.0, 1e3)?;
        within("null_space.max_torque [N·m]", self.max_torque.unwrap_or(0.0), 0.0, 1e3)?;
        within("null_space.stiffness [N·m/rad]", self.stiffness.unwrap_or(0.0), 0.0, 1e6)?;
        within("null_space.max_speed [rad/s]", self.max_speed, 0.0, f64::INFINITY)?;
        all_within("null_space.posture [rad]", self.posture.as_deref(), -1e6, 1e6)
    }
}

impl Compensation {
    /// Checks every value that can be checked without arm and servos.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] names the setting, its value and the bound.
    pub fn validate(&self) -> Result<()> {
        within("compensation.friction", self.friction, 0.0, 1.0)?;
        within("compensation.damping", self.damping, 0.0, 1.0)?;
        within("compensation.delay", self.delay, 0.0, 1.0)
    }
}

impl TorqueLimits {
    /// Checks every value that can be checked without arm and servos.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] names the setting, its value and the bound.
    pub fn validate(&self) -> Result<()> {
        within("torque_limits.margin", self.margin, 0.0, 1.0)?;
        within("torque_limits.stiffening_time [s]", self.stiffening_time, 0.0, 10.0)?;
        if let Some(max) = self.max_host_loss_force {
            within("torque_limits.max_host_loss_force [N]", max, 1e-3, f64::INFINITY)?;
        }
        all_within("torque_limits.floor [N·m]", self.floor.as_deref(), 0.0, f64::INFINITY)
    }
}

impl PaperOptions {
    /// Checks every value that can be checked without arm and servos.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] names the setting, its value and the bound.
    pub fn validate(&self) -> Result<()> {
        within("paper_options.horizon [s]", self.horizon, 1e-3, 10.0)?;
        within("paper_options.manipulability", self.manipulability, 0.0, 1e3)?;
        within("paper_options.gravity_scale", self.gravity_scale, 1.0, 2.0)?;
        within("paper_options.friction_speed [rad/s]", self.friction_speed, 1e-4, 10.0)?;
        within("paper_options.direction_band", self.direction_band.unwrap_or(0.0), 0.0, 1.0)?;
        within_gain("paper_options.kq", &self.kq, 10.0)?;
        if let Some(lead) = self.lead_limit {
            within("paper_options.lead_limit [rad]", lead, 1e-3, f64::INFINITY)?;
        }
        all_within("paper_options.posture_weights", self.posture_weights.as_deref(), 0.0, 1e6)?;
        all_within("paper_options.joint_weights", self.joint_weights.as_deref(), 1e-6, 1e6)
    }
}

fn within_gain(name: &str, gain: &Gain, high: f64) -> Result<()> {
    let low = if matches!(gain, Gain::Matrix(_)) { -high } else { 0.0 };
    gain.values().into_iter().try_for_each(|k| within(name, k, low, high))
}

fn all_within(name: &str, values: Option<&[f64]>, low: f64, high: f64) -> Result<()> {
    values.into_iter().flatten().try_for_each(|value| within(name, *value, low, high))
}

fn within(name: &str, value: f64, low: f64, high: f64) -> Result<()> {
    if value >= low && value <= high {
        return Ok(());
    }
    let close = if high.is_infinite() { "∞]".into() } else { format!("{high}]") };
    Err(Error::out_of_range(name, value, format!("[{low}, {close}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::params::Task;

    #[test]
    fn defaults_are_valid() {
        Settings::default().validate().unwrap();
    }

    #[test]
    fn wrong_values_name_setting_value_and_bound() {
        let message = |settings: Settings| settings.validate().unwrap_err().to_string();
        assert_eq!(
            message(Settings { rate: f64::NAN, ..Settings::default() }),
            "rate [Hz] = NaN is outside [1, 100000]"
        );
        assert_eq!(
            message(Settings {
                tracking: Tracking { gain: Gain::Scalar(-1.0), ..Tracking::default() },
                ..Settings::default()
            }),
            "tracking.gain [1/s] = -1 is outside [0, 100]"
        );
        let mut settings = Settings { task: Task::parse("xyz").unwrap(), ..Settings::default() };
        settings.set_axes("yaw", Axis { hold: Some(1.0), ..Axis::default() }).unwrap();
        assert!(message(settings).starts_with("axes.yaw: 'yaw' is not an axis of the task"));
    }
}
