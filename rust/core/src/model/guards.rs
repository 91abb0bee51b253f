//! What the URDF reader swallows or drops: checked on the XML tree, where absence and position can still be seen.
//!
//! Every number is checked to be one, whole vectors included; names are unique; what is absent is noted as absent. The
//! text that goes on to the reader holds links, inertials and joints alone: what it cannot see cannot break it.

use std::collections::HashMap;

use roxmltree::Node;

use super::text::{MAX_LINKS, Source, shortened};
use crate::error::{Position, Result};
use crate::pose::COORDINATE_BOUND;

/// What the tree says about one `<link>`.
#[derive(Debug, Clone)]
pub(super) struct LinkFacts {
    pub(super) name: String,
    pub(super) at: Position,
    pub(super) inertial: bool,
    /// Rotation of the inertial's origin where it is given as a quaternion, x y z w, unit.
    pub(super) quaternion: Option<[f64; 4]>,
}

/// What the tree says about one `<joint>`.
#[derive(Debug, Clone, Default)]
pub(super) struct JointFacts {
    pub(super) name: String,
    pub(super) at: Position,
    pub(super) type_name: String,
    /// Numbers that are there, and finite.
    pub(super) lower: Option<f64>,
    pub(super) upper: Option<f64>,
    pub(super) damping: Option<f64>,
    pub(super) friction: Option<f64>,
    pub(super) quaternion: Option<[f64; 4]>,
}

/// A checked text: what it says, and the part of it that the reader needs.
#[derive(Debug)]
pub(super) struct Checked {
    pub(super) links: Vec<LinkFacts>,
    pub(super) joints: Vec<JointFacts>,
    pub(super) text: String,
}

const JOINT_TYPES: [&str; 7] = ["revolute", "continuous", "prismatic", "fixed", "floating", "planar", "spherical"];
const JOINT_PARTS: [&str; 7] = ["origin", "parent", "child", "axis", "limit", "mimic", "dynamics"];
const INERTIAL_PARTS: [&str; 3] = ["origin", "mass", "inertia"];
const INERTIA: [&str; 6] = ["ixx", "ixy", "ixz", "iyy", "iyz", "izz"];

/// Runs every check that needs the text.
pub(super) fn check(source: &Source, text: &str) -> Result<Checked> {
    let document = source.parse()?;
    let root = document.root_element();
    let mut guard = Guard { source, text, quaternions: quaternions_allowed(root), edits: Vec::new() };
    if let Some(version) = root.attribute_node("version") {
        // From 1.2 on the reader fills in infinities for what is absent; without the version it leaves it alone.
        guard.edits.push((version.range().start, version.range().end, ""));
    }

    let (mut links, mut joints) = (Vec::new(), Vec::new());
    for child in guard.keep(root, &["link", "joint"]) {
        if child.tag_name().name() == "link" {
            if links.len() == MAX_LINKS {
                return Err(source.error_at(child, format!("more than {MAX_LINKS} links")));
            }
            links.push(guard.link(child)?);
        } else {
            if joints.len() == MAX_LINKS {
                return Err(source.error_at(child, format!("more than {MAX_LINKS} joints")));
            }
            joints.push(guard.joint(child)?);
        }
    }
    unique(source, "link", links.iter().map(|l| (l.name.as_str(), l.at)))?;
    unique(source, "joint", joints.iter().map(|j| (j.name.as_str(), j.at)))?;
    if links.is_empty() {
        return Err(source.error_at(root, "the robot has no links"));
    }
    let text = guard.edited(root.range());
    Ok(Checked { links, joints, text })
}

/// URDF 1.1 brought `quat_xyzw`; a file that names no version, or only "1", is 1.0.
fn quaternions_allowed(root: Node) -> bool {
    let version = root.attribute("version").and_then(|v| v.trim().split_once('.'));
    let number = version.and_then(|(major, minor)| Some((major.parse::<u32>().ok()?, minor.parse::<u32>().ok()?)));
    number.is_some_and(|number| number >= (1, 1))
}

fn unique<'a>(source: &Source, what: &str, names: impl Iterator<Item = (&'a str, Position)>) -> Result<()> {
    let mut seen: HashMap<&str, Position> = HashMap::new();
    for (name, at) in names {
        if let Some(Position(first)) = seen.insert(name, at) {
            let line = first.map_or(String::new(), |(line, _)| format!(", first in line {line}"));
            return Err(source.error(at, format!("two {what}s are named '{name}'{line}; names must be unique")));
        }
    }
    Ok(())
}

