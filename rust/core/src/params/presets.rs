//! Presets: settings for common tasks, as a starting point.

use crate::error::{Error, Result};
use crate::params::{
    AXIS_NAMES, Axis, CompliantSide, Law, NullSpace, PaperOptions, Profile, Settings, TorqueLimits, Tracking,
};

/// Target adaptation η of an axis that yields in preset `soft`.
const ETA_SOFT: f64 = 0.9;

/// Target adaptation η of preset `door`: the handle moves the tool, and the target pulls it back only weakly.
const ETA_DOOR: f64 = 0.999;

/// η of a plug. With a larger η, friction carries the plug past the hole; with a smaller one, the walls push harder.
const ETA_PLUG: f64 = 0.5;

/// Target adaptation η of preset `hand_guiding`: the largest that does not require a known `k_p`.
const ETA_HAND_GUIDING: f64 = 0.95;

/// Null-space gain α [1/s] for an arm that is moved far from its posture: a quarter of the default K_x.
const ALPHA_WEAK_POSTURE: f64 = 1.0;

/// `soft_until` and `firm_from` [m] of an axis with the same force cap at any deviation. They are so small that no
/// servo reaches the cap below them.
const CAPPED_DEVIATIONS: [f64; 2] = [0.001, 0.002];

/// `soft_until` and `firm_from` [m] between which the strength falls while a person takes the object.
const HAND_OVER_DEVIATIONS: [f64; 2] = [0.01, 0.05];

impl Settings {
    /// Returns law `paper` as published: no gravity model and no limits beyond those of the paper.
    ///
    /// Strengths are torque budgets [N·m] with the defaults soft 0.5, firm = hold = 10; no axis yields by default.
    /// Only the velocity of each axis, as in the paper, and the joint speeds of the model are limited.
    pub fn paper() -> Self {
        Self {
            law: Law::Paper,
            gravity: false,
            max_tool_speed: [f64::INFINITY; 2],
            tracking: Tracking { goal_slew: f64::INFINITY, ..Tracking::default() },
            torque_limits: TorqueLimits { stiffening_time: 0.0, ..TorqueLimits::default() },
            paper_options: PaperOptions { lead_limit: Some(f64::INFINITY), ..PaperOptions::default() },
            ..Self::default()
        }
    }

    /// Returns settings under which the named axes yield in both directions with the arm's default strengths and η =
    /// 0.9; the others hold.
    ///
    /// # Errors
    /// [`Error::Config`] for an invalid key.
    pub fn soft(axes: &str) -> Result<Self> {
        let mut settings = Self::default();
        settings.set_axes(axes, yielding(ETA_SOFT))?;
        Ok(settings)
    }

    /// Returns settings under which no axis yields: the defaults.
    pub fn firm() -> Self {
        Self::default()
    }

    /// Returns settings for opening and closing doors: the axes y (lateral) and yaw follow the handle with η = 0.999;
    /// the others hold. Sets `accept_high_adaptation`.
    ///
    /// The posture task is a quarter as strong as by default, because a handle moves the arm on an arc far from its
    /// start.
    pub fn door() -> Self {
        let mut settings = Self { null_space: weak_posture(), accept_high_adaptation: true, ..Self::default() };
        (settings.axes[1], settings.axes[5]) = (yielding(ETA_DOOR), yielding(ETA_DOOR));
        settings
    }

    /// Returns settings for pulling a drawer open or pushing it shut along `axis`, with at most the force `pull` [N]
    /// (default: the default [`Axis::firm`] of this arm).
    ///
    /// The direction of a slide is rarely known exactly, so the other translations follow it (η = 0.95, the largest
    /// that does not require a known `k_p`). Rotations hold, because a rotated drawer jams. At the end stop the force
    /// is at most `pull`.
    ///
    /// # Errors
    /// [`Error::Config`] for an axis other than x, y, z, [`Error::OutOfRange`] for the force.
    pub fn drawer(axis: &str, pull: Option<f64>) -> Result<Self> {
        let along = translation("axis", axis)?;
        let mut settings = Self { null_space: weak_posture(), ..Self::default() };
        settings.axes[..3].fill(yielding(ETA_HAND_GUIDING));
        settings.axes[along] = capped("pull [N]", pull, CompliantSide::Both)?;
        Ok(settings)
    }

    /// Returns settings for pressing on a surface along its normal `axis` with the force `press` [N] (default: the
    /// default [`Axis::soft`] of this arm) while the tool moves along the surface.
    ///
    /// Place the target behind the surface by at least `press` divided by the arm's stiffness, plus the unevenness of
    /// the surface. The force is then `press`, whatever the height of the surface. Rotations about the other two axes
    /// yield, so that a flat tool stays flat on the surface.
    ///
    /// # Errors
    /// As [`Settings::drawer`].
    pub fn wipe(press: Option<f64>, axis: &str) -> Result<Self> {
        let normal = translation("axis", axis)?;
        let mut settings = Self::default();
        for tilt in (3..6).filter(|&tilt| tilt != normal + 3) {
            settings.axes[tilt] = yielding(ETA_SOFT);
        }
        let profile = Profile::Constant;
        let soft = press.map(|press| strength("press [N]", press)).transpose()?;
        settings.axes[normal] = Axis { soft, profile, yields: Some(CompliantSide::Both), ..Axis::default() };
        Ok(settings)
    }

