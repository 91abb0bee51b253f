//! URDF text → links and joints as in the file.

use std::collections::HashMap;

use roxmltree::Node;

use super::elements::{Reader, children};
use super::parts::{Inertial, JointKind};
use super::text::{MAX_LINKS, Source};
use crate::error::{Position, Result};
use crate::pose::Pose;

/// A robot as in the file, names not yet resolved.
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
    /// Driving joint, multiplier, offset.
    pub(super) mimic: Option<(String, f64, f64)>,
}

/// Checks and parses a text.
pub(super) fn read(source: &Source) -> Result<Robot> {
    let document = source.parse()?;
    let root = document.root_element();
    let reader = Reader { source, quaternions: quaternions_allowed(root) };
    let (mut links, mut joints) = (Vec::new(), Vec::new());
    for child in children(root, &["link", "joint"]) {
        let (what, count) =
            if child.tag_name().name() == "link" { ("links", links.len()) } else { ("joints", joints.len()) };
        if count == MAX_LINKS {
            return Err(source.error_at(child, format!("more than {MAX_LINKS} {what}")));
        }
        if what == "links" {
            links.push(reader.link(child)?);
        } else {
            joints.push(reader.joint(child)?);
        }
    }
    unique(source, "link", links.iter().map(|l| (l.name.as_str(), l.at)))?;
    unique(source, "joint", joints.iter().map(|j| (j.name.as_str(), j.at)))?;
    if links.is_empty() {
        return Err(source.error_at(root, "the robot has no links"));
    }
    Ok(Robot { name: root.attribute("name").unwrap_or_default().to_owned(), links, joints })
}

/// URDF 1.1 added `quat_xyzw`; a file without a version, or with version "1", is 1.0.
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
