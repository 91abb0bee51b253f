//! Torques that accelerate the arm, groups taken as point masses.

use super::forward::Frames;
use super::gravity::Masses;
use super::spatial::{Vec3, add, cross, dot, rotate, sub};
use crate::model::Chain;
use crate::{JointVec, MAX_JOINTS};

impl Chain {
    /// Torques [N·m, N for prismatic joints] that accelerate the arm with `acceleration` [rad/s², m/s²] from rest.
    ///
    /// `τ = Σ_k m_k J_kᵀ a_k`, every rigid group a point mass at its centre, terms of the velocity left out: right to
    /// the groups' own moments of inertia, which no [`Masses`] hold. Groups beside the path ride on the path.
    pub(crate) fn acceleration_torque(
        &self,
        frames: &Frames,
        masses: &Masses,
        acceleration: &JointVec,
        out: &mut JointVec,
    ) {
        *out = [0.0; MAX_JOINTS];
        let (path, total) = (self.path.min(MAX_JOINTS), self.total.min(MAX_JOINTS));
        // Angular and linear acceleration of each group, at its joint's origin.
        let (mut turning, mut moving) = ([[0.0; 3]; MAX_JOINTS], [[0.0; 3]; MAX_JOINTS]);
        let (mut alpha, mut a, mut at): (Vec3, Vec3, Vec3) = ([0.0; 3], [0.0; 3], self.base.position);
        for k in 0..path {
            let (axis, origin) = (&frames.axis[k], &frames.origin[k]);
            let driver = acceleration[self.driver[k] & (MAX_JOINTS - 1)];
            a = add(&a, &cross(&alpha, &sub(origin, &at)));
            alpha = add(&alpha, &axis.map(|z| z * self.angle_per_q[k] * driver));
            a = add(&a, &axis.map(|z| z * self.slide_per_q[k] * driver));
            at = *origin;
            (turning[k], moving[k]) = (alpha, a);
        }
        for k in path..total {
            let parent = self.parent[k];
            if parent < MAX_JOINTS {
                let lever = sub(&frames.origin[k], &frames.origin[parent]);
                turning[k] = turning[parent];
                moving[k] = add(&moving[parent], &cross(&turning[parent], &lever));
            }
        }
        // Force, and its moment about the base's origin, of each group and of what hangs on it.
        let (mut force, mut moment) = ([[0.0; 3]; MAX_JOINTS], [[0.0; 3]; MAX_JOINTS]);
        for k in 0..total {
            let mass = masses.mass[k];
            let first = rotate(&frames.rotation[k], &masses.moment[k]);
            force[k] = add(&moving[k].map(|a| mass * a), &cross(&turning[k], &first));
            // c × m a with the centre of mass c = o + first/m.
            let about_origin = cross(&frames.origin[k], &force[k]);
            let spin = if mass > 0.0 { cross(&first, &force[k]).map(|x| x / mass) } else { [0.0; 3] };
            moment[k] = add(&about_origin, &spin);
        }
        for k in (path..total).rev() {
            let parent = self.parent[k];
            if parent < MAX_JOINTS {
                (force[parent], moment[parent]) = (add(&force[parent], &force[k]), add(&moment[parent], &moment[k]));
            }
        }
        let (mut push, mut twist): (Vec3, Vec3) = ([0.0; 3], [0.0; 3]);
        for k in (0..path).rev() {
            (push, twist) = (add(&push, &force[k]), add(&twist, &moment[k]));
            let torque = dot(&frames.axis[k], &sub(&twist, &cross(&frames.origin[k], &push)));
            let thrust = dot(&frames.axis[k], &push);
            out[self.driver[k] & (MAX_JOINTS - 1)] += self.angle_per_q[k] * torque + self.slide_per_q[k] * thrust;
        }
    }
}
