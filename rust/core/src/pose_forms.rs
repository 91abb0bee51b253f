//! Other forms of a pose: quaternions, rotation vectors, roll-pitch-yaw; composition and inverse.

use nalgebra::{Quaternion, Rotation3, UnitQuaternion};

use crate::error::{Error, Result};
use crate::pose::Pose;
use crate::task::deviation::{rotation_matrix, rotation_vector};

/// Allowed difference of a quaternion's norm from 1.
const QUATERNION_TOLERANCE: f64 = 1e-3;

impl Pose {
    /// Creates a pose from a position [m] and a quaternion w, x, y, z, which is normalised.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for a quaternion whose norm is not 1 within 1e-3; as [`Pose::validate`] for the position.
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

    /// [`Pose::from_wxyz`] with w last: x, y, z, w, the order of ROS and SciPy.
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

    /// Returns the rotation as a vector [rad] of norm at most π.
    pub fn rotation_vector(&self) -> [f64; 3] {
        rotation_vector(&self.rotation)
    }

    /// Returns the pose of the base in the tool.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let (r, p) = (&self.rotation, &self.position);
        let column = |i: usize| [r[0][i], r[1][i], r[2][i]];
        let back = |i: usize| -(r[0][i] * p[0] + r[1][i] * p[1] + r[2][i] * p[2]);
        Self { rotation: [column(0), column(1), column(2)], position: [back(0), back(1), back(2)] }
    }

    /// Returns `a_from_c` from `self` = `a_from_b` and `other` = `b_from_c`.
    #[must_use]
    pub fn compose(&self, other: &Self) -> Self {
        let r = &self.rotation;
        let entry = |i: usize, j: usize| (0..3).map(|k| r[i][k] * other.rotation[k][j]).sum();
        let row = |i: usize| [entry(i, 0), entry(i, 1), entry(i, 2)];
        let moved = |i: usize| self.position[i] + (0..3).map(|k| r[i][k] * other.position[k]).sum::<f64>();
        Self { rotation: [row(0), row(1), row(2)], position: [moved(0), moved(1), moved(2)] }
    }
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
    fn forms_agree() {
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
    fn a_pose_times_its_inverse_is_nothing() {
        let pose = Pose::from_rpy([1.0, 2.0, 3.0], [0.3, 0.5, -0.7]).unwrap();
        close(&pose.compose(&pose.inverse()), &Pose::IDENTITY);
    }

    #[test]
    fn the_order_of_a_quaternion_is_in_its_name() {
        let pose = Pose::from_rpy([0.1, -0.2, 0.3], [0.3, 0.5, -0.7]).unwrap();
        let ([w, x, y, z], xyzw) = (pose.wxyz(), pose.xyzw());
        assert_eq!(xyzw.map(f64::to_bits), [x, y, z, w].map(f64::to_bits));
    }

    #[test]
    fn a_quaternion_of_another_length_is_refused() {
        let message = Pose::from_wxyz([0.0; 3], [0.5, 0.0, 0.0, 0.0]).unwrap_err().to_string();
        assert_eq!(message, "quaternion: length = 0.5 is outside 1 ± 0.001");
    }
}
