//! Eight numbers in an array, for any architecture.
#![forbid(unsafe_code)]

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::scalar::{Plain, turn};
use super::{Arithmetic, Cell, LANES, Many, Packed, Spread, Three, Wide, eight, eight_mut};

/// Eight numbers in an array, vectorized by the compiler: for architectures without hand-written SIMD types.
#[cfg_attr(target_arch = "x86_64", allow(dead_code, reason = "x86-64 has registers of its own"))]
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Array([f64; LANES]);

macro_rules! operators {
    ($($trait:ident, $method:ident;)*) => {
        $(impl $trait for Array {
            type Output = Self;

            #[inline(always)]
            fn $method(mut self, other: Self) -> Self {
                for i in 0..LANES {
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

impl Neg for Array {
    type Output = Self;

    #[inline(always)]
    fn neg(mut self) -> Self {
        for value in &mut self.0 {
            *value = -*value;
        }
        self
    }
}

/// Defines elementwise functions of an array.
macro_rules! by_lane {
    ($($function:ident($first:ident $(, $argument:ident)*);)*) => {
        $(#[inline(always)]
        fn $function(mut $first: Self $(, $argument: Self)*) -> Self {
            for i in 0..LANES {
                $first.0[i] = Plain::$function($first.0[i] $(, $argument.0[i])*);
            }
            $first
        })*
    };
}

impl Arithmetic for Array {
    type Real = Self;

    const WIDE: bool = true;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self([value; LANES])
    }

    by_lane! {
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
        for i in 0..LANES {
            any |= a.0[i] < b.0[i];
        }
        any
    }

    #[inline(always)]
    fn turn(turns: Self, mut s: Self, mut c: Self) -> (Self, Self) {
        for i in 0..LANES {
            (s.0[i], c.0[i]) = turn(turns.0[i], s.0[i], c.0[i]);
        }
        (s, c)
    }
}

impl Packed for Array {
    const COUNT: usize = LANES;

    #[inline(always)]
    fn of(values: &[f64; LANES]) -> Self {
        Self(*values)
    }

    #[inline(always)]
    fn part(values: &[f64]) -> Self {
        let mut out = [0.0; LANES];
        out.iter_mut().zip(values).for_each(|(slot, value)| *slot = *value);
        Self(out)
    }

    #[inline(always)]
    fn put(self, values: &mut [f64; LANES]) {
        *values = self.0;
    }
}

impl Spread<f64> for Array {
    #[inline(always)]
    fn spread(value: f64) -> Self {
        Self::splat(value)
    }
}

impl Spread<Self> for Array {
    #[inline(always)]
    fn spread(value: Self) -> Self {
        value
    }
}

impl Wide for Array {
    type One = Plain;
    type Triple = Three<Plain>;

    #[inline(always)]
    fn four_sums(numbers: [Self; 4]) -> [f64; 4] {
        let mut out = [0.0; 4];
        for (sum, Self(n)) in out.iter_mut().zip(numbers) {
            *sum = ((n[0] + n[4]) + (n[1] + n[5])) + ((n[2] + n[6]) + (n[3] + n[7]));
        }
        out
    }

    #[inline(always)]
    fn four_dots(a: [Self; 4], b: [Self; 4]) -> [f64; 4] {
        Self::four_sums([a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]])
    }

    #[inline(always)]
    fn components(cells: &[Cell; LANES]) -> [Self; 3] {
        let mut out = [Self([0.0; LANES]); 3];
        for i in 0..3 {
            for k in 0..LANES {
                out[i].0[k] = cells[k][i];
            }
        }
        out
    }
}

impl Many for Array {
    #[inline(always)]
    fn from_rows(rows: &[f64], stride: usize) -> [Self; LANES] {
        let mut out = [Self([0.0; LANES]); LANES];
        for j in 0..LANES {
            let row = eight(rows, j * stride);
            for i in 0..LANES {
                out[i].0[j] = row[i];
            }
        }
        out
    }

    #[inline(always)]
    fn into_rows(numbers: &[Self; LANES], rows: &mut [f64], stride: usize) {
        for i in 0..LANES {
            if let Some(row) = eight_mut(rows, i * stride) {
                for j in 0..LANES {
                    row[j] = numbers[j].0[i];
                }
            }
        }
    }
}
