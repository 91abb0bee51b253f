//! Tool pose, Jacobian and gravity torques for the control step, computed together. After the forward pass, each SIMD
//! lane computes one joint.

use super::forward::{FrameAxes, JointFrames, Visitor, transform_point};
use super::gravity::GroupMasses;
use crate::math::rows::load_rows;
use crate::math::simd::{JointVector, LANES, PaddedVec3, StoreVec3, Vec3Ops};
use crate::math::spatial::{Vec3, cross, dot, splat, sub};
use crate::model::Chain;
use crate::pose::Pose;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Tool pose, Jacobian and gravity torques of one configuration.
#[derive(Clone, Copy)]
pub(crate) struct KinematicState<J: JointVector> {
    /// Frame of the tool.
    pub(crate) frame: FrameAxes<J::Vec3>,
    /// Pose of the tool, `base_from_tool`.
    pub(crate) tool: Pose,
    /// Geometric Jacobian at the tool, in base axes (6 × n).
    pub(crate) j_base: [J; MAX_AXES],
    /// Torques that hold the arm against gravity [N·m]; 0 if they were not requested.
    pub(crate) holding: J,
}

/// Scratch memory of [`Chain::evaluate`]; contains no results.
#[derive(Debug, Clone)]
pub(crate) struct KinematicScratch {
    simple: SimpleScratch,
    frames: JointFrames,
    j_base: Rows,
    holding: JointVec,
}

impl KinematicScratch {
    pub(crate) fn new() -> Self {
        let zero = [0.0; MAX_JOINTS];
        let simple = SimpleScratch { cells: JointAxes::new(), moments: [[0.0; 4]; MAX_JOINTS] };
        Self { simple, frames: JointFrames::default(), j_base: [zero; MAX_AXES], holding: zero }
    }
}

/// Scratch memory of [`Chain::evaluate_simple`]; zeros in the padding.
#[derive(Debug, Clone)]
struct SimpleScratch {
    cells: JointAxes<MAX_JOINTS>,
    /// First moment of mass [kg·m] in base axes. After the forward pass: of each joint's rigid group. After the backward
    /// pass: of everything that the joint carries, about the joint's origin.
    moments: [PaddedVec3; MAX_JOINTS],
}

/// Origin [m] and axis of each joint, base axes; zeros in the padding.
#[derive(Debug, Clone)]
struct JointAxes<const N: usize> {
    origin: [PaddedVec3; N],
    axis: [PaddedVec3; N],
}

impl<const N: usize> JointAxes<N> {
    #[inline(always)]
    fn new() -> Self {
        let zero = [[0.0; 4]; N];
        Self { origin: zero, axis: zero }
    }

    /// Returns the joint axes, and the Jacobian at the tool as if every joint were revolute.
    #[inline(always)]
    fn jacobian<J: JointVector>(&self, tool: &Pose) -> ([J; 3], [J; MAX_AXES]) {
        let (origin, axis) = (J::components(&self.origin), J::components(&self.axis));
        let lever = cross::<J>(&axis, &sub::<J>(&splat::<J>(&tool.position), &origin));
        (axis, [lever[0], lever[1], lever[2], axis[0], axis[1], axis[2]])
    }
}

impl<T: StoreVec3, const N: usize> Visitor<T> for JointAxes<N> {
    #[inline(always)]
    fn visit_joint(&mut self, k: usize, axes: &[T; 3], origin: T) {
        origin.store(&mut self.origin[k]);
        axes[2].store(&mut self.axis[k]);
    }
}

/// Visitor that stores the joint axes and the first moments of the groups.
struct WithMasses<'a> {
    cells: &'a mut JointAxes<MAX_JOINTS>,
    moments: &'a mut [PaddedVec3; MAX_JOINTS],
    masses: &'a GroupMasses,
}

impl<T: StoreVec3> Visitor<T> for WithMasses<'_> {
    #[inline(always)]
    fn visit_joint(&mut self, k: usize, axes: &[T; 3], origin: T) {
        self.cells.visit_joint(k, axes, origin);
        transform_point(axes, &self.masses.moment[k], T::constant(&[0.0; 3])).store(&mut self.moments[k]);
    }
}

