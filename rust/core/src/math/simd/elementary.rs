//! Elementary functions without calls of the system's library: vectorizable, with identical results on every system.
#![forbid(unsafe_code)]

use super::{ROUND, RealOps};

/// tan(π/8): boundary between the two expansion points of the arctangent series.
const TAN_EIGHTH: f64 = 0.414_213_562_373_095_05;

/// Coefficients, lowest power first, of the minimax polynomial in u for `(atan √u / √u − 1) / u` up to u = tan²(π/8);
/// its error is at most 1.2e-18.
const ARC: [f64; 12] = [
    -0.333_333_333_333_333_3,
    0.199_999_999_999_998_04,
    -0.142_857_142_856_597_5,
    0.111_111_111_051_477_64,
    -0.090_909_087_531_185_94,
    0.076_922_963_639_799_5,
    -0.066_664_246_872_464_86,
    0.058_789_267_157_565_87,
    -0.052_304_374_642_507_85,
    0.045_515_165_635_866_286,
    -0.034_568_590_668_521_22,
    0.016_283_572_356_395_895,
];

/// Returns the angle [rad] of the point (x, y) in the first quadrant, with an error of at most 3e-16; 0 for the origin.
#[inline(always)]
pub(crate) fn atan2_first_quadrant<A: RealOps>(y: A::Real, x: A::Real) -> A::Real {
    let c = A::splat;
    let (small, large) = (A::min(y, x), A::max(y, x));
    // Above tan(π/8) the angle is computed relative to the diagonal, so that one division serves both cases.
    let edge = c(TAN_EIGHTH) * large;
    let up = A::select_lt(edge, small, small - large, small);
    let down = A::select_lt(edge, small, small + large, large);
    let from = A::select_lt(edge, small, c(std::f64::consts::FRAC_PI_4), c(0.0));
    let t = up / A::max(down, c(f64::MIN_POSITIVE));
    let u = t * t;
    let angle = from + A::fma(t * u, arc_series::<A>(u), t);
    A::select_lt(x, y, c(std::f64::consts::FRAC_PI_2) - angle, angle)
}

/// Returns `atan(y/x) / y`, given `squared = y²`, for x > 0 and y at most x tan(π/8). Uses no square root, and no
/// division by y.
#[inline(always)]
pub(crate) fn atan_over_y<A: RealOps>(squared: A::Real, x: A::Real) -> A::Real {
    let per_x = A::splat(1.0) / x;
    let u = squared * (per_x * per_x);
    A::fma(per_x * u, arc_series::<A>(u), per_x)
}

/// Returns true if y is at most x tan(π/8), as [`atan_over_y`] requires; `squared` is y².
#[inline(always)]
pub(crate) fn is_small_angle(squared: f64, x: f64) -> bool {
    !(TAN_EIGHTH * TAN_EIGHTH * (x * x) < squared)
}

/// Returns `(atan √u / √u − 1) / u` for u up to tan²(π/8), in groups of four terms that are computed in parallel.
#[inline(always)]
fn arc_series<A: RealOps>(u: A::Real) -> A::Real {
    let c = A::splat;
    let (u2, u4) = (u * u, u * u * u * u);
    let mut fours = [c(0.0); 3];
    for i in 0..3 {
        let low = A::fma(u, c(ARC[4 * i + 1]), c(ARC[4 * i]));
        fours[i] = A::fma(u2, A::fma(u, c(ARC[4 * i + 3]), c(ARC[4 * i + 2])), low);
    }
    A::fma(u4, A::fma(u4, fours[2], fours[1]), fours[0])
}

