//! Bounds on targets, which detect values in wrong units or in another frame.

use crate::error::{Error, Result};
use crate::kinematics::JointFrames;
use crate::math::simd::{BaselineF64, NEGLIGIBLE};
use crate::model::Model;
use crate::pose::{COORDINATE_BOUND, POSITION_BOUND, Pose, TargetRegion};
use crate::{JointVec, MAX_JOINTS};

/// Largest distance of a target from the first joint, in multiples of [`Model::reach`].
///
/// A target out of reach is valid, because the arm stretches toward it: with an arm of 0.7 m, a target may jump by a
/// metre. Targets in feet, inches, centimetres or millimetres are too large by factors of 3.3 to 1000.
const REACH_FACTOR: f64 = 2.0;

/// Margin [m] added to `REACH_FACTOR` times the reach, which can be 0: for an arm of one joint with the tool on its
/// axis.
const REACH_MARGIN: f64 = 0.1;

/// Largest distance of a joint target beyond the position limits [rad].
///
/// Goals are clamped to the limits in any case. The margin accepts targets of leader arms and policies with a zero
/// error of some degrees; targets in degrees are too large by a factor of 57.
const ANGLE_MARGIN: f64 = 0.2;

/// Largest distance of a prismatic joint's target beyond its position limits, as a share of its travel.
const TRAVEL_MARGIN: f64 = 0.1;

/// Returns the smallest and the largest joint target [rad or m] of each joint, ∓∞ in the padding.
pub(crate) fn joint_targets(model: &Model) -> [JointVec; 2] {
    let mut out = [[f64::NEG_INFINITY; MAX_JOINTS], [f64::INFINITY; MAX_JOINTS]];
    for (i, (&lower, &upper)) in model.lower().iter().zip(model.upper()).enumerate().take(MAX_JOINTS) {
        let margin = if model.prismatic()[i] { TRAVEL_MARGIN * (upper - lower) } else { ANGLE_MARGIN };
        out[0][i] = (lower - margin).max(-COORDINATE_BOUND);
        out[1][i] = (upper + margin).min(COORDINATE_BOUND);
    }
    out
}

/// Returns the region of plausible target positions of an arm; all positions for a prismatic joint without limits.
pub(crate) fn target_region(model: &Model) -> TargetRegion {
    let bounded = |i: usize| (model.upper()[i] - model.lower()[i]).is_finite();
    if (0..model.n()).any(|i| model.prismatic()[i] && !bounded(i)) {
        return TargetRegion::ANY;
    }
    TargetRegion::ball(model.reach_origin(), (REACH_FACTOR * model.reach() + REACH_MARGIN).min(POSITION_BOUND))
}

impl Model {
    /// Returns the centre of [`Model::reach`]: the origin of the first joint at q = 0, in the base [m].
    pub fn reach_origin(&self) -> [f64; 3] {
        let mut frames = JointFrames::default();
        self.chain().forward(&[0.0; MAX_JOINTS], &mut frames);
        frames.origin[0]
    }

    /// Checks that a pose is a plausible target of this arm: a position far out of reach is probably in wrong units.
    ///
    /// [`Controller::step`](crate::Controller::step) does this for tasks with translations.
    ///
    /// # Errors
    /// As [`Pose::validate`]; [`Error::OutOfRange`] for a position farther from the first joint than 2 ×
    /// [`Model::reach`] + 0.1 m.
    pub fn check_target(&self, target: &Pose) -> Result<()> {
        self.check_target_in("target", target, &target_region(self))
    }

    /// Checks as [`Model::check_target`], with the valid positions `region`; `name` is the argument's name for the
    /// message.
    pub(crate) fn check_target_in(&self, name: &str, target: &Pose, region: &TargetRegion) -> Result<()> {
        if !target.is_invalid::<BaselineF64>(region) {
            return Ok(());
        }
        if target.position.iter().all(|value| value.is_finite()) && region.excludes(&target.position) {
            return Err(self.too_far(name, &target.position, region));
        }
        target.check(name)
    }

