//! Joint positions → frames of all joints and of the tool.

use super::spatial::{Mat3, Vec3, add, multiply, rotate, sin_cos};
use crate::model::Chain;
use crate::pose::Pose;
use crate::{JointVec, MAX_JOINTS};

/// Where every moving joint and the tool are, in the base; scratch of the hot path.
///
/// The first joints are those between base and tip, base first. Behind them stand joints beside the path that follow a
/// coordinate of the chain (the other finger of a gripper): they carry mass but move no tool. Entries beyond are 0.
#[derive(Debug, Clone, PartialEq)]
pub struct Frames {
    /// Unit axis of each joint.
    pub axis: [[f64; 3]; MAX_JOINTS],
    /// A point on each joint's axis [m]: the joint's origin, moved along the axis by a prismatic joint.
    pub origin: [[f64; 3]; MAX_JOINTS],
    /// `base_from_joint`, rotation after the joint's own motion; its z is the joint's axis.
    pub rotation: [[[f64; 3]; 3]; MAX_JOINTS],
    /// `base_from_tool`.
    pub tool: Pose,
}

impl Default for Frames {
    fn default() -> Self {
        Self {
            axis: [[0.0; 3]; MAX_JOINTS],
            origin: [[0.0; 3]; MAX_JOINTS],
            rotation: [[[0.0; 3]; 3]; MAX_JOINTS],
            tool: Pose::IDENTITY,
        }
    }
}

impl Chain {
    /// Frames of all joints and of the tool at `q`.
    ///
    /// `q` [rad or m]: `n` finite entries of at most [`COORDINATE_BOUND`](crate::pose::COORDINATE_BOUND); the rest is 0.
    pub fn forward(&self, q: &JointVec, frames: &mut Frames) {
        let (mut angle, mut slide) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
        for k in 0..MAX_JOINTS {
            let driver = q[self.driver[k] & (MAX_JOINTS - 1)];
            angle[k] = self.angle_per_q[k] * driver + self.angle_offset[k];
            slide[k] = self.slide_per_q[k] * driver + self.slide_offset[k];
        }
        // Whole eights, so that the sines become vector code.
        let (mut sine, mut cosine) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
        for k in 0..8 {
            (sine[k], cosine[k]) = sin_cos(angle[k]);
        }
        if self.total > 8 {
            for k in 8..MAX_JOINTS {
                (sine[k], cosine[k]) = sin_cos(angle[k]);
            }
        }

        let mut rotation = self.base.rotation;
        let mut origin = self.base.position;
        for k in 0..self.path.min(MAX_JOINTS) {
            (rotation, origin) = self.advance(k, &rotation, &origin, (sine[k], cosine[k], slide[k]));
            frames.set(k, &rotation, &origin);
        }
        frames.tool.rotation = multiply(&rotation, &self.tool.rotation);
        frames.tool.position = add(&origin, &rotate(&rotation, &self.tool.position));

        for k in self.path..self.total.min(MAX_JOINTS) {
            let parent = self.parent[k];
            let (rotation, origin) = if parent < MAX_JOINTS {
                (frames.rotation[parent], frames.origin[parent])
            } else {
                (self.base.rotation, self.base.position)
            };
            let turned = multiply(&rotation, &self.turn[k]);
            let (rotation, origin) = self.advance(k, &turned, &origin, (sine[k], cosine[k], slide[k]));
            frames.set(k, &rotation, &origin);
        }
    }

    /// From the frame before joint `k` to the frame after it: `T(offset) · Rx(tilt) · Rz(angle) · T(slide z)`.
    ///
    /// Any rotation is `Rz · Rx · Rz`. The last turn is added to the joint's angle and the first one is part of the frame
    /// before, whose own angle takes it in; so one matrix product is left, with a column of two terms.
    #[inline]
    fn advance(&self, k: usize, r: &Mat3, p: &Vec3, (s, c, slide): (f64, f64, f64)) -> (Mat3, Vec3) {
        let (st, ct) = self.tilt[k];
        let (x1, x2, y1, y2) = (ct * s, st * s, ct * c, st * c);
        let row =
            |v: &Vec3| [v[0] * c + (v[1] * x1 + v[2] * x2), (v[1] * y1 + v[2] * y2) - v[0] * s, v[2] * ct - v[1] * st];
        let rotation = [row(&r[0]), row(&r[1]), row(&r[2])];
        let mut origin = add(p, &rotate(r, &self.offset[k]));
        for i in 0..3 {
            origin[i] += rotation[i][2] * slide;
        }
        (rotation, origin)
    }
}

impl Frames {
    #[inline]
    fn set(&mut self, k: usize, rotation: &Mat3, origin: &Vec3) {
        self.rotation[k] = *rotation;
        self.axis[k] = [rotation[0][2], rotation[1][2], rotation[2][2]];
        self.origin[k] = *origin;
    }
}
