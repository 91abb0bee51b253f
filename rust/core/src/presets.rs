//! Settings for common jobs, to start from.

use crate::error::{Error, Result};
use crate::settings::{Law, NullSpace, PaperOptions, Settings, TorqueLimits, Tracking};
use crate::task::axes::{AXIS_NAMES, Axis, Profile, Yields};

/// η of axes that a person or a mechanism is to move.
const ETA_SOFT: f64 = 0.9;

/// η of a door: the handle leads, the target hardly pulls back.
const ETA_DOOR: f64 = 0.999;

/// η of a plug: with more, friction on the way leads it past the mouth; with less, the walls push harder.
const ETA_PLUG: f64 = 0.5;

/// η of hand guiding: the largest that needs no proof of `k_p`.
const ETA_GUIDED: f64 = 0.95;

/// α [1/s] where the arm is led far from its posture: a quarter of the default K_x.
const ALPHA_LOOSE: f64 = 1.0;

/// d⁻, d⁺ [m] of an axis that exerts its arm's `firm` at any deviation: below the first millimetre no servo reaches it.
const FIRM_FROM: [f64; 2] = [0.001, 0.002];

/// d⁻, d⁺ [m] over which a hand that takes the object overcomes the hold on it.
const TAKEN: [f64; 2] = [0.01, 0.05];

impl Settings {
    /// Law `paper` as printed: no gravity model, and none of the limits that the paper does not have.
    ///
    /// Strengths are budgets [N·m], soft 0.5, firm = hold = 10; no axis yields until one is told to. What remains of
    /// limits is the paper's per-axis step and the model's joint speed.
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

    /// The named axes yield both ways with the arm's default strengths and η = 0.9; the others hold.
    ///
    /// # Errors
    /// [`Error::Config`] for a key that is not understood.
    pub fn soft(axes: &str) -> Result<Self> {
        let mut settings = Self::default();
        settings.set_axes(axes, yielding(ETA_SOFT))?;
        Ok(settings)
    }

    /// Nothing yields.
    pub fn firm() -> Self {
        Self::default()
    }

    /// Opens and closes doors: lateral and yaw follow the handle (η = 0.999, accepted), the others hold.
    ///
    /// The posture pulls a quarter as much as usual: a handle on its arc takes the arm far from where it started.
    pub fn door() -> Self {
        let mut settings = Self { null_space: loose(), accept_high_adaptation: true, ..Self::default() };
        (settings.axes[1], settings.axes[5]) = (yielding(ETA_DOOR), yielding(ETA_DOOR));
        settings
    }

    /// Pulls a drawer open, or pushes it shut, along `axis`, with at most the force `pull` [N] (by default the arm's `firm`).
    ///
    /// A slide is straight, but seldom where the target believes: the other translations follow it (η = 0.95, the largest
    /// that needs no proof of `k_p`). Rotations hold, for a drawer that is turned binds. At the end stop the force is
    /// `pull` and no more.
    ///
    /// # Errors
    /// [`Error::Config`] for an axis other than x, y, z, [`Error::OutOfRange`] for the force.
    pub fn drawer(axis: &str, pull: Option<f64>) -> Result<Self> {
        let along = translation("axis", axis)?;
        let mut settings = Self { null_space: loose(), ..Self::default() };
        settings.axes[..3].fill(yielding(ETA_GUIDED));
        settings.axes[along] = capped("pull [N]", pull, Yields::Both)?;
        Ok(settings)
    }

