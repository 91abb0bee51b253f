//! Kinematics: pose, Jacobian, gravity torques and mass matrix from joint positions; inverse kinematics.

use nalgebra::{DVector, Matrix6xX};

use crate::error::{Error, Result};
use crate::math::simd::{F64x8, Isa, JointVector, Kernel, LANES, ScalarVec3, SimdLevel};
use crate::model::{Chain, Model};
use crate::pose::{COORDINATE_BOUND, Pose};
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

pub(crate) mod batch;
mod forward;
mod fused;
mod gravity;
mod ik;
mod jacobian;
mod mass_matrix;
mod points;
pub(crate) mod statics;
mod targets;
pub(crate) mod velocity_filter;

pub(crate) use forward::FrameAxes;
pub use forward::JointFrames;
pub(crate) use fused::{KinematicScratch, KinematicState};
pub use gravity::GroupMasses;
pub use ik::{IkOptions, IkResult, IkStatus};
pub(crate) use jacobian::{rotated_rows, task_row, task_rows};
pub use points::{ArmGeometry, ArmPoints, MAX_POINTS};
pub(crate) use targets::{joint_targets, target_region};

/// Axes in which a Jacobian is expressed; its reference point is the tool in both cases.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Reference {
    /// Axes of the base.
    #[default]
    WorldAligned,
    /// Axes of the tool.
    Local,
}

impl Model {
    /// Returns `base_from_tool` at the joint positions `q` [rad or m].
    ///
    /// # Errors
    /// [`Error::Shape`] for a wrong length, [`Error::OutOfRange`] for an entry that is not finite or beyond 1e6.
    /// Position limits are not enforced: a real arm may be slightly outside of them.
    pub fn forward_kinematics(&self, q: &[f64]) -> Result<Pose> {
        let q = self.joint_vector(q)?;
        Ok(SimdLevel::detect().dispatch_narrow(Forward { chain: self.chain(), q: &q }))
    }

    /// Returns the geometric Jacobian (6×n) at the tool, linear rows first.
    ///
    /// # Errors
    /// As [`Model::forward_kinematics`].
    pub fn jacobian(&self, q: &[f64], reference: Reference) -> Result<Matrix6xX<f64>> {
        Ok(self.kinematics(q, reference)?.1)
    }

    /// Returns the pose `base_from_tool` and the geometric Jacobian (6×n, linear rows first), computed in one pass.
    ///
    /// # Errors
    /// As [`Model::forward_kinematics`].
    pub fn kinematics(&self, q: &[f64], reference: Reference) -> Result<(Pose, Matrix6xX<f64>)> {
        let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
        let pose = self.kinematics_into(q, reference, &mut rows)?;
        Ok((pose, Matrix6xX::from_fn(self.n(), |i, j| rows[i][j])))
    }

    /// Returns the pose `base_from_tool` and writes the Jacobian's rows into the caller's array; allocates nothing.
    /// Columns after `n` are undefined.
    ///
    /// # Errors
    /// As [`Model::forward_kinematics`].
    pub fn kinematics_into(&self, q: &[f64], reference: Reference, rows: &mut Rows) -> Result<Pose> {
        Ok(self.chain().pose_and_rows(SimdLevel::detect(), &self.joint_vector(q)?, reference, rows))
    }

    /// Returns the torque of each joint [N·m or N] that holds the arm and its payload at rest at `q`.
    ///
    /// # Errors
    /// As [`Model::forward_kinematics`].
    pub fn gravity(&self, q: &[f64]) -> Result<DVector<f64>> {
        let (q, masses) = (self.joint_vector(q)?, self.chain().masses(self.payload()));
        let gravity = self.gravity_vector();
        let statics = Statics { chain: self.chain(), masses: &masses, gravity: &gravity, q: &q, rows: None };
        let torque = SimdLevel::detect().dispatch_narrow(statics);
        Ok(DVector::from_fn(self.n(), |i, _| torque[i]))
    }

