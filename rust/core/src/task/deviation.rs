//! Deviation between two poses, e = x_d − x.

use crate::AxisVec;
use crate::number::{Plain, quadrant_angle, sin_cos};
use crate::pose::Pose;

/// Deviation `e = x_d − x` in base axes: `[m, m, m, rad, rad, rad]`.
///
/// Linear part: difference of the positions. Angular part: rotation vector of `R_d Rᵀ` on the shortest branch; at an
/// angle of exactly π the axis is the one of the quaternion with non-negative scalar part.
#[inline(always)]
pub fn pose_error(actual: &Pose, target: &Pose) -> AxisVec {
    let (r, d) = (&actual.rotation, &target.rotation);
    let mut m = [[0.0; 3]; 3];
    for i in 0..3 {
        for j in 0..3 {
            m[i][j] = d[i][0] * r[j][0] + d[i][1] * r[j][1] + d[i][2] * r[j][2];
        }
    }
    let w = rotation_vector(&m);
    [
        target.position[0] - actual.position[0],
        target.position[1] - actual.position[1],
        target.position[2] - actual.position[2],
        w[0],
        w[1],
        w[2],
    ]
}

/// Rotation vector [rad] of a rotation matrix (row-major), of length at most π.
///
/// By way of the quaternion, whose largest component is found first: accurate at 0 and at π, where the trace formula
/// loses half the digits.
#[inline(always)]
pub fn rotation_vector(m: &[[f64; 3]; 3]) -> [f64; 3] {
    let trace = m[0][0] + m[1][1] + m[2][2];
    let (mut w, mut v) = if trace > 0.0 {
        let s = (1.0 + trace).sqrt();
        let f = 0.5 / s;
        (0.5 * s, [(m[2][1] - m[1][2]) * f, (m[0][2] - m[2][0]) * f, (m[1][0] - m[0][1]) * f])
    } else {
        let i = if m[0][0] >= m[1][1] && m[0][0] >= m[2][2] {
            0
        } else if m[1][1] >= m[2][2] {
            1
        } else {
            2
        };
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let s = (1.0 + m[i][i] - m[j][j] - m[k][k]).max(0.0).sqrt();
        let f = if s > 0.0 { 0.5 / s } else { 0.0 };
        let mut v = [0.0; 3];
        v[i] = 0.5 * s;
        v[j] = (m[j][i] + m[i][j]) * f;
        v[k] = (m[k][i] + m[i][k]) * f;
        ((m[k][j] - m[j][k]) * f, v)
    };
    if w < 0.0 {
        w = -w;
        v = [-v[0], -v[1], -v[2]];
    }
    let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
    // Below 1e-8 the series 2 (1 + |v|²/6) is 2 in double precision.
    let scale = if length < 1e-8 { 2.0 } else { 2.0 * quadrant_angle(length, w) / length };
    [scale * v[0], scale * v[1], scale * v[2]]
}

/// Rotation matrix (row-major) of a rotation vector [rad]: Rodrigues' formula.
#[inline(always)]
pub fn rotation_matrix(v: [f64; 3]) -> [[f64; 3]; 3] {
    let angle2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    let angle = angle2.sqrt();
    let (a, b) = if angle < 1e-6 {
        (1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0)
    } else {
        let (s, c) = sin_cos::<Plain>(0.5 * angle);
        let half = s / (0.5 * angle);
        (half * c, 0.5 * half * half)
    };
    let [x, y, z] = v;
    [
        [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
        [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x],
        [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)],
    ]
}

/// A 6-vector of base axes in the axes whose unit vectors are the columns of `base_from_task`.
#[inline(always)]
pub(crate) fn into_frame(base_from_task: &[[f64; 3]; 3], v: &AxisVec) -> AxisVec {
    let r = base_from_task;
    let turn = |a: f64, b: f64, c: f64, i: usize| r[0][i] * a + r[1][i] * b + r[2][i] * c;
    [
        turn(v[0], v[1], v[2], 0),
        turn(v[0], v[1], v[2], 1),
        turn(v[0], v[1], v[2], 2),
        turn(v[3], v[4], v[5], 0),
        turn(v[3], v[4], v[5], 1),
        turn(v[3], v[4], v[5], 2),
    ]
}

/// Both halves of a 6-vector turned from the task frame into base axes.
pub(crate) fn out_of_frame(base_from_task: &[[f64; 3]; 3], v: &AxisVec) -> AxisVec {
    std::array::from_fn(|i| (0..3).map(|k| base_from_task[i % 3][k] * v[3 * (i / 3) + k]).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    fn close(a: [f64; 3], b: [f64; 3], tolerance: f64) {
        for (x, y) in a.iter().zip(b) {
            assert!((x - y).abs() <= tolerance, "{a:?} {b:?}");
        }
    }

    #[test]
    fn logarithm_inverts_the_exponential_near_zero_at_one_and_near_pi() {
        let axis = [0.36, -0.48, 0.8];
        for angle in [0.0, 1e-12, 1e-9, 1e-7, 1e-4, 0.3, 1.0, 2.0, 3.0, PI - 1e-4, PI - 1e-9] {
            let v = axis.map(|a| a * angle);
            close(rotation_vector(&rotation_matrix(v)), v, 1e-9_f64.min(1e-15 + angle * 1e-9));
        }
    }

    #[test]
    fn half_turns_have_length_pi() {
        for axis in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.6, 0.0, -0.8], [0.36, -0.48, 0.8]] {
            let v = rotation_vector(&rotation_matrix(axis.map(|a| a * PI)));
            let length = (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]).sqrt();
            assert!((length - PI).abs() < 1e-12, "{v:?}");
            let cosine = (v[0] * axis[0] + v[1] * axis[1] + v[2] * axis[2]) / length;
            assert!((cosine.abs() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn the_shortest_branch_is_taken() {
        let v = rotation_vector(&rotation_matrix([0.0, 0.0, 1.5 * PI]));
        close(v, [0.0, 0.0, -0.5 * PI], 1e-12);
    }
}
