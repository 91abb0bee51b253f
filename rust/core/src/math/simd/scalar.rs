//! Scalars of one configuration: `f64`, with and without fused multiply-add.
#![forbid(unsafe_code)]

use super::{Arithmetic, Spread};

/// `f64` with the baseline of the architecture: on aarch64 with fused multiply-add, elsewhere without.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Plain;

/// `f64` on x86-64 processors with fused multiply-add.
#[cfg(target_arch = "x86_64")]
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fused;

/// Swaps and negates sine and cosine for the quadrant in the last bits of `turns`.
#[inline(always)]
pub(super) fn turn(turns: f64, sine: f64, cosine: f64) -> (f64, f64) {
    let quadrant = turns.to_bits();
    // Odd quadrants swap the two; the sign bits follow from the quadrant.
    let swap = (quadrant & 1).wrapping_neg();
    let (s, c) = (sine.to_bits(), cosine.to_bits());
    let exchanged = (s ^ c) & swap;
    let sine_sign = (quadrant & 2) << 62;
    let cosine_sign = (quadrant.wrapping_add(1) & 2) << 62;
    (f64::from_bits((s ^ exchanged) ^ sine_sign), f64::from_bits((c ^ exchanged) ^ cosine_sign))
}

macro_rules! scalar {
    ($name:ident, ($a:ident, $b:ident, $c:ident), $fma:expr, $fnma:expr) => {
        impl Arithmetic for $name {
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
            fn at_least(value: f64, bound: f64) -> f64 {
                if value < bound { bound } else { value }
            }

            #[inline(always)]
            fn at_most(value: f64, bound: f64) -> f64 {
                if value > bound { bound } else { value }
            }

            #[inline(always)]
            fn copy_sign(size: f64, sign: f64) -> f64 {
                size.copysign(sign)
            }

            #[inline(always)]
            fn if_less(a: f64, b: f64, then: f64, otherwise: f64) -> f64 {
                if a < b { then } else { otherwise }
            }

            #[inline(always)]
            fn less_anywhere(a: f64, b: f64) -> bool {
                a < b
            }

            #[inline(always)]
            fn power_of_two(sum: f64) -> f64 {
                f64::from_bits((sum.to_bits() << 52).wrapping_add(1023 << 52))
            }

            #[inline(always)]
            fn turn(turns: f64, s: f64, c: f64) -> (f64, f64) {
                turn(turns, s, c)
            }
        }

        impl Spread<f64> for $name {
            #[inline(always)]
            fn spread(value: f64) -> f64 {
                value
            }
        }
    };
}

#[cfg(not(target_arch = "aarch64"))]
scalar!(Plain, (a, b, c), a * b + c, c - a * b);
#[cfg(target_arch = "aarch64")]
scalar!(Plain, (a, b, c), a.mul_add(b, c), (-a).mul_add(b, c));
#[cfg(target_arch = "x86_64")]
scalar!(Fused, (a, b, c), a.mul_add(b, c), (-a).mul_add(b, c));