impl Chain {
    /// Computes tool pose, Jacobian and gravity torques at `q`. `weight` holds the masses, and gravity [m/s²] in base
    /// axes; `None`: the torques are 0. `any_chain`: the chain may have prismatic or mimic joints, or joints beside its
    /// path.
    #[inline(always)]
    pub(crate) fn evaluate<J: JointVector>(
        &self,
        any_chain: bool,
        q: J,
        weight: Option<(&GroupMasses, &Vec3)>,
        scratch: &mut KinematicScratch,
    ) -> KinematicState<J> {
        if !any_chain {
            return if J::OUTLINED {
                self.evaluate_simple::<J, MAX_JOINTS>(q, weight, &mut scratch.simple)
            } else {
                self.evaluate_simple::<J, LANES>(q, weight, &mut scratch.simple)
            };
        }
        let KinematicScratch { frames, j_base, holding, .. } = scratch;
        self.forward_by::<J::Elem>(&q.to_joints(), frames);
        self.jacobian_by::<J::Elem>(frames, j_base);
        let (tool, j_base) = (frames.tool, load_rows(j_base));
        let frame = FrameAxes::at(&tool);
        let Some((masses, g)) = weight else { return KinematicState { frame, tool, j_base, holding: J::splat(0.0) } };
        self.gravity_by::<J::Elem>(frames, masses, g, holding);
        KinematicState { frame, tool, j_base, holding: J::load(holding) }
    }

    /// Computes [`Chain::evaluate`] for a simple chain without joints beside its path, of at most `N` joints.
    #[inline(always)]
    fn evaluate_simple<J: JointVector, const N: usize>(
        &self,
        q: J,
        weight: Option<(&GroupMasses, &Vec3)>,
        scratch: &mut SimpleScratch,
    ) -> KinematicState<J> {
        let SimpleScratch { cells, moments } = scratch;
        let joint_trigs = self.joint_trigs_simd::<J, N>(q);
        let Some((masses, g)) = weight else {
            let frame = self.forward_frame::<J::Vec3, N, false>(&joint_trigs, cells);
            let tool = frame.pose();
            let (_, j_base) = cells.jacobian::<J>(&tool);
            return KinematicState { frame, tool, j_base, holding: J::splat(0.0) };
        };
        let frame = self.forward_frame::<J::Vec3, N, false>(&joint_trigs, &mut WithMasses { cells, moments, masses });
        let tool = frame.pose();
        // Replace each moment by S − M o, where S and M are first moment and mass of everything beyond the joint and o
        // is its origin, as in [`Chain::gravity`]. `subtree` and `mass` are S and M without the joint's own group,
        // whose moment is already relative to o.
        let (mut subtree, mut mass) = (J::Vec3::constant(&[0.0; 3]), 0.0);
        for k in (0..self.path.min(MAX_JOINTS)).rev() {
            let (group, origin) = (J::Vec3::load(&moments[k]), J::Vec3::load(&cells.origin[k]));
            group.sub_scaled(mass, origin).add_scaled(1.0, subtree).store(&mut moments[k]);
            // The terms that do not depend on other joints come first, to shorten the dependency chain.
            subtree = group.add_scaled(masses.mass[k], origin).add_scaled(1.0, subtree);
            mass += masses.mass[k];
        }
        let (axis, j_base) = cells.jacobian::<J>(&tool);
        let holding = -dot::<J>(&J::components(&*moments), &cross::<J>(&splat::<J>(g), &axis));
        KinematicState { frame, tool, j_base, holding }
    }

    /// Computes tool pose and Jacobian at `q` of a simple chain (see `Chain::simple`) of at most eight joints.
    #[inline(always)]
    pub(super) fn pose_and_jacobian<J: JointVector>(&self, q: &JointVec, rows: &mut Rows) -> Pose {
        let mut cells = JointAxes::<LANES>::new();
        let joint_trigs = self.joint_trigs_simd::<J, LANES>(J::load(q));
        let tool = self.forward_pass::<J::Vec3, LANES, false>(&joint_trigs, &mut cells);
        let (_, j_base) = cells.jacobian::<J>(&tool);
        for r in 0..MAX_AXES {
            j_base[r].store(&mut rows[r]);
        }
        tool
    }
}
