//! Kinematic chain from base to tip with all bodies that it carries, as constant arrays for the control step.

use nalgebra::{Rotation3, Translation3, Vector3};

use super::ModelOptions;
use super::bodies::{Bodies, Slot, Transform, collect, pose, step};
use super::parts::JointKind;
use super::roles::{Role, roles};
use super::tree::Tree;
use crate::error::{Error, Result};
use crate::math::simd::PaddedVec3;
use crate::pose::Pose;
use crate::{JointVec, MAX_JOINTS};

/// One kinematic chain with all bodies that it carries, in the form that the control step uses.
///
/// The moving joints of the chain are numbered from base to tip. After them come mimic joints outside the chain, each
/// driven by one of its joints. When the robot is read, every frame is rotated so that its joint moves about or along
/// z; the rotation between successive joints is then a constant twist about x followed by the joint angle about z.
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    /// Number of independent joints, the length of q.
    pub(crate) n: usize,
    /// Number of moving joints between base and tip.
    pub(crate) path: usize,
    /// Total number of moving joints, including those beside the path.
    pub(crate) total: usize,
    /// Pose in the base of the frame before the first joint.
    pub(crate) base: Pose,
    /// Axes and origin of [`Chain::base`], each padded to a vector register.
    pub(crate) base_cells: [PaddedVec3; 4],
    /// Pose of the tool in the frame after the last joint of the path.
    pub(crate) tool: Pose,
    /// Index in q of the independent joint that drives each joint.
    pub(crate) driver: [usize; MAX_JOINTS],
    /// Index of the moving joint that carries each joint; `MAX_JOINTS` for the base.
    pub(crate) parent: [usize; MAX_JOINTS],
    /// Rotation about z that precedes the tilt of each joint; the identity on the path.
    pub(crate) turn: [[[f64; 3]; 3]; MAX_JOINTS],
    /// Origin of each joint in its parent's frame [m].
    pub(crate) offset: [[f64; 3]; MAX_JOINTS],
    /// Sine and cosine of the tilt about x that precedes each joint.
    pub(crate) tilt: [(f64, f64); MAX_JOINTS],
    /// Angle of each joint per unit of q; 0 for prismatic joints.
    pub(crate) angle_per_q: JointVec,
    /// Angle of each joint at q = 0 [rad]; the constant angle of a prismatic joint.
    pub(crate) angle_offset: JointVec,
    /// Displacement of each joint per unit of q; 0 for revolute joints.
    pub(crate) slide_per_q: JointVec,
    /// Displacement of each joint at q = 0 [m]; 0 for revolute joints.
    pub(crate) slide_offset: JointVec,
    /// True for prismatic joints.
    pub(crate) slides: [bool; MAX_JOINTS],
    /// True if every joint i of the path rotates and is at the angle `q[i]` plus a constant.
    pub(crate) simple: bool,
    /// Mass of the rigid group after each joint [kg], without payload.
    pub(crate) mass: JointVec,
    /// Mass times centre of mass of the rigid group after each joint [kg·m], in the frame after the joint.
    pub(crate) moment: [[f64; 3]; MAX_JOINTS],
}

/// A chain, and the properties that [`Model`](super::Model) stores beside it.
pub(super) struct Assembly {
    pub(super) chain: Chain,
    /// Indices in the tree of the independent joints, in the order of q.
    pub(super) independent: Vec<usize>,
    /// Indices in q of the independent joints that move a rigid group without mass.
    pub(super) massless: Vec<usize>,
    /// Upper bound on the distance of the tool from the first joint's origin [m].
    pub(super) reach: f64,
}

impl Chain {
    /// Returns the number of independent joints.
    pub const fn n(&self) -> usize {
        self.n
    }
}

