//! URDF text → links and joints. The only file that knows the reader.

use nalgebra::{Quaternion, Rotation3, UnitQuaternion};

use super::guards::{Checked, JointFacts, LinkFacts};
use super::parts::{Inertial, JointKind};
use super::text::{Source, shortened};
use crate::error::{Error, Position, Result};
use crate::pose::Pose;

/// A robot as the file says it, names not yet resolved.
#[derive(Debug)]
pub(super) struct Robot {
    pub(super) name: String,
    pub(super) links: Vec<RawLink>,
    pub(super) joints: Vec<RawJoint>,
}

#[derive(Debug)]
pub(super) struct RawLink {
    pub(super) name: String,
    pub(super) at: Position,
    pub(super) inertial: Option<Inertial>,
}

#[derive(Debug)]
pub(super) struct RawJoint {
    pub(super) name: String,
    pub(super) at: Position,
    pub(super) kind: JointKind,
    pub(super) type_name: String,
    pub(super) parent: String,
    pub(super) child: String,
    pub(super) origin: Pose,
    pub(super) axis: [f64; 3],
    pub(super) lower: Option<f64>,
    pub(super) upper: Option<f64>,
    pub(super) velocity: Option<f64>,
    pub(super) effort: Option<f64>,
    pub(super) damping: Option<f64>,
    pub(super) friction: Option<f64>,
    /// Joint followed, multiplier, offset.
    pub(super) mimic: Option<(String, f64, f64)>,
}

/// Checks a text and reads it.
pub(super) fn read(source: &Source, text: &str) -> Result<Robot> {
    let checked = super::guards::check(source, text)?;
    let robot = urdf_rs::read_from_string(&checked.text).map_err(|error| {
        source
            .error(Position(None), format!("the URDF reader refuses this file: {}", shortened(&error.to_string(), 300)))
    })?;
    same_names(source, &checked, &robot)?;
    Ok(Robot {
        name: robot.name,
        links: robot.links.into_iter().zip(checked.links).map(|(link, facts)| raw_link(&link, facts)).collect(),
        joints: robot.joints.into_iter().zip(checked.joints).map(|(joint, facts)| raw_joint(joint, facts)).collect(),
    })
}

/// The two XML readers must have seen the same things in the same order, or facts would go to the wrong joint.
fn same_names(source: &Source, checked: &Checked, robot: &urdf_rs::Robot) -> Result<()> {
    let differ = |what: &str, at: Position, name: &str| -> Error {
        source.error(
            at,
            format!("{what} '{name}' is read differently by two XML readers; use plain characters in its name"),
        )
    };
    for (i, facts) in checked.links.iter().enumerate() {
        if robot.links.get(i).is_none_or(|link| link.name != facts.name) {
            return Err(differ("link", facts.at, &facts.name));
        }
    }
    for (i, facts) in checked.joints.iter().enumerate() {
        if robot.joints.get(i).is_none_or(|joint| joint.name != facts.name) {
            return Err(differ("joint", facts.at, &facts.name));
        }
    }
    Ok(())
}

fn raw_link(link: &urdf_rs::Link, facts: LinkFacts) -> RawLink {
    let inertial = facts.inertial.then(|| {
        let i = &link.inertial.inertia;
        let origin = pose(&link.inertial.origin, facts.quaternion);
        Inertial {
            mass: link.inertial.mass.value,
            com: origin.position,
            rotation: origin.rotation,
            inertia: [[i.ixx, i.ixy, i.ixz], [i.ixy, i.iyy, i.iyz], [i.ixz, i.iyz, i.izz]],
        }
    });
    RawLink { name: facts.name, at: facts.at, inertial }
}

fn raw_joint(joint: urdf_rs::Joint, facts: JointFacts) -> RawJoint {
    let kind = match joint.joint_type {
        urdf_rs::JointType::Revolute => JointKind::Revolute,
        urdf_rs::JointType::Continuous => JointKind::Continuous,
        urdf_rs::JointType::Prismatic => JointKind::Prismatic,
        urdf_rs::JointType::Fixed => JointKind::Fixed,
        _ => JointKind::Other,
    };
    // 0, negative and infinite all mean that nobody filled it in.
    let positive = |value: f64| (value > 0.0 && value.is_finite()).then_some(value);
    let continuous = kind == JointKind::Continuous;
    RawJoint {
        name: facts.name,
        at: facts.at,
        kind,
        type_name: facts.type_name,
        parent: joint.parent.link,
        child: joint.child.link,
        origin: pose(&joint.origin, facts.quaternion),
        axis: if kind.is_actuated() { unit(joint.axis.xyz.0) } else { [0.0, 0.0, 1.0] },
        lower: facts.lower.filter(|_| !continuous),
        upper: facts.upper.filter(|_| !continuous),
        velocity: positive(joint.limit.velocity),
        effort: positive(joint.limit.effort),
        damping: facts.damping,
        friction: facts.friction,
        mimic: joint.mimic.map(|m| (m.joint, m.multiplier.unwrap_or(1.0), m.offset.unwrap_or(0.0))),
    }
}

/// The guards have seen that the length is not near 0.
fn unit(axis: [f64; 3]) -> [f64; 3] {
    let length = axis[0].hypot(axis[1]).hypot(axis[2]);
    axis.map(|x| x / length)
}

/// The quaternion is used directly: the reader's detour over roll, pitch, yaw snaps near ±90° of pitch.
fn pose(origin: &urdf_rs::Pose, quaternion: Option<[f64; 4]>) -> Pose {
    let rotation = match quaternion {
        Some([x, y, z, w]) => UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)).to_rotation_matrix(),
        None => Rotation3::from_euler_angles(origin.rpy[0], origin.rpy[1], origin.rpy[2]),
    };
    Pose { rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| rotation[(i, j)])), position: origin.xyz.0 }
}
