//! Deviation between two poses, e = x_d − x.

use crate::AxisVec;
use crate::math::rotation::rotation_vector_by;
use crate::math::simd::{BaselineF64, RealOps};
use crate::math::spatial::{mul_tr, sub};
use crate::pose::Pose;

/// Returns the deviation `e = x_d − x` (6,) in base axes [m, rad]: the difference of the positions, then the rotation
/// vector of `R_d Rᵀ`.
///
/// The rotation vector has a length of at most π. At exactly π its sign is ambiguous; it is then that of the quaternion
/// with non-negative scalar part.
#[inline(always)]
pub fn pose_error(actual: &Pose, target: &Pose) -> AxisVec {
    pose_error_by::<BaselineF64>(actual, target)
}

/// Computes [`pose_error`] with the scalar operations of an instruction set.
#[inline(always)]
pub(crate) fn pose_error_by<A: RealOps<Real = f64>>(actual: &Pose, target: &Pose) -> AxisVec {
    let (p, d) = (&actual.position, &target.position);
    let [x, y, z] = sub::<A>(d, p);
    let [rx, ry, rz] = rotation_vector_by::<A>(&mul_tr::<A>(&target.rotation, &actual.rotation));
    [x, y, z, rx, ry, rz]
}
