//! Eight configurations: one value of each in every number.
#![expect(unsafe_code, reason = "vector instructions; they are entered only through `Instructions::run`")]

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::scalar::turn;
use super::{Arithmetic, LANES, Wide};

/// Eight numbers in an array, vector code left to the compiler: any architecture.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Array([f64; LANES]);

macro_rules! by_lane {
    ($trait:ident, $method:ident, $op:tt) => {
        impl $trait for Array {
            type Output = Self;

            #[inline(always)]
            fn $method(mut self, other: Self) -> Self {
                for i in 0..LANES {
                    self.0[i] $op other.0[i];
                }
                self
            }
        }
    };
}

by_lane!(Add, add, +=);
by_lane!(Sub, sub, -=);
by_lane!(Mul, mul, *=);
by_lane!(Div, div, /=);

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

impl Arithmetic for Array {
    type Real = Self;

    const WIDE: bool = true;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self([value; LANES])
    }

    #[inline(always)]
    fn fma(a: Self, b: Self, c: Self) -> Self {
        a * b + c
    }

    #[inline(always)]
    fn fnma(a: Self, b: Self, c: Self) -> Self {
        c - a * b
    }

    #[inline(always)]
    fn turn(turns: Self, mut s: Self, mut c: Self) -> (Self, Self) {
        for i in 0..LANES {
            (s.0[i], c.0[i]) = turn(turns.0[i], s.0[i], c.0[i]);
        }
        (s, c)
    }
}

impl Wide for Array {
    #[inline(always)]
    fn load(values: &[f64; LANES]) -> Self {
        Self(*values)
    }