    /// Presses on a surface along its normal `axis` with the force `press` [N] (by default the arm's `soft`) while the tool
    /// moves along it.
    ///
    /// The target lies behind the surface by at least `press` over the arm's stiffness there, plus its unevenness; then the
    /// force is `press` whatever the height. Rotations about the other two axes give way, so that a flat tool lies flat.
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
        settings.axes[normal] = Axis { soft, profile, yields: Some(Yields::Both), ..Axis::default() };
        Ok(settings)
    }

    /// Presents an object and gives way to the hand that takes it.
    ///
    /// Translations resist with up to the arm's `firm` near the target, so that the weight of the object and a passing touch
    /// move little, and with `soft` once a hand has drawn the object 0.05 m away. Rotations yield. Opening the gripper is
    /// the caller's: when the deviation says that somebody pulls.
    pub fn hand_over() -> Self {
        let [near, far] = TAKEN;
        let taken = Axis { profile: Profile::Softening, soft_until: Some(near), firm_from: Some(far), ..yielding(0.0) };
        let turned = yielding(ETA_SOFT);
        Self { axes: [taken, taken, taken, turned, turned, turned], ..Self::default() }
    }

    /// Puts a plug into a hole along `axis`, with a sign (`"-z"`), pushing with at most the force `push` [N] (by default the
    /// arm's `firm`).
    ///
    /// The other translations and the rotations follow the hole by half (η = 0.5). Pulling out again may use all of `hold`.
    ///
    /// # Errors
    /// As [`Settings::drawer`].
    pub fn plug(axis: &str, push: Option<f64>) -> Result<Self> {
        // What resists the insertion pushes the tool the other way.
        let (name, resists) = match axis.split_at_checked(1) {
            Some(("-", name)) => (name, Yields::Plus),
            Some(("+", name)) => (name, Yields::Minus),
            _ => (axis, Yields::Minus),
        };
        let along = translation("axis", name)?;
        let mut settings = Self { axes: [yielding(ETA_PLUG); 6], ..Self::default() };
        settings.axes[along] = capped("push [N]", push, resists)?;
        Ok(settings)
    }

    /// A hand leads the tool: all axes yield with η = 0.95, and the posture pulls a quarter as much as usual.
    pub fn hand_guiding() -> Self {
        Self { axes: [yielding(ETA_GUIDED); 6], null_space: loose(), ..Self::default() }
    }
}

fn loose() -> NullSpace {
    NullSpace { gain: Some(ALPHA_LOOSE), ..NullSpace::default() }
}

fn yielding(adaptation: f64) -> Axis {
    Axis { yields: Some(Yields::Both), adaptation, ..Axis::default() }
}

/// An axis that is as stiff as its servos up to one force, and gives way beyond it.
fn capped(what: &str, most: Option<f64>, yields: Yields) -> Result<Axis> {
    let [soft_until, firm_from] = FIRM_FROM.map(Some);
    let axis = Axis { yields: Some(yields), soft_until, firm_from, ..Axis::default() };
    match most {
        Some(most) => Ok(Axis { soft: Some(strength(what, most)?), profile: Profile::Constant, ..axis }),
        None => Ok(axis),
    }
}

fn strength(what: &str, value: f64) -> Result<[f64; 2]> {
    if value > 0.0 && value.is_finite() { Ok([value; 2]) } else { Err(Error::out_of_range(what, value, "(0, ∞)")) }
}

/// Index of one of x, y, z.
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
    fn directions_and_forces_are_checked_by_name() {
        let message = |settings: Result<Settings>| settings.unwrap_err().to_string();
        assert!(message(Settings::drawer("-x", None)).starts_with("axis: '-x' is not a direction"));
        assert!(message(Settings::plug("-yaw", None)).starts_with("axis: 'yaw' is not a direction"));
        assert!(message(Settings::plug("ä", None)).starts_with("axis: 'ä' is not a direction"));
        assert_eq!(message(Settings::wipe(Some(0.0), "z")), "press [N] = 0 is outside (0, ∞)");
        assert_eq!(message(Settings::plug("-z", Some(f64::NAN))), "push [N] = NaN is outside (0, ∞)");
    }

    #[test]
    fn a_plug_is_pushed_in_gently_and_pulled_out_with_all_there_is() {
        let sides = |axis: &str| Settings::plug(axis, Some(10.0)).unwrap().axes[2].effective_yields();
        assert_eq!([sides("-z"), sides("z"), sides("+z")], [Yields::Plus, Yields::Minus, Yields::Minus]);
    }
}
