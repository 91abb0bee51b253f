//! Conversion between rotation vectors and rotation matrices; rotation of 6-vectors between base and task axes.

use super::simd::{BaselineF64, RealOps, atan_over_y, atan2_first_quadrant, is_small_angle, sin_cos};
use super::spatial::{Mat3, Vec3, dot, tr_rotate};
use crate::AxisVec;

/// Returns the rotation vector [rad] of a rotation matrix (row-major), of length at most π.
///
/// Computed from the quaternion, starting with its largest component. This is accurate at 0 and at π, where the formula
/// with the trace loses half of the digits.
#[inline(always)]
pub(crate) fn rotation_vector(m: &[[f64; 3]; 3]) -> [f64; 3] {
    rotation_vector_by::<BaselineF64>(m)
}

/// Computes [`rotation_vector`] with the scalar operations of an instruction set.
#[inline(always)]
pub(crate) fn rotation_vector_by<A: RealOps<Real = f64>>(m: &Mat3) -> Vec3 {
    let trace = m[0][0] + m[1][1] + m[2][2];
    // Four times the products of the quaternion's largest component with all components: scalar, x, y, z.
    let turned = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]];
    let mut products = [1.0 + trace, turned[0], turned[1], turned[2]];
    let squared = dot::<A>(&turned, &turned);
    // Fast path for angles up to an eighth of a turn, the usual case.
    if is_small_angle(squared, products[0]) && !(trace < 0.0) {
        let half = atan_over_y::<A>(squared, products[0]);
        let scale = half + half;
        return [scale * turned[0], scale * turned[1], scale * turned[2]];
    }
    if trace < 0.0 {
        let shared = [m[1][0] + m[0][1], m[0][2] + m[2][0], m[2][1] + m[1][2]];
        let twice = [m[0][0] + m[0][0], m[1][1] + m[1][1], m[2][2] + m[2][2]];
        let rest = 1.0 - trace;
        let x = [turned[0], rest + twice[0], shared[0], shared[1]];
        let y = [turned[1], shared[0], rest + twice[1], shared[2]];
        let z = [turned[2], shared[1], shared[2], rest + twice[2]];
        let larger = A::max(m[0][0], m[1][1]);
        for i in 0..4 {
            let of_two = A::select_lt(m[0][0], m[1][1], y[i], x[i]);
            products[i] = A::select_lt(larger, m[2][2], z[i], of_two);
        }
    }
    // atan2 does not depend on a common scale, so the quaternion is not normalized. For a small angle, the errors of
    // the two arguments cancel.
    let [w, x, y, z] = products;
    let length = A::sqrt(dot::<A>(&[x, y, z], &[x, y, z]));
    let angle = atan2_first_quadrant::<A>(length, A::abs(w));
    let scale = A::copy_sign((angle + angle) / A::max(length, f64::MIN_POSITIVE), w);
    [scale * x, scale * y, scale * z]
}

/// Returns the rotation matrix (row-major) of a rotation vector [rad], by Rodrigues' formula.
#[inline(always)]
pub(crate) fn rotation_matrix(v: [f64; 3]) -> [[f64; 3]; 3] {
    rotation_matrix_by::<BaselineF64>(v)
}

/// Computes [`rotation_matrix`] with the scalar operations of an instruction set.
#[inline(always)]
pub(crate) fn rotation_matrix_by<A: RealOps<Real = f64>>(v: [f64; 3]) -> Mat3 {
    let angle2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    let angle = angle2.sqrt();
    let (a, b) = if angle < 1e-6 {
        (1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0)
    } else {
        let (s, c) = sin_cos::<A>(0.5 * angle);
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

/// Rotates both halves of a 6-vector from base axes into the task axes, the columns of `base_from_task`.
#[inline(always)]
pub(crate) fn base_to_task<A: RealOps<Real = f64>>(base_from_task: &Mat3, v: &AxisVec) -> AxisVec {
    let [x, y, z] = tr_rotate::<A>(base_from_task, &[v[0], v[1], v[2]]);
    let [roll, pitch, yaw] = tr_rotate::<A>(base_from_task, &[v[3], v[4], v[5]]);
    [x, y, z, roll, pitch, yaw]
}

/// Rotates both halves of a 6-vector from the task axes, the columns of `base_from_task`, into base axes.
pub(crate) fn task_to_base(base_from_task: &[[f64; 3]; 3], v: &AxisVec) -> AxisVec {
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
