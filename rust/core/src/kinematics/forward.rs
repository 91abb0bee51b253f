//! Forward kinematics: joint positions → frames of all joints and of the tool.

use crate::math::simd::{Arithmetic, Joints, Plain, Real, Three, Triple, sin_cos};
use crate::math::spatial::{Mat3, Vec3, multiply, splat, splat_matrix};
use crate::model::Chain;
use crate::pose::Pose;
use crate::{JointVec, MAX_JOINTS};

/// Frames of all moving joints and of the tool in the base; scratch of the control step.
///
/// The first joints are those between base and tip, base first. After them come joints beside the path that follow a
/// coordinate of the chain (the other finger of a gripper): they carry mass but do not move the tool. Further entries
/// are 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Frames<R = f64> {
    /// Unit axis of each joint.
    pub axis: [[R; 3]; MAX_JOINTS],
    /// A point on each joint's axis [m]: the joint's origin, moved along the axis by a prismatic joint.
    pub origin: [[R; 3]; MAX_JOINTS],
    /// `base_from_joint`, rotation after the joint's own motion; its z is the joint's axis.
    pub rotation: [[[R; 3]; 3]; MAX_JOINTS],
    /// `base_from_tool`.
    pub tool: Pose<R>,
}

impl<R: Copy> Frames<R> {
    /// Fills all entries with one number.
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

impl Default for Frames {
    fn default() -> Self {
        Self { tool: Pose::IDENTITY, ..Self::filled(0.0) }
    }
}

/// Visitor of the joint frames on the path to the tool.
pub(super) trait Visitor<T> {
    /// Called with the frame after joint `k`: its axes, the columns of the rotation, and its origin.
    fn joint(&mut self, k: usize, axes: &[T; 3], origin: T);
}

impl<A: Arithmetic> Visitor<Three<A>> for Frames<A::Real> {
    #[inline(always)]
    fn joint(&mut self, k: usize, axes: &[Three<A>; 3], origin: Three<A>) {
        self.rotation[k] = matrix(axes);
        self.axis[k] = axes[2].numbers();
        self.origin[k] = origin.numbers();
    }
}

/// Visits no joint frames, for the tool pose alone.
impl<T> Visitor<T> for () {
    #[inline(always)]
    fn joint(&mut self, _: usize, _: &[T; 3], _: T) {}
}

/// Returns the rotation with these axes as columns.
#[inline(always)]
fn matrix<T: Triple>([x, y, z]: &[T; 3]) -> Mat3<Real<T>> {
    let (x, y, z) = (x.numbers(), y.numbers(), z.numbers());
    [[x[0], y[0], z[0]], [x[1], y[1], z[1]], [x[2], y[2], z[2]]]
}

/// Returns the columns of a rotation.
#[inline(always)]
fn columns<T: Triple>(m: &Mat3<Real<T>>) -> [T; 3] {
    [T::of([m[0][0], m[1][0], m[2][0]]), T::of([m[0][1], m[1][1], m[2][1]]), T::of([m[0][2], m[1][2], m[2][2]])]
}

/// Sine and cosine of a joint's angle, and its displacement.
#[derive(Clone, Copy)]
struct Motion<R> {
    sine: R,
    cosine: R,
    slide: R,
}

/// Motion of a joint with coordinate `q`, whose angle and displacement are `[per q, offset]`.
#[inline(always)]
fn motion<A: Arithmetic>(q: A::Real, angle: [A::Real; 2], slide: [A::Real; 2]) -> Motion<A::Real> {
    let (sine, cosine) = sin_cos::<A>(A::fma(angle[0], q, angle[1]));
    Motion { sine, cosine, slide: A::fma(slide[0], q, slide[1]) }
}

/// Motions of up to `N` joints; for a single configuration they are precomputed.
pub(super) struct Motions<'a, R, const N: usize = MAX_JOINTS> {
    q: &'a [R; MAX_JOINTS],
    all: [[R; N]; 3],
}

impl Chain {
    /// Computes the frames of all joints and of the tool at `q`.
    ///
    /// `q` [rad or m]: `n` finite entries of at most [`COORDINATE_BOUND`](crate::pose::COORDINATE_BOUND), then zeros.
    pub fn forward(&self, q: &JointVec, frames: &mut Frames) {
        self.forward_by::<Plain>(q, frames);
    }

    /// [`Chain::forward`] for one configuration or several.
    #[inline(always)]
    pub(crate) fn forward_by<A: Arithmetic>(&self, q: &[A::Real; MAX_JOINTS], frames: &mut Frames<A::Real>) {
        let motions = self.motions::<A>(q, self.total);
        frames.tool = self.walk::<Three<A>, _>(&motions, frames);
        for k in self.path..self.total.min(MAX_JOINTS) {
            let parent = self.parent[k];
            let (rotation, origin) = if parent < MAX_JOINTS {
                (frames.rotation[parent], frames.origin[parent])
            } else {
                (splat_matrix::<A>(&self.base.rotation), splat::<A>(&self.base.position))
            };
            let turned = multiply::<A>(&rotation, &splat_matrix::<A>(&self.turn[k]));
            let (axes, origin) = self.advance(k, &columns::<Three<A>>(&turned), Three::of(origin), &motions);
            frames.joint(k, &axes, origin);
        }
    }