/// Builds the chain from `base` to `tip`: chooses the independent joints, locks the others and rotates the frames.
pub(super) fn assemble(tree: &mut Tree, base: usize, tip: usize, options: &ModelOptions) -> Result<Assembly> {
    let (anchor, above_base) = anchor(tree, base, tip);
    let path = tree.joints_between(anchor, tip);
    let roles = roles(tree, &path, &options.locked)?;
    let independent = roles.independent;

    // All joints between anchor and base must be fixed, otherwise the base would move with the arm.
    let mut anchor_from_base = Transform::identity();
    for &joint in &above_base {
        let Role::Still(value) = roles.of[joint] else {
            return Err(Error::config(
                "base",
                format!(
                    "'{}' is not rigidly fixed to '{}', where the chain to '{}' starts: joint '{}' moves between them; \
                     choose a base above it",
                    tree.links[base].name, tree.links[anchor].name, tree.links[tip].name, tree.joints[joint].name
                ),
            ));
        };
        anchor_from_base = step(&tree.joints[joint], value) * anchor_from_base;
    }
    let base_from_anchor = anchor_from_base.inverse();

    let bodies = collect(tree, anchor, base_from_anchor, &path, &roles.of)?;
    Ok(turn_frames(tree, &bodies, independent))
}

/// Returns the deepest common ancestor of the links `base` and `tip`, and the joints from `base` up to it.
fn anchor(tree: &Tree, base: usize, tip: usize) -> (usize, Vec<usize>) {
    let mut above_tip = vec![false; tree.links.len()];
    let mut link = Some(tip);
    while let Some(l) = link {
        above_tip[l] = true;
        link = tree.parent_link(l);
    }
    let (mut joints, mut link) = (Vec::new(), base);
    while !above_tip[link] {
        let Some(joint) = tree.links[link].parent_joint else { break };
        joints.push(joint);
        link = tree.joints[joint].parent;
    }
    (link, joints)
}

/// Angles [rad] of a rotation `F = Rz(a) · Rx(tilt) · Rz(c)`; the tilt as sine and cosine.
struct Zxz {
    a: f64,
    tilt: (f64, f64),
    c: f64,
}

/// Decomposes a rotation F. If the tilt is almost 0 or π, `a` is arbitrary and set to 0. `c` is computed from the
/// rotation that remains after `a` and the tilt, so that the product is F up to rounding in every case.
fn zxz(rotation: &Rotation3<f64>) -> Zxz {
    let f = rotation.matrix();
    let sine = f[(0, 2)].hypot(f[(1, 2)]);
    let length = sine.hypot(f[(2, 2)]);
    let tilt = (sine / length, f[(2, 2)] / length);
    let a = if sine < 1e-12 { 0.0 } else { f[(0, 2)].atan2(-f[(1, 2)]) };
    let first = z_turn(a) * Rotation3::from_axis_angle(&Vector3::x_axis(), tilt.0.atan2(tilt.1));
    let rest = first.inverse() * rotation;
    Zxz { a, tilt, c: rest[(1, 0)].atan2(rest[(0, 0)]) }
}

fn z_turn(angle: f64) -> Rotation3<f64> {
    Rotation3::from_axis_angle(&Vector3::z_axis(), angle)
}

