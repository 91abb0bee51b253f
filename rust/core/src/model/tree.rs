//! Tree of links and joints with one root; mimic joints are resolved.

use std::collections::HashMap;

use super::names::{SHOWN, likeliest, listed, some};
use super::parts::{Joint, Link, Mimic};
use super::urdf::text::Source;
use super::urdf::{guard, reader};
use crate::error::{Error, Position, Result};

/// Largest multiplier and offset of a mimic joint, also of a product along a chain of mimics. Larger ones could
/// overflow in the Jacobian and in gravity.
const MAX_MIMIC: f64 = 1e6;

/// All links and joints of a robot: a tree with one root, in which each mimic joint refers to its driving joint.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tree {
    /// Name of the robot.
    pub(super) name: String,
    /// Name of the file or text, for messages.
    pub(super) source_name: String,
    pub(super) links: Vec<Link>,
    pub(super) joints: Vec<Joint>,
    /// For each link, the joints of which it is the parent (indices into `joints`), in the order of the file.
    pub(super) children: Vec<Vec<usize>>,
    /// Index of the link without a parent joint.
    pub(super) root: usize,
}

impl Tree {
    /// Reads a URDF text, resolves names and checks that the links form one tree.
    pub(super) fn read(source: &Source) -> Result<Self> {
        let document = source.parse()?;
        let checked = guard::check(source, &document)?;
        let robot = reader::parse(source, &checked)?;
        let link_index: HashMap<&str, usize> =
            robot.links.iter().enumerate().map(|(i, link)| (link.name.as_str(), i)).collect();
        let mut links = Vec::with_capacity(robot.links.len());
        for (link, &node) in robot.links.iter().zip(&checked.links) {
            let inertial = reader::inertial(source, node, link)?;
            links.push(Link { name: link.name.clone(), parent_joint: None, inertial });
        }
        let mut children = vec![Vec::new(); links.len()];
        let mut joints = Vec::with_capacity(robot.joints.len());
        for (j, (raw, &node)) in robot.joints.iter().zip(&checked.joints).enumerate() {
            let error = |message: String| source.error_at(node, message);
            let find = |what: &str, name: &str| {
                link_index.get(name).copied().ok_or_else(|| {
                    let links = listed(&links, |link| &link.name, name);
                    error(format!("joint '{}': {what} link '{name}' does not exist; links: {links}", raw.name))
                })
            };
            let (parent, child) = (find("parent", &raw.parent.link)?, find("child", &raw.child.link)?);
            if parent == child {
                return Err(error(format!("joint '{}': link '{}' is its own parent", raw.name, raw.parent.link)));
            }
            if let Some(other) = links[child].parent_joint {
                let other: &Joint = &joints[other];
                return Err(error(format!(
                    "link '{}' has two parents: joint '{}' and joint '{}'; a robot must be a tree",
                    raw.child.link, other.name, raw.name
                )));
            }
            links[child].parent_joint = Some(j);
            children[parent].push(j);
            joints.push(reader::joint(source, node, raw, [parent, child])?);
        }
        let source_name = source.name().to_owned();
        let mut tree = Self { name: robot.name, source_name, links, joints, children, root: 0 };
        tree.root = tree.find_root(|link| source.at(checked.links[link].range().start))?;
        tree.resolve_mimics(&robot.joints)?;
        Ok(tree)
    }

    /// Returns the root, the only link without a parent; an error if there are several or a link is not reachable from
    /// it.
    fn find_root(&self, position: impl Fn(usize) -> Position) -> Result<usize> {
        let roots: Vec<usize> = (0..self.links.len()).filter(|&l| self.links[l].parent_joint.is_none()).collect();
        let [root] = roots[..] else {
            if let Some(&second) = roots.get(1) {
                let names = some(roots.iter().map(|&l| self.links[l].name.as_str()));
                let message = format!("{} links have no parent joint ({names}); a robot has one root", roots.len());
                return Err(self.error(position(second), message));
            }
            return Err(self.error(
                Position(None),
                "every link has a parent joint, so the joints form a loop; a robot has one root",
            ));
        };
        let mut reached = vec![false; self.links.len()];
        let mut stack = vec![root];
        while let Some(link) = stack.pop() {
            reached[link] = true;
            stack.extend(self.children[link].iter().map(|&j| self.joints[j].child));
        }
        if let Some(lost) = reached.iter().position(|&r| !r) {
            let message = format!(
                "link '{}' is not connected to the root '{}': its parents form a loop",
                self.links[lost].name, self.links[root].name
            );
            return Err(self.error(position(lost), message));
        }
        Ok(root)
    }

