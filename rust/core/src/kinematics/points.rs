//! Positions, Jacobians and effective masses of points of the arm (joint origins and tool), and its mass matrix.

use nalgebra::{Matrix3, Rotation3, Unit, Vector3};

use crate::error::{Error, Result};
use crate::model::{Joint, JointKind, Model};
use crate::pose::Pose;
use crate::{JointVec, MAX_JOINTS};

/// Maximum number of points: one per joint between base and tip, and the tool.
pub const MAX_POINTS: usize = MAX_JOINTS + 1;

/// Speed [m/s] below which a point counts as at rest: the direction of its velocity would be rounding error.
const MIN_SPEED: f64 = 1e-9;

/// Geometry of a moving joint between base and tip.
#[derive(Debug, Clone)]
struct PathJoint {
    /// Index in q of the independent joint that drives this joint (itself, or by mimic).
    q_index: usize,
    prismatic: bool,
    /// Joint motion per motion of the independent joint; 1 for a joint that is not a mimic.
    multiplier: f64,
    /// Joint value at position 0 of the independent joint [rad or m].
    offset: f64,
    axis: Unit<Vector3<f64>>,
    /// Rotation part of the fixed transform to the frame that the previous joint moves.
    rotation: Matrix3<f64>,
    /// Translation part of the fixed transform to the frame that the previous joint moves [m].
    translation: Vector3<f64>,
}

impl PathJoint {
    /// Returns the linear and angular velocity of a point [m/s, rad/s] at unit speed of the independent joint.
    fn motion(&self, axis: &Vector3<f64>, origin: &Vector3<f64>, point: &Vector3<f64>) -> [Vector3<f64>; 2] {
        let [linear, angular] =
            if self.prismatic { [*axis, Vector3::zeros()] } else { [axis.cross(&(point - origin)), *axis] };
        [linear * self.multiplier, angular * self.multiplier]
    }
}

/// All links between one moving joint and the next as one body, in the frame that the joint moves.
#[derive(Debug, Clone, Default)]
struct RigidBody {
    /// Mass [kg].
    mass: f64,
    /// Centre of mass [m].
    com: Vector3<f64>,
    /// Inertia about the centre of mass [kg·m²].
    inertia: Matrix3<f64>,
}

impl RigidBody {
    /// Merges another body into this one, by the parallel-axis theorem.
    fn add(&mut self, part: &Self) {
        let mass = self.mass + part.mass;
        if mass <= 0.0 {
            return;
        }
        let com = (self.com * self.mass + part.com * part.mass) / mass;
        *self = Self { mass, com, inertia: self.inertia_about(&com) + part.inertia_about(&com) };
    }

    fn inertia_about(&self, point: &Vector3<f64>) -> Matrix3<f64> {
        let arm = self.com - point;
        self.inertia + (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose()) * self.mass
    }
}

/// Joint origins and tool of an arm, with the rigid bodies between them.
///
/// Joints outside the chain are fixed at the values at which the model locks them. The payload is a point mass in the
/// last body.
#[derive(Debug, Clone)]
pub struct ArmPoints {
    n: usize,
    joints: Vec<PathJoint>,
    /// Rigid body between each joint and the next.
    bodies: Vec<RigidBody>,
    /// Position of the tool in the frame that the last joint moves [m].
    tool: Vector3<f64>,
    /// Rotor inertia at each joint [kg·m²].
    armature: JointVec,
}

impl ArmPoints {
    /// Creates the points of a model: the joints between base and tip, and the tool.
    ///
    /// `armature` is the rotor inertia of the servo at each of the n joints [kg·m²].
    ///
    /// # Errors
    /// [`Error::Shape`] if `armature` does not have n entries.
    pub fn new(model: &Model, armature: &[f64]) -> Result<Self> {
        let n = model.n();
        if armature.len() != n {
            return Err(Error::length("armature", armature.len(), n));
        }
        let mut rotors = [0.0; MAX_JOINTS];
        rotors[..n].copy_from_slice(armature);

        let mut points = Self { n, joints: Vec::new(), bodies: Vec::new(), tool: Vector3::zeros(), armature: rotors };
        let mut moved_by = vec![None; model.links().len()];
        let mut fixed = Frame::identity();
        for j in path(model) {
            let joint = &model.joints()[j];
            let Some(q_index) = joint.q_index else {
                fixed = fixed.then(&Frame::of_fixed_joint(model, joint));
                continue;
            };
            let before = fixed.then(&Frame::from(&joint.origin));
            let (multiplier, offset) = joint.mimic.map_or((1.0, 0.0), |mimic| (mimic.multiplier, mimic.offset));
            moved_by[joint.child] = Some(points.joints.len());
            points.joints.push(PathJoint {
                q_index,
                prismatic: joint.kind == JointKind::Prismatic,
                multiplier,
                offset,
                axis: Unit::new_unchecked(joint.axis.into()),
                rotation: before.rotation,
                translation: before.translation,
            });
            fixed = Frame::identity();
        }
        points.tool = fixed.translation;
        points.bodies = rigid_bodies(model, &moved_by, points.joints.len(), &fixed);
        Ok(points)
    }

