//! Tree of links and joints with one root, mimics resolved.

use std::collections::HashMap;

use super::names::{SHOWN, likeliest, listed, some};
use super::parts::{Joint, Link, Mimic};
use super::text::Source;
use super::urdf::Robot;
use crate::error::{Error, Position, Result};

/// All links and joints; a tree with one root, mimics resolved.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tree {
    pub(super) name: String,
    pub(super) source_name: String,
    pub(super) links: Vec<Link>,
    pub(super) joints: Vec<Joint>,
    /// Joints below each link, in the file's order.
    pub(super) children: Vec<Vec<usize>>,
    pub(super) root: usize,
}

impl Tree {
    /// Resolves names and checks that the links form one tree.
    pub(super) fn build(source: &Source, robot: Robot) -> Result<Self> {
        let link_index: HashMap<String, usize> =
            robot.links.iter().enumerate().map(|(i, link)| (link.name.clone(), i)).collect();
        let positions: Vec<Position> = robot.links.iter().map(|link| link.at).collect();
        let mut links: Vec<Link> = robot
            .links
            .into_iter()
            .map(|link| Link { name: link.name, parent_joint: None, inertial: link.inertial })
            .collect();
        let mut children = vec![Vec::new(); links.len()];
        let mut joints = Vec::with_capacity(robot.joints.len());
        let mut mimics = Vec::with_capacity(robot.joints.len());
        for (j, raw) in robot.joints.into_iter().enumerate() {
            let find = |what: &str, name: &str| {
                link_index.get(name).copied().ok_or_else(|| {
                    let links = listed(&links, |link| &link.name, name);
                    source.error(
                        raw.at,
                        format!("joint '{}': {what} link '{name}' does not exist; links: {links}", raw.name),
                    )
                })
            };
            let (parent, child) = (find("parent", &raw.parent)?, find("child", &raw.child)?);
            if parent == child {
                let message = format!("joint '{}': link '{}' is its own parent", raw.name, raw.parent);
                return Err(source.error(raw.at, message));
            }
            if let Some(other) = links[child].parent_joint {
                let other: &Joint = &joints[other];
                let message = format!(
                    "link '{}' has two parents: joint '{}' and joint '{}'; a robot must be a tree",
                    raw.child, other.name, raw.name
                );
                return Err(source.error(raw.at, message));
            }
            if let (Some(lower), Some(upper)) = (raw.lower, raw.upper)
                && lower > upper
            {
                let message = format!("joint '{}': lower limit {lower} is above upper limit {upper}", raw.name);
                return Err(source.error(raw.at, message));
            }
            links[child].parent_joint = Some(j);
            children[parent].push(j);
            mimics.push(raw.mimic.clone().filter(|_| raw.kind.is_actuated()));
            joints.push(Joint {
                name: raw.name,
                kind: raw.kind,
                type_name: raw.type_name,
                parent,
                child,
                origin: raw.origin,
                axis: raw.axis,
                lower: raw.lower,
                upper: raw.upper,
                velocity: raw.velocity,
                effort: raw.effort,
                damping: raw.damping,
                friction: raw.friction,
                mimic: None,
                q_index: None,
                locked_at: None,
                at: raw.at,
            });
        }
        let mut tree =
            Self { name: robot.name, source_name: source.name().to_owned(), links, joints, children, root: 0 };
        tree.root = tree.find_root(&positions)?;
        tree.resolve_mimics(&mimics)?;
        Ok(tree)
    }

    /// Returns the only link without a parent, from which every link must be reachable.
    fn find_root(&self, positions: &[Position]) -> Result<usize> {
        let roots: Vec<usize> = (0..self.links.len()).filter(|&l| self.links[l].parent_joint.is_none()).collect();
        let [root] = roots[..] else {
            if let Some(&second) = roots.get(1) {
                let names = some(roots.iter().map(|&l| self.links[l].name.as_str()));
                let message = format!("{} links have no parent joint ({names}); a robot has one root", roots.len());
                return Err(self.error(positions[second], message));
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
            return Err(self.error(positions[lost], message));
        }
        Ok(root)
    }

    /// Resolves chains of mimic joints to their driving joint.
    fn resolve_mimics(&mut self, raw: &[Option<(String, f64, f64)>]) -> Result<()> {
        let index: HashMap<String, usize> =
            self.joints.iter().enumerate().map(|(j, joint)| (joint.name.clone(), j)).collect();
        // Direct drivers first, so that a chain can be followed by index.
        let mut direct: Vec<Option<Mimic>> = vec![None; raw.len()];
        for (j, entry) in raw.iter().enumerate() {
            let Some((leader, multiplier, offset)) = entry else { continue };
            let Some(&joint) = index.get(leader) else {
                let joints = listed(&self.joints, |joint| &joint.name, leader);
                return Err(self.joint_error(j, format!("mimics '{leader}', which does not exist; joints: {joints}")));
            };
            if multiplier.abs() < 1e-9 {
                return Err(self.joint_error(
                    j,
                    format!("mimics '{leader}' with multiplier {multiplier}; make the joint fixed instead"),
                ));
            }
            direct[j] = Some(Mimic { joint, multiplier: *multiplier, offset: *offset });
        }
        // A driver is resolved before its followers: each joint is visited once, however long the chains are.
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
                resolved[j] = direct[j].map(|own| match resolved[own.joint] {
                    Some(leader) => Mimic {
                        joint: leader.joint,
                        multiplier: own.multiplier * leader.multiplier,
                        offset: own.multiplier * leader.offset + own.offset,
                    },
                    None => own,
                });
            }
        }
        for (joint, mimic) in self.joints.iter_mut().zip(resolved) {
            joint.mimic = mimic;
        }
        Ok(())
    }

    /// Link above a link.
    pub(super) fn parent_link(&self, link: usize) -> Option<usize> {
        self.links[link].parent_joint.map(|j| self.joints[j].parent)
    }

    /// Joints from `top` down to `bottom`, which is below it.
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

    /// Index of a link by name.
    pub(super) fn frame(&self, name: &str) -> Result<usize> {
        self.links.iter().position(|link| link.name == name).ok_or_else(|| {
            // Most similar name first, at most one screenful.
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
