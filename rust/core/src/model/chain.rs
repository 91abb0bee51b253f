//! Base → tip of a tree, and every body it carries, as constant arrays for the hot path.

use std::collections::BTreeMap;

use nalgebra::{Rotation3, Translation3, Unit, Vector3};

use super::names::{listed, some};
use super::tree::{Joint, JointKind, Tree};
use super::ModelOptions;
use crate::error::{Error, Result};
use crate::pose::{COORDINATE_BOUND, Pose};
use crate::{JointVec, MAX_JOINTS};

/// Rigid transform of the set-up code.
type Transform = nalgebra::IsometryMatrix3<f64>;

/// One kinematic chain with every body it carries; what the hot path reads.
///
/// Moving joints are numbered base → tip; behind them stand joints beside the path that follow one of its coordinates.
/// Frames are turned once, when the robot is read, so that every joint moves about or along its own z and the rotation
/// from one joint to the next is a tilt about x followed by the joint's own angle.
#[derive(Debug, Clone, PartialEq)]
pub struct Chain {
    /// Independent coordinates.
    pub(crate) n: usize,
    /// Moving joints between base and tip.
    pub(crate) path: usize,
    /// Moving joints in all.
    pub(crate) total: usize,
    /// Frame before the first joint, in the base.
    pub(crate) base: Pose,
    /// Tool in the frame of the last joint of the path.
    pub(crate) tool: Pose,
    /// Whether joint k is driven by coordinate k, for every k: no joint follows another.
    pub(crate) direct: bool,
    /// Coordinate that drives each joint.
    pub(crate) driver: [usize; MAX_JOINTS],
    /// Moving joint that carries each joint; `MAX_JOINTS`: the base.
    pub(crate) parent: [usize; MAX_JOINTS],
    /// Turn about z of the parent's frame before the tilt; the identity on the path.
    pub(crate) turn: [[[f64; 3]; 3]; MAX_JOINTS],
    /// Origin of each joint in its parent's frame [m].
    pub(crate) offset: [[f64; 3]; MAX_JOINTS],
    /// Sine and cosine of the tilt about x.
    pub(crate) tilt: [(f64, f64); MAX_JOINTS],
    /// Joint angle = `angle_per_q · q + angle_offset`; 0 and a constant for prismatic joints.
    pub(crate) angle_per_q: JointVec,
    pub(crate) angle_offset: JointVec,
    /// Joint travel = `slide_per_q · q + slide_offset`; 0 and 0 for revolute joints.
    pub(crate) slide_per_q: JointVec,
    pub(crate) slide_offset: JointVec,
    /// Mass of the rigid group behind each joint [kg], without payload.
    pub(crate) mass: JointVec,
    /// Mass times centre of mass of that group [kg·m], in the frame after the joint.
    pub(crate) moment: [[f64; 3]; MAX_JOINTS],
}

/// The chain, and what of it a user sees by name.
pub(super) struct Assembly {
    pub(super) chain: Chain,
    /// Joint (index into the tree) that each coordinate is.
    pub(super) coordinates: Vec<usize>,
    /// Coordinates that move a rigid group without any mass.
    pub(super) massless: Vec<usize>,
    /// Largest distance of the tool from the first joint's origin [m].
    pub(super) reach: f64,
}

/// What a joint of the tree does once base, tip and locks are chosen.
#[derive(Clone, Copy)]
enum Role {
    /// Stays at this value.
    Still(f64),
    /// Follows a coordinate: `multiplier · q + offset`.
    Moves { coordinate: usize, multiplier: f64, offset: f64 },
}

/// A moving joint before its frame is turned.
struct Slot {
    joint: usize,
    parent: Option<usize>,
    /// Frame before the joint in the frame after its parent joint; z is the axis in both.
    before: Transform,
    coordinate: usize,
    multiplier: f64,
    offset: f64,
}

impl Chain {
    /// Number of independent coordinates.
    pub const fn n(&self) -> usize {
        self.n
    }
}

/// Chooses the coordinates, locks the rest and turns the frames.
pub(super) fn assemble(tree: &mut Tree, base: usize, tip: usize, options: &ModelOptions) -> Result<Assembly> {
    let (anchor, above_base) = anchor(tree, base, tip);
    let path = tree.joints_between(anchor, tip);
    let roles = roles(tree, &path, &options.locked)?;
    let coordinates = roles.coordinates;

    // From the anchor up to the base: rigid, or the base would move with the arm.
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
    Ok(turn_frames(tree, &bodies, coordinates))
}

struct Roles {
    of: Vec<Role>,
    coordinates: Vec<usize>,
}

/// Deepest link above both `base` and `tip`, and the joints from `base` up to it.
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

