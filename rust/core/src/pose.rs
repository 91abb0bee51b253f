//! Poses: position and rotation of one frame in another.

use nalgebra::{Isometry3, Matrix3, Matrix4, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::error::{Error, Result};
use crate::math::rotation::{rotation_matrix, rotation_vector};
use crate::math::simd::{BaselineF64, RealOps};
use crate::math::spatial::{Mat3, add, cross, dot, multiply, rotate, sub, tr_rotate};

/// Largest accepted absolute value of a joint position [rad; m if prismatic].
///
/// Differences of larger numbers lose the digits that control needs.
pub const COORDINATE_BOUND: f64 = 1e6;

/// Largest accepted absolute value of a position along an axis [m]. No arm reaches it; larger values are usually in
/// millimetres.
pub const POSITION_BOUND: f64 = 100.0;

/// Largest accepted absolute value of an entry of `RᵀR − I` of a rotation matrix R.
pub const ROTATION_TOLERANCE: f64 = 1e-4;

/// Largest accepted difference of a quaternion's norm from 1.
const QUATERNION_TOLERANCE: f64 = 1e-3;

/// Threshold of the fast check on the sum of residuals. No entry of `RᵀR − I` exceeds six times that sum, so at this
/// threshold every entry is within [`ROTATION_TOLERANCE`].
pub(crate) const FAST_TOLERANCE: f64 = 0.1 * ROTATION_TOLERANCE;

/// Ball that contains all plausible target positions.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TargetRegion {
    /// Centre in the base frame [m].
    pub(crate) centre: [f64; 3],
    /// Radius [m].
    pub(crate) radius: f64,
    /// [`FAST_TOLERANCE`] divided by the radius [1/m].
    tolerance_per_metre: f64,
}

impl TargetRegion {
    /// Region of radius [`POSITION_BOUND`] around the base, for checks without an arm and for tasks without
    /// translations.
    pub(crate) const ANY: Self = Self::ball([0.0; 3], POSITION_BOUND);

    /// Creates a region from centre and radius [m].
    pub(crate) const fn ball(centre: [f64; 3], radius: f64) -> Self {
        Self { centre, radius, tolerance_per_metre: FAST_TOLERANCE / radius }
    }

    /// Returns the distance of a position from the centre [m].
    pub(crate) fn distance(&self, position: &[f64; 3]) -> f64 {
        // `hypot`, because the square of 1e300 would overflow.
        let apart = std::array::from_fn::<f64, 3, _>(|i| position[i] - self.centre[i]);
        apart[0].hypot(apart[1]).hypot(apart[2])
    }

    /// Returns true if a position [m] is outside the region or NaN.
    pub(crate) fn excludes(&self, position: &[f64; 3]) -> bool {
        !(self.distance(position) <= self.radius)
    }
}

/// Pose of the tool in the base, `base_from_tool`: rotation matrix and position [m].
///
/// With `R = f64` it is one pose; with a SIMD type, one pose per lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose<R = f64> {
    /// Rotation matrix, indexed as `rotation[row][column]`.
    pub rotation: [[R; 3]; 3],
    /// Position [m].
    pub position: [R; 3],
}

