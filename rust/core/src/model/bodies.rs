//! Moving joints of the chain, joints beside it that follow them by mimic, and the rigid bodies between the joints.

use std::collections::BTreeMap;

use nalgebra::{Rotation3, Translation3, Unit, Vector3};

use super::parts::{Joint, JointKind};
use super::roles::Role;
use super::tree::Tree;
use crate::MAX_JOINTS;
use crate::error::{Error, Result};
use crate::pose::Pose;

/// Rigid transform; used only while a model is read.
pub(super) type Transform = nalgebra::IsometryMatrix3<f64>;

/// A moving joint, with its frame as in the URDF file.
pub(super) struct Slot {
    /// Index of the joint in the tree.
    pub(super) joint: usize,
    /// Slot of the moving joint that carries this one; `None` for the base.
    pub(super) parent: Option<usize>,
    /// Pose of this joint's frame at joint value 0 in the moved frame of the parent joint. Joints move about or along
    /// z.
    pub(super) before: Transform,
    /// Index in q of the independent joint that drives this one.
    pub(super) q_index: usize,
    /// Joint value per unit of the independent joint.
    pub(super) multiplier: f64,
    /// Joint value at position 0 of the independent joint [rad or m].
    pub(super) offset: f64,
}

/// Returns the pose of a joint's child link in its parent link at the joint value `value` [rad or m].
pub(super) fn step(joint: &Joint, value: f64) -> Transform {
    let axis = Unit::new_unchecked(Vector3::from(joint.axis));
    let motion = match joint.kind {
        JointKind::Revolute | JointKind::Continuous => {
            Transform::from_parts(Translation3::identity(), Rotation3::from_axis_angle(&axis, value))
        }
        JointKind::Prismatic => Transform::from_parts((axis.into_inner() * value).into(), Rotation3::identity()),
        JointKind::Fixed | JointKind::Other => Transform::identity(),
    };
    transform(&joint.origin) * motion
}

/// Returns the rotation that takes z to the joint's axis.
fn z_to_axis(joint: &Joint) -> Transform {
    let axis = Vector3::from(joint.axis);
    let rotation = Rotation3::rotation_between(&Vector3::z(), &axis)
        .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    Transform::from_parts(Translation3::identity(), rotation)
}

pub(super) fn transform(pose: &Pose) -> Transform {
    let rotation = nalgebra::Matrix3::from_fn(|i, j| pose.rotation[i][j]);
    Transform::from_parts(Translation3::from(pose.position), Rotation3::from_matrix_unchecked(rotation))
}

pub(super) fn pose(transform: &Transform) -> Pose {
    let rotation = transform.rotation.matrix();
    Pose {
        rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| rotation[(i, j)])),
        position: transform.translation.vector.into(),
    }
}

/// Moving joints and the rigid bodies between them, with frames as in the URDF file.
pub(super) struct Bodies {
    /// Moving joints, those of the path first.
    pub(super) slots: Vec<Slot>,
    /// Number of moving joints on the path.
    pub(super) path: usize,
    /// Pose in the base of the link at which the chain starts.
    pub(super) base: Transform,
    /// Pose of the tool in the frame after the last joint of the path.
    pub(super) tool: Transform,
    /// Mass that moves with each slot [kg].
    pub(super) mass: Vec<f64>,
    /// Mass times centre of mass that moves with each slot [kg·m], in the frame after the joint.
    pub(super) moment: Vec<Vector3<f64>>,
}

/// Collects moving joints and masses in the subtree of `anchor`: first along the path, then everything attached to it.
pub(super) fn collect(tree: &Tree, anchor: usize, base: Transform, path: &[usize], roles: &[Role]) -> Result<Bodies> {
    let mut bodies =
        Bodies { slots: Vec::new(), path: 0, base, tool: Transform::identity(), mass: Vec::new(), moment: Vec::new() };
    // Slot of each moving joint, so that the second traversal does not add it again.
    let mut slot_of: BTreeMap<usize, usize> = BTreeMap::new();
    let (mut slot, mut here) = (None, Transform::identity());
    for &j in path {
        (slot, here) = bodies.pass(tree, j, slot, &here, roles[j], &mut slot_of)?;
    }
    bodies.path = bodies.slots.len();
    bodies.tool = here;

    let mut stack = vec![(anchor, None, Transform::identity())];
    while let Some((link, slot, here)) = stack.pop() {
        if let (Some(slot), Some(inertial)) = (slot, &tree.links[link].inertial) {
            bodies.mass[slot] += inertial.mass;
            bodies.moment[slot] += (here * nalgebra::Point3::from(inertial.com)).coords * inertial.mass;
        }
        for &j in &tree.children[link] {
            let (next, pose) = bodies.pass(tree, j, slot, &here, roles[j], &mut slot_of)?;
            stack.push((tree.joints[j].child, next, pose));
        }
    }
    Ok(bodies)
}

impl Bodies {
    /// Adds joint `j` if it moves; returns the slot that carries its child link, and the child's pose in that slot's
    /// frame.
    fn pass(
        &mut self,
        tree: &Tree,
        j: usize,
        slot: Option<usize>,
        here: &Transform,
        role: Role,
        slot_of: &mut BTreeMap<usize, usize>,
    ) -> Result<(Option<usize>, Transform)> {
        let joint = &tree.joints[j];
        let (q_index, multiplier, offset) = match role {
            Role::Still(value) => return Ok((slot, here * step(joint, value))),
            Role::Moves { q_index, multiplier, offset } => (q_index, multiplier, offset),
        };
        let turned = z_to_axis(joint);
        let known = slot_of.get(&j).copied();
        let joint_slot = known.unwrap_or(self.slots.len());
        if known.is_none() {
            if joint_slot == MAX_JOINTS {
                return Err(Error::config(
                    "tip",
                    format!(
                        "more than {MAX_JOINTS} moving joints: those that follow a joint of the chain by mimic count too; \
                         lock the joint that they follow, e.g. '{}'",
                        joint.mimic.map_or(&joint.name, |m| &tree.joints[m.joint].name)
                    ),
                ));
            }
            slot_of.insert(j, joint_slot);
            let before = here * transform(&joint.origin) * turned;
            self.slots.push(Slot { joint: j, parent: slot, before, q_index, multiplier, offset });
            self.mass.push(0.0);
            self.moment.push(Vector3::zeros());
        }
        Ok((Some(joint_slot), turned.inverse()))
    }
}
