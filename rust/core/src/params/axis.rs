//! Task axes: their names and keys, their frame, and the settings of each axis.

use crate::MAX_AXES;
use crate::error::{Error, Result};
use crate::math::spatial::Mat3;
use crate::pose::Pose;

/// Names of the task axes, in the order of every 6-vector: linear first, then angular.
pub const AXIS_NAMES: [&str; MAX_AXES] = ["x", "y", "z", "roll", "pitch", "yaw"];

/// Largest accepted stiffness [N/m, N·m/rad] and damping [N·s/m, N·m·s/rad] of an axis.
const IMPEDANCE_BOUND: f64 = 1e9;

/// Largest accepted threshold and limit of a deviation [m, rad]: larger numbers are in millimetres or degrees.
const MAX_DEVIATION: f64 = 5.0;

/// Frame whose axes are the task axes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Frame {
    /// Axes of the base.
    #[default]
    Base,
    /// Axes of the tool, which turn with it.
    Tool,
    /// Axes fixed in the base: the columns of this rotation matrix `base_from_task` (row-major).
    Rotation([[f64; 3]; 3]),
}

impl Frame {
    /// Returns the rotation matrix `base_from_task`: its columns are the task axes in the base frame. `tool` is the
    /// rotation of the tool in the base frame.
    pub(crate) fn base_from_task(&self, tool: &Mat3) -> Mat3 {
        match self {
            Self::Base => Pose::IDENTITY.rotation,
            Self::Tool => *tool,
            Self::Rotation(rotation) => *rotation,
        }
    }
}

/// The controlled axes and the frame in which they are defined.
#[derive(Debug, Clone, PartialEq)]
pub struct Task {
    /// True for each of x, y, z, roll, pitch, yaw that is controlled.
    pub axes: [bool; MAX_AXES],
    /// Frame of the axes.
    pub frame: Frame,
    /// Length [m] by which translations are divided to compare them with rotations; required only with more axes than
    /// joints, else ignored.
    pub length: Option<f64>,
}

impl Default for Task {
    fn default() -> Self {
        Self { axes: [true; MAX_AXES], frame: Frame::Base, length: None }
    }
}

impl Task {
    /// Creates a task from an axis key such as `"xyz rpy"`, in base axes.
    ///
    /// # Errors
    /// As [`parse_axes`].
    pub fn parse(axes: &str) -> Result<Self> {
        Ok(Self { axes: parse_axes("task.axes", axes)?, ..Self::default() })
    }

    /// Returns the number of controlled axes.
    pub fn len(&self) -> usize {
        self.axes.iter().filter(|&&on| on).count()
    }

    /// Returns true if no axis is selected.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Checks axes, frame and length.
    ///
    /// # Errors
    /// [`Error::Config`] for an empty task or an invalid rotation as frame, [`Error::OutOfRange`] for the length.
    pub fn validate(&self) -> Result<()> {
        if self.is_empty() {
            return Err(Error::config("task.axes", "no axis given; e.g. \"xyz rpy\", \"xyz\", \"x z pitch\""));
        }
        if let Frame::Rotation(rotation) = self.frame {
            Pose { rotation, position: [0.0; 3] }.check("task.frame")?;
        }
        match self.length {
            Some(length) if !(length > 0.0 && length <= 100.0) => {
                Err(Error::out_of_range("task.length [m]", length, "(0, 100]"))
            }
            _ => Ok(()),
        }
    }
}

/// Parses an axis key: axis names separated by spaces, a word of the letters x, y, z, `rpy` or `all`.
///
/// Examples: `"y yaw"`, `"xz"`, `"rpy"`, `"xyz rpy"`, `"all"`; `y` never means yaw.
///
/// # Errors
/// [`Error::Config`] with the unknown word and the valid words.
pub fn parse_axes(key: &str, text: &str) -> Result<[bool; MAX_AXES]> {
    let mut axes = [false; MAX_AXES];
    for word in text.split_whitespace() {
        let chosen: Vec<usize> = if let Some(axis) = AXIS_NAMES.iter().position(|&name| name == word) {
            vec![axis]
        } else if word == "all" {
            (0..MAX_AXES).collect()
        } else if word == "rpy" {
            vec![3, 4, 5]
        } else if word.chars().all(|c| matches!(c, 'x' | 'y' | 'z')) {
            word.chars().map(|c| (c as usize) - ('x' as usize)).collect()
        } else {
            return Err(Error::config(
                key,
                format!(
                    "'{word}' is not an axis; use names apart by spaces ({}), letters of x y z in one word, 'rpy', or 'all'",
                    AXIS_NAMES.join(" ")
                ),
            ));
        };
        for axis in chosen {
            if axes[axis] {
                return Err(Error::config(key, format!("'{}' is named twice in '{text}'", AXIS_NAMES[axis])));
            }
            axes[axis] = true;
        }
    }
    if axes.iter().any(|&on| on) {
        Ok(axes)
    } else {
        Err(Error::config(key, "no axis given; e.g. \"xyz rpy\", \"y yaw\", \"all\""))
    }
}

