//! Several configurations interleaved: one register per joint or per task axis.
#![forbid(unsafe_code)]
#![expect(
    clippy::manual_memcpy,
    reason = "copies of slices are calls where they are not inlined; loops become registers"
)]

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::{ABREAST, Arithmetic, Axes, LANES, Lanes, Many, Spread};
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

/// `N` values per configuration, one register each.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Columns<W, const N: usize>([W; N]);

impl<W: Many> Columns<W, ABREAST> {
    /// Returns a number per joint, zeros in the padding.
    #[inline(always)]
    pub(crate) fn numbers(self) -> [W; LANES] {
        let mut out = [W::splat(0.0); LANES];
        for i in 0..ABREAST {
            out[i] = self.0[i];
        }
        out
    }
}

impl<W: Many> Lanes for Columns<W, ABREAST> {
    type One = W;
    type Axes = Columns<W, MAX_AXES>;
    type Group = W;

    const GROUPS: usize = ABREAST;

    #[inline(always)]
    fn group(&self, i: usize) -> W {
        self.0[i]
    }

    #[inline(always)]
    fn set_group(&mut self, i: usize, value: W) {
        self.0[i] = value;
    }

    #[inline(always)]
    fn load(values: &JointVec) -> Self {
        let mut out = [W::splat(0.0); ABREAST];
        for i in 0..ABREAST {
            out[i] = W::splat(values[i]);
        }
        Self(out)
    }

    #[inline(always)]
    fn of_joints(values: &[W; MAX_JOINTS]) -> Self {
        let mut out = [W::splat(0.0); ABREAST];
        for i in 0..ABREAST {
            out[i] = values[i];
        }
        Self(out)
    }

    #[inline(always)]
    fn array(self) -> [W; MAX_JOINTS] {
        let mut out = [W::splat(0.0); MAX_JOINTS];
        for i in 0..ABREAST {
            out[i] = self.0[i];
        }
        out
    }

    #[inline(always)]
    fn largest(self) -> W {
        let mut largest = W::splat(0.0);
        for i in 0..ABREAST {
            largest = W::at_least(largest, self.0[i]);
        }
        largest
    }

    #[inline(always)]
    fn sums(numbers: [Self; 4]) -> [W; 4] {
        [numbers[0].sum(), numbers[1].sum(), numbers[2].sum(), numbers[3].sum()]
    }

    #[inline(always)]
    fn sum(self) -> W {
        let mut sum = self.0[0];
        for i in 1..ABREAST {
            sum = sum + self.0[i];
        }
        sum
    }

    #[inline(always)]
    fn dots(a: [&Self; 4], b: [&Self; 4]) -> [W; 4] {
        let mut out = [W::splat(0.0); 4];
        for k in 0..4 {
            out[k] = a[k].0[0] * b[k].0[0];
        }
        for i in 1..ABREAST {
            for k in 0..4 {
                out[k] = W::fma(a[k].0[i], b[k].0[i], out[k]);
            }
        }
        out
    }
}

impl<W: Many> Axes for Columns<W, MAX_AXES> {
    type One = W;

    #[inline(always)]
    fn constant(values: &[f64; LANES]) -> Self {
        let mut out = [W::splat(0.0); MAX_AXES];
        for i in 0..MAX_AXES {
            out[i] = W::splat(values[i]);
        }
        Self(out)
    }

    #[inline(always)]
    fn of_axes(values: &[W; MAX_AXES]) -> Self {
        Self(*values)
    }

    #[inline(always)]
    fn axes(self) -> [W; MAX_AXES] {
        self.0
    }
}

impl<W: Many, const N: usize> Spread<W> for Columns<W, N> {
    #[inline(always)]
    fn spread(value: W) -> Self {
        Self([value; N])
    }
}

/// Defines elementwise functions.
macro_rules! by_column {
    ($($function:ident($first:ident $(, $argument:ident)*);)*) => {
        $(#[inline(always)]
        fn $function(mut $first: Self $(, $argument: Self)*) -> Self {
            for i in 0..N {
                $first.0[i] = W::$function($first.0[i] $(, $argument.0[i])*);
            }
            $first
        })*
    };
}

impl<W: Many, const N: usize> Arithmetic for Columns<W, N> {
    type Real = Self;

    const WIDE: bool = true;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self([W::splat(value); N])
    }

    by_column! {
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
        let mut any = false;
        for i in 0..N {
            any |= W::less_anywhere(a.0[i], b.0[i]);
        }
        any
    }

    #[inline(always)]
    fn turn(turns: Self, mut s: Self, mut c: Self) -> (Self, Self) {
        for i in 0..N {
            (s.0[i], c.0[i]) = W::turn(turns.0[i], s.0[i], c.0[i]);
        }
        (s, c)
    }
}

macro_rules! operators {
    ($($trait:ident, $method:ident;)*) => {
        $(impl<W: Many, const N: usize> $trait for Columns<W, N> {
            type Output = Self;

            #[inline(always)]
            fn $method(mut self, other: Self) -> Self {
                for i in 0..N {
                    self.0[i] = self.0[i].$method(other.0[i]);
                }
                self
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

impl<W: Many, const N: usize> Neg for Columns<W, N> {
    type Output = Self;

    #[inline(always)]
    fn neg(mut self) -> Self {
        for i in 0..N {
            self.0[i] = -self.0[i];
        }
        self
    }
}
