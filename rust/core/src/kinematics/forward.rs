//! Forward kinematics: joint positions → frames of all joints and of the tool.

use crate::math::simd::{BaselineF64x8, F64x8, JointVector, Real, RealOps, ScalarVec3, Vec3Ops, sin_cos};
use crate::math::spatial::{Mat3, Vec3, multiply, splat, splat_matrix};
use crate::model::Chain;
use crate::pose::Pose;
use crate::{JointVec, MAX_JOINTS};

/// Frames of all moving joints and of the tool, in the base.
///
/// The first joints are those between base and tip, base first. After them come mimic joints beside the path, such as
/// the second finger of a gripper: they carry mass but do not move the tool. Further entries are 0.
#[derive(Debug, Clone, PartialEq)]
pub struct JointFrames<R = f64> {
    /// Unit axis of each joint, in the base.
    pub axis: [[R; 3]; MAX_JOINTS],
    /// Origin of the frame after each joint [m]: a point on the joint's axis, which a prismatic joint moves along the
    /// axis.
    pub origin: [[R; 3]; MAX_JOINTS],
    /// Rotation `base_from_joint` of the frame after each joint; its z axis is the joint's axis.
    pub rotation: [[[R; 3]; 3]; MAX_JOINTS],
    /// Pose of the tool, `base_from_tool`.
    pub tool: Pose<R>,
}

impl<R: Copy> JointFrames<R> {
    /// Creates frames with all entries `value`, as memory for a forward pass.
    pub(crate) fn filled(value: R) -> Self {
        let three = [value; 3];
        Self {
            axis: [three; MAX_JOINTS],
            origin: [three; MAX_JOINTS],
            rotation: [[three; 3]; MAX_JOINTS],
            tool: Pose { rotation: [three; 3], position: three },
        }
    }
}

impl Default for JointFrames {
    fn default() -> Self {
        Self { tool: Pose::IDENTITY, ..Self::filled(0.0) }
    }
}

/// Receives the joint frames of a forward pass.
pub(super) trait Visitor<T> {
    /// Receives the frame after joint `k`: its axes (columns of the rotation) and its origin.
    fn visit_joint(&mut self, k: usize, axes: &[T; 3], origin: T);
}

impl<A: RealOps> Visitor<ScalarVec3<A>> for JointFrames<A::Real> {
    #[inline(always)]
    fn visit_joint(&mut self, k: usize, axes: &[ScalarVec3<A>; 3], origin: ScalarVec3<A>) {
        self.rotation[k] = matrix(axes);
        self.axis[k] = axes[2].components();
        self.origin[k] = origin.components();
    }
}

/// Ignores the joint frames; for a pass that computes only the tool pose.
impl<T> Visitor<T> for () {
    #[inline(always)]
    fn visit_joint(&mut self, _: usize, _: &[T; 3], _: T) {}
}

/// Returns the rotation matrix with these axes as columns.
#[inline(always)]
fn matrix<T: Vec3Ops>([x, y, z]: &[T; 3]) -> Mat3<Real<T>> {
    let (x, y, z) = (x.components(), y.components(), z.components());
    [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]]
}

/// Axes and origin of a frame, in the base.
#[derive(Clone, Copy)]
pub(crate) struct FrameAxes<T> {
    pub(crate) axes: [T; 3],
    pub(crate) origin: T,
}

impl<T: Vec3Ops> FrameAxes<T> {
    /// Creates the frame at `pose`.
    #[inline(always)]
    pub(super) fn at(pose: &Pose<Real<T>>) -> Self {
        Self { axes: columns(&pose.rotation), origin: T::from_components(pose.position) }
    }

    /// Returns the pose of the frame.
    #[inline(always)]
    pub(super) fn pose(&self) -> Pose<Real<T>> {
        Pose { rotation: matrix(&self.axes), position: self.origin.components() }
    }
}

/// Returns the columns of a rotation matrix.
#[inline(always)]
fn columns<T: Vec3Ops>(m: &Mat3<Real<T>>) -> [T; 3] {
    [
        T::from_components([m[0][0], m[1][0], m[2][0]]),
        T::from_components([m[0][1], m[1][1], m[2][1]]),
        T::from_components([m[0][2], m[1][2], m[2][2]]),
    ]
}

/// Motion of a joint: sine and cosine of its angle, and its displacement along its axis [m].
#[derive(Clone, Copy)]
struct JointTrig<R> {
    sine: R,
    cosine: R,
    slide: R,
}

