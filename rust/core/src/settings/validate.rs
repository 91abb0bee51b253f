//! Checks of everything that can be checked without arm and servos.

use crate::error::{Error, Result};
use crate::settings::{Damping, Follow, Gain, Law, Settings};
use crate::task::axes::{AXIS_NAMES, Axis};

/// Risks that can be taken by name.
const RISKS: [&str; 2] = ["eta", "stiffness"];

impl Settings {
    /// Checks every value that can be checked without arm and servos.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] names the setting, its value and the bound; [`Error::Config`] what does not go together.
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
        let infinite = f64::INFINITY;
        let ranges: [(&str, f64, f64, f64); 20] = [
            ("horizon [s]", self.horizon, 1e-3, 10.0),
            ("rate [Hz]", self.rate, 1.0, 1e5),
            ("alpha [1/s]", self.alpha.unwrap_or(0.0), 0.0, 100.0),
            ("limit_avoidance", self.limit_avoidance, 0.0, 1e3),
            ("manipulability", self.manipulability, 0.0, 1e3),
            ("null_torque [N·m]", self.null_torque.unwrap_or(0.0), 0.0, 1e3),
            ("null_stiffness [N·m/rad]", self.null_stiffness.unwrap_or(0.0), 0.0, 1e6),
            ("null_speed [rad/s]", self.null_speed, 0.0, infinite),
            ("gravity_scale", self.gravity_scale, 1.0, 2.0),
            ("friction_share", self.friction_share, 0.0, 1.0),
            ("damping_share", self.damping_share, 0.0, 1.0),
            ("prediction_share", self.prediction_share, 0.0, 1.0),
            ("friction_speed [rad/s]", self.friction_speed, 1e-4, 10.0),
            ("velocity_filter [s]", self.velocity_filter, 0.0, 1.0),
            ("delay [s]", self.delay, 0.0, 0.5),
            ("goal_slew [rad/s]", self.goal_slew, 1e-3, infinite),
            ("stiffening_time [s]", self.stiffening_time, 0.0, 10.0),
            ("margin", self.margin, 0.0, 1.0),
            ("direction_band", self.direction_band.unwrap_or(0.0), 0.0, 1.0),
            ("integrate [1/s]", self.integrate, 0.0, 20.0),
        ];
        for (name, value, low, high) in ranges {
            within(name, value, low, high)?;
        }
        for (name, gain, high) in [("kx [1/s]", &self.kx, 100.0), ("kq", &self.kq, 10.0)] {
            let low = if matches!(gain, Gain::Matrix(_)) { -high } else { 0.0 };
            gain.values().into_iter().try_for_each(|k| within(name, k, low, high))?;
        }
        for (speed, acceleration) in self.max_tool_speed.into_iter().zip(self.max_tool_acceleration) {
            within("max_tool_speed [m/s, rad/s]", speed, 1e-3, infinite)?;
            within("max_tool_acceleration [m/s², rad/s²]", acceleration, 1e-2, infinite)?;
        }
        if let Some(most) = self.max_host_loss_force {
            within("max_host_loss_force [N]", most, 1e-3, infinite)?;
        }
        if let Some(lead) = self.lead_limit {
            within("lead_limit [rad]", lead, 1e-3, infinite)?;
        }
        for (name, list, low, high) in [
            ("posture_weights", &self.posture_weights, 0.0, 1e6),
            ("joint_speed [rad/s]", &self.joint_speed, 1e-6, infinite),
            ("floor [N·m]", &self.floor, 0.0, infinite),
            ("joint_weights", &self.joint_weights, 1e-6, 1e6),
        ] {
            for value in list.iter().flatten() {
                within(name, *value, low, high)?;
            }
        }
        for value in self.posture.iter().flatten() {
            within("posture [rad]", *value, -1e6, 1e6)?;
        }
        self.validate_damping()?;
        for risk in &self.accept {
            if !RISKS.contains(&risk.as_str()) {
                return Err(Error::config(
                    "accept",
                    format!("'{risk}' is not a risk that can be taken by name; known: {}", RISKS.join(", ")),
                ));
            }
        }
        Ok(())
    }

    /// Springs and dampers go with law `impedance`, and it with no solve.
    fn validate_impedance(&self) -> Result<()> {
        if self.law == Law::Impedance {
            return match self.follow {
                Some(Follow::Hold) => Err(Error::config(
                    "follow",
                    "law=\"impedance\" has no solve in which a yielding axis could stay: leave it out, or use law=\"cap\"",
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
            for (field, given) in [("stiffness", axis.stiffness), ("damping", axis.damping)] {
                if given.is_some() {
                    return wrong(format!("axes.{name}.{field}"));
                }
            }
        }
        if self.null_stiffness.is_some() { wrong("null_stiffness".into()) } else { Ok(()) }
    }

    fn validate_damping(&self) -> Result<()> {
        match self.damping {
            Damping::Auto => Ok(()),
            Damping::Fixed(lambda) => within("damping", lambda, 0.0, 10.0),
            Damping::Adaptive { lambda_0, sigma_0, lambda_max } => {
                within("damping.lambda_0", lambda_0, 1e-6, 10.0)?;
                within("damping.sigma_0", sigma_0, 0.0, 10.0)?;
                within("damping.lambda_max", lambda_max, 0.0, 10.0)
            }
        }
    }
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
    use crate::task::axes::Task;

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
            message(Settings { kx: Gain::Scalar(-1.0), ..Settings::default() }),
            "kx [1/s] = -1 is outside [0, 100]"
        );
        let mut settings = Settings { task: Task::of("xyz").unwrap(), ..Settings::default() };
        settings.set_axes("yaw", Axis { hold: Some(1.0), ..Axis::default() }).unwrap();
        assert!(message(settings).starts_with("axes.yaw: 'yaw' is not an axis of the task"));
    }
}
