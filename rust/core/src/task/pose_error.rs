//! Deviation between two poses, e = x_d − x.

use crate::math::rotation::rotation_vector_by;
use crate::math::simd::{Arithmetic, Plain};
use crate::math::spatial::{multiply_back, sub};
use crate::pose::Pose;
use crate::{AxisVec, MAX_AXES};

/// Deviation `e = x_d − x` in base axes: `[m, m, m, rad, rad, rad]`.
///
/// Linear part: difference of the positions. Angular part: rotation vector of `R_d Rᵀ` on the shortest branch; at an
/// angle of exactly π the axis of the quaternion with non-negative scalar part.
#[inline(always)]
pub fn pose_error(actual: &Pose, target: &Pose) -> AxisVec {
    pose_error_by::<Plain>(actual, target)
}

/// [`pose_error`] of one configuration or of several.
#[inline(always)]
pub(crate) fn pose_error_by<A: Arithmetic>(actual: &Pose<A::Real>, target: &Pose<A::Real>) -> [A::Real; MAX_AXES] {
    let (p, d) = (&actual.position, &target.position);
    let [x, y, z] = sub::<A>(d, p);
    let [roll, pitch, yaw] = rotation_vector_by::<A>(&multiply_back::<A>(&target.rotation, &actual.rotation));
    [x, y, z, roll, pitch, yaw]
}
