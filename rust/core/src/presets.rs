//! Settings for common jobs, to start from.

use crate::error::Result;
use crate::settings::{GravityUse, Law, Settings};
use crate::task::axes::{Axis, Yields};

/// η of axes that a person or a mechanism is to move.
const ETA_SOFT: f64 = 0.9;

/// η of a door: the handle leads, the target hardly pulls back.
const ETA_DOOR: f64 = 0.999;

/// η of hand guiding: the largest that needs no proof of `k_p`.
const ETA_GUIDED: f64 = 0.95;

/// α [1/s] where the arm is led far from its posture: a quarter of the default K_x.
const ALPHA_LOOSE: f64 = 1.0;

impl Settings {
    /// Law `paper` as printed: no gravity model, and none of the limits that the paper does not have.
    ///
    /// Strengths are budgets [N·m], soft 0.5, firm = hold = 10; no axis yields until one is told to. What remains of
    /// limits is the paper's per-axis step and the model's joint speed.
    pub fn paper() -> Self {
        Self {
            law: Law::Paper,
            gravity: GravityUse::Off,
            goal_slew: f64::INFINITY,
            stiffening_time: 0.0,
            max_tool_speed: [f64::INFINITY; 2],
            lead_limit: Some(f64::INFINITY),
            ..Self::default()
        }
    }

    /// The named axes yield both ways with the arm's default strengths and η = 0.9; the others hold.
    ///
    /// # Errors
    /// [`Error::Config`](crate::Error::Config) for a key that is not understood.
    pub fn soft(axes: &str) -> Result<Self> {
        let mut settings = Self::default();
        settings.set_axes(axes, yielding(ETA_SOFT))?;
        Ok(settings)
    }

    /// Nothing yields.
    pub fn firm() -> Self {
        Self::default()
    }

    /// Opens and closes doors: lateral and yaw follow the handle (η = 0.999, accepted by name), the others hold.
    ///
    /// The posture pulls a quarter as much as usual: a handle on its arc takes the arm far from where it started.
    pub fn door() -> Self {
        let mut settings = Self { alpha: Some(ALPHA_LOOSE), accept: vec!["eta".into()], ..Self::default() };
        (settings.axes[1], settings.axes[5]) = (yielding(ETA_DOOR), yielding(ETA_DOOR));
        settings
    }

    /// A hand leads the tool: all axes yield with η = 0.95, and the posture pulls a quarter as much as usual.
    pub fn hand_guiding() -> Self {
        Self { axes: [yielding(ETA_GUIDED); 6], alpha: Some(ALPHA_LOOSE), ..Self::default() }
    }
}

fn yielding(eta: f64) -> Axis {
    Axis { yields: Some(Yields::Both), eta, ..Axis::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid() {
        for settings in [
            Settings::paper(),
            Settings::firm(),
            Settings::door(),
            Settings::hand_guiding(),
            Settings::soft("y yaw").unwrap(),
        ] {
            settings.validate().unwrap();
        }
        assert!(Settings::soft("q").is_err());
    }
}