    #[inline(always)]
    fn transpose(numbers: &[Self; LANES]) -> [[f64; LANES]; LANES] {
        let mut out = [[0.0; LANES]; LANES];
        for i in 0..LANES {
            for j in 0..LANES {
                out[i][j] = numbers[j].0[i];
            }
        }
        out
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{Avx2, Avx512};

#[cfg(target_arch = "x86_64")]
mod x86 {
    #[allow(clippy::wildcard_imports, reason = "the names of instructions are unmistakable")]
    use std::arch::x86_64::*;

    use super::{Add, Arithmetic, Div, LANES, Mul, Neg, Sub, Wide};

    /// Eight numbers in two registers.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct Avx2([__m256d; 2]);

    /// Eight numbers in one register.
    #[derive(Debug, Clone, Copy)]
    pub(crate) struct Avx512(__m512d);

    // SAFETY of every `unsafe` below: values of these types come into being only in code entered through
    // `Instructions::run`, that is on a processor that has the instructions; memory is reached through references of the
    // right size alone.

    macro_rules! operators {
        ($name:ident, $($trait:ident, $method:ident, ($a:ident, $b:ident) => $result:expr;)*) => {
            $(impl $trait for $name {
                type Output = Self;

                #[inline(always)]
                fn $method(self, other: Self) -> Self {
                    let ($a, $b) = (self.0, other.0);
                    // SAFETY: as above.
                    Self(unsafe { $result })
                }
            })*

            impl Neg for $name {
                type Output = Self;

                #[inline(always)]
                fn neg(self) -> Self {
                    Self::splat(-0.0) - self
                }
            }
        };
    }

    operators! {
        Avx2,
        Add, add, (a, b) => [_mm256_add_pd(a[0], b[0]), _mm256_add_pd(a[1], b[1])];
        Sub, sub, (a, b) => [_mm256_sub_pd(a[0], b[0]), _mm256_sub_pd(a[1], b[1])];
        Mul, mul, (a, b) => [_mm256_mul_pd(a[0], b[0]), _mm256_mul_pd(a[1], b[1])];
        Div, div, (a, b) => [_mm256_div_pd(a[0], b[0]), _mm256_div_pd(a[1], b[1])];
    }

    operators! {
        Avx512,
        Add, add, (a, b) => _mm512_add_pd(a, b);
        Sub, sub, (a, b) => _mm512_sub_pd(a, b);
        Mul, mul, (a, b) => _mm512_mul_pd(a, b);
        Div, div, (a, b) => _mm512_div_pd(a, b);
    }

    /// [`turn`] of four.
    #[inline(always)]
    fn turn_four(turns: __m256d, s: __m256d, c: __m256d) -> (__m256d, __m256d) {
        // SAFETY: as above.
        unsafe {
            let quadrant = _mm256_castpd_si256(turns);
            let odd = _mm256_slli_epi64::<63>(quadrant);
            let (sine, cosine) =
                (_mm256_blendv_pd(s, c, _mm256_castsi256_pd(odd)), _mm256_blendv_pd(c, s, _mm256_castsi256_pd(odd)));
            let top = _mm256_set1_epi64x(i64::MIN);
            let sine_sign = _mm256_and_si256(_mm256_slli_epi64::<62>(quadrant), top);
            let cosine_sign = _mm256_xor_si256(sine_sign, odd);
            (
                _mm256_xor_pd(sine, _mm256_castsi256_pd(sine_sign)),
                _mm256_xor_pd(cosine, _mm256_castsi256_pd(cosine_sign)),
            )
        }
    }

    impl Arithmetic for Avx2 {
        type Real = Self;

        const WIDE: bool = true;

        #[inline(always)]
        fn splat(value: f64) -> Self {
            // SAFETY: as above.
            let four = unsafe { _mm256_set1_pd(value) };
            Self([four; 2])
        }

        #[inline(always)]
        fn fma(a: Self, b: Self, c: Self) -> Self {
            // SAFETY: as above.
            Self(unsafe { [_mm256_fmadd_pd(a.0[0], b.0[0], c.0[0]), _mm256_fmadd_pd(a.0[1], b.0[1], c.0[1])] })
        }

        #[inline(always)]
        fn fnma(a: Self, b: Self, c: Self) -> Self {
            // SAFETY: as above.
            Self(unsafe { [_mm256_fnmadd_pd(a.0[0], b.0[0], c.0[0]), _mm256_fnmadd_pd(a.0[1], b.0[1], c.0[1])] })
        }

        #[inline(always)]
        fn turn(turns: Self, s: Self, c: Self) -> (Self, Self) {
            let low = turn_four(turns.0[0], s.0[0], c.0[0]);
            let high = turn_four(turns.0[1], s.0[1], c.0[1]);
            (Self([low.0, high.0]), Self([low.1, high.1]))
        }
    }

    /// Four rows of four, turned.
    #[inline(always)]
    fn transpose_four(r: [__m256d; 4]) -> [__m256d; 4] {
        // SAFETY: as above.
        unsafe {
            let (a, b) = (_mm256_unpacklo_pd(r[0], r[1]), _mm256_unpackhi_pd(r[0], r[1]));
            let (c, d) = (_mm256_unpacklo_pd(r[2], r[3]), _mm256_unpackhi_pd(r[2], r[3]));
            [
                _mm256_permute2f128_pd::<0x20>(a, c),
                _mm256_permute2f128_pd::<0x20>(b, d),
                _mm256_permute2f128_pd::<0x31>(a, c),
                _mm256_permute2f128_pd::<0x31>(b, d),
            ]
        }
    }

    /// Eight rows of eight in halves, turned.
    #[inline(always)]
    fn transpose_halves(n: &[[__m256d; 2]; LANES]) -> [[f64; LANES]; LANES] {
        let mut out = [[0.0; LANES]; LANES];
        for half in 0..2 {
            let left = transpose_four([n[0][half], n[1][half], n[2][half], n[3][half]]);
            let right = transpose_four([n[4][half], n[5][half], n[6][half], n[7][half]]);
            for i in 0..4 {
                let row = out[4 * half + i].as_mut_ptr();
                // SAFETY: as above; a row has room for eight.
                unsafe {
                    _mm256_storeu_pd(row, left[i]);
                    _mm256_storeu_pd(row.add(4), right[i]);
                }
            }
        }
        out
    }

    impl Wide for Avx2 {
        #[inline(always)]
        fn load(values: &[f64; LANES]) -> Self {
            // SAFETY: as above; there are eight values.
            Self(unsafe { [_mm256_loadu_pd(values.as_ptr()), _mm256_loadu_pd(values.as_ptr().add(4))] })
        }

        #[inline(always)]
        fn transpose(n: &[Self; LANES]) -> [[f64; LANES]; LANES] {
            transpose_halves(&[n[0].0, n[1].0, n[2].0, n[3].0, n[4].0, n[5].0, n[6].0, n[7].0])
        }
    }

    impl Arithmetic for Avx512 {
        type Real = Self;

        const WIDE: bool = true;

        #[inline(always)]
        fn splat(value: f64) -> Self {
            // SAFETY: as above.
            Self(unsafe { _mm512_set1_pd(value) })
        }

        #[inline(always)]
        fn fma(a: Self, b: Self, c: Self) -> Self {
            // SAFETY: as above.
            Self(unsafe { _mm512_fmadd_pd(a.0, b.0, c.0) })
        }

        #[inline(always)]
        fn fnma(a: Self, b: Self, c: Self) -> Self {
            // SAFETY: as above.
            Self(unsafe { _mm512_fnmadd_pd(a.0, b.0, c.0) })
        }

        #[inline(always)]
        fn turn(turns: Self, s: Self, c: Self) -> (Self, Self) {
            // SAFETY: as above.
            unsafe {
                let quadrant = _mm512_castpd_si512(turns.0);
                let odd = _mm512_test_epi64_mask(quadrant, _mm512_set1_epi64(1));
                let (sine, cosine) = (_mm512_mask_blend_pd(odd, s.0, c.0), _mm512_mask_blend_pd(odd, c.0, s.0));
                let top = _mm512_set1_epi64(i64::MIN);
                let sine_sign = _mm512_and_si512(_mm512_slli_epi64::<62>(quadrant), top);
                let cosine_sign = _mm512_xor_si512(sine_sign, _mm512_slli_epi64::<63>(quadrant));
                (
                    Self(_mm512_xor_pd(sine, _mm512_castsi512_pd(sine_sign))),
                    Self(_mm512_xor_pd(cosine, _mm512_castsi512_pd(cosine_sign))),
                )
            }
        }
    }

    impl Avx512 {
        #[inline(always)]
        fn halves(self) -> [__m256d; 2] {
            // SAFETY: as above.
            unsafe { [_mm512_castpd512_pd256(self.0), _mm512_extractf64x4_pd::<1>(self.0)] }
        }
    }

    impl Wide for Avx512 {
        #[inline(always)]
        fn load(values: &[f64; LANES]) -> Self {
            // SAFETY: as above; there are eight values.
            Self(unsafe { _mm512_loadu_pd(values.as_ptr()) })
        }

        #[inline(always)]
        fn transpose(n: &[Self; LANES]) -> [[f64; LANES]; LANES] {
            transpose_halves(&[
                n[0].halves(),
                n[1].halves(),
                n[2].halves(),
                n[3].halves(),
                n[4].halves(),
                n[5].halves(),
                n[6].halves(),
                n[7].halves(),
            ])
        }
    }
}
