//! Fused evaluation of tool pose, Jacobian and gravity torques for the control step; after the frames, one joint per
//! SIMD lane.

use super::forward::{Frames, Visitor, place};
use super::gravity::Masses;
use crate::math::rows::load_rows;
use crate::math::simd::{Arithmetic, Cell, Joints, Kept, LANES, Lanes, Scalar, Triple};
use crate::math::spatial::{Vec3, cross, dot, splat, sub};
use crate::model::Chain;
use crate::pose::Pose;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Tool pose, Jacobian and gravity torques at one configuration per lane.
#[derive(Clone, Copy)]
pub(crate) struct View<J: Lanes> {
    /// `base_from_tool`.
    pub(crate) tool: Pose<Scalar<J>>,
    /// Jacobian in base axes (6 × n).
    pub(crate) world: [J; MAX_AXES],
    /// Gravity torques [N·m].
    pub(crate) holding: J,
}

/// Scratch memory of an evaluation; nothing in it is used afterwards.
#[derive(Debug, Clone)]
pub(crate) struct LookScratch {
    cells: Cells,
    /// First moment of each group's own mass about the base; then the first moment that its joint carries.
    moments: [Cell; MAX_JOINTS],
    frames: Frames,
    world: Rows,
    holding: JointVec,
}

impl LookScratch {
    pub(crate) fn new() -> Self {
        let zero = [0.0; MAX_JOINTS];
        Self {
            cells: Cells::new(),
            moments: [[0.0; 4]; MAX_JOINTS],
            frames: Frames::default(),
            world: [zero; MAX_AXES],
            holding: zero,
        }
    }
}

/// One vector per joint, base axes; zeros in the padding.
#[derive(Debug, Clone)]
struct Cells<const N: usize = MAX_JOINTS> {
    origin: [Cell; N],
    axis: [Cell; N],
}

impl<const N: usize> Cells<N> {
    #[inline(always)]
    fn new() -> Self {
        let zero = [[0.0; 4]; N];
        Self { origin: zero, axis: zero }
    }

    /// Returns the axes, and the tool motion from a rotation about them.
    #[inline(always)]
    fn jacobian<J: Joints>(&self, tool: &Pose) -> ([J; 3], [J; MAX_AXES]) {
        let (origin, axis) = (J::components(&self.origin), J::components(&self.axis));
        let lever = cross::<J>(&axis, &sub::<J>(&splat::<J>(&tool.position), &origin));
        (axis, [lever[0], lever[1], lever[2], axis[0], axis[1], axis[2]])
    }
}

impl<T: Kept, const N: usize> Visitor<T> for Cells<N> {
    #[inline(always)]
    fn joint(&mut self, k: usize, axes: &[T; 3], origin: T) {
        origin.keep(&mut self.origin[k]);
        axes[2].keep(&mut self.axis[k]);
    }
}

/// The frame visitor with masses.
struct Heavy<'a> {
    cells: &'a mut Cells,
    moments: &'a mut [Cell; MAX_JOINTS],
    masses: &'a Masses,
}

impl<T: Kept> Visitor<T> for Heavy<'_> {
    #[inline(always)]
    fn joint(&mut self, k: usize, axes: &[T; 3], origin: T) {
        self.cells.joint(k, axes, origin);
        place(axes, &self.masses.moment[k], T::constant(&[0.0; 3])).keep(&mut self.moments[k]);
    }
}

impl Chain {
    /// Computes tool pose, Jacobian and, if `heavy`, gravity torques of several configurations; `rows` are 0 after the
    /// last joint.
    #[inline(always)]
    pub(crate) fn look_abreast<J: Lanes>(
        &self,
        q: &[Scalar<J>; MAX_JOINTS],
        masses: &Masses,
        g: &Vec3,
        heavy: bool,
        rows: &mut [[Scalar<J>; MAX_JOINTS]; MAX_AXES],
    ) -> View<J> {
        let zero = J::One::splat(0.0);
        let mut holding = [zero; MAX_JOINTS];
        let tool = if heavy {
            let mut frames = Frames::filled(zero);
            self.forward_by::<J::One>(q, &mut frames);
            self.jacobian_by::<J::One>(&frames, rows);
            self.gravity_by::<J::One>(&frames, masses, g, &mut holding);
            frames.tool
        } else {
            self.kinematics_by::<J::One>(q, rows)
        };
        let [a, b, c, d, e, f] = rows;
        // Built in place: too large to be moved.
        View {
            tool,
            world: [
                J::of_joints(a),
                J::of_joints(b),
                J::of_joints(c),
                J::of_joints(d),
                J::of_joints(e),
                J::of_joints(f),
            ],
            holding: J::of_joints(&holding),
        }
    }

    /// Computes tool pose and Jacobian at `q`, and the gravity torques of masses under `g` [m/s²] in the base; these
    /// are 0 if `weight` is `None`.
    #[inline(always)]
    pub(crate) fn look<J: Joints>(&self, q: J, weight: Option<(&Masses, &Vec3)>, scratch: &mut LookScratch) -> View<J> {
        let (q, nothing) = (q.array(), J::splat(0.0));
        if !(self.simple && self.path == self.total) {
            let LookScratch { frames, world, holding, .. } = scratch;
            self.forward_by::<J::One>(&q, frames);
            self.jacobian_by::<J::One>(frames, world);
            let (tool, world) = (frames.tool, load_rows(world));
            let Some((masses, g)) = weight else { return View { tool, world, holding: nothing } };
            self.gravity_by::<J::One>(frames, masses, g, holding);
            return View { tool, world, holding: J::load(holding) };
        }
        let LookScratch { cells, moments, .. } = scratch;
        let motions = self.motions_abreast::<J, MAX_JOINTS>(&q);
        let Some((masses, g)) = weight else {
            let tool = self.walk::<J::Triple, _>(&motions, cells);
            let (_, world) = cells.jacobian::<J>(&tool);
            return View { tool, world, holding: nothing };
        };
        let tool = self.walk::<J::Triple, _>(&motions, &mut Heavy { cells, moments, masses });
        // S − M o of [`Chain::gravity`]; M o of the joint's own group cancels. S and M are those of the groups beyond
        // it.
        let (mut beyond, mut mass) = (J::Triple::constant(&[0.0; 3]), 0.0);
        for k in (0..self.path.min(MAX_JOINTS)).rev() {
            let (own, origin) = (J::Triple::kept(&moments[k]), J::Triple::kept(&cells.origin[k]));
            own.minus(mass, origin).plus(1.0, beyond).keep(&mut moments[k]);
            // Terms that do not depend on the previous joint come first, to shorten the dependency chain.
            beyond = own.plus(masses.mass[k], origin).plus(1.0, beyond);
            mass += masses.mass[k];
        }
        let (axis, world) = cells.jacobian::<J>(&tool);
        let holding = -dot::<J>(&J::components(moments), &cross::<J>(&splat::<J>(g), &axis));
        View { tool, world, holding }
    }

    /// Computes tool pose and Jacobian at `q` of an arm in which each coordinate drives one joint.
    #[inline(always)]
    pub(super) fn see<J: Joints>(&self, q: &JointVec, rows: &mut Rows) -> Pose {
        let mut cells = Cells::<LANES>::new();
        let tool = self.walk::<J::Triple, LANES>(&self.motions_abreast::<J, LANES>(q), &mut cells);
        let (_, world) = cells.jacobian::<J>(&tool);
        for r in 0..MAX_AXES {
            world[r].store(&mut rows[r]);
        }
        tool
    }
}
