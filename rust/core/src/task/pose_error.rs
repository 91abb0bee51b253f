//! Deviation between two poses, e = x_d − x.

use crate::AxisVec;
use crate::kinematics::FrameAxes;
use crate::math::rotation::rotation_vector_by;
use crate::math::simd::{BaselineF64, RealOps, StoreVec3};
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

/// Computes [`pose_error`] from the frame of the tool; bit-identical to [`pose_error_by`] with its pose.
#[inline(always)]
pub(crate) fn frame_error<T: StoreVec3>(tool: &FrameAxes<T>, target: &Pose) -> AxisVec {
    let [x, y, z] = sub::<T::Elem>(&target.position, &tool.origin.components());
    let ([a, b, c], d, mut turn) = (tool.axes, &target.rotation, [[0.0; 3]; 3]);
    for i in 0..3 {
        turn[i] = a.scaled(d[i][0]).add_scaled(d[i][1], b).add_scaled(d[i][2], c).components();
    }
    let [rx, ry, rz] = rotation_vector_by::<T::Elem>(&turn);
    [x, y, z, rx, ry, rz]
}