/// Which joints move, and with which coordinate.
fn roles(tree: &mut Tree, path: &[usize], locked: &BTreeMap<String, f64>) -> Result<Roles> {
    let mut fixed_at: Vec<Option<f64>> = vec![None; tree.joints.len()];
    for (name, &value) in locked {
        fixed_at[lockable(tree, name, value)?] = Some(value);
    }

    let mut coordinates: Vec<usize> = Vec::new();
    let mut index = vec![None; tree.joints.len()];
    let mut moving = 0;
    for &j in path {
        let joint = &tree.joints[j];
        if joint.kind == JointKind::Fixed {
            continue;
        }
        if joint.kind == JointKind::Other {
            return Err(tree.joint_error(j, format!(
                "is of type '{}', which has no single coordinate; between base and tip only revolute, continuous, \
                 prismatic and fixed joints can be controlled: choose a base below it, or replace it",
                joint.type_name
            )));
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
            index[driver] = Some(coordinates.len());
            coordinates.push(driver);
        }
    }
    if coordinates.is_empty() {
        return Err(Error::config(
            "tip",
            format!(
                "no joint between base and tip can move; choose another base or tip, frames: {}",
                some(tree.links.iter().map(|link| link.name.as_str()))
            ),
        ));
    }
    if moving > MAX_JOINTS || coordinates.len() > MAX_JOINTS {
        return Err(Error::config(
            "tip",
            format!("{moving} moving joints between base and tip, at most {MAX_JOINTS}; lock some of them or choose a nearer tip"),
        ));
    }

    let mut of = Vec::with_capacity(tree.joints.len());
    for j in 0..tree.joints.len() {
        let joint = &tree.joints[j];
        let (driver, multiplier, offset) = joint.mimic.map_or((j, 1.0, 0.0), |m| (m.joint, m.multiplier, m.offset));
        of.push(match index[driver] {
            Some(coordinate) if joint.kind.is_actuated() => Role::Moves { coordinate, multiplier, offset },
            _ if !joint.kind.is_actuated() => Role::Still(0.0),
            _ => {
                let at = fixed_at[driver].unwrap_or_else(|| tree.joints[driver].resting_value());
                Role::Still(multiplier * at + offset)
            }
        });
    }
    for (joint, role) in tree.joints.iter_mut().zip(&of) {
        match *role {
            Role::Moves { coordinate, .. } => joint.q_index = Some(coordinate),
            Role::Still(value) if joint.kind.is_actuated() => joint.locked_at = Some(value),
            Role::Still(_) => {}
        }
    }
    Ok(Roles { of, coordinates })
}

/// Index of a joint that may be locked at this value.
fn lockable(tree: &Tree, name: &str, value: f64) -> Result<usize> {
    let key = || format!("locked.{name}");
    let Some(j) = tree.joints.iter().position(|joint| joint.name == name) else {
        return Err(Error::config(key(), format!("no joint of that name; joints: {}", listed(&tree.joints, |joint| &joint.name, name))));
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
        return Err(Error::limit(key(), value, format!("[{lower}, {upper}], the limits of this joint")));
    }
    Ok(j)
}

/// Pose of a joint's child link in its parent link, at this value.
fn step(joint: &Joint, value: f64) -> Transform {
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

/// Rotation that takes z to the joint's axis.
fn z_to_axis(joint: &Joint) -> Transform {
    let axis = Vector3::from(joint.axis);
    let rotation = Rotation3::rotation_between(&Vector3::z(), &axis)
        .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    Transform::from_parts(Translation3::identity(), rotation)
}

fn transform(pose: &Pose) -> Transform {
    let rotation = nalgebra::Matrix3::from_fn(|i, j| pose.rotation[i][j]);
    Transform::from_parts(Translation3::from(pose.position), Rotation3::from_matrix_unchecked(rotation))
}

fn pose(transform: &Transform) -> Pose {
    let rotation = transform.rotation.matrix();
    Pose {
        rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| rotation[(i, j)])),
        position: transform.translation.vector.into(),
    }
}

/// Moving joints and the bodies between them, frames not yet turned.
struct Bodies {
    slots: Vec<Slot>,
    path: usize,
    base: Transform,
    tool: Transform,
    mass: Vec<f64>,
    moment: Vec<Vector3<f64>>,
}

/// Walks the subtree of `anchor`: the path first, then all that hangs on it.
fn collect(tree: &Tree, anchor: usize, base: Transform, path: &[usize], roles: &[Role]) -> Result<Bodies> {
    let mut bodies = Bodies { slots: Vec::new(), path: 0, base, tool: Transform::identity(), mass: Vec::new(), moment: Vec::new() };
    // Slot that carries each path joint's child; joints of the path keep their slots in the second walk.
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
    /// Crosses joint `j`: the slot that carries its child, and the child's pose in that slot's frame.
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
        let (coordinate, multiplier, offset) = match role {
            Role::Still(value) => return Ok((slot, here * step(joint, value))),
            Role::Moves { coordinate, multiplier, offset } => (coordinate, multiplier, offset),
        };
        let turned = z_to_axis(joint);
        let known = slot_of.get(&j).copied();
        let own = known.unwrap_or(self.slots.len());
        if known.is_none() {
            if own == MAX_JOINTS {
                return Err(Error::config(
                    "tip",
                    format!(
                        "more than {MAX_JOINTS} moving joints: those that follow a joint of the chain by mimic count too; \
                         lock the joint that they follow, e.g. '{}'",
                        joint.mimic.map_or(&joint.name, |m| &tree.joints[m.joint].name)
                    ),
                ));
            }
            slot_of.insert(j, own);
            let before = here * transform(&joint.origin) * turned;
            self.slots.push(Slot { joint: j, parent: slot, before, coordinate, multiplier, offset });
            self.mass.push(0.0);
            self.moment.push(Vector3::zeros());
        }
        Ok((Some(own), turned.inverse()))
    }
}

