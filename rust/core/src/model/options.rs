//! Options with which a URDF file is read, and their checks against the file.

use std::collections::BTreeMap;

use super::names::listed;
use super::parts::JointKind;
use super::tree::Tree;
use crate::error::{Error, Result};
use crate::pose::COORDINATE_BOUND;

/// Options of a model: base and tip, locked joints, payload, gravity and position limits.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelOptions {
    /// Link in whose frame poses are expressed; `None` for the root link. Must be rigidly fixed to a link above the
    /// tip.
    pub base: Option<String>,
    /// Link that is the tool frame; `None` for the only link below the base that has no child.
    pub tip: Option<String>,
    /// Values [rad or m] at which joints are locked, by joint name. Other actuated joints beside the chain are locked
    /// at 0, or at the limit nearest to 0.
    pub locked: BTreeMap<String, f64>,
    /// Payload at the tool; `None` for no payload.
    pub payload: Option<Payload>,
    /// Gravity in the base frame [m/s²]; default 9.81 along −z.
    pub gravity: [f64; 3],
    /// Position limits (lower, upper) [rad or m] by joint name, which replace those of the file.
    pub limits: BTreeMap<String, (f64, f64)>,
}

impl Default for ModelOptions {
    fn default() -> Self {
        Self {
            base: None,
            tip: None,
            locked: BTreeMap::new(),
            payload: None,
            gravity: [0.0, 0.0, -9.81],
            limits: BTreeMap::new(),
        }
    }
}

/// A payload: a point mass fixed in the tool frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Payload {
    /// Mass [kg], ≥ 0.
    pub mass: f64,
    /// Centre of mass in the tool frame [m].
    pub com: [f64; 3],
}

impl Payload {
    /// Checks that mass and centre of mass are finite and within ±1e6, and the mass not negative.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] names the entry.
    pub fn validate(&self) -> Result<()> {
        if !(self.mass >= 0.0 && self.mass <= COORDINATE_BOUND) {
            return Err(Error::out_of_range("payload.mass [kg]", self.mass, format!("0 to {COORDINATE_BOUND:e}")));
        }
        finite_vector("payload.com", "m", &self.com)
    }
}

pub(crate) fn finite_vector(what: &str, unit: &str, vector: &[f64; 3]) -> Result<()> {
    for (axis, &value) in ["x", "y", "z"].iter().zip(vector) {
        if !(value.abs() <= COORDINATE_BOUND) {
            return Err(Error::out_of_range(
                format!("{what}.{axis} [{unit}]"),
                value,
                format!("±{COORDINATE_BOUND:e}"),
            ));
        }
    }
    Ok(())
}

pub(super) fn override_limits(tree: &mut Tree, limits: &BTreeMap<String, (f64, f64)>) -> Result<()> {
    for (name, &(lower, upper)) in limits {
        let key = format!("limits.{name}");
        let Some(j) = tree.joints.iter().position(|joint| joint.name == *name) else {
            let joints = listed(&tree.joints, |joint| &joint.name, name);
            return Err(Error::config(key, format!("no joint of that name; joints: {joints}")));
        };
        if !tree.joints[j].kind.is_actuated() {
            return Err(Error::config(key, format!("a joint of type '{}' has no limits", tree.joints[j].type_name)));
        }
        if !(lower < upper && lower.abs() <= COORDINATE_BOUND && upper.abs() <= COORDINATE_BOUND) {
            let message =
                format!("({lower}, {upper}) must be finite, within ±{COORDINATE_BOUND:e}, the lower one first");
            return Err(Error::config(key, message));
        }
        (tree.joints[j].lower, tree.joints[j].upper) = (Some(lower), Some(upper));
    }
    Ok(())
}

/// Returns an error if the position range of joint `j` is unknown or empty, unless the joint is continuous.
pub(super) fn need_limits(tree: &Tree, j: usize) -> Result<()> {
    let joint = &tree.joints[j];
    let remedy = format!("pass limits = {{\"{}\": (lower, upper)}}", joint.name);
    match (joint.lower, joint.upper) {
        _ if joint.kind == JointKind::Continuous => Ok(()),
        (Some(lower), Some(upper)) if lower < upper => Ok(()),
        (Some(lower), Some(_)) => {
            let message =
                format!("({}) has lower = upper = {lower} and cannot move; mend <limit> or {remedy}", joint.type_name);
            Err(tree.joint_error(j, message))
        }
        (lower, upper) => {
            let missing = match (lower, upper) {
                (None, None) => "lower and upper position limits",
                (None, _) => "lower position limit",
                _ => "upper position limit",
            };
            let message = format!(
                "({}) has no {missing}; add <limit lower=\"...\" upper=\"...\"/>, make it continuous, or {remedy}",
                joint.type_name
            );
            Err(tree.joint_error(j, message))
        }
    }
}