/// Computes the motion of a joint driven by `q`; `angle` [rad] and `slide` [m] are `[slope per unit of q, offset]`.
#[inline(always)]
fn joint_trig<A: RealOps>(q: A::Real, angle: [A::Real; 2], slide: [A::Real; 2]) -> JointTrig<A::Real> {
    let (sine, cosine) = sin_cos::<A>(A::fma(angle[0], q, angle[1]));
    JointTrig { sine, cosine, slide: A::fma(slide[0], q, slide[1]) }
}

/// Motions of up to `N` joints at the positions `q`.
pub(super) struct JointTrigs<'a, R, const N: usize = MAX_JOINTS> {
    q: &'a [R; MAX_JOINTS],
    /// Sines, cosines and displacements [m]; unused if `R` holds several configurations, whose values are computed when
    /// needed.
    all: [[R; N]; 3],
}

impl Chain {
    /// Computes the frames of all joints and of the tool at `q`.
    ///
    /// `q` [rad or m]: `n` finite entries of at most [`COORDINATE_BOUND`](crate::pose::COORDINATE_BOUND), then zeros.
    pub fn forward(&self, q: &JointVec, frames: &mut JointFrames) {
        self.forward_one::<BaselineF64x8>(q, frames);
    }

    /// Computes [`Chain::forward`] for one configuration, with the instruction set of `V`.
    #[inline(always)]
    pub(crate) fn forward_one<V: F64x8>(&self, q: &JointVec, frames: &mut JointFrames) {
        let joint_trigs = if self.fits_f64x8() && self.total == self.path {
            self.joint_trigs_simd::<V, MAX_JOINTS>(V::load(q))
        } else {
            self.joint_trigs::<V::Elem>(q, self.total)
        };
        self.forward_with::<V::Elem>(&joint_trigs, frames);
    }

    /// Computes [`Chain::forward`] for one configuration or for several.
    #[inline(always)]
    pub(crate) fn forward_by<A: RealOps>(&self, q: &[A::Real; MAX_JOINTS], frames: &mut JointFrames<A::Real>) {
        self.forward_with::<A>(&self.joint_trigs::<A>(q, self.total), frames);
    }

    #[inline(always)]
    fn forward_with<A: RealOps>(&self, joint_trigs: &JointTrigs<'_, A::Real>, frames: &mut JointFrames<A::Real>) {
        frames.tool = self.forward_pass::<ScalarVec3<A>, MAX_JOINTS, true>(joint_trigs, frames);
        for k in self.path..self.total.min(MAX_JOINTS) {
            let parent = self.parent[k];
            let (rotation, origin) = if parent < MAX_JOINTS {
                (frames.rotation[parent], frames.origin[parent])
            } else {
                (splat_matrix::<A>(&self.base.rotation), splat::<A>(&self.base.position))
            };
            let turned = multiply::<A>(&rotation, &splat_matrix::<A>(&self.turn[k]));
            let (axes, origin) = self.advance_frame::<ScalarVec3<A>, MAX_JOINTS, true>(
                k,
                &columns::<ScalarVec3<A>>(&turned),
                ScalarVec3::from_components(origin),
                joint_trigs,
            );
            frames.visit_joint(k, &axes, origin);
        }
    }