    /// Computes positions, Jacobians and mass matrix at q [rad or m]; entries beyond n are ignored.
    pub fn evaluate(&self, q: &JointVec) -> ArmGeometry {
        let mut out = ArmGeometry {
            n: self.n,
            points: self.joints.len() + 1,
            position: [[0.0; 3]; MAX_POINTS],
            jacobian: [[[0.0; MAX_JOINTS]; 3]; MAX_POINTS],
            inertia: [[0.0; MAX_JOINTS]; MAX_JOINTS],
        };
        for (i, rotor) in self.armature.iter().enumerate() {
            out.inertia[i][i] = *rotor;
        }
        let (mut origins, mut axes) = ([Vector3::zeros(); MAX_JOINTS], [Vector3::zeros(); MAX_JOINTS]);
        let (mut p, mut turn) = (Vector3::zeros(), Matrix3::identity());
        for (k, (joint, body)) in self.joints.iter().zip(&self.bodies).enumerate() {
            p += turn * joint.translation;
            turn *= joint.rotation;
            let value = joint.multiplier * q[joint.q_index] + joint.offset;
            axes[k] = turn * joint.axis.into_inner();
            if joint.prismatic {
                p += axes[k] * value;
            } else {
                turn *= Rotation3::from_axis_angle(&joint.axis, value).into_inner();
            }
            origins[k] = p;
            self.write_point(k, &p, &origins, &axes, &mut out);
            self.add_body(k, body, &(p + turn * body.com), &turn, &origins, &axes, &mut out.inertia);
        }
        self.write_point(self.joints.len(), &(p + turn * self.tool), &origins, &axes, &mut out);
        out
    }

    /// Stores position and Jacobian of point `k`, which the joints up to and including joint `k` move.
    fn write_point(
        &self,
        k: usize,
        point: &Vector3<f64>,
        origins: &[Vector3<f64>; MAX_JOINTS],
        axes: &[Vector3<f64>; MAX_JOINTS],
        out: &mut ArmGeometry,
    ) {
        out.position[k] = (*point).into();
        for (j, joint) in self.joints.iter().enumerate().take(k + 1) {
            let [linear, _] = joint.motion(&axes[j], &origins[j], point);
            for (row, speed) in out.jacobian[k].iter_mut().zip(&linear) {
                row[joint.q_index] += speed;
            }
        }
    }

    /// Adds `m J_vᵀ J_v + J_ωᵀ I J_ω` of the body after joint `k` to the mass matrix; `com` is the body's centre of
    /// mass and `turn` its rotation, in base axes.
    #[expect(clippy::too_many_arguments, reason = "state of one forward pass")]
    fn add_body(
        &self,
        k: usize,
        body: &RigidBody,
        com: &Vector3<f64>,
        turn: &Matrix3<f64>,
        origins: &[Vector3<f64>; MAX_JOINTS],
        axes: &[Vector3<f64>; MAX_JOINTS],
        inertia: &mut [JointVec; MAX_JOINTS],
    ) {
        let about_com = turn * body.inertia * turn.transpose();
        let mut motions = [[Vector3::zeros(); 2]; MAX_JOINTS];
        for (j, joint) in self.joints.iter().enumerate().take(k + 1) {
            let [linear, angular] = joint.motion(&axes[j], &origins[j], com);
            motions[joint.q_index][0] += linear;
            motions[joint.q_index][1] += angular;
        }
        let motions = &motions[..self.n];
        for (row, [linear, angular]) in inertia.iter_mut().zip(motions) {
            let (momentum, spin) = (linear * body.mass, about_com * angular);
            for (entry, [other, turning]) in row.iter_mut().zip(motions) {
                *entry += momentum.dot(other) + spin.dot(turning);
            }
        }
    }
}

/// Positions and Jacobians of the points, base to tip, and the mass matrix of the arm, in one configuration.
#[derive(Debug, Clone)]
pub struct ArmGeometry {
    n: usize,
    points: usize,
    position: [[f64; 3]; MAX_POINTS],
    jacobian: [[JointVec; 3]; MAX_POINTS],
    inertia: [JointVec; MAX_JOINTS],
}