/// Fills the arrays of the chain, with every frame rotated about its z axis so that only a tilt about x lies between it
/// and the next joint.
fn turn_frames(tree: &Tree, bodies: &Bodies, independent: Vec<usize>) -> Assembly {
    let forms: Vec<Zxz> = bodies.slots.iter().map(|slot| zxz(&slot.before.rotation)).collect();
    let on_path = bodies.path.min(MAX_JOINTS);
    // A frame is rotated by the `a` of the next joint on the path.
    let turn_after = |k: usize| if k + 1 < on_path { forms[k + 1].a } else { 0.0 };
    let base_turn = forms.first().map_or(0.0, |form| form.a);

    let mut base = bodies.base;
    base.rotation *= z_turn(base_turn);
    let mut chain = Chain {
        n: independent.len(),
        path: on_path,
        total: bodies.slots.len().min(MAX_JOINTS),
        base: pose(&base),
        base_cells: cells(&pose(&base)),
        tool: pose(&bodies.tool),
        driver: [0; MAX_JOINTS],
        parent: [MAX_JOINTS; MAX_JOINTS],
        turn: [Pose::IDENTITY.rotation; MAX_JOINTS],
        offset: [[0.0; 3]; MAX_JOINTS],
        tilt: [(0.0, 1.0); MAX_JOINTS],
        angle_per_q: [0.0; MAX_JOINTS],
        angle_offset: [0.0; MAX_JOINTS],
        slide_per_q: [0.0; MAX_JOINTS],
        slide_offset: [0.0; MAX_JOINTS],
        slides: [false; MAX_JOINTS],
        simple: on_path == independent.len(),
        mass: [0.0; MAX_JOINTS],
        moment: [[0.0; 3]; MAX_JOINTS],
    };
    let mut reach = bodies.tool.translation.vector.norm();
    for (k, (slot, form)) in bodies.slots.iter().zip(&forms).enumerate().take(MAX_JOINTS) {
        let joint = &tree.joints[slot.joint];
        chain.driver[k] = slot.q_index;
        chain.parent[k] = slot.parent.unwrap_or(MAX_JOINTS);
        chain.offset[k] = (z_turn(-form.a) * slot.before.translation.vector).into();
        chain.tilt[k] = form.tilt;
        if k >= on_path {
            let parent_turn = slot.parent.map_or(base_turn, turn_after);
            chain.turn[k] =
                pose(&Transform::from_parts(Translation3::identity(), z_turn(form.a - parent_turn))).rotation;
        }
        chain.angle_offset[k] = form.c + turn_after(k);
        if joint.kind == JointKind::Prismatic {
            chain.slide_per_q[k] = slot.multiplier;
            chain.slide_offset[k] = slot.offset;
            chain.slides[k] = true;
        } else {
            chain.angle_per_q[k] = slot.multiplier;
            chain.angle_offset[k] += slot.offset;
        }
        chain.mass[k] = bodies.mass[k];
        chain.moment[k] = (z_turn(-turn_after(k)) * bodies.moment[k]).into();
        if k < on_path {
            chain.simple &= slot.q_index == k && chain.angle_per_q[k].to_bits() == 1.0_f64.to_bits();
            reach += travel(tree, slot, independent[slot.q_index]);
            reach += if k > 0 { slot.before.translation.vector.norm() } else { 0.0 };
        }
    }
    let massless = (0..chain.n).filter(|&i| group_mass(bodies, i, independent[i]) <= 0.0).collect();
    Assembly { chain, independent, massless, reach }
}

/// Returns the axes of a frame, the columns of its rotation, then its origin.
fn cells(frame: &Pose) -> [PaddedVec3; 4] {
    let (r, p) = (&frame.rotation, &frame.position);
    let axis = |i: usize| [r[0][i], r[1][i], r[2][i], 0.0];
    [axis(0), axis(1), axis(2), [p[0], p[1], p[2], 0.0]]
}

/// Returns the largest displacement of a prismatic joint [m]; 0 for other joints and for unknown limits.
fn travel(tree: &Tree, slot: &Slot, driver: usize) -> f64 {
    if tree.joints[slot.joint].kind != JointKind::Prismatic {
        return 0.0;
    }
    let end = |limit: Option<f64>| limit.map_or(0.0, |q| (slot.multiplier * q + slot.offset).abs());
    end(tree.joints[driver].lower).max(end(tree.joints[driver].upper))
}

/// Returns the mass [kg] of the rigid group after the joint `driver`; if that joint does not carry a part of the arm,
/// of the group after the first joint that mimics it.
fn group_mass(bodies: &Bodies, q_index: usize, driver: usize) -> f64 {
    let driving_slot = bodies.slots.iter().position(|slot| slot.joint == driver);
    let slot = driving_slot.or_else(|| bodies.slots.iter().position(|slot| slot.q_index == q_index));
    slot.map_or(0.0, |slot| bodies.mass[slot])
}
