//! Scalar operations on `f64`, with and without fused multiply-add.
#![forbid(unsafe_code)]

use super::RealOps;

/// Operations on `f64` with the baseline instruction set of the architecture: with fused multiply-add on aarch64,
/// elsewhere without.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BaselineF64;

/// Operations on `f64` with fused multiply-add, for x86-64 processors that have it.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy)]
pub(crate) struct FmaF64;

/// Rotates (cosine, sine) by quarter turns; their number is in the low mantissa bits of `shifted` (see `super::ROUND`).
#[inline(always)]
pub(super) fn rotate_quadrant(shifted: f64, sine: f64, cosine: f64) -> (f64, f64) {
    let quadrant = shifted.to_bits();
    // An odd number of quarter turns swaps sine and cosine; the last two bits determine the signs.
    let swap = (quadrant & 1).wrapping_neg();
    let (s, c) = (sine.to_bits(), cosine.to_bits());
    let exchanged = (s ^ c) & swap;
    let sine_sign = (quadrant & 2) << 62;
    let cosine_sign = (quadrant.wrapping_add(1) & 2) << 62;
    (f64::from_bits((s ^ exchanged) ^ sine_sign), f64::from_bits((c ^ exchanged) ^ cosine_sign))
}

macro_rules! scalar {
    ($name:ident, ($a:ident, $b:ident, $c:ident), $fma:expr, $fnma:expr) => {
        impl RealOps for $name {
            type Real = f64;

            const WIDE: bool = false;

            #[inline(always)]
            fn splat(value: f64) -> f64 {
                value
            }

            #[inline(always)]
            fn fma($a: f64, $b: f64, $c: f64) -> f64 {
                $fma
            }

            #[inline(always)]
            fn fnma($a: f64, $b: f64, $c: f64) -> f64 {
                $fnma
            }

            #[inline(always)]
            fn sqrt(value: f64) -> f64 {
                value.sqrt()
            }

            #[inline(always)]
            fn abs(value: f64) -> f64 {
                value.abs()
            }

            #[inline(always)]
            fn max(value: f64, bound: f64) -> f64 {
                if value < bound { bound } else { value }
            }

            #[inline(always)]
            fn min(value: f64, bound: f64) -> f64 {
                if value > bound { bound } else { value }
            }

            #[inline(always)]
            fn copy_sign(size: f64, sign: f64) -> f64 {
                size.copysign(sign)
            }

            #[inline(always)]
            fn select_lt(a: f64, b: f64, then: f64, otherwise: f64) -> f64 {
                if a < b { then } else { otherwise }
            }

            #[inline(always)]
            fn exp2_int(shifted: f64) -> f64 {
                f64::from_bits((shifted.to_bits() << 52).wrapping_add(1023 << 52))
            }

            #[inline(always)]
            fn rotate_quadrant(shifted: f64, s: f64, c: f64) -> (f64, f64) {
                rotate_quadrant(shifted, s, c)
            }
        }
    };
}

#[cfg(not(target_arch = "aarch64"))]
scalar!(BaselineF64, (a, b, c), a * b + c, c - a * b);
#[cfg(target_arch = "aarch64")]
scalar!(BaselineF64, (a, b, c), a.mul_add(b, c), (-a).mul_add(b, c));
#[cfg(target_arch = "x86_64")]
scalar!(FmaF64, (a, b, c), a.mul_add(b, c), (-a).mul_add(b, c));