struct Guard<'a> {
    source: &'a Source<'a>,
    text: &'a str,
    quaternions: bool,
    /// Byte ranges to replace, in order of their start within each element.
    edits: Vec<(usize, usize, &'static str)>,
}

impl Guard<'_> {
    /// Child elements of these names; everything else inside `parent` is cut from the text.
    fn keep<'n, 'i>(&mut self, parent: Node<'n, 'i>, names: &[&str]) -> Vec<Node<'n, 'i>> {
        let mut kept = Vec::new();
        for child in parent.children() {
            let same_space = child.tag_name().namespace() == parent.tag_name().namespace();
            if child.is_element() && same_space && names.contains(&child.tag_name().name()) {
                kept.push(child);
            } else {
                self.edits.push((child.range().start, child.range().end, ""));
            }
        }
        kept
    }

    /// At most one child of each name, in the order of `names`.
    fn parts<'n, 'i, const N: usize>(
        &mut self,
        parent: Node<'n, 'i>,
        names: &[&str; N],
        owner: &str,
    ) -> Result<[Option<Node<'n, 'i>>; N]> {
        let mut parts = [None; N];
        for child in self.keep(parent, names) {
            let name = child.tag_name().name();
            for (part, _) in parts.iter_mut().zip(names).filter(|(_, n)| **n == name) {
                if part.replace(child).is_some() {
                    return Err(self
                        .source
                        .error_at(child, format!("{owner}: a second <{name}>; at most one is allowed")));
                }
            }
            self.keep(child, &[]);
        }
        Ok(parts)
    }

    fn link(&mut self, node: Node) -> Result<LinkFacts> {
        let name = self.source.named(node, "link")?;
        let owner = format!("link '{name}'");
        let at = self.source.at(node.range().start);
        let inertials = self.keep(node, &["inertial"]);
        let Some((&inertial, more)) = inertials.split_first() else {
            return Ok(LinkFacts { name, at, inertial: false, quaternion: None });
        };
        if let Some(&second) = more.first() {
            return Err(self.source.error_at(second, format!("{owner}: a second <inertial>; at most one is allowed")));
        }
        let [origin, mass, inertia] = self.parts(inertial, &INERTIAL_PARTS, &owner)?;
        let quaternion = self.origin(origin, &owner)?;
        let Some(mass) = mass else {
            return Err(self.source.error_at(inertial, format!("{owner}: <inertial> without <mass value=\"...\"/>")));
        };
        let kilograms = self.source.required(mass, "value", &owner)?;
        if !(0.0..=COORDINATE_BOUND).contains(&kilograms) {
            let message = format!("{owner}: mass is {kilograms} kg; it must be between 0 and {COORDINATE_BOUND:e}");
            return Err(self.source.error_at(mass, message));
        }
        let Some(inertia) = inertia else {
            let message = format!(
                "{owner}: <inertial> without <inertia ixx=... ixy=... ixz=... iyy=... iyz=... izz=.../>; leave <inertial> \
                 out for a massless link"
            );
            return Err(self.source.error_at(inertial, message));
        };
        for entry in INERTIA {
            self.source.required(inertia, entry, &owner)?;
        }
        Ok(LinkFacts { name, at, inertial: true, quaternion })
    }

    fn joint(&mut self, node: Node) -> Result<JointFacts> {
        let name = self.source.named(node, "joint")?;
        let owner = format!("joint '{name}'");
        let at = self.source.at(node.range().start);
        let type_name = node.attribute("type").unwrap_or_default().to_owned();
        if !JOINT_TYPES.contains(&type_name.as_str()) {
            let message = format!(
                "{owner}: type is '{}'; it must be one of {}",
                shortened(&type_name, 40),
                JOINT_TYPES.join(", ")
            );
            return Err(self.source.error_at(node, message));
        }
        let [origin, parent, child, axis, limit, mimic, dynamics] = self.parts(node, &JOINT_PARTS, &owner)?;
        for (part, what) in [(parent, "parent"), (child, "child")] {
            let named = part.and_then(|part| part.attribute("link")).is_some_and(|link| !link.is_empty());
            if !named {
                return Err(self.source.error_at(node, format!("{owner}: <{what} link=\"...\"/> is missing")));
            }
            self.source.refuse_long(part, "link")?;
        }
        let quaternion = self.origin(origin, &owner)?;
        if let Some(axis) = axis {
            self.axis(axis, &owner, &type_name)?;
        }
        let mut facts = JointFacts { name, at, type_name, quaternion, ..JointFacts::default() };
        if let Some(limit) = limit {
            self.limit(limit, &owner, &mut facts)?;
        }
        if let Some(mimic) = mimic {
            if mimic.attribute("joint").is_none_or(str::is_empty) {
                return Err(self.source.error_at(mimic, format!("{owner}: <mimic> without joint=\"...\"")));
            }
            self.source.refuse_long(Some(mimic), "joint")?;
            self.source.number(mimic, "multiplier", &owner)?;
            self.source.number(mimic, "offset", &owner)?;
        }
        if let Some(dynamics) = dynamics {
            for (entry, present) in [("damping", &mut facts.damping), ("friction", &mut facts.friction)] {
                if let Some(value) = self.source.number(dynamics, entry, &owner)? {
                    if value < 0.0 {
                        let message = format!("{owner}: {entry} is {value}; it must be 0 or more");
                        return Err(self.source.error_at(dynamics, message));
                    }
                    *present = Some(value);
                }
            }
        }
        Ok(facts)
    }

    fn axis(&self, axis: Node, owner: &str, type_name: &str) -> Result<()> {
        let Some(xyz) = self.source.vector::<3>(axis, "xyz", owner)? else {
            let message = format!("{owner}: <axis> without xyz=\"...\"; leave <axis> out for \"1 0 0\"");
            return Err(self.source.error_at(axis, message));
        };
        let length = xyz[0].hypot(xyz[1]).hypot(xyz[2]);
        let turns = ["revolute", "continuous", "prismatic"].contains(&type_name);
        if turns && !(1e-6..=COORDINATE_BOUND).contains(&length) {
            let message =
                format!("{owner}: axis {xyz:?} has length {length:e}; it must point somewhere, e.g. \"0 0 1\"");
            return Err(self.source.error_at(axis, message));
        }
        Ok(())
    }

    fn limit(&mut self, limit: Node, owner: &str, facts: &mut JointFacts) -> Result<()> {
        for (entry, present) in [("lower", &mut facts.lower), ("upper", &mut facts.upper)] {
            *present = self.source.number_or_infinite(limit, entry, owner)?.filter(|value| value.is_finite());
        }
        self.source.number_or_infinite(limit, "effort", owner)?;
        if self.source.number_or_infinite(limit, "velocity", owner)?.is_none() {
            // The reader demands it; many real files leave it out.
            let start = limit.range().start;
            let name = self.text.get(start..).and_then(|tag| tag.find([' ', '\t', '\r', '\n', '/', '>']));
            let end = start + name.unwrap_or(0);
            self.edits.push((end, end, " velocity=\"inf\""));
        }
        Ok(())
    }

    /// Checks an `<origin>`; its quaternion, if it has one.
    fn origin(&self, origin: Option<Node>, owner: &str) -> Result<Option<[f64; 4]>> {
        let Some(origin) = origin else { return Ok(None) };
        if let Some(xyz) = self.source.vector::<3>(origin, "xyz", owner)?
            && let Some(far) = xyz.iter().find(|x| x.abs() > COORDINATE_BOUND)
        {
            let message = format!("{owner}: <origin> is {far:e} m away; at most {COORDINATE_BOUND:e}");
            return Err(self.source.error_at(origin, message));
        }
        self.source.vector::<3>(origin, "rpy", owner)?;
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

    /// The text of `range` after all edits.
    fn edited(&mut self, range: std::ops::Range<usize>) -> String {
        self.edits.sort_unstable();
        let mut text = String::with_capacity(range.len());
        let mut from = range.start;
        for &(start, end, replacement) in &self.edits {
            text.push_str(self.text.get(from..start).unwrap_or_default());
            text.push_str(replacement);
            from = end;
        }
        text.push_str(self.text.get(from..range.end).unwrap_or_default());
        text
    }
}
