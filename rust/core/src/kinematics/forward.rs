//! Joint positions → frames of all joints and of the tool.

use super::spatial::{Mat3, Vec3, multiply, place, splat, splat_matrix};
use crate::model::Chain;
use crate::number::{Arithmetic, Plain, sin_cos};
use crate::pose::Pose;
use crate::{JointVec, MAX_JOINTS};

/// Where every moving joint and the tool are, in the base; scratch of the hot path.
///
/// The first joints are those between base and tip, base first. Behind them stand joints beside the path that follow a
/// coordinate of the chain (the other finger of a gripper): they carry mass but move no tool. Entries beyond are 0.
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
    /// The same number everywhere.
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

/// What is done with the frame of each joint on the way to the tool.
pub(super) trait Visitor<R> {
    /// The frame after joint `k`.
    fn joint(&mut self, k: usize, rotation: &Mat3<R>, origin: &Vec3<R>);
}

impl<R: Copy> Visitor<R> for Frames<R> {
    #[inline(always)]
    fn joint(&mut self, k: usize, rotation: &Mat3<R>, origin: &Vec3<R>) {
        self.rotation[k] = *rotation;
        self.axis[k] = [rotation[0][2], rotation[1][2], rotation[2][2]];
        self.origin[k] = *origin;
    }
}

/// Of nothing but the tool.
impl<R> Visitor<R> for () {
    #[inline(always)]
    fn joint(&mut self, _: usize, _: &Mat3<R>, _: &Vec3<R>) {}
}

/// Sine and cosine of a joint's angle, and its travel.
#[derive(Clone, Copy)]
struct Motion<R> {
    sine: R,
    cosine: R,
    slide: R,
}

impl<R> Motion<R> {
    #[inline(always)]
    fn store(self, k: usize, all: &mut [[R; MAX_JOINTS]; 3]) {
        (all[0][k], all[1][k], all[2][k]) = (self.sine, self.cosine, self.slide);
    }
}

/// Motions of all joints: of one configuration already known.
pub(super) struct Motions<'a, R> {
    q: &'a [R; MAX_JOINTS],
    all: [[R; MAX_JOINTS]; 3],
}

impl Chain {
    /// Frames of all joints and of the tool at `q`.
    ///
    /// `q` [rad or m]: `n` finite entries of at most [`COORDINATE_BOUND`](crate::pose::COORDINATE_BOUND); the rest is 0.
    pub fn forward(&self, q: &JointVec, frames: &mut Frames) {
        self.forward_by::<Plain>(q, frames);
    }

    /// [`Chain::forward`] of one configuration or of eight.
    #[inline(always)]
    pub(crate) fn forward_by<A: Arithmetic>(&self, q: &[A::Real; MAX_JOINTS], frames: &mut Frames<A::Real>) {
        let motions = self.motions::<A>(q, self.total);
        frames.tool = self.walk::<A>(&motions, frames);
        for k in self.path..self.total.min(MAX_JOINTS) {
            let parent = self.parent[k];
            let (rotation, origin) = if parent < MAX_JOINTS {
                (frames.rotation[parent], frames.origin[parent])
            } else {
                (splat_matrix::<A>(&self.base.rotation), splat::<A>(&self.base.position))
            };
            let turned = multiply::<A>(&rotation, &splat_matrix::<A>(&self.turn[k]));
            let (rotation, origin) = self.advance::<A>(k, &turned, &origin, &motions);
            frames.joint(k, &rotation, &origin);
        }
    }

    /// Motions of the first `count` joints at `q`.
    #[inline(always)]
    pub(super) fn motions<'a, A: Arithmetic>(
        &self,
        q: &'a [A::Real; MAX_JOINTS],
        count: usize,
    ) -> Motions<'a, A::Real> {
        let zero = A::splat(0.0);
        let mut all = [[zero; MAX_JOINTS]; 3];
        // Whole eights, so that the sines become vector code; what is that by itself is not stored.
        if !A::WIDE {
            for k in 0..8 {
                self.motion::<A>(k, q).store(k, &mut all);
            }
            if count > 8 {
                for k in 8..MAX_JOINTS {
                    self.motion::<A>(k, q).store(k, &mut all);
                }
            }
        }
        Motions { q, all }
    }

    #[inline(always)]
    fn motion<A: Arithmetic>(&self, k: usize, q: &[A::Real; MAX_JOINTS]) -> Motion<A::Real> {
        let driver = q[self.driver[k] & (MAX_JOINTS - 1)];
        let angle = A::fma(A::splat(self.angle_per_q[k]), driver, A::splat(self.angle_offset[k]));
        let slide = A::fma(A::splat(self.slide_per_q[k]), driver, A::splat(self.slide_offset[k]));
        let (sine, cosine) = sin_cos::<A>(angle);
        Motion { sine, cosine, slide }
    }

    /// From the base to the tool, whose pose is returned.
    #[inline(always)]
    pub(super) fn walk<A: Arithmetic>(
        &self,
        motions: &Motions<'_, A::Real>,
        visitor: &mut impl Visitor<A::Real>,
    ) -> Pose<A::Real> {
        let mut rotation = splat_matrix::<A>(&self.base.rotation);
        let mut origin = splat::<A>(&self.base.position);
        for k in 0..self.path.min(MAX_JOINTS) {
            (rotation, origin) = self.advance::<A>(k, &rotation, &origin, motions);
            visitor.joint(k, &rotation, &origin);
        }
        Pose {
            rotation: multiply::<A>(&rotation, &splat_matrix::<A>(&self.tool.rotation)),
            position: place::<A>(&rotation, &splat::<A>(&self.tool.position), &origin),
        }
    }

    /// From the frame before joint `k` to the frame after it: `T(offset) · Rx(tilt) · Rz(angle) · T(slide z)`.
    ///
    /// Any rotation is `Rz · Rx · Rz`. The last turn is added to the joint's angle and the first one is part of the frame
    /// before, whose own angle takes it in; so one matrix product is left, with a column of two terms.
    #[inline(always)]
    fn advance<A: Arithmetic>(
        &self,
        k: usize,
        r: &Mat3<A::Real>,
        p: &Vec3<A::Real>,
        motions: &Motions<'_, A::Real>,
    ) -> (Mat3<A::Real>, Vec3<A::Real>) {
        let Motion { sine: s, cosine: c, slide } = if A::WIDE {
            self.motion::<A>(k, motions.q)
        } else {
            let [sine, cosine, slide] = &motions.all;
            Motion { sine: sine[k], cosine: cosine[k], slide: slide[k] }
        };
        let (st, ct) = (A::splat(self.tilt[k].0), A::splat(self.tilt[k].1));
        let (x1, x2, y1, y2) = (ct * s, st * s, ct * c, st * c);
        let mut rotation = *r;
        for row in &mut rotation {
            let v = *row;
            row[0] = A::fma(v[2], x2, A::fma(v[1], x1, v[0] * c));
            row[1] = A::fma(v[2], y2, A::fnma(v[0], s, v[1] * y1));
            row[2] = A::fnma(v[1], st, v[2] * ct);
        }
        let mut origin = place::<A>(r, &splat::<A>(&self.offset[k]), p);
        if self.slides[k] {
            for i in 0..3 {
                origin[i] = A::fma(rotation[i][2], slide, origin[i]);
            }
        }
        (rotation, origin)
    }
}
