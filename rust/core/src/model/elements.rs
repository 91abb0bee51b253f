//! Parser of `<link>` and `<joint>` elements; reports errors with their position.
//!
//! Checks that every number and vector is complete and finite, and keeps absent values as `None`.

use nalgebra::{Quaternion, Rotation3, UnitQuaternion};
use roxmltree::Node;

use super::parts::{Inertial, JointKind};
use super::text::{Source, shortened};
use super::urdf::{RawJoint, RawLink};
use crate::error::Result;
use crate::pose::{COORDINATE_BOUND, Pose};

const JOINT_TYPES: [&str; 7] = ["revolute", "continuous", "prismatic", "fixed", "floating", "planar", "spherical"];
const JOINT_PARTS: [&str; 7] = ["origin", "parent", "child", "axis", "limit", "mimic", "dynamics"];
const INERTIAL_PARTS: [&str; 3] = ["origin", "mass", "inertia"];
const INERTIA: [&str; 6] = ["ixx", "ixy", "ixz", "iyy", "iyz", "izz"];

/// Reads the elements of one file.
pub(super) struct Reader<'a> {
    pub(super) source: &'a Source<'a>,
    /// True if the file's version supports `quat_xyzw`.
    pub(super) quaternions: bool,
}

/// Child elements with these names; other elements inside `parent` are ignored.
pub(super) fn children<'n, 'i>(parent: Node<'n, 'i>, names: &[&str]) -> impl Iterator<Item = Node<'n, 'i>> {
    let space = parent.tag_name().namespace();
    parent.children().filter(move |child| {
        let tag = child.tag_name();
        child.is_element() && tag.namespace() == space && names.contains(&tag.name())
    })
}

