//! Conversion of urdf-rs' links and joints to those of this crate, with checks of their values.

use nalgebra::{Quaternion, Rotation3, UnitQuaternion};
use roxmltree::Node;
use urdf_rs::JointType;

use super::guard::{Checked, child};
use super::text::Source;
use crate::error::{Position, Result};
use crate::model::parts::{Inertial, Joint, JointKind};
use crate::pose::{COORDINATE_BOUND, Pose};

/// Parses a checked text. Errors of urdf-rs are replaced: they name neither position nor element, and formatting them
/// takes 17 kB of code.
pub(in crate::model) fn parse(source: &Source, checked: &Checked) -> Result<urdf_rs::Robot> {
    urdf_rs::read_from_string(&checked.text)
        .map_err(|_| source.error(Position(None), "urdf-rs cannot parse the links and joints; report this file"))
}

/// Converts the inertial of a link; `None` if the file has none, which urdf-rs reports as mass 0.
pub(in crate::model) fn inertial(source: &Source, node: Node, link: &urdf_rs::Link) -> Result<Option<Inertial>> {
    let Some(node) = child(node, "inertial") else { return Ok(None) };
    let owner = format!("link '{}'", link.name);
    let urdf_rs::Inertial { origin, mass, inertia } = &link.inertial;
    let origin = pose(source, child(node, "origin"), origin, &owner)?;
    if !(0.0..=COORDINATE_BOUND).contains(&mass.value) {
        let message = format!("{owner}: mass is {} kg; it must be between 0 and {COORDINATE_BOUND:e}", mass.value);
        return Err(source.error_at(child(node, "mass").unwrap_or(node), message));
    }
    let &urdf_rs::Inertia { ixx, ixy, ixz, iyy, iyz, izz } = inertia;
    if let Some((name, moment)) = [("ixx", ixx), ("iyy", iyy), ("izz", izz)].into_iter().find(|&(_, i)| i < 0.0) {
        let message = format!("{owner}: {name} is {moment} kg·m²; it must not be negative");
        return Err(source.error_at(child(node, "inertia").unwrap_or(node), message));
    }
    Ok(Some(Inertial {
        mass: mass.value,
        com: origin.position,
        rotation: origin.rotation,
        inertia: [[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]],
    }))
}

/// Converts a joint between the links of these indices; its mimic parameters are resolved later.
pub(in crate::model) fn joint(
    source: &Source,
    node: Node,
    joint: &urdf_rs::Joint,
    [parent_link, child_link]: [usize; 2],
) -> Result<Joint> {
    let owner = format!("joint '{}'", joint.name);
    let (kind, type_name) = match joint.joint_type {
        JointType::Revolute => (JointKind::Revolute, "revolute"),
        JointType::Continuous => (JointKind::Continuous, "continuous"),
        JointType::Prismatic => (JointKind::Prismatic, "prismatic"),
        JointType::Fixed => (JointKind::Fixed, "fixed"),
        JointType::Floating => (JointKind::Other, "floating"),
        JointType::Planar => (JointKind::Other, "planar"),
        JointType::Spherical => (JointKind::Other, "spherical"),
    };
    let limit = &joint.limit;
    let position = |value: f64| Some(value).filter(|value| value.is_finite() && kind != JointKind::Continuous);
    // Values that are 0, negative or infinite mean that the limit was not filled in.
    let positive = |value: f64| Some(value).filter(|&value| value > 0.0 && value.is_finite());
    let (lower, upper) = (position(limit.lower), position(limit.upper));
    if let (Some(lower), Some(upper)) = (lower, upper)
        && lower > upper
    {
        return Err(source.error_at(node, format!("{owner}: lower limit {lower} is above upper limit {upper}")));
    }
    // The guard writes NaN for an absent value.
    let dynamics = joint.dynamics.as_ref().map_or([f64::NAN; 2], |dynamics| [dynamics.damping, dynamics.friction]);
    for (name, value) in ["damping", "friction"].into_iter().zip(dynamics) {
        if value < 0.0 {
            let message = format!("{owner}: {name} is {value}; it must be 0 or more");
            return Err(source.error_at(child(node, "dynamics").unwrap_or(node), message));
        }
    }
    let [damping, friction] = dynamics.map(|value| Some(value).filter(|value| !value.is_nan()));
    Ok(Joint {
        name: joint.name.clone(),
        kind,
        type_name: type_name.to_owned(),
        parent: parent_link,
        child: child_link,
        origin: pose(source, child(node, "origin"), &joint.origin, &owner)?,
        axis: if kind.is_actuated() { axis(source, node, *joint.axis.xyz, &owner)? } else { [0.0, 0.0, 1.0] },
        lower,
        upper,
        velocity: positive(limit.velocity),
        effort: positive(limit.effort),
        damping,
        friction,
        mimic: None,
        q_index: None,
        locked_at: None,
        at: source.at(node.range().start),
    })
}