    /// Sets the mimic parameters of each joint; a chain of mimics is reduced to the joint that drives all of it.
    fn resolve_mimics(&mut self, raw: &[urdf_rs::Joint]) -> Result<()> {
        let index: HashMap<&str, usize> = raw.iter().enumerate().map(|(j, joint)| (joint.name.as_str(), j)).collect();
        // First the direct mimic parameters, so that chains can be followed by index.
        let mut direct: Vec<Option<Mimic>> = vec![None; raw.len()];
        for (j, raw) in raw.iter().enumerate() {
            let Some(mimic) = raw.mimic.as_ref().filter(|_| self.joints[j].kind.is_actuated()) else { continue };
            let (leader, multiplier) = (&mimic.joint, mimic.multiplier.unwrap_or(1.0));
            let Some(&joint) = index.get(leader.as_str()) else {
                let joints = listed(&self.joints, |joint| &joint.name, leader);
                return Err(self.joint_error(j, format!("mimics '{leader}', which does not exist; joints: {joints}")));
            };
            if multiplier.abs() < 1e-9 {
                return Err(self.joint_error(
                    j,
                    format!("mimics '{leader}' with multiplier {multiplier}; make the joint fixed instead"),
                ));
            }
            direct[j] = Some(Mimic { joint, multiplier, offset: mimic.offset.unwrap_or(0.0) });
        }
        // A joint is resolved before the joints that mimic it, so that each is visited once, also in long chains.
        let mut resolved: Vec<Option<Mimic>> = vec![None; raw.len()];
        for start in 0..direct.len() {
            let mut waiting = Vec::new();
            let mut j = start;
            while let (Some(mimic), None) = (direct[j], resolved[j]) {
                if waiting.len() > direct.len() {
                    let message = format!(
                        "is in a ring of mimics that leads back to '{}'; one joint must lead",
                        self.joints[j].name
                    );
                    return Err(self.joint_error(start, message));
                }
                waiting.push(j);
                j = mimic.joint;
            }
            while let Some(j) = waiting.pop() {
                resolved[j] = direct[j].map(|mimic| match resolved[mimic.joint] {
                    Some(leader) => Mimic {
                        joint: leader.joint,
                        multiplier: mimic.multiplier * leader.multiplier,
                        offset: mimic.multiplier * leader.offset + mimic.offset,
                    },
                    None => mimic,
                });
            }
        }
        for (j, mimic) in resolved.into_iter().enumerate() {
            if let Some(Mimic { joint, multiplier, offset }) = mimic
                && ![multiplier, offset].iter().all(|number| number.abs() <= MAX_MIMIC)
            {
                let message = format!(
                    "mimics '{}' with multiplier {multiplier:?} and offset {offset:?}; each must be at most {MAX_MIMIC}",
                    self.joints[joint].name
                );
                return Err(self.joint_error(j, message));
            }
            self.joints[j].mimic = mimic;
        }
        Ok(())
    }

    /// Returns the parent of a link; `None` for the root.
    pub(super) fn parent_link(&self, link: usize) -> Option<usize> {
        self.links[link].parent_joint.map(|j| self.joints[j].parent)
    }

    /// Returns the joints from the link `top` down to its descendant `bottom`.
    pub(super) fn joints_between(&self, top: usize, bottom: usize) -> Vec<usize> {
        let (mut joints, mut link) = (Vec::new(), bottom);
        while link != top {
            let Some(joint) = self.links[link].parent_joint else { break };
            joints.push(joint);
            link = self.joints[joint].parent;
        }
        joints.reverse();
        joints
    }

    /// Returns the index of the link of this name.
    pub(super) fn frame(&self, name: &str) -> Result<usize> {
        self.links.iter().position(|link| link.name == name).ok_or_else(|| {
            let available = likeliest(self.links.iter().map(|link| link.name.as_str()).collect(), name);
            let available = available.into_iter().take(SHOWN).map(str::to_owned).collect();
            Error::FrameNotFound { frame: name.to_owned(), available }
        })
    }

    pub(super) fn error(&self, at: Position, message: impl Into<String>) -> Error {
        Error::Urdf { source_name: self.source_name.clone(), at, message: message.into() }
    }

    /// Creates an error about a joint, with its position in the file.
    pub(super) fn joint_error(&self, j: usize, message: impl std::fmt::Display) -> Error {
        self.error(self.joints[j].at, format!("joint '{}' {message}", self.joints[j].name))
    }
}
