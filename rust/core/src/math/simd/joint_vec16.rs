//! Vector of one number per joint, padded to 16, with the baseline instruction set only; for code that is compiled
//! once.
#![forbid(unsafe_code)]

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::dispatch::BaselineF64x8;
use super::scalar::{BaselineF64, rotate_quadrant};
use super::{JointVector, PaddedVec3, RealOps, ScalarVec3};
use crate::{JointVec, MAX_JOINTS};

/// One number per joint, padded to 16: for arms with more than [`LANES`](super::LANES) joints and for code that runs
/// rarely.
///
/// Each operation is a function call that is not inlined: inlined operations made the control step of a large arm a
/// sixth of the size of the Python wheel.
#[derive(Debug, Clone, Copy)]
pub(crate) struct JointVec16(
    JointVec,
    #[expect(dead_code, reason = "the padding makes the compiler copy it by a call")] u64,
);

/// Evaluates an elementwise operation as a call.
macro_rules! each {
    ($of_one:path, $first:ident $(, $argument:ident)*) => {{
        #[inline(never)]
        fn each($first: &JointVec16 $(, $argument: &JointVec16)*) -> JointVec16 {
            let mut out = [0.0; MAX_JOINTS];
            for i in 0..MAX_JOINTS {
                out[i] = $of_one($first.0[i] $(, $argument.0[i])*);
            }
            JointVec16(out, 0)
        }
        each(&$first $(, &$argument)*)
    }};
}

macro_rules! operators {
    ($($trait:ident, $method:ident;)*) => {
        $(impl $trait for JointVec16 {
            type Output = Self;

            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                let a = self;
                each!($trait::$method, a, b)
            }
        })*
    };
}

operators! {
    Add, add;
    Sub, sub;
    Mul, mul;
    Div, div;
}

impl Neg for JointVec16 {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        let value = self;
        each!(Neg::neg, value)
    }
}

/// Defines elementwise functions of [`RealOps`].
macro_rules! by_joint {
    ($($function:ident($first:ident $(, $argument:ident)*);)*) => {
        $(#[inline(always)]
        fn $function($first: Self $(, $argument: Self)*) -> Self {
            each!(BaselineF64::$function, $first $(, $argument)*)
        })*
    };
}

impl RealOps for JointVec16 {
    type Real = Self;

    const WIDE: bool = true;

    #[inline(never)]
    fn splat(value: f64) -> Self {
        Self([value; MAX_JOINTS], 0)
    }

    by_joint! {
        fma(a, b, c);
        fnma(a, b, c);
        sqrt(value);
        abs(value);
        max(value, bound);
        min(value, bound);
        copy_sign(size, sign);
        select_lt(a, b, then, otherwise);
        exp2_int(shifted);
    }

    fn rotate_quadrant(shifted: Self, mut s: Self, mut c: Self) -> (Self, Self) {
        for i in 0..MAX_JOINTS {
            (s.0[i], c.0[i]) = rotate_quadrant(shifted.0[i], s.0[i], c.0[i]);
        }
        (s, c)
    }
}

impl JointVector for JointVec16 {
    type Elem = BaselineF64;
    type Axes = BaselineF64x8;
    type Vec3 = ScalarVec3<BaselineF64>;
    type Register = Self;

    const REGISTERS: usize = 1;
    const OUTLINED: bool = true;

    #[inline(always)]
    fn register(self, _: usize) -> Self {
        self
    }

    #[inline(always)]
    fn set_register(&mut self, _: usize, register: Self) {
        *self = register;
    }

    #[inline(always)]
    fn load(values: &JointVec) -> Self {
        Self(*values, 0)
    }

    fn load_slice(values: &[f64]) -> Self {
        let mut out = [0.0; MAX_JOINTS];
        out.iter_mut().zip(values).for_each(|(slot, value)| *slot = *value);
        Self::load(&out)
    }

    #[inline(always)]
    fn store(self, values: &mut JointVec) {
        *values = self.0;
    }

    #[inline(always)]
    fn to_joints(self) -> JointVec {
        self.0
    }

    fn prefix<const N: usize>(self) -> [f64; N] {
        let mut out = [0.0; N];
        out.iter_mut().zip(self.0).for_each(|(slot, value)| *slot = value);
        out
    }

    fn components(cells: &[PaddedVec3]) -> [Self; 3] {
        let mut out = [[0.0; MAX_JOINTS]; 3];
        for (k, cell) in cells.iter().enumerate().take(MAX_JOINTS) {
            for (row, &value) in out.iter_mut().zip(cell) {
                row[k] = value;
            }
        }
        out.map(|row| Self::load(&row))
    }

    #[inline(never)]
    fn max_element(self) -> f64 {
        self.0.iter().fold(0.0, |largest, &value| BaselineF64::max(largest, value))
    }

    #[inline(always)]
    fn is_any_lt(self, other: Self) -> bool {
        #[inline(never)]
        fn anywhere(a: &JointVec16, b: &JointVec16) -> bool {
            a.0.iter().zip(&b.0).any(|(a, b)| a < b)
        }
        anywhere(&self, &other)
    }

    #[inline(never)]
    fn is_any_not_lt(self, other: Self) -> bool {
        self.0.iter().zip(&other.0).any(|(a, b)| !(a < b))
    }

    #[inline(always)]
    fn sum4(vectors: [Self; 4]) -> [f64; 4] {
        let [a, b, c, d] = &vectors;
        [sum_by_halves(a), sum_by_halves(b), sum_by_halves(c), sum_by_halves(d)]
    }

    #[inline(always)]
    fn dot4(a: [&Self; 4], b: [&Self; 4]) -> [f64; 4] {
        #[inline(never)]
        fn dot(a: &JointVec16, b: &JointVec16) -> f64 {
            let mut sums = [0.0; MAX_JOINTS / 2];
            for i in 0..MAX_JOINTS / 2 {
                sums[i] = a.0[i] * b.0[i] + a.0[i + MAX_JOINTS / 2] * b.0[i + MAX_JOINTS / 2];
            }
            sum_of_eight(sums)
        }
        [dot(a[0], b[0]), dot(a[1], b[1]), dot(a[2], b[2]), dot(a[3], b[3])]
    }

    #[inline(always)]
    fn sum(self) -> f64 {
        sum_by_halves(&self)
    }
}

/// Returns the sum of the elements.
#[inline(never)]
fn sum_by_halves(of: &JointVec16) -> f64 {
    let mut sums = [0.0; MAX_JOINTS / 2];
    for i in 0..MAX_JOINTS / 2 {
        sums[i] = of.0[i] + of.0[i + MAX_JOINTS / 2];
    }
    sum_of_eight(sums)
}

/// Returns the sum by halves, an order that can be vectorized.
#[inline(always)]
fn sum_of_eight(mut sums: [f64; MAX_JOINTS / 2]) -> f64 {
    for half in [4, 2, 1] {
        for i in 0..half {
            sums[i] += sums[i + half];
        }
    }
    sums[0]
}