impl ArmGeometry {
    /// Returns the positions of the joint origins and, last, of the tool, in base axes [m].
    pub fn position(&self) -> &[[f64; 3]] {
        &self.position[..self.points]
    }

    /// Returns the linear Jacobians of the points [m/rad], in base axes; columns beyond n are 0.
    pub fn jacobian(&self) -> &[[JointVec; 3]] {
        &self.jacobian[..self.points]
    }

    /// Returns the mass matrix including the rotors (n rows) [kg·m²]; columns beyond n are 0.
    pub fn inertia(&self) -> &[JointVec] {
        &self.inertia[..self.n]
    }

    /// Returns the velocities of the points [m/s] for joint velocities u [rad/s]; entries after the last point are 0.
    pub fn velocity(&self, u: &JointVec) -> [[f64; 3]; MAX_POINTS] {
        self.jacobian.map(|rows| rows.map(|row| dot(&row, u)))
    }

    /// Returns the largest speed of any point [m/s] for joint velocities u [rad/s].
    pub fn max_speed(&self, u: &JointVec) -> f64 {
        self.velocity(u).iter().map(norm).fold(0.0, f64::max)
    }

    /// Returns the kinetic energy [J] for joint velocities u [rad/s].
    pub fn energy(&self, u: &JointVec) -> f64 {
        0.5 * self.inertia.iter().zip(u).map(|(row, speed)| dot(row, u) * speed).sum::<f64>()
    }

    /// Returns the effective mass [kg] of each point along its own velocity [m/s]: `1 / (dᵀ J M⁻¹ Jᵀ d)` with d the
    /// direction of the velocity (Khatib 1995); 0 for a point at rest. M includes a point mass `load` at the tool [kg].
    pub fn effective_mass(&self, velocity: &[[f64; 3]; MAX_POINTS], load: f64) -> [f64; MAX_POINTS] {
        let factor = self.cholesky(load);
        let mut mass = [0.0; MAX_POINTS];
        for ((mass, v), rows) in mass.iter_mut().zip(velocity).zip(&self.jacobian) {
            let speed = norm(v);
            if speed > MIN_SPEED {
                let mut row: JointVec =
                    std::array::from_fn(|i| (v[0] * rows[0][i] + v[1] * rows[1][i] + v[2] * rows[2][i]) / speed);
                // |L⁻¹ r|² by forward substitution.
                let mut mobility = 0.0;
                for i in 0..self.n {
                    let known: f64 = (0..i).map(|k| factor[i][k] * row[k]).sum();
                    row[i] = (row[i] - known) / factor[i][i];
                    mobility += row[i] * row[i];
                }
                *mass = 1.0 / mobility.max(1e-9);
            }
        }
        mass
    }

    /// Returns, for each joint, the absolute vertical displacement per joint motion [m/rad] of the lowest point that
    /// the joint moves. `up` is a unit vector in base axes.
    pub fn lowest_lever(&self, up: &[f64; 3]) -> JointVec {
        let mut lever = [0.0; MAX_JOINTS];
        let mut lowest = [f64::INFINITY; MAX_JOINTS];
        for (position, rows) in self.position().iter().zip(&self.jacobian) {
            let height = dot3(up, position);
            for i in 0..self.n {
                let column = [rows[0][i], rows[1][i], rows[2][i]];
                if dot3(&column, &column) > 1e-12 && height < lowest[i] {
                    (lowest[i], lever[i]) = (height, dot3(up, &column).abs());
                }
            }
        }
        lever
    }

    /// Returns the height of the tool along `up`, a unit vector in base axes, above the base's origin [m].
    pub fn tool_height(&self, up: &[f64; 3]) -> f64 {
        dot3(up, &self.position[self.points - 1])
    }

    /// Returns the rise of the tool along `up`, a unit vector in base axes, per joint motion [m/rad].
    pub fn tool_rise(&self, up: &[f64; 3]) -> JointVec {
        let rows = &self.jacobian[self.points - 1];
        std::array::from_fn(|i| up[0] * rows[0][i] + up[1] * rows[1][i] + up[2] * rows[2][i])
    }