impl Pose {
    /// Identity: no rotation, no translation.
    pub const IDENTITY: Self =
        Self { rotation: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], position: [0.0; 3] };

    /// Creates a pose from a homogeneous 4×4 matrix, row-major.
    ///
    /// # Errors
    /// As [`Pose::validate`]; [`Error::Config`] if the last row is not `0 0 0 1`.
    pub fn from_rows(m: &[[f64; 4]; 4]) -> Result<Self> {
        Self::from_rows_of("pose", m)
    }

    /// Creates a pose as [`Pose::from_rows`]; `name` is the name of the argument in error messages.
    ///
    /// # Errors
    /// As [`Pose::from_rows`].
    pub fn from_rows_of(name: &str, m: &[[f64; 4]; 4]) -> Result<Self> {
        let Some(pose) = m.as_flattened().first_chunk().and_then(Self::from_unchecked_matrix) else {
            return Err(Self::no_homogeneous_matrix(name, m[3]));
        };
        pose.check(name)?;
        Ok(pose)
    }

    /// Returns the error for a matrix with this last row.
    #[cold]
    #[inline(never)]
    pub(crate) fn no_homogeneous_matrix(name: &str, [x, y, z, w]: [f64; 4]) -> Error {
        let hint = if (w - 1.0).abs() < 1e-9 { ": is the matrix transposed?" } else { "" };
        Error::config(name, format!("last row of a 4×4 pose must be 0 0 0 1, got {x} {y} {z} {w}{hint}"))
    }

    /// Creates a pose from a homogeneous matrix, row-major; `None` if the last row is not `0 0 0 1`. The other rows are
    /// unchecked.
    #[inline(always)]
    pub(crate) fn from_unchecked_matrix(m: &[f64; 16]) -> Option<Self> {
        if !(m[12].abs() < 1e-9 && m[13].abs() < 1e-9 && m[14].abs() < 1e-9 && (m[15] - 1.0).abs() < 1e-9) {
            return None;
        }
        let rotation = [[m[0], m[1], m[2]], [m[4], m[5], m[6]], [m[8], m[9], m[10]]];
        Some(Self { rotation, position: [m[3], m[7], m[11]] })
    }

    /// Returns the homogeneous 4×4 matrix, row-major.
    pub fn to_rows(&self) -> [[f64; 4]; 4] {
        let (r, p) = (&self.rotation, &self.position);
        [
            [r[0][0], r[0][1], r[0][2], p[0]],
            [r[1][0], r[1][1], r[1][2], p[1]],
            [r[2][0], r[2][1], r[2][2], p[2]],
            [0.0, 0.0, 0.0, 1.0],
        ]
    }

    /// Checks that the position is finite and within [`POSITION_BOUND`] and that the rotation matrix is valid.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a position, [`Error::Config`] for a rotation matrix.
    pub fn validate(&self) -> Result<()> {
        self.check("pose")
    }

    /// Checks the pose as [`Pose::validate`]; `name` is the name of the argument in error messages.
    #[inline]
    pub(crate) fn check(&self, name: &str) -> Result<()> {
        if self.validity_residual::<BaselineF64>(&TargetRegion::ANY) <= FAST_TOLERANCE {
            Ok(())
        } else {
            self.diagnose(name)
        }
    }

    /// Returns a sum of residuals: of the orthonormality of the first two rows of the rotation, of the third row
    /// against their cross product, and the scaled distance of the position from the centre of `region`. A pose with a
    /// sum of at most [`FAST_TOLERANCE`] is valid, so one comparison replaces many.
    #[inline(always)]
    fn validity_residual<A: RealOps<Real = f64>>(&self, region: &TargetRegion) -> f64 {
        let [x, y, z] = &self.rotation;
        let [a, b, c] = sub::<A>(&self.position, &region.centre);
        let off = sub::<A>(&cross::<A>(x, y), z);
        let lengths = A::abs(dot::<A>(x, x) - 1.0) + A::abs(dot::<A>(y, y) - 1.0);
        let angles = A::abs(dot::<A>(x, y)) + (A::abs(off[0]) + A::abs(off[1]) + A::abs(off[2]));
        // The sum of the absolute components is at least the distance.
        let far = A::abs(a) + A::abs(b) + A::abs(c);
        A::fma(region.tolerance_per_metre, far, lengths + angles)
    }

    /// Returns true if [`Pose::check`] would reject the pose or its position is outside `region`; tries the fast check
    /// first.
    #[inline(always)]
    pub(crate) fn is_invalid<A: RealOps<Real = f64>>(&self, region: &TargetRegion) -> bool {
        !(self.validity_residual::<A>(region) <= FAST_TOLERANCE) && self.is_invalid_slow(region)
    }

    /// Returns the result of [`Pose::is_invalid`] without the fast check.
    #[cold]
    #[inline(never)]
    fn is_invalid_slow(&self, region: &TargetRegion) -> bool {
        region.excludes(&self.position) || self.diagnose("").is_err()
    }

    /// Checks position and rotation one by one; returns an error that describes the first defect.
    #[cold]
    #[inline(never)]
    fn diagnose(&self, name: &str) -> Result<()> {
        for (axis, &value) in ["x", "y", "z"].iter().zip(&self.position) {
            if !(value.abs() <= POSITION_BOUND) {
                let hint = if value.is_finite() { "; is it in millimetres?" } else { "" };
                let bound = format!("±{POSITION_BOUND}{hint}");
                return Err(Error::out_of_range(format!("{name}: position {axis} [m]"), value, bound));
            }
        }
        let mut worst: f64 = 0.0;
        for i in 0..3 {
            for j in 0..3 {
                let error = orthogonality_error(&self.rotation, i, j);
                // `f64::max` would ignore a NaN.
                worst = if error > worst || error.is_nan() { error } else { worst };
            }
        }
        if worst <= ROTATION_TOLERANCE && determinant(&self.rotation) >= 0.0 {
            return Ok(());
        }
        if worst <= ROTATION_TOLERANCE {
            return Err(Error::config(name, "rotation part is a reflection (determinant −1); swap or negate an axis"));
        }
        Err(Error::config(
            name,
            format!(
                "rotation part is not a rotation: largest entry of RᵀR − I is {worst:.3e}, at most {ROTATION_TOLERANCE:e}"
            ),
        ))
    }

    /// Converts to nalgebra's isometry.
    pub fn to_isometry(&self) -> Isometry3<f64> {
        let r = &self.rotation;
        let m = Matrix3::new(r[0][0], r[0][1], r[0][2], r[1][0], r[1][1], r[1][2], r[2][0], r[2][1], r[2][2]);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(m));
        Isometry3::from_parts(Translation3::from(Vector3::from(self.position)), rotation)
    }

    /// Creates a pose from nalgebra's isometry.
    pub fn from_isometry(isometry: &Isometry3<f64>) -> Self {
        let m: Matrix4<f64> = isometry.to_homogeneous();
        Self {
            rotation: [
                [m[(0, 0)], m[(0, 1)], m[(0, 2)]],
                [m[(1, 0)], m[(1, 1)], m[(1, 2)]],
                [m[(2, 0)], m[(2, 1)], m[(2, 2)]],
            ],
            position: [m[(0, 3)], m[(1, 3)], m[(2, 3)]],
        }
    }

    /// Creates a pose from a position [m] and a quaternion w, x, y, z, which is then normalised.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] if the quaternion's norm differs from 1 by more than 1e-3, or for the position as
    /// [`Pose::validate`].
    pub fn from_wxyz(position: [f64; 3], wxyz: [f64; 4]) -> Result<Self> {
        let [w, x, y, z] = wxyz;
        let quaternion = Quaternion::new(w, x, y, z);
        let length = quaternion.norm();
        if !((length - 1.0).abs() <= QUATERNION_TOLERANCE) {
            return Err(Error::out_of_range("quaternion: length", length, format!("1 ± {QUATERNION_TOLERANCE}")));
        }
        let rotation = UnitQuaternion::new_normalize(quaternion).to_rotation_matrix();
        Self::checked(position, &rotation)
    }

    /// Creates a pose from a position [m] and a quaternion x, y, z, w, the order of ROS and SciPy, which is then
    /// normalised.
    ///
    /// # Errors
    /// As [`Pose::from_wxyz`].
    pub fn from_xyzw(position: [f64; 3], xyzw: [f64; 4]) -> Result<Self> {
        let [x, y, z, w] = xyzw;
        Self::from_wxyz(position, [w, x, y, z])
    }

    /// Creates a pose from a position [m] and a rotation vector [rad] (axis times angle).
    ///
    /// # Errors
    /// As [`Pose::validate`].
    pub fn from_rotation_vector(position: [f64; 3], vector: [f64; 3]) -> Result<Self> {
        let pose = Self { rotation: rotation_matrix(vector), position };
        pose.validate()?;
        Ok(pose)
    }

    /// Creates a pose from a position [m] and roll, pitch, yaw [rad] about the fixed axes x, y, z, in this order, as in
    /// a URDF.
    ///
    /// # Errors
    /// As [`Pose::validate`].
    pub fn from_rpy(position: [f64; 3], rpy: [f64; 3]) -> Result<Self> {
        Self::checked(position, &Rotation3::from_euler_angles(rpy[0], rpy[1], rpy[2]))
    }

    fn checked(position: [f64; 3], rotation: &Rotation3<f64>) -> Result<Self> {
        let m = rotation.matrix();
        let row = |i: usize| [m[(i, 0)], m[(i, 1)], m[(i, 2)]];
        let pose = Self { rotation: [row(0), row(1), row(2)], position };
        pose.validate()?;
        Ok(pose)
    }

    /// Returns the rotation as a quaternion w, x, y, z with w ≥ 0.
    pub fn wxyz(&self) -> [f64; 4] {
        let q = self.to_isometry().rotation;
        let sign = if q.w < 0.0 { -1.0 } else { 1.0 };
        [q.w, q.i, q.j, q.k].map(|value| sign * value)
    }

    /// Returns the rotation as a quaternion x, y, z, w with w ≥ 0.
    pub fn xyzw(&self) -> [f64; 4] {
        let [w, x, y, z] = self.wxyz();
        [x, y, z, w]
    }

    /// Returns the rotation as a rotation vector (axis times angle) [rad] of norm at most π.
    pub fn rotation_vector(&self) -> [f64; 3] {
        rotation_vector(&self.rotation)
    }

    /// Returns the inverse pose, `tool_from_base`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let r = &self.rotation;
        let column = |i: usize| [r[0][i], r[1][i], r[2][i]];
        let position = tr_rotate::<BaselineF64>(r, &self.position).map(|x| -x);
        Self { rotation: [column(0), column(1), column(2)], position }
    }

    /// Returns `a_from_c` from `self` = `a_from_b` and `other` = `b_from_c`.
    #[must_use]
    pub fn compose(&self, other: &Self) -> Self {
        let moved = rotate::<BaselineF64>(&self.rotation, &other.position);
        Self {
            rotation: multiply::<BaselineF64>(&self.rotation, &other.rotation),
            position: add::<BaselineF64>(&self.position, &moved),
        }
    }
}