    /// Computes sine and cosine, or the displacement, of the first `count` joints at `q`. If the lanes of `A` hold
    /// several configurations, only stores the reference to `q`, and they are computed on use.
    #[inline(always)]
    pub(super) fn joint_trigs<'a, A: RealOps>(
        &self,
        q: &'a [A::Real; MAX_JOINTS],
        count: usize,
    ) -> JointTrigs<'a, A::Real> {
        let mut all = [[A::splat(0.0); MAX_JOINTS]; 3];
        // With several configurations, `advance_frame` computes each motion when its joint is reached.
        if !A::WIDE {
            for k in 0..count.min(MAX_JOINTS) {
                let JointTrig { sine, cosine, slide } = self.joint_trig::<A>(k, q);
                (all[0][k], all[1][k], all[2][k]) = (sine, cosine, slide);
            }
        }
        JointTrigs { q, all }
    }

    /// Computes the motions of the joints of a simple chain (see `Chain::simple`) at `q`, one joint per lane.
    #[inline(always)]
    pub(super) fn joint_trigs_simd<J: JointVector, const N: usize>(&self, q: J) -> JointTrigs<'static, f64, N> {
        let (sine, cosine) = sin_cos::<J>(q + J::load(&self.angle_offset));
        JointTrigs { q: &[0.0; MAX_JOINTS], all: [sine.prefix(), cosine.prefix(), [0.0; N]] }
    }

    #[inline(always)]
    fn joint_trig<A: RealOps>(&self, k: usize, q: &[A::Real; MAX_JOINTS]) -> JointTrig<A::Real> {
        joint_trig::<A>(
            q[self.driver[k] & (MAX_JOINTS - 1)],
            [A::splat(self.angle_per_q[k]), A::splat(self.angle_offset[k])],
            [A::splat(self.slide_per_q[k]), A::splat(self.slide_offset[k])],
        )
    }

    /// Computes the frames from base to tool, passes each joint frame to `visitor` and returns the tool pose. With
    /// `SLIDES` false, all joints must be revolute.
    #[inline(always)]
    pub(super) fn forward_pass<T: Vec3Ops, const N: usize, const SLIDES: bool>(
        &self,
        joint_trigs: &JointTrigs<'_, Real<T>, N>,
        visitor: &mut impl Visitor<T>,
    ) -> Pose<Real<T>> {
        self.forward_frame::<T, N, SLIDES>(joint_trigs, visitor).pose()
    }

    /// Computes [`Chain::forward_pass`], and returns the frame of the tool.
    #[inline(always)]
    pub(super) fn forward_frame<T: Vec3Ops, const N: usize, const SLIDES: bool>(
        &self,
        joint_trigs: &JointTrigs<'_, Real<T>, N>,
        visitor: &mut impl Visitor<T>,
    ) -> FrameAxes<T> {
        let [x, y, z, origin] = &self.base_cells;
        let mut axes = [T::constant_cell(x), T::constant_cell(y), T::constant_cell(z)];
        let mut origin = T::constant_cell(origin);
        for k in 0..self.path.min(N).min(MAX_JOINTS) {
            (axes, origin) = self.advance_frame::<T, N, SLIDES>(k, &axes, origin, joint_trigs);
            visitor.visit_joint(k, &axes, origin);
        }
        let (r, zero) = (&self.tool.rotation, T::constant(&[0.0; 3]));
        let rotation = [
            transform_point(&axes, &[r[0][0], r[1][0], r[2][0]], zero),
            transform_point(&axes, &[r[0][1], r[1][1], r[2][1]], zero),
            transform_point(&axes, &[r[0][2], r[1][2], r[2][2]], zero),
        ];
        FrameAxes { axes: rotation, origin: transform_point(&axes, &self.tool.position, origin) }
    }

    /// Returns axes and origin of the frame after joint `k`, from those of the frame before it:
    /// `T(offset) · Rx(tilt) · Rz(angle) · T(slide z)`.
    ///
    /// Any fixed rotation between joints is `Rz · Rx · Rz`. The model adds its last Rz to this joint's angle and its
    /// first Rz to the angle of the previous joint, so only two planar rotations remain.
    #[inline(always)]
    fn advance_frame<T: Vec3Ops, const N: usize, const SLIDES: bool>(
        &self,
        k: usize,
        &[x, y, z]: &[T; 3],
        origin: T,
        joint_trigs: &JointTrigs<'_, Real<T>, N>,
    ) -> ([T; 3], T) {
        let JointTrig { sine: s, cosine: c, slide } = if T::Elem::WIDE {
            self.joint_trig::<T::Elem>(k, joint_trigs.q)
        } else {
            let [sine, cosine, slide] = &joint_trigs.all;
            JointTrig { sine: sine[k], cosine: cosine[k], slide: slide[k] }
        };
        let (st, ct) = (T::Elem::splat(self.tilt[k].0), T::Elem::splat(self.tilt[k].1));
        let (tilted, axis) = (y.scaled(ct).add_scaled(st, z), z.scaled(ct).sub_scaled(st, y));
        // The tilted axis is ready last, so it enters in the last multiply-add: this chain determines the latency.
        let axes = [x.scaled(c).add_scaled(s, tilted), x.scaled(-s).add_scaled(c, tilted), axis];
        let mut origin = transform_point(&[x, y, z], &self.offset[k], origin);
        if SLIDES && self.slides[k] {
            origin = origin.add_scaled(slide, axis);
        }
        (axes, origin)
    }
}

/// Transforms a point from a frame, given by its axes and its origin, into the base.
#[inline(always)]
pub(super) fn transform_point<T: Vec3Ops>(axes: &[T; 3], point: &Vec3, origin: T) -> T {
    let [x, y, z] = splat::<T::Elem>(point);
    origin.add_scaled(x, axes[0]).add_scaled(y, axes[1]).add_scaled(z, axes[2])
}