    /// Checks joint positions and pads them to the fixed array size of the control step.
    ///
    /// # Errors
    /// As [`Model::forward_kinematics`].
    pub fn joint_vector(&self, q: &[f64]) -> Result<JointVec> {
        if q.len() != self.n() {
            return Err(Error::length("q", q.len(), self.n()));
        }
        let mut out = [0.0; MAX_JOINTS];
        for (i, (slot, &value)) in out.iter_mut().zip(q).enumerate() {
            if !(value.abs() <= COORDINATE_BOUND) {
                let name = &self.joint_names()[i];
                return Err(Error::out_of_range(format!("q[{i}] ({name})"), value, format!("±{COORDINATE_BOUND:e}")));
            }
            *slot = value;
        }
        Ok(out)
    }
}

impl Chain {
    /// Returns the pose of the tool and writes the rows of the Jacobian; arguments as [`Model::kinematics_into`], with
    /// valid positions.
    pub(crate) fn pose_and_rows(&self, level: SimdLevel, q: &JointVec, reference: Reference, rows: &mut Rows) -> Pose {
        level.dispatch_narrow(Kinematics { chain: self, q, reference, rows })
    }

    /// Returns true for a simple chain (see [`Chain::simple`]) of at most eight joints.
    const fn fits_f64x8(&self) -> bool {
        self.simple && self.n <= LANES
    }
}

/// Inputs for the pose of the tool at one configuration.
struct Forward<'a> {
    chain: &'a Chain,
    q: &'a JointVec,
}

impl Kernel for Forward<'_> {
    type Output = Pose;

    #[inline(always)]
    fn run<M: Isa>(self) -> Pose {
        if self.chain.fits_f64x8() {
            let q = <M::F64x8 as JointVector>::load(self.q);
            let joint_trigs = self.chain.joint_trigs_simd::<M::F64x8, LANES>(q);
            self.chain.forward_pass::<<M::F64x8 as F64x8>::Vec3, LANES, false>(&joint_trigs, &mut ())
        } else {
            self.chain.forward_pass::<ScalarVec3<M::Elem>, MAX_JOINTS, true>(
                &self.chain.joint_trigs::<M::Elem>(self.q, self.chain.path),
                &mut (),
            )
        }
    }
}

/// Inputs for the gravity torques at one configuration; also computes the Jacobian in base axes if `rows` is given.
pub(crate) struct Statics<'a> {
    pub(crate) chain: &'a Chain,
    pub(crate) masses: &'a GroupMasses,
    pub(crate) gravity: &'a [f64; 3],
    pub(crate) q: &'a JointVec,
    pub(crate) rows: Option<&'a mut Rows>,
}

impl Kernel for Statics<'_> {
    /// Torques that hold the arm [N·m], bit-identical to those of a batch.
    type Output = JointVec;

    #[inline(always)]
    fn run<M: Isa>(self) -> JointVec {
        let (mut frames, mut torque) = (JointFrames::default(), [0.0; MAX_JOINTS]);
        self.chain.forward_one::<M::F64x8>(self.q, &mut frames);
        if let Some(rows) = self.rows {
            self.chain.jacobian_by::<M::Elem>(&frames, rows);
        }
        self.chain.gravity_by::<M::Elem>(&frames, self.masses, self.gravity, &mut torque);
        torque
    }
}

/// Inputs and output rows for the pose and the Jacobian at one configuration.
struct Kinematics<'a> {
    chain: &'a Chain,
    q: &'a JointVec,
    reference: Reference,
    rows: &'a mut Rows,
}

impl Kernel for Kinematics<'_> {
    type Output = Pose;

    #[inline(always)]
    fn run<M: Isa>(self) -> Pose {
        let pose = if self.chain.fits_f64x8() {
            self.chain.pose_and_jacobian::<M::F64x8>(self.q, self.rows)
        } else {
            self.chain.kinematics_by::<M::Elem>(self.q, self.rows)
        };
        if self.reference == Reference::Local {
            jacobian::rotate_to_tool::<M::Elem>(&pose.rotation, self.rows, self.chain.n);
        }
        pose
    }
}
