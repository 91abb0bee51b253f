//! Role of each joint of the tree: independent, driven by an independent joint, or locked at a value.

use std::collections::BTreeMap;

use super::names::{listed, some};
use super::parts::JointKind;
use super::tree::Tree;
use crate::MAX_JOINTS;
use crate::error::{Error, Result};
use crate::pose::COORDINATE_BOUND;

/// Role of a joint of the tree for the chosen base, tip and locks.
#[derive(Clone, Copy)]
pub(super) enum Role {
    /// Locked at this value [rad or m].
    Still(f64),
    /// Driven by the independent joint `q_index`, or that joint itself: joint value `multiplier · q[q_index] + offset`.
    Moves { q_index: usize, multiplier: f64, offset: f64 },
}

pub(super) struct Roles {
    /// Role of each joint of the tree.
    pub(super) of: Vec<Role>,
    /// Indices in the tree of the independent joints, in the order of q.
    pub(super) independent: Vec<usize>,
}

/// Chooses the independent joints and the role of every joint for this path and these locks; sets `q_index` and
/// `locked_at` of the joints in the tree.
pub(super) fn roles(tree: &mut Tree, path: &[usize], locked: &BTreeMap<String, f64>) -> Result<Roles> {
    let mut fixed_at: Vec<Option<f64>> = vec![None; tree.joints.len()];
    for (name, &value) in locked {
        fixed_at[lockable(tree, name, value)?] = Some(value);
    }

    let mut independent: Vec<usize> = Vec::new();
    let mut index = vec![None; tree.joints.len()];
    let mut moving = 0;
    for &j in path {
        let joint = &tree.joints[j];
        if joint.kind == JointKind::Fixed {
            continue;
        }
        if joint.kind == JointKind::Other {
            return Err(tree.joint_error(
                j,
                format!(
                    "is of type '{}', which has no single coordinate; between base and tip only revolute, continuous, \
                 prismatic and fixed joints can be controlled: choose a base below it, or replace it",
                    joint.type_name
                ),
            ));
        }
        let driver = joint.mimic.map_or(j, |m| m.joint);
        if !tree.joints[driver].kind.is_actuated() {
            return Err(tree.joint_error(j, format!(
                "mimics '{}', which is of type '{}' and never moves; lock it by name (locked = {{\"{}\": value}}) or make it fixed",
                tree.joints[driver].name, tree.joints[driver].type_name, joint.name
            )));
        }
        if fixed_at[driver].is_some() {
            continue;
        }
        moving += 1;
        if index[driver].is_none() {
            index[driver] = Some(independent.len());
            independent.push(driver);
        }
    }
    if independent.is_empty() {
        return Err(Error::config(
            "tip",
            format!(
                "no joint between base and tip can move; choose another base or tip, frames: {}",
                some(tree.links.iter().map(|link| link.name.as_str()))
            ),
        ));
    }
    if moving > MAX_JOINTS || independent.len() > MAX_JOINTS {
        return Err(Error::config(
            "tip",
            format!(
                "{moving} moving joints between base and tip, at most {MAX_JOINTS}; lock some of them or choose a nearer tip"
            ),
        ));
    }

    let mut of = Vec::with_capacity(tree.joints.len());
    for j in 0..tree.joints.len() {
        let joint = &tree.joints[j];
        let (driver, multiplier, offset) = joint.mimic.map_or((j, 1.0, 0.0), |m| (m.joint, m.multiplier, m.offset));
        of.push(match index[driver] {
            Some(q_index) if joint.kind.is_actuated() => Role::Moves { q_index, multiplier, offset },
            _ if !joint.kind.is_actuated() => Role::Still(0.0),
            _ => {
                let at = fixed_at[driver].unwrap_or_else(|| tree.joints[driver].resting_value());
                Role::Still(multiplier * at + offset)
            }
        });
    }
    for (joint, role) in tree.joints.iter_mut().zip(&of) {
        match *role {
            Role::Moves { q_index, .. } => joint.q_index = Some(q_index),
            Role::Still(value) if joint.kind.is_actuated() => joint.locked_at = Some(value),
            Role::Still(_) => {}
        }
    }
    Ok(Roles { of, independent })
}

/// Returns the index of the joint of this name; an error if it cannot be locked at this value.
fn lockable(tree: &Tree, name: &str, value: f64) -> Result<usize> {
    let key = || format!("locked.{name}");
    let Some(j) = tree.joints.iter().position(|joint| joint.name == name) else {
        return Err(Error::config(
            key(),
            format!("no joint of that name; joints: {}", listed(&tree.joints, |joint| &joint.name, name)),
        ));
    };
    let joint = &tree.joints[j];
    if !joint.kind.is_actuated() {
        return Err(Error::config(key(), format!("a joint of type '{}' cannot be locked", joint.type_name)));
    }
    if let Some(mimic) = joint.mimic {
        let driver = &tree.joints[mimic.joint].name;
        return Err(Error::config(key(), format!("follows '{driver}' (mimic); lock '{driver}' instead")));
    }
    let (lower, upper) = (joint.lower.unwrap_or(-COORDINATE_BOUND), joint.upper.unwrap_or(COORDINATE_BOUND));
    if !(value >= lower && value <= upper) {
        return Err(Error::out_of_range(key(), value, format!("[{lower}, {upper}], the limits of this joint")));
    }
    Ok(j)
}
