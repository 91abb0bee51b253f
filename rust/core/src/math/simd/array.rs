//! Vector of eight numbers in an array, for architectures without hand-written SIMD types.
#![forbid(unsafe_code)]

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::scalar::{BaselineF64, rotate_quadrant};
use super::{F64x8, LANES, PaddedVec3, RealOps, ScalarVec3, SimdVec, SoaLanes, chunk8, chunk8_mut};

/// Eight numbers in an array, which the compiler may vectorize. x86-64 uses its own SIMD types.
#[cfg_attr(target_arch = "x86_64", allow(dead_code, reason = "x86-64 has registers of its own"))]
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct ArrayF64x8([f64; LANES]);

macro_rules! operators {
    ($($trait:ident, $method:ident;)*) => {
        $(impl $trait for ArrayF64x8 {
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

impl Neg for ArrayF64x8 {
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
                $first.0[i] = BaselineF64::$function($first.0[i] $(, $argument.0[i])*);
            }
            $first
        })*
    };
}

impl RealOps for ArrayF64x8 {
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
        max(value, bound);
        min(value, bound);
        copy_sign(size, sign);
        select_lt(a, b, then, otherwise);
        exp2_int(shifted);
    }

    #[inline(always)]
    fn rotate_quadrant(shifted: Self, mut s: Self, mut c: Self) -> (Self, Self) {
        for i in 0..LANES {
            (s.0[i], c.0[i]) = rotate_quadrant(shifted.0[i], s.0[i], c.0[i]);
        }
        (s, c)
    }
}

impl SimdVec for ArrayF64x8 {
    const COUNT: usize = LANES;

    #[inline(always)]
    fn from_array(values: &[f64; LANES]) -> Self {
        Self(*values)
    }

    #[inline(always)]
    fn store_array(self, values: &mut [f64; LANES]) {
        *values = self.0;
    }
}

impl F64x8 for ArrayF64x8 {
    type Elem = BaselineF64;
    type Vec3 = ScalarVec3<BaselineF64>;
    type Register = Self;

    const REGISTERS: usize = 1;

    #[inline(always)]
    fn register(self, _: usize) -> Self {
        self
    }

    #[inline(always)]
    fn set_register(&mut self, _: usize, register: Self) {
        *self = register;
    }

    #[inline(always)]
    fn load_partial(values: &[f64]) -> Self {
        let mut out = [0.0; LANES];
        out.iter_mut().zip(values).for_each(|(slot, value)| *slot = *value);
        Self(out)
    }

    #[inline(always)]
    fn any_lt(a: Self, b: Self) -> bool {
        let mut any = false;
        for i in 0..LANES {
            any |= a.0[i] < b.0[i];
        }
        any
    }

    #[inline(always)]
    fn any_not_lt(a: Self, b: Self) -> bool {
        let mut any = false;
        for i in 0..LANES {
            any |= !(a.0[i] < b.0[i]);
        }
        any
    }

    #[inline(always)]
    fn hsum4(vectors: [Self; 4]) -> [f64; 4] {
        let mut out = [0.0; 4];
        for (sum, Self(n)) in out.iter_mut().zip(vectors) {
            *sum = ((n[0] + n[4]) + (n[1] + n[5])) + ((n[2] + n[6]) + (n[3] + n[7]));
        }
        out
    }

    #[inline(always)]
    fn hdot4(a: [Self; 4], b: [Self; 4]) -> [f64; 4] {
        Self::hsum4([a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]])
    }

    #[inline(always)]
    fn components(cells: &[PaddedVec3; LANES]) -> [Self; 3] {
        let mut out = [Self([0.0; LANES]); 3];
        for i in 0..3 {
            for k in 0..LANES {
                out[i].0[k] = cells[k][i];
            }
        }
        out
    }
}

impl SoaLanes for ArrayF64x8 {
    #[inline(always)]
    fn load_transposed(rows: &[f64], stride: usize) -> [Self; LANES] {
        let mut out = [Self([0.0; LANES]); LANES];
        for j in 0..LANES {
            let row = chunk8(rows, j * stride);
            for i in 0..LANES {
                out[i].0[j] = row[i];
            }
        }
        out
    }

    #[inline(always)]
    fn store_transposed(columns: &[Self; LANES], rows: &mut [f64], stride: usize) {
        for i in 0..LANES {
            if let Some(row) = chunk8_mut(rows, i * stride) {
                for j in 0..LANES {
                    row[j] = columns[j].0[i];
                }
            }
        }
    }
}