/// Returns the unit axis in the joint's frame; an error if `xyz` is nearly zero.
fn axis(source: &Source, joint: Node, xyz: [f64; 3], owner: &str) -> Result<[f64; 3]> {
    let length = xyz[0].hypot(xyz[1]).hypot(xyz[2]);
    if !(1e-6..=COORDINATE_BOUND).contains(&length) {
        let message = format!("{owner}: axis {xyz:?} has length {length:e}; it must point somewhere, e.g. \"0 0 1\"");
        return Err(source.error_at(child(joint, "axis").unwrap_or(joint), message));
    }
    Ok(xyz.map(|x| x / length))
}

/// Returns the pose of an `<origin>`; the identity if absent.
fn pose(source: &Source, origin: Option<Node>, pose: &urdf_rs::Pose, owner: &str) -> Result<Pose> {
    let Some(origin) = origin else { return Ok(Pose::IDENTITY) };
    let position = *pose.xyz;
    if let Some(far) = position.iter().find(|x| x.abs() > COORDINATE_BOUND) {
        let message = format!("{owner}: <origin> is {far:e} m away; at most {COORDINATE_BOUND:e}");
        return Err(source.error_at(origin, message));
    }
    let [roll, pitch, yaw] = *pose.rpy;
    let rotation = match quaternion(source, origin, owner)? {
        Some([x, y, z, w]) => UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)).to_rotation_matrix(),
        None => Rotation3::from_euler_angles(roll, pitch, yaw),
    };
    Ok(Pose { rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| rotation[(i, j)])), position })
}

/// Returns the unit quaternion x y z w of an `<origin>`; `None` if not given.
///
/// urdf-rs would convert it to roll, pitch and yaw with errors of up to 4.5 mrad near a pitch of ±90°.
fn quaternion(source: &Source, origin: Node, owner: &str) -> Result<Option<[f64; 4]>> {
    let Some(text) = origin.attribute("quat_xyzw") else { return Ok(None) };
    if !quaternions_allowed(origin) {
        let message = format!(
            "{owner}: quat_xyzw needs <robot version=\"1.1\"> or later and would be ignored without; set the version \
             or use rpy"
        );
        return Err(source.error_at(origin, message));
    }
    if origin.has_attribute("rpy") {
        return Err(source.error_at(origin, format!("{owner}: <origin> has both rpy and quat_xyzw; keep one")));
    }
    let mut entries = [f64::NAN; 4];
    for (entry, word) in entries.iter_mut().zip(text.split_whitespace()) {
        *entry = word.parse().unwrap_or(f64::NAN);
    }
    let norm = entries.iter().map(|x| x * x).sum::<f64>().sqrt();
    if !((norm - 1.0).abs() <= 1e-3) {
        let message = format!("{owner}: quat_xyzw has norm {norm}; it must be 1 within 1e-3");
        return Err(source.error_at(origin, message));
    }
    Ok(Some(entries.map(|x| x / norm)))
}

/// Returns true if the file's URDF version is 1.1 or later, which added `quat_xyzw`; a file without a version, or with
/// version "1", is 1.0.
fn quaternions_allowed(node: Node) -> bool {
    let version = node.document().root_element().attribute("version").and_then(|v| v.trim().split_once('.'));
    let number = version.and_then(|(major, minor)| Some((major.parse::<u32>().ok()?, minor.parse::<u32>().ok()?)));
    number.is_some_and(|number| number >= (1, 1))
}
