//! Target adaptation, equation (12) of the paper, and the blend between the two sides of an axis.

use crate::math::rotation::rotation_matrix;
use crate::math::simd::{BaselineF64, RealOps};
use crate::pose::Pose;
use crate::task::compliance::clamp01;
use crate::task::pose_error;

/// Returns the weight, 0 to 1, of the values for an axis pushed toward + (tool beyond its target, deviation e < 0);
/// `slope` is 1 / (2 `band`).
///
/// Within ± `band` the weight is linear in `e`, so that encoder noise does not switch it; with `band` = 0 it switches
/// at zero.
#[inline(always)]
pub(crate) fn push_side_blend<A: RealOps>(e: A::Real, band: A::Real, slope: A::Real) -> A::Real {
    let (zero, one) = (A::splat(0.0), A::splat(1.0));
    let linear = clamp01::<A>(A::fnma(e, slope, A::splat(0.5)));
    A::select_lt(zero, band, linear, A::select_lt(e, zero, one, zero))
}

/// Returns the adapted deviation `ẽ = (1 − η w) e` of one axis or of a vector of axes. This form of the paper's
/// equation (12) has no memory, so it does not depend on the control rate.
#[inline(always)]
pub(crate) fn adapt_deviation<A: RealOps>(e: A::Real, eta: A::Real, softness: A::Real) -> A::Real {
    A::fnma(eta, softness, A::splat(1.0)) * e
}

/// Returns the intermediate target, equation (12) of the paper, as a pose: `x_d + η (x − x_d)` on the compliant axes,
/// `x_d` on the others, in base axes.
///
/// For rotations, η scales components of the rotation vector of the deviation, not Euler angles.
pub fn adapt_target(actual: &Pose, target: &Pose, eta: f64, compliant: [bool; 6]) -> Pose {
    let e = pose_error(actual, target);
    let mut adapted = e;
    for (value, on) in adapted.iter_mut().zip(compliant) {
        *value = adapt_deviation::<BaselineF64>(*value, eta, f64::from(u8::from(on)));
    }
    let turn = rotation_matrix([adapted[3], adapted[4], adapted[5]]);
    let mut out = *actual;
    for i in 0..3 {
        out.position[i] += adapted[i];
        for j in 0..3 {
            out.rotation[i][j] = (0..3).map(|k| turn[i][k] * actual.rotation[k][j]).sum();
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sides_are_named_by_the_push() {
        for (e, band, slope, share) in [
            (-1.0, 0.001, 500.0, 1.0),
            (1.0, 0.001, 500.0, 0.0),
            (0.0, 0.001, 500.0, 0.5),
            (0.0005, 0.001, 500.0, 0.25),
            (-1e-9, 0.0, f64::INFINITY, 1.0),
            (0.0, 0.0, f64::INFINITY, 0.0),
        ] {
            assert!((push_side_blend::<BaselineF64>(e, band, slope) - share).abs() < f64::EPSILON, "{e} within {band}");
        }
    }

    #[test]
    fn full_adaptation_leaves_the_stiff_axes_at_their_target() {
        let target = Pose { position: [1.0, 2.0, 3.0], rotation: rotation_matrix([0.0, 0.0, 0.5]) };
        let adapted = adapt_target(&Pose::IDENTITY, &target, 0.75, [true, false, false, false, false, true]);
        let e = pose_error(&Pose::IDENTITY, &adapted);
        for (value, expected) in e.iter().zip([0.25, 2.0, 3.0, 0.0, 0.0, 0.125]) {
            assert!((value - expected).abs() < 1e-14, "{e:?}");
        }
    }
}