impl Reader<'_> {
    /// Returns at most one child of each name, in the order of `names`.
    fn parts<'n, 'i, const N: usize>(
        &self,
        parent: Node<'n, 'i>,
        names: &[&str; N],
        owner: &str,
    ) -> Result<[Option<Node<'n, 'i>>; N]> {
        let mut parts = [None; N];
        for child in children(parent, names) {
            let name = child.tag_name().name();
            for (part, _) in parts.iter_mut().zip(names).filter(|(_, n)| **n == name) {
                if part.replace(child).is_some() {
                    let message = format!("{owner}: a second <{name}>; at most one is allowed");
                    return Err(self.source.error_at(child, message));
                }
            }
        }
        Ok(parts)
    }

    pub(super) fn link(&self, node: Node) -> Result<RawLink> {
        let name = self.source.named(node, "link")?;
        let owner = format!("link '{name}'");
        let [inertial] = self.parts(node, &["inertial"], &owner)?;
        let inertial = inertial.map(|node| self.inertial(node, &owner)).transpose()?;
        Ok(RawLink { name, at: self.source.at(node.range().start), inertial })
    }

    fn inertial(&self, node: Node, owner: &str) -> Result<Inertial> {
        let [origin, mass, inertia] = self.parts(node, &INERTIAL_PARTS, owner)?;
        let origin = self.origin(origin, owner)?;
        let Some(mass) = mass else {
            return Err(self.source.error_at(node, format!("{owner}: <inertial> without <mass value=\"...\"/>")));
        };
        let kilograms = self.source.required(mass, "value", owner)?;
        if !(0.0..=COORDINATE_BOUND).contains(&kilograms) {
            let message = format!("{owner}: mass is {kilograms} kg; it must be between 0 and {COORDINATE_BOUND:e}");
            return Err(self.source.error_at(mass, message));
        }
        let Some(inertia) = inertia else {
            let message = format!(
                "{owner}: <inertial> without <inertia ixx=... ixy=... ixz=... iyy=... iyz=... izz=.../>; leave <inertial> \
                 out for a massless link"
            );
            return Err(self.source.error_at(node, message));
        };
        let mut entries = [0.0; INERTIA.len()];
        for (entry, name) in entries.iter_mut().zip(INERTIA) {
            *entry = self.source.required(inertia, name, owner)?;
            let moment = name == "ixx" || name == "iyy" || name == "izz";
            if moment && *entry < 0.0 {
                let message = format!("{owner}: {name} is {entry} kg·m²; it must not be negative");
                return Err(self.source.error_at(inertia, message));
            }
        }
        let [xx, xy, xz, yy, yz, zz] = entries;
        Ok(Inertial {
            mass: kilograms,
            com: origin.position,
            rotation: origin.rotation,
            inertia: [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]],
        })
    }

    pub(super) fn joint(&self, node: Node) -> Result<RawJoint> {
        let source = self.source;
        let name = source.named(node, "joint")?;
        let owner = format!("joint '{name}'");
        let type_name = node.attribute("type").unwrap_or_default().to_owned();
        if !JOINT_TYPES.contains(&type_name.as_str()) {
            let message = format!(
                "{owner}: type is '{}'; it must be one of {}",
                shortened(&type_name, 40),
                JOINT_TYPES.join(", ")
            );
            return Err(source.error_at(node, message));
        }
        let kind = match type_name.as_str() {
            "revolute" => JointKind::Revolute,
            "continuous" => JointKind::Continuous,
            "prismatic" => JointKind::Prismatic,
            "fixed" => JointKind::Fixed,
            _ => JointKind::Other,
        };
        let [origin, parent, child, axis, limit, mimic, dynamics] = self.parts(node, &JOINT_PARTS, &owner)?;
        let [parent, child] = [(parent, "parent"), (child, "child")].map(|(part, what)| {
            let named = part.and_then(|part| part.attribute("link")).filter(|link| !link.is_empty());
            let Some(link) = named else {
                return Err(source.error_at(node, format!("{owner}: <{what} link=\"...\"/> is missing")));
            };
            source.refuse_long(part, "link")?;
            Ok(link.to_owned())
        });
        let mut joint = RawJoint {
            at: source.at(node.range().start),
            kind,
            parent: parent?,
            child: child?,
            origin: self.origin(origin, &owner)?,
            axis: self.axis(axis, &owner, kind)?,
            lower: None,
            upper: None,
            velocity: None,
            effort: None,
            damping: None,
            friction: None,
            mimic: mimic.map(|mimic| self.mimic(mimic, &owner)).transpose()?,
            name,
            type_name,
        };
        if let Some(limit) = limit {
            self.limit(limit, &owner, &mut joint)?;
        }
        if let Some(dynamics) = dynamics {
            for (entry, present) in [("damping", &mut joint.damping), ("friction", &mut joint.friction)] {
                if let Some(value) = source.number(dynamics, entry, &owner)? {
                    if value < 0.0 {
                        let message = format!("{owner}: {entry} is {value}; it must be 0 or more");
                        return Err(source.error_at(dynamics, message));
                    }
                    *present = Some(value);
                }
            }
        }
        Ok(joint)
    }

    /// Unit axis in the joint's frame.
    fn axis(&self, axis: Option<Node>, owner: &str, kind: JointKind) -> Result<[f64; 3]> {
        let Some(axis) = axis else { return Ok(if kind.is_actuated() { [1.0, 0.0, 0.0] } else { [0.0, 0.0, 1.0] }) };
        let Some(xyz) = self.source.vector::<3>(axis, "xyz", owner)? else {
            let message = format!("{owner}: <axis> without xyz=\"...\"; leave <axis> out for \"1 0 0\"");
            return Err(self.source.error_at(axis, message));
        };
        if !kind.is_actuated() {
            return Ok([0.0, 0.0, 1.0]);
        }
        let length = xyz[0].hypot(xyz[1]).hypot(xyz[2]);
        if !(1e-6..=COORDINATE_BOUND).contains(&length) {
            let message =
                format!("{owner}: axis {xyz:?} has length {length:e}; it must point somewhere, e.g. \"0 0 1\"");
            return Err(self.source.error_at(axis, message));
        }
        Ok(xyz.map(|x| x / length))
    }

    fn limit(&self, limit: Node, owner: &str, joint: &mut RawJoint) -> Result<()> {
        let read = |entry: &str| self.source.number_or_infinite(limit, entry, owner);
        let position =
            |value: Option<f64>| value.filter(|value| value.is_finite() && joint.kind != JointKind::Continuous);
        // 0, negative and infinite values all mean that the limit was not filled in.
        let positive = |value: Option<f64>| value.filter(|&value| value > 0.0 && value.is_finite());
        (joint.lower, joint.upper) = (position(read("lower")?), position(read("upper")?));
        (joint.effort, joint.velocity) = (positive(read("effort")?), positive(read("velocity")?));
        Ok(())
    }

    /// Returns the driving joint, multiplier, offset.
    fn mimic(&self, mimic: Node, owner: &str) -> Result<(String, f64, f64)> {
        let Some(joint) = mimic.attribute("joint").filter(|joint| !joint.is_empty()) else {
            return Err(self.source.error_at(mimic, format!("{owner}: <mimic> without joint=\"...\"")));
        };
        self.source.refuse_long(Some(mimic), "joint")?;
        let number = |entry: &str, absent: f64| Ok(self.source.number(mimic, entry, owner)?.unwrap_or(absent));
        Ok((joint.to_owned(), number("multiplier", 1.0)?, number("offset", 0.0)?))
    }

    /// Returns the pose of an `<origin>`; the identity if absent.
    fn origin(&self, origin: Option<Node>, owner: &str) -> Result<Pose> {
        let Some(origin) = origin else { return Ok(Pose::IDENTITY) };
        let position = self.source.vector::<3>(origin, "xyz", owner)?.unwrap_or_default();
        if let Some(far) = position.iter().find(|x| x.abs() > COORDINATE_BOUND) {
            let message = format!("{owner}: <origin> is {far:e} m away; at most {COORDINATE_BOUND:e}");
            return Err(self.source.error_at(origin, message));
        }
        let [roll, pitch, yaw] = self.source.vector::<3>(origin, "rpy", owner)?.unwrap_or_default();
        let rotation = match self.quaternion(origin, owner)? {
            Some([x, y, z, w]) => UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)).to_rotation_matrix(),
            None => Rotation3::from_euler_angles(roll, pitch, yaw),
        };
        Ok(Pose { rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| rotation[(i, j)])), position })
    }

    /// Returns the unit quaternion x y z w of an `<origin>`, if given.
    fn quaternion(&self, origin: Node, owner: &str) -> Result<Option<[f64; 4]>> {
        let Some(quaternion) = self.source.vector::<4>(origin, "quat_xyzw", owner)? else { return Ok(None) };
        if !self.quaternions {
            let message = format!(
                "{owner}: quat_xyzw needs <robot version=\"1.1\"> or later and would be ignored without; set the version \
                 or use rpy"
            );
            return Err(self.source.error_at(origin, message));
        }
        if origin.has_attribute("rpy") {
            return Err(self
                .source
                .error_at(origin, format!("{owner}: <origin> has both rpy and quat_xyzw; keep one")));
        }
        let norm = quaternion.iter().map(|x| x * x).sum::<f64>().sqrt();
        if !((norm - 1.0).abs() <= 1e-3) {
            let message = format!("{owner}: quat_xyzw has norm {norm}; it must be 1 within 1e-3");
            return Err(self.source.error_at(origin, message));
        }
        Ok(Some(quaternion.map(|x| x / norm)))
    }
}
