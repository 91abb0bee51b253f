//! Deviation between two poses, e = x_d − x.

use crate::AxisVec;
use crate::math::rotation::rotation_vector_by;
use crate::math::simd::{BaselineF64, RealOps};
use crate::math::spatial::{mul_tr, sub};
use crate::pose::Pose;

/// Returns the deviation `e = x_d − x` in base axes: `[m, m, m, rad, rad, rad]`.
///
/// Linear part: difference of the positions. Angular part: rotation vector of `R_d Rᵀ`, of length at most π. At exactly
/// π, where its sign is ambiguous, it follows the quaternion with non-negative scalar part.
#[inline(always)]
pub fn pose_error(actual: &Pose, target: &Pose) -> AxisVec {
    pose_error_by::<BaselineF64>(actual, target)
}

/// Computes [`pose_error`] with the scalar operations of an instruction set.
#[inline(always)]
pub(crate) fn pose_error_by<A: RealOps<Real = f64>>(actual: &Pose, target: &Pose) -> AxisVec {
    let (p, d) = (&actual.position, &target.position);
    let [x, y, z] = sub::<A>(d, p);
    let [roll, pitch, yaw] = rotation_vector_by::<A>(&mul_tr::<A>(&target.rotation, &actual.rotation));
    [x, y, z, roll, pitch, yaw]
}