    /// Returns settings for presenting an object and yielding to a person who takes it.
    ///
    /// Near the target, translations resist with up to the arm's `firm`, so that the object's weight and an accidental
    /// touch move the tool little. Once a person has pulled the object 0.05 m away, they resist with `soft`. Rotations
    /// yield. The caller opens the gripper when the deviation indicates a pull.
    pub fn hand_over() -> Self {
        let [near, far] = HAND_OVER_DEVIATIONS;
        let linear =
            Axis { profile: Profile::Softening, soft_until: Some(near), firm_from: Some(far), ..yielding(0.0) };
        let angular = yielding(ETA_SOFT);
        Self { axes: [linear, linear, linear, angular, angular, angular], ..Self::default() }
    }

    /// Returns settings for inserting a plug into a hole along `axis`, with a sign (`"-z"`), with at most the force
    /// `push` [N] (default: the arm's `firm`).
    ///
    /// The other translations and the rotations yield with η = 0.5. Pulling the plug out may use all of `hold`.
    ///
    /// # Errors
    /// As [`Settings::drawer`].
    pub fn plug(axis: &str, push: Option<f64>) -> Result<Self> {
        // The hole pushes the tool against the direction of insertion.
        let (name, resists) = match axis.split_at_checked(1) {
            Some(("-", name)) => (name, CompliantSide::Plus),
            Some(("+", name)) => (name, CompliantSide::Minus),
            _ => (axis, CompliantSide::Minus),
        };
        let along = translation("axis", name)?;
        let mut settings = Self { axes: [yielding(ETA_PLUG); 6], ..Self::default() };
        settings.axes[along] = capped("push [N]", push, resists)?;
        Ok(settings)
    }

    /// Returns settings for hand guiding: all axes yield with η = 0.95, and the posture task is a quarter as strong as
    /// by default.
    pub fn hand_guiding() -> Self {
        Self { axes: [yielding(ETA_HAND_GUIDING); 6], null_space: weak_posture(), ..Self::default() }
    }
}

/// Returns null-space settings with a weaker posture task.
fn weak_posture() -> NullSpace {
    NullSpace { gain: Some(ALPHA_WEAK_POSTURE), ..NullSpace::default() }
}

/// Returns an axis that yields in both directions with this adaptation η.
fn yielding(adaptation: f64) -> Axis {
    Axis { yields: Some(CompliantSide::Both), adaptation, ..Axis::default() }
}

/// Returns an axis that is as stiff as its servos up to the force `max` (default: that of the arm) and yields beyond
/// it.
fn capped(what: &str, max: Option<f64>, yields: CompliantSide) -> Result<Axis> {
    let [soft_until, firm_from] = CAPPED_DEVIATIONS.map(Some);
    let axis = Axis { yields: Some(yields), soft_until, firm_from, ..Axis::default() };
    match max {
        Some(max) => Ok(Axis { soft: Some(strength(what, max)?), profile: Profile::Constant, ..axis }),
        None => Ok(axis),
    }
}

/// Returns a positive force as the strength of both sides, else an error.
fn strength(what: &str, value: f64) -> Result<[f64; 2]> {
    if value > 0.0 && value.is_finite() { Ok([value; 2]) } else { Err(Error::out_of_range(what, value, "(0, ∞)")) }
}

/// Returns the index of the axis x, y or z; an error for any other name.
fn translation(key: &str, name: &str) -> Result<usize> {
    AXIS_NAMES[..3].iter().position(|&known| known == name).ok_or_else(|| {
        Error::config(
            key,
            format!("'{name}' is not a direction; use 'x', 'y' or 'z', of a plug with its sign, as in '-z'"),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_valid() {
        let all = vec![
            Settings::paper(),
            Settings::firm(),
            Settings::door(),
            Settings::hand_guiding(),
            Settings::hand_over(),
            Settings::soft("y yaw").unwrap(),
            Settings::drawer("x", None).unwrap(),
            Settings::drawer("y", Some(3.0)).unwrap(),
            Settings::wipe(None, "z").unwrap(),
            Settings::plug("-z", Some(10.0)).unwrap(),
        ];
        for settings in all {
            settings.validate().unwrap();
        }
        assert!(Settings::soft("q").is_err());
    }

    #[test]
    fn invalid_directions_and_forces_are_named() {
        let message = |settings: Result<Settings>| settings.unwrap_err().to_string();
        assert!(message(Settings::drawer("-x", None)).starts_with("axis: '-x' is not a direction"));
        assert!(message(Settings::plug("-yaw", None)).starts_with("axis: 'yaw' is not a direction"));
        assert!(message(Settings::plug("ä", None)).starts_with("axis: 'ä' is not a direction"));
        assert_eq!(message(Settings::wipe(Some(0.0), "z")), "press [N] = 0 is outside (0, ∞)");
        assert_eq!(message(Settings::plug("-z", Some(f64::NAN))), "push [N] = NaN is outside (0, ∞)");
    }

    #[test]
    fn a_plug_yields_on_the_side_opposite_to_the_insertion() {
        let sides = |axis: &str| Settings::plug(axis, Some(10.0)).unwrap().axes[2].compliant_side();
        assert_eq!(
            [sides("-z"), sides("z"), sides("+z")],
            [CompliantSide::Plus, CompliantSide::Minus, CompliantSide::Minus]
        );
    }
}
