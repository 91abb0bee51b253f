//! Vector with one number per joint of any arm, for any processor: for code that is compiled once.
#![forbid(unsafe_code)]

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::dispatch::PlainEight;
use super::scalar::{Plain, turn};
use super::{Arithmetic, Cell, Joints, Lanes, Spread, Three};
use crate::{JointVec, MAX_JOINTS};

/// Sixteen numbers, for arms with more joints than [`LANES`](super::LANES) and for rare code.
///
/// Each operation is a call: inlined, the step of a large arm alone was a sixth of the wheel's size.
#[derive(Debug, Clone, Copy)]
pub(crate) struct EveryJoint(JointVec, #[expect(dead_code, reason = "a larger value is copied by a call")] u64);

/// Defines an outlined elementwise operation.
macro_rules! each {
    ($of_one:path, $first:ident $(, $argument:ident)*) => {{
        #[inline(never)]
        fn each($first: &EveryJoint $(, $argument: &EveryJoint)*) -> EveryJoint {
            let mut out = *$first;
            for i in 0..MAX_JOINTS {
                out.0[i] = $of_one($first.0[i] $(, $argument.0[i])*);
            }
            out
        }
        each(&$first $(, &$argument)*)
    }};
}

macro_rules! operators {
    ($($trait:ident, $method:ident;)*) => {
        $(impl $trait for EveryJoint {
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

impl Neg for EveryJoint {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        let value = self;
        each!(Neg::neg, value)
    }
}

/// Defines functions of [`Arithmetic`], joint by joint.
macro_rules! by_joint {
    ($($function:ident($first:ident $(, $argument:ident)*);)*) => {
        $(#[inline(always)]
        fn $function($first: Self $(, $argument: Self)*) -> Self {
            each!(Plain::$function, $first $(, $argument)*)
        })*
    };
}

impl Arithmetic for EveryJoint {
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
        at_least(value, bound);
        at_most(value, bound);
        copy_sign(size, sign);
        if_less(a, b, then, otherwise);
        power_of_two(sum);
    }

    #[inline(always)]
    fn less_anywhere(a: Self, b: Self) -> bool {
        #[inline(never)]
        fn anywhere(a: &EveryJoint, b: &EveryJoint) -> bool {
            a.0.iter().zip(&b.0).any(|(a, b)| a < b)
        }
        anywhere(&a, &b)
    }

    fn turn(turns: Self, mut s: Self, mut c: Self) -> (Self, Self) {
        for i in 0..MAX_JOINTS {
            (s.0[i], c.0[i]) = turn(turns.0[i], s.0[i], c.0[i]);
        }
        (s, c)
    }
}

impl Spread<f64> for EveryJoint {
    #[inline(always)]
    fn spread(value: f64) -> Self {
        Self::splat(value)
    }
}

impl Lanes for EveryJoint {
    type One = Plain;
    type Axes = PlainEight;
    type Group = Self;

    const GROUPS: usize = 1;
    const CALLED: bool = true;

    #[inline(always)]
    fn group(&self, _: usize) -> Self {
        *self
    }

    #[inline(always)]
    fn set_group(&mut self, _: usize, value: Self) {
        *self = value;
    }

    #[inline(always)]
    fn load(values: &JointVec) -> Self {
        Self(*values, 0)
    }

    #[inline(always)]
    fn of_joints(values: &JointVec) -> Self {
        Self::load(values)
    }

    #[inline(always)]
    fn array(self) -> JointVec {
        self.0
    }

    #[inline(never)]
    fn largest(self) -> f64 {
        self.0.iter().fold(0.0, |largest, &value| Plain::at_least(largest, value))
    }

    #[inline(always)]
    fn sums(numbers: [Self; 4]) -> [f64; 4] {
        #[inline(never)]
        fn sum(of: &EveryJoint) -> f64 {
            let mut sums = of.0;
            // By halves: this order can be vectorized.
            for half in [8, 4, 2, 1] {
                for i in 0..half {
                    sums[i] += sums[i + half];
                }
            }
            sums[0]
        }
        let [a, b, c, d] = &numbers;
        [sum(a), sum(b), sum(c), sum(d)]
    }

    #[inline(always)]
    fn dots(a: [&Self; 4], b: [&Self; 4]) -> [f64; 4] {
        Self::sums([*a[0] * *b[0], *a[1] * *b[1], *a[2] * *b[2], *a[3] * *b[3]])
    }
}

impl Joints for EveryJoint {
    type Triple = Three<Plain>;

    fn read(values: &[f64]) -> Self {
        let mut out = [0.0; MAX_JOINTS];
        out.iter_mut().zip(values).for_each(|(slot, value)| *slot = *value);
        Self::load(&out)
    }

    fn few<const N: usize>(self) -> [f64; N] {
        let mut out = [0.0; N];
        out.iter_mut().zip(self.0).for_each(|(slot, value)| *slot = value);
        out
    }

    fn components(cells: &[Cell]) -> [Self; 3] {
        let mut out = [[0.0; MAX_JOINTS]; 3];
        for (k, cell) in cells.iter().enumerate().take(MAX_JOINTS) {
            for (row, &value) in out.iter_mut().zip(cell) {
                row[k] = value;
            }
        }
        out.map(|row| Self::load(&row))
    }

    #[inline(always)]
    fn store(self, values: &mut JointVec) {
        *values = self.0;
    }
}
