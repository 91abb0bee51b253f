//! What a file does not say, and how it is checked against what the file does say.

use std::collections::BTreeMap;

use super::names::listed;
use super::parts::JointKind;
use super::tree::Tree;
use crate::error::{Error, Result};
use crate::pose::COORDINATE_BOUND;

/// What a file does not say: which part of the robot, what it carries, which way is down.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelOptions {
    /// Frame in which poses are given; default: the root link. Must be rigidly fixed to a link above the tip.
    pub base: Option<String>,
    /// The tool frame; may be omitted when only one link of the robot carries no other.
    pub tip: Option<String>,
    /// Joints held at a value [rad or m]. Actuated joints beside the chain that are not named rest at 0, or at the
    /// limit nearest to it.
    pub locked: BTreeMap<String, f64>,
    /// What the tool holds.
    pub payload: Option<Payload>,
    /// Gravity in the base frame [m/s²].
    pub gravity: [f64; 3],
    /// Position limits [rad or m] (lower, upper) by joint, in place of the file's.
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

/// A point mass in the tool frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Payload {
    /// Mass [kg], ≥ 0.
    pub mass: f64,
    /// Centre of mass in the tool frame [m].
    pub com: [f64; 3],
}

impl Payload {
    /// Checks that the numbers can be a payload.
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

/// Only a continuous joint may move without end: limits that nobody wrote down would read as 0…0 or ±∞.
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