/// Directions of a push to which an axis yields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CompliantSide {
    /// Yields to a push in either direction.
    Both,
    /// Yields only to a push toward + (tool beyond its target, deviation e < 0).
    Plus,
    /// Yields only to a push toward − (tool short of its target, deviation e > 0).
    Minus,
    /// Does not yield.
    None,
}

impl CompliantSide {
    /// Returns two flags: the axis yields to a push toward −, and to one toward +.
    pub(crate) fn sides(self) -> [bool; 2] {
        match self {
            Self::Both => [true, true],
            Self::Plus => [false, true],
            Self::Minus => [true, false],
            Self::None => [false, false],
        }
    }
}

/// Strength of a yielding axis as a function of the deviation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Profile {
    /// From `soft` below `soft_until` to `firm` above `firm_from`, as in equation (9) of the paper.
    #[default]
    Hardening,
    /// `soft` at every deviation.
    Constant,
    /// From `firm` below `soft_until` to `soft` above `firm_from`.
    Softening,
}

impl Profile {
    /// Returns the strengths at a small and at a large deviation.
    pub(crate) fn ends(self, soft: f64, firm: f64) -> [f64; 2] {
        match self {
            Self::Hardening => [soft, firm],
            Self::Constant => [soft, soft],
            Self::Softening => [firm, soft],
        }
    }
}

/// Behaviour of the target when a stiff axis exceeds its deviation limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum OnDeviationLimit {
    /// The target follows the tool along this axis: the arm yields with the force that it exerts at the limit, and
    /// returns after the release.
    #[default]
    Yield,
    /// The whole target stops until the axis is within its limit again.
    Wait,
}

/// Settings of one task axis. `None` selects the default; the defaults of the strengths depend on law and arm.
///
/// A strength (`soft`, `firm`, `hold`) is the largest force of the axis [N] ([N·m] for rotations) under the laws `cap`
/// and `impedance`, and a torque budget [N·m] under law `paper`. Pairs are (pushed toward −, pushed toward +).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Axis {
    /// Strength at a small deviation, for each direction that yields; τ⁻ in equation (9) of the paper.
    pub soft: Option<[f64; 2]>,
    /// Strength at a large deviation, for each direction that yields; τ⁺ in equation (9) of the paper.
    pub firm: Option<[f64; 2]>,
    /// Strength in a direction that does not yield.
    pub hold: Option<f64>,
    /// Law `impedance`: stiffness of the axis [N/m or N·m/rad]; default 0 for a side that yields, else derived from the
    /// arm.
    pub stiffness: Option<[f64; 2]>,
    /// Law `impedance`: damping of the axis [N·s/m or N·m·s/rad]; default 0.
    pub damping: Option<[f64; 2]>,
    /// Sides that yield; default both if `soft` or `firm` is set, else none.
    pub yields: Option<CompliantSide>,
    /// Target adaptation η, 0 ≤ η < 1, of equation (12) of the paper: share of the deviation by which the target of a
    /// yielding axis follows the tool.
    pub adaptation: f64,
    /// Deviation [m or rad] below which the compliance is 1; default 0.01 m or 0.04 rad. d⁻ in equation (8) of the
    /// paper.
    pub soft_until: Option<f64>,
    /// Deviation [m or rad] above which the compliance is 0; default 0.1 m or 0.4 rad. d⁺ in equation (8) of the paper.
    pub firm_from: Option<f64>,
    /// Shape of the strength between `soft_until` and `firm_from`.
    pub profile: Profile,
    /// Limit of the commanded task velocity while the axis is stiff [m/s or rad/s]; ∞ for no limit; default 0.4 m/s or
    /// 2 rad/s. Law `impedance` ignores it.
    pub max_velocity: Option<f64>,
    /// Limit of the commanded task velocity while the axis yields [m/s or rad/s]; default ∞, under law `paper` 0.1 m/s
    /// or 0.5 rad/s. Law `impedance` ignores it.
    pub soft_step_limit: Option<f64>,
    /// Largest deviation [m or rad] while pushed toward a side that does not yield; `None` for no limit.
    pub deviation_limit: Option<f64>,
    /// Behaviour of the target when the axis exceeds its deviation limit.
    pub on_deviation_limit: OnDeviationLimit,
}