/// `F = Rz(a) · Rx(tilt) · Rz(c)`.
struct Zxz {
    a: f64,
    tilt: (f64, f64),
    c: f64,
}

/// Where the tilt is almost 0 or π, `a` is arbitrary; `c` is taken from what `a` and the tilt leave, so that the product
/// is `F` to rounding in every case.
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

/// Turns every frame about its z so that the next joint's rotation begins with a tilt about x.
fn turn_frames(tree: &Tree, bodies: &Bodies, coordinates: Vec<usize>) -> Assembly {
    let forms: Vec<Zxz> = bodies.slots.iter().map(|slot| zxz(&slot.before.rotation)).collect();
    let on_path = bodies.path.min(MAX_JOINTS);
    // The turn of a frame is the `a` of the joint that follows on the path.
    let turn_after = |k: usize| if k + 1 < on_path { forms[k + 1].a } else { 0.0 };
    let base_turn = forms.first().map_or(0.0, |form| form.a);

    let mut base = bodies.base;
    base.rotation *= z_turn(base_turn);
    let mut chain = Chain {
        n: coordinates.len(),
        path: on_path,
        total: bodies.slots.len().min(MAX_JOINTS),
        base: pose(&base),
        tool: pose(&bodies.tool),
        direct: bodies.slots.iter().enumerate().all(|(k, slot)| slot.coordinate == k),
        driver: [0; MAX_JOINTS],
        parent: [MAX_JOINTS; MAX_JOINTS],
        turn: [Pose::IDENTITY.rotation; MAX_JOINTS],
        offset: [[0.0; 3]; MAX_JOINTS],
        tilt: [(0.0, 1.0); MAX_JOINTS],
        angle_per_q: [0.0; MAX_JOINTS],
        angle_offset: [0.0; MAX_JOINTS],
        slide_per_q: [0.0; MAX_JOINTS],
        slide_offset: [0.0; MAX_JOINTS],
        mass: [0.0; MAX_JOINTS],
        moment: [[0.0; 3]; MAX_JOINTS],
    };
    let mut reach = bodies.tool.translation.vector.norm();
    for (k, (slot, form)) in bodies.slots.iter().zip(&forms).enumerate().take(MAX_JOINTS) {
        let joint = &tree.joints[slot.joint];
        chain.driver[k] = slot.coordinate;
        chain.parent[k] = slot.parent.unwrap_or(MAX_JOINTS);
        chain.offset[k] = (z_turn(-form.a) * slot.before.translation.vector).into();
        chain.tilt[k] = form.tilt;
        if k >= on_path {
            let parent_turn = slot.parent.map_or(base_turn, turn_after);
            chain.turn[k] = pose(&Transform::from_parts(Translation3::identity(), z_turn(form.a - parent_turn))).rotation;
        }
        chain.angle_offset[k] = form.c + turn_after(k);
        if joint.kind == JointKind::Prismatic {
            chain.slide_per_q[k] = slot.multiplier;
            chain.slide_offset[k] = slot.offset;
        } else {
            chain.angle_per_q[k] = slot.multiplier;
            chain.angle_offset[k] += slot.offset;
        }
        chain.mass[k] = bodies.mass[k];
        chain.moment[k] = (z_turn(-turn_after(k)) * bodies.moment[k]).into();
        if k < on_path {
            reach += travel(tree, slot, coordinates[slot.coordinate]);
            reach += if k > 0 { slot.before.translation.vector.norm() } else { 0.0 };
        }
    }
    let massless = (0..chain.n).filter(|&c| group_mass(bodies, c, coordinates[c]) <= 0.0).collect();
    Assembly { chain, coordinates, massless, reach }
}

/// Farthest that a prismatic joint slides [m]; 0 for others and where no limit is known.
fn travel(tree: &Tree, slot: &Slot, driver: usize) -> f64 {
    if tree.joints[slot.joint].kind != JointKind::Prismatic {
        return 0.0;
    }
    let end = |limit: Option<f64>| limit.map_or(0.0, |q| (slot.multiplier * q + slot.offset).abs());
    end(tree.joints[driver].lower).max(end(tree.joints[driver].upper))
}

/// Mass of the group that a coordinate's own joint moves [kg]; where that joint carries nothing of the arm, of its
/// first follower's.
fn group_mass(bodies: &Bodies, coordinate: usize, driver: usize) -> f64 {
    let own = bodies.slots.iter().position(|slot| slot.joint == driver);
    let slot = own.or_else(|| bodies.slots.iter().position(|slot| slot.coordinate == coordinate));
    slot.map_or(0.0, |slot| bodies.mass[slot])
}