    #[cold]
    #[inline(never)]
    fn too_far(&self, name: &str, position: &[f64; 3], region: &TargetRegion) -> Error {
        let bound = if region.radius < POSITION_BOUND {
            format!(
                "[0, {:.3}]: the arm reaches {:.3} m; is it in millimetres? A position is in metres, in the axes of '{}'",
                region.radius,
                self.reach(),
                self.base()
            )
        } else {
            format!("[0, {POSITION_BOUND}]; is it in millimetres?")
        };
        let from = self.joint_names().first().map_or("the base", String::as_str);
        let from = if region.radius < POSITION_BOUND { from } else { self.base() };
        // Four decimals are enough to recognize the mistake.
        let shown = |value: f64| {
            if value.abs() < 1e6 { format!("{}", (1e4 * value).round() / 1e4) } else { format!("{value:e}") }
        };
        let [x, y, z] = position.map(shown);
        let distance = region.distance(position);
        let distance = if distance < 1e6 { (1e3 * distance).round() / 1e3 } else { distance };
        Error::out_of_range(format!("{name}: distance of position [{x}, {y}, {z}] from {from} [m]"), distance, bound)
    }

    /// Checks that joint positions [rad or m] are a plausible target: values far beyond the limits are probably
    /// in wrong units.
    ///
    /// [`Controller::step_joints`](crate::Controller::step_joints) does this.
    ///
    /// # Errors
    /// [`Error::Shape`] for a wrong length; [`Error::OutOfRange`] for a joint beyond its limits by more than 0.2 rad,
    /// or a tenth of the travel of a prismatic joint.
    pub fn check_joint_target(&self, q: &[f64]) -> Result<()> {
        let [lowest, highest] = joint_targets(self);
        self.joints_between("q", q, &lowest, &highest).map(|_| ())
    }

    /// Checks that joint positions are between two bounds; returns them padded, with negligibly small values set to 0.
    #[inline]
    pub(crate) fn joints_between(
        &self,
        what: &str,
        values: &[f64],
        lowest: &JointVec,
        highest: &JointVec,
    ) -> Result<JointVec> {
        let (mut out, mut fine) = ([0.0; MAX_JOINTS], values.len() == self.n());
        for (i, (slot, &value)) in out.iter_mut().zip(values).enumerate() {
            fine &= lowest[i] < value && value < highest[i];
            *slot = if value.abs() < NEGLIGIBLE { 0.0 } else { value };
        }
        if fine { Ok(out) } else { Err(self.not_between(what, values, lowest, highest)) }
    }

    /// Checks that |value| ≤ `bound` for one number per joint; returns them padded, with negligibly small values set to
    /// 0.
    pub(crate) fn joints_within(&self, what: &str, values: &[f64], bound: f64) -> Result<JointVec> {
        if values.len() != self.n() {
            return Err(Error::length(what, values.len(), self.n()));
        }
        let mut out = [0.0; MAX_JOINTS];
        for (i, (slot, &value)) in out.iter_mut().zip(values).enumerate() {
            if !(value.abs() <= bound) {
                let name = self.joint_names().get(i).map_or("", String::as_str);
                return Err(Error::out_of_range(format!("{what}[{i}] ({name})"), value, format!("±{bound:e}")));
            }
            *slot = if value.abs() < NEGLIGIBLE { 0.0 } else { value };
        }
        Ok(out)
    }

    /// Returns the error for joint positions that are not between the bounds, with a hint on units.
    #[cold]
    #[inline(never)]
    fn not_between(&self, what: &str, values: &[f64], lowest: &JointVec, highest: &JointVec) -> Error {
        if values.len() != self.n() {
            return Error::length(what, values.len(), self.n());
        }
        let named = |i: usize| self.joint_names().get(i).map_or("", String::as_str);
        if let Some(i) = values.iter().position(|value| !(value.abs() <= COORDINATE_BOUND)) {
            return Error::out_of_range(
                format!("{what}[{i}] ({})", named(i)),
                values[i],
                format!("±{COORDINATE_BOUND:e}"),
            );
        }
        let outside = |&i: &usize| !(lowest[i] < values[i] && values[i] < highest[i]);
        let i = (0..self.n().min(MAX_JOINTS)).find(outside).unwrap_or(0);
        let (lower, upper) = (self.lower()[i], self.upper()[i]);
        let (unit, hint) = if self.prismatic()[i] { ("m", "millimetres") } else { ("rad", "degrees") };
        Error::out_of_range(
            format!("{what}[{i}] ({}) [{unit}]", named(i)),
            values[i],
            format!(
                "({:.3}, {:.3}), beyond the limits [{lower}, {upper}] of this joint; is it in {hint}?",
                lowest[i], highest[i]
            ),
        )
    }
}