impl Axis {
    /// Creates a stiff axis with default strength.
    pub fn new() -> Self {
        Self::default()
    }

    /// Returns the sides that yield; both if `yields` is `None` and `soft` or `firm` is set, else none.
    pub fn compliant_side(&self) -> CompliantSide {
        let compliant = self.soft.is_some() || self.firm.is_some();
        self.yields.unwrap_or(if compliant { CompliantSide::Both } else { CompliantSide::None })
    }

    /// Checks every value. `owner`, e.g. `axes.y`, is the prefix of the field's name in an error message.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] or [`Error::Config`] naming the field.
    pub fn validate(&self, owner: &str) -> Result<()> {
        let at = |field: &str| format!("{owner}.{field}");
        for (field, pair) in [("soft", self.soft), ("firm", self.firm)] {
            for value in pair.into_iter().flatten() {
                check(at(field), value, value >= 0.0 && value.is_finite(), "[0, ∞)")?;
            }
        }
        for (field, pair) in [("stiffness", self.stiffness), ("damping", self.damping)] {
            for value in pair.into_iter().flatten() {
                check(at(field), value, (0.0..=IMPEDANCE_BOUND).contains(&value), "[0, 1e9]")?;
            }
        }
        if let Some(hold) = self.hold {
            check(at("hold"), hold, hold >= 0.0 && hold.is_finite(), "[0, ∞)")?;
        }
        check(at("adaptation"), self.adaptation, (0.0..1.0).contains(&self.adaptation), "[0, 1)")?;
        for (field, value) in [("max_velocity", self.max_velocity), ("soft_step_limit", self.soft_step_limit)] {
            if let Some(value) = value {
                check(at(field), value, value > 0.0, "(0, ∞]")?;
            }
        }
        if let Some(value) = self.soft_until {
            check(at("soft_until"), value, value >= 0.0 && value.is_finite(), "[0, firm_from)")?;
        }
        if let Some(value) = self.firm_from {
            check(at("firm_from"), value, value > 0.0 && value <= MAX_DEVIATION, "(soft_until, 5] [m, rad]")?;
        }
        if let (Some(low), Some(high)) = (self.soft_until, self.firm_from) {
            check(at("soft_until"), low, low < high, &format!("[0, firm_from = {high})"))?;
        }
        if let (Some(soft), Some(firm)) = (self.soft, self.firm) {
            for side in 0..2 {
                check(at("soft"), soft[side], soft[side] <= firm[side], &format!("[0, firm = {}]", firm[side]))?;
            }
        }
        if let Some(limit) = self.deviation_limit {
            check(at("deviation_limit"), limit, limit > 0.0 && limit <= MAX_DEVIATION, "(0, 5] [m, rad]")?;
            if self.compliant_side() == CompliantSide::Both {
                return Err(Error::config(
                    at("deviation_limit"),
                    format!(
                        "{limit} has no effect on an axis that yields to both sides: leave it out, or say to which side \
                         the axis yields (yields=\"+\", \"-\" or \"none\")"
                    ),
                ));
            }
        }
        if self.adaptation > 0.0 && self.compliant_side() == CompliantSide::None {
            return Err(Error::config(
                at("adaptation"),
                format!(
                    "{} has no effect on an axis that does not yield: give soft or firm, or yields=\"both\"",
                    self.adaptation
                ),
            ));
        }
        Ok(())
    }
}

fn check(what: String, value: f64, ok: bool, bound: &str) -> Result<()> {
    if ok { Ok(()) } else { Err(Error::out_of_range(what, value, bound)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axis_keys_select_their_axes() {
        let on = |text| parse_axes("axes", text).unwrap();
        assert_eq!(on("y yaw"), [false, true, false, false, false, true]);
        assert_eq!(on("xz"), [true, false, true, false, false, false]);
        assert_eq!(on("xyz rpy"), [true; 6]);
        assert_eq!(on("all"), [true; 6]);
        assert_eq!(on("rpy"), [false, false, false, true, true, true]);
        assert_eq!(on("y"), [false, true, false, false, false, false]);
    }

    #[test]
    fn invalid_axis_keys_are_named() {
        for (text, part) in [
            ("q", "'q' is not an axis"),
            ("xx", "'x' is named twice"),
            ("", "no axis given"),
            ("all y", "'y' is named twice"),
        ] {
            let message = parse_axes("axes", text).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }

    #[test]
    fn adaptation_needs_an_axis_that_yields() {
        let message = Axis { adaptation: 0.5, ..Axis::default() }.validate("axes.y").unwrap_err().to_string();
        assert!(message.starts_with("axes.y.adaptation: 0.5 has no effect"), "{message}");
    }
}