/// Returns the hyperbolic tangent, with an absolute error of at most 5e-16; NaN if `x` is NaN.
#[inline(always)]
pub(crate) fn tanh<A: RealOps>(x: A::Real) -> A::Real {
    const LN_2: [f64; 2] = [6.931_471_803_691_238e-1, 1.908_214_929_270_587_7e-10];
    let c = A::splat;
    // For 2 |x| above 40, tanh is ±1 up to rounding.
    let y = A::max(c(-2.0) * A::abs(x), c(-40.0));
    let shifted = A::fma(y, c(std::f64::consts::LOG2_E), c(ROUND));
    let exponent = shifted - c(ROUND);
    let r = A::fnma(exponent, c(LN_2[1]), A::fnma(exponent, c(LN_2[0]), y));
    let r2 = r * r;
    let r4 = r2 * r2;
    // Taylor series of the exponential function: the first omitted term is below 1e-17.
    let low = A::fma(r2, A::fma(r, c(1.0 / 6.0), c(0.5)), c(1.0) + r);
    let middle = A::fma(r2, A::fma(r, c(1.0 / 5_040.0), c(1.0 / 720.0)), A::fma(r, c(1.0 / 120.0), c(1.0 / 24.0)));
    let high = A::fma(
        r2,
        A::fma(r, c(1.0 / 39_916_800.0), c(1.0 / 3_628_800.0)),
        A::fma(r, c(1.0 / 362_880.0), c(1.0 / 40_320.0)),
    );
    let top = A::fma(r, c(1.0 / 6_227_020_800.0), c(1.0 / 479_001_600.0));
    let fraction = A::fma(r4, A::fma(r4, A::fma(r4, top, high), middle), low);
    let e = fraction * A::exp2_int(shifted);
    A::copy_sign((c(1.0) - e) / (c(1.0) + e), x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::simd::BaselineF64;

    /// Number of samples of a range. Miri takes milliseconds for each.
    const SAMPLES: i32 = if cfg!(miri) { 100 } else { 100_000 };

    #[test]
    fn quadrant_angles_agree_with_atan2() {
        for i in 0..=SAMPLES {
            let (y, x) = (f64::from(i) / f64::from(SAMPLES) * std::f64::consts::FRAC_PI_2).sin_cos();
            let off = (atan2_first_quadrant::<BaselineF64>(y, x) - y.atan2(x)).abs();
            assert!(off <= 3e-16, "{i}: {off:e}");
        }
        for small in [1e-300, 1e-9, 1e-3] {
            assert!((atan2_first_quadrant::<BaselineF64>(small, 1.0) / small.atan() - 1.0).abs() <= 3e-16);
        }
        assert_eq!(atan2_first_quadrant::<BaselineF64>(0.0, 0.0).to_bits(), 0.0_f64.to_bits());
    }

    #[test]
    fn narrow_angles_agree_with_atan2() {
        for i in 0..=SAMPLES {
            let (y, x) = (f64::from(i) / f64::from(SAMPLES) * std::f64::consts::FRAC_PI_8, 1.7_f64);
            let (y, x) = (x * y.sin(), x * y.cos());
            let off = (y * atan_over_y::<BaselineF64>(y * y, x) - y.atan2(x)).abs();
            assert!(off <= 2e-16 && is_small_angle(0.999 * y * y, x), "{i}: {off:e}");
        }
        assert!(!is_small_angle(0.172, 1.0) && is_small_angle(0.171, 1.0));
        assert!((atan_over_y::<BaselineF64>(0.0, 4.0) - 0.25).abs() < f64::EPSILON);
    }

    #[test]
    fn hyperbolic_tangents_agree_with_the_system() {
        for i in -2 * SAMPLES..2 * SAMPLES {
            let x = f64::from(i) * 17.0 / f64::from(SAMPLES);
            let off = (tanh::<BaselineF64>(x) - x.tanh()).abs();
            assert!(off <= 5e-16, "{x}: {off:e}");
        }
        assert!(
            (tanh::<BaselineF64>(1e9) - 1.0).abs() < f64::EPSILON
                && (tanh::<BaselineF64>(-1e300) + 1.0).abs() < f64::EPSILON
        );
        assert!(tanh::<BaselineF64>(f64::NAN).is_nan() && tanh::<BaselineF64>(0.0).to_bits() == 0);
    }
}