/// Returns the absolute value of entry (i, j) of `RᵀR − I`.
fn orthogonality_error(r: &Mat3, i: usize, j: usize) -> f64 {
    let product = dot::<BaselineF64>(&[r[0][i], r[1][i], r[2][i]], &[r[0][j], r[1][j], r[2][j]]);
    (product - f64::from(u8::from(i == j))).abs()
}

fn determinant(r: &Mat3) -> f64 {
    dot::<BaselineF64>(&r[0], &cross::<BaselineF64>(&r[1], &r[2]))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: &Pose, b: &Pose) {
        let (a, b) = (a.to_rows(), b.to_rows());
        for (x, y) in a.iter().flatten().zip(b.iter().flatten()) {
            assert!((x - y).abs() < 1e-14, "{a:?} {b:?}");
        }
    }

    #[test]
    fn representations_of_a_rotation_agree() {
        let (p, half) = ([0.1, -0.2, 0.3], std::f64::consts::FRAC_PI_4);
        let turned = Pose { position: p, rotation: [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]] };
        close(&Pose::from_wxyz(p, [half.cos(), 0.0, 0.0, half.sin()]).unwrap(), &turned);
        close(&Pose::from_rotation_vector(p, [0.0, 0.0, 2.0 * half]).unwrap(), &turned);
        close(&Pose::from_rpy(p, [0.0, 0.0, 2.0 * half]).unwrap(), &turned);
        close(&Pose::from_wxyz(p, turned.wxyz()).unwrap(), &turned);
        close(&Pose::from_xyzw(p, [0.0, 0.0, half.sin(), half.cos()]).unwrap(), &turned);
        close(&Pose::from_xyzw(p, turned.xyzw()).unwrap(), &turned);
    }

    #[test]
    fn roll_comes_first_and_about_fixed_axes() {
        let roll = Pose::from_rpy([0.0; 3], [0.3, 0.0, 0.0]).unwrap();
        let pitch = Pose::from_rpy([0.0; 3], [0.0, 0.5, 0.0]).unwrap();
        let yaw = Pose::from_rpy([0.0; 3], [0.0, 0.0, -0.7]).unwrap();
        close(&Pose::from_rpy([0.0; 3], [0.3, 0.5, -0.7]).unwrap(), &yaw.compose(&pitch).compose(&roll));
    }

    #[test]
    fn a_pose_times_its_inverse_is_the_identity() {
        let pose = Pose::from_rpy([1.0, 2.0, 3.0], [0.3, 0.5, -0.7]).unwrap();
        close(&pose.compose(&pose.inverse()), &Pose::IDENTITY);
    }

    #[test]
    fn xyzw_has_the_components_of_wxyz() {
        let pose = Pose::from_rpy([0.1, -0.2, 0.3], [0.3, 0.5, -0.7]).unwrap();
        let ([w, x, y, z], xyzw) = (pose.wxyz(), pose.xyzw());
        assert_eq!(xyzw.map(f64::to_bits), [x, y, z, w].map(f64::to_bits));
    }

    #[test]
    fn a_quaternion_of_length_other_than_one_is_refused() {
        let message = Pose::from_wxyz([0.0; 3], [0.5, 0.0, 0.0, 0.0]).unwrap_err().to_string();
        assert_eq!(message, "quaternion: length = 0.5 is outside 1 ± 0.001");
    }
}