    /// Returns the motions of the first `count` joints at `q`.
    #[inline(always)]
    pub(super) fn motions<'a, A: Arithmetic>(
        &self,
        q: &'a [A::Real; MAX_JOINTS],
        count: usize,
    ) -> Motions<'a, A::Real> {
        let mut all = [[A::splat(0.0); MAX_JOINTS]; 3];
        // Values that are already SIMD vectors are not stored.
        if !A::WIDE {
            for k in 0..count.min(MAX_JOINTS) {
                let Motion { sine, cosine, slide } = self.motion::<A>(k, q);
                (all[0][k], all[1][k], all[2][k]) = (sine, cosine, slide);
            }
        }
        Motions { q, all }
    }

    /// Returns the motions at `q` of joints that each have their own coordinate, one joint per lane.
    #[inline(always)]
    pub(super) fn motions_abreast<'a, J: Joints, const N: usize>(&self, q: &'a JointVec) -> Motions<'a, f64, N> {
        let (angle, slide) = ([&self.angle_per_q, &self.angle_offset], [&self.slide_per_q, &self.slide_offset]);
        let (angle, slide) = ([J::load(angle[0]), J::load(angle[1])], [J::load(slide[0]), J::load(slide[1])]);
        let Motion { sine, cosine, slide } = motion::<J>(J::load(q), angle, slide);
        Motions { q, all: [sine.few(), cosine.few(), slide.few()] }
    }

    #[inline(always)]
    fn motion<A: Arithmetic>(&self, k: usize, q: &[A::Real; MAX_JOINTS]) -> Motion<A::Real> {
        motion::<A>(
            q[self.driver[k] & (MAX_JOINTS - 1)],
            [A::splat(self.angle_per_q[k]), A::splat(self.angle_offset[k])],
            [A::splat(self.slide_per_q[k]), A::splat(self.slide_offset[k])],
        )
    }

    /// Runs the forward pass from the base to the tool and returns the tool pose.
    #[inline(always)]
    pub(super) fn walk<T: Triple, const N: usize>(
        &self,
        motions: &Motions<'_, Real<T>, N>,
        visitor: &mut impl Visitor<T>,
    ) -> Pose<Real<T>> {
        let mut axes = columns::<T>(&splat_matrix::<T::One>(&self.base.rotation));
        let mut origin = T::constant(&self.base.position);
        for k in 0..self.path.min(N).min(MAX_JOINTS) {
            (axes, origin) = self.advance(k, &axes, origin, motions);
            visitor.joint(k, &axes, origin);
        }
        let (r, nothing) = (&self.tool.rotation, T::constant(&[0.0; 3]));
        let rotation = [
            place(&axes, &[r[0][0], r[1][0], r[2][0]], nothing),
            place(&axes, &[r[0][1], r[1][1], r[2][1]], nothing),
            place(&axes, &[r[0][2], r[1][2], r[2][2]], nothing),
        ];
        Pose { rotation: matrix(&rotation), position: place(&axes, &self.tool.position, origin).numbers() }
    }

    /// Advances from the frame before joint `k` to the frame after it: `T(offset) · Rx(tilt) · Rz(angle) · T(slide z)`.
    ///
    /// Any rotation is `Rz · Rx · Rz`. The last rotation is added to the joint's angle. The first one is merged into
    /// the previous frame, whose joint angle includes it. So two planar rotations remain.
    #[inline(always)]
    fn advance<T: Triple, const N: usize>(
        &self,
        k: usize,
        &[x, y, z]: &[T; 3],
        origin: T,
        motions: &Motions<'_, Real<T>, N>,
    ) -> ([T; 3], T) {
        let Motion { sine: s, cosine: c, slide } = if T::One::WIDE {
            self.motion::<T::One>(k, motions.q)
        } else {
            let [sine, cosine, slide] = &motions.all;
            Motion { sine: sine[k], cosine: cosine[k], slide: slide[k] }
        };
        let (st, ct) = (T::One::splat(self.tilt[k].0), T::One::splat(self.tilt[k].1));
        let (tilted, axis) = (y.times(ct).plus(st, z), z.times(ct).minus(st, y));
        // The tilted axis is ready last, so it enters in the last multiply-add: this dependency chain is the latency
        // per joint.
        let axes = [x.times(c).plus(s, tilted), x.times(-s).plus(c, tilted), axis];
        let mut origin = place(&[x, y, z], &self.offset[k], origin);
        if self.slides[k] {
            origin = origin.plus(slide, axis);
        }
        (axes, origin)
    }
}

/// Transforms a point from a frame into the base.
#[inline(always)]
pub(super) fn place<T: Triple>(axes: &[T; 3], point: &Vec3, origin: T) -> T {
    let [x, y, z] = splat::<T::One>(point);
    origin.plus(x, axes[0]).plus(y, axes[1]).plus(z, axes[2])
}