    /// Returns the lower triangular factor L of the mass matrix, M = L Lᵀ; the pivot of a joint without inertia is tiny
    /// but positive. M includes a point mass `load` at the tool [kg].
    fn cholesky(&self, load: f64) -> [JointVec; MAX_JOINTS] {
        let tool = &self.jacobian[self.points - 1];
        let mut factor = [[0.0; MAX_JOINTS]; MAX_JOINTS];
        for i in 0..self.n {
            for j in 0..=i {
                let known: f64 = (0..j).map(|k| factor[i][k] * factor[j][k]).sum();
                let added: f64 = tool.iter().map(|row| row[i] * row[j]).sum();
                let left = self.inertia[i][j] + load * added - known;
                factor[i][j] = if i == j { left.max(1e-15).sqrt() } else { left / factor[j][j] };
            }
        }
        factor
    }
}

/// A rigid transform.
#[derive(Debug, Clone)]
struct Frame {
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

impl Frame {
    fn identity() -> Self {
        Self { rotation: Matrix3::identity(), translation: Vector3::zeros() }
    }

    fn then(&self, other: &Self) -> Self {
        Self {
            rotation: self.rotation * other.rotation,
            translation: self.rotation * other.translation + self.translation,
        }
    }

    /// Returns the pose of the child link in the parent link, for a joint that does not move with the chain.
    fn of_fixed_joint(model: &Model, joint: &Joint) -> Self {
        let value = joint.mimic.map_or(joint.locked_at.unwrap_or(0.0), |mimic| {
            mimic.offset + mimic.multiplier * model.joints()[mimic.joint].locked_at.unwrap_or(0.0)
        });
        let axis = Unit::new_unchecked(Vector3::from(joint.axis));
        let displacement = match joint.kind {
            JointKind::Prismatic => Self { translation: axis.into_inner() * value, ..Self::identity() },
            JointKind::Revolute | JointKind::Continuous => {
                Self { rotation: Rotation3::from_axis_angle(&axis, value).into_inner(), ..Self::identity() }
            }
            JointKind::Fixed | JointKind::Other => Self::identity(),
        };
        Self::from(&joint.origin).then(&displacement)
    }
}

impl From<&Pose> for Frame {
    fn from(pose: &Pose) -> Self {
        Self { rotation: Matrix3::from_fn(|i, j| pose.rotation[i][j]), translation: pose.position.into() }
    }
}

/// Returns the indices of the joints from base to tip, fixed joints included.
fn path(model: &Model) -> Vec<usize> {
    let mut path = Vec::new();
    let mut link = model.links().iter().find(|link| link.name == model.tip());
    while let Some(joint) = link.filter(|link| link.name != model.base()).and_then(|link| link.parent_joint) {
        path.push(joint);
        link = model.links().get(model.joints()[joint].parent);
    }
    path.reverse();
    path
}

/// Returns the rigid body after each moving joint between base and tip; `tool` is the tool's pose in the last body.
fn rigid_bodies(model: &Model, moved_by: &[Option<usize>], count: usize, tool: &Frame) -> Vec<RigidBody> {
    let mut bodies = vec![RigidBody::default(); count];
    for (index, link) in model.links().iter().enumerate() {
        let Some(inertial) = &link.inertial else { continue };
        let Some((body, frame)) = carrying_joint(model, moved_by, index) else { continue };
        let turn = frame.rotation * Matrix3::from_fn(|i, j| inertial.rotation[i][j]);
        let inertia = Matrix3::from_fn(|i, j| inertial.inertia[i][j]);
        bodies[body].add(&RigidBody {
            mass: inertial.mass,
            com: frame.rotation * Vector3::from(inertial.com) + frame.translation,
            inertia: turn * inertia * turn.transpose(),
        });
    }
    if let (Some(payload), Some(last)) = (model.payload(), bodies.last_mut()) {
        let com = tool.rotation * Vector3::from(payload.com) + tool.translation;
        last.add(&RigidBody { mass: payload.mass, com, inertia: Matrix3::zeros() });
    }
    bodies
}

/// Returns the joint between base and tip that moves a link, and the link's pose in that joint's frame; `None` if the
/// link does not move relative to the base.
fn carrying_joint(model: &Model, moved_by: &[Option<usize>], link: usize) -> Option<(usize, Frame)> {
    let (mut link, mut frame) = (link, Frame::identity());
    loop {
        if let Some(joint) = moved_by[link] {
            return Some((joint, frame));
        }
        let joint = &model.joints()[model.links()[link].parent_joint?];
        frame = Frame::of_fixed_joint(model, joint).then(&frame);
        link = joint.parent;
    }
}

fn dot(a: &JointVec, b: &JointVec) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn dot3(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn norm(v: &[f64; 3]) -> f64 {
    dot3(v, v).sqrt()
}
