//! Eight numbers in the vector registers of x86-64: four of two, two of four or one of eight.
#![expect(unsafe_code, reason = "vector instructions; they are entered only through `Instructions::run`")]

use std::arch::x86_64::__m256d;

use super::LANES;

// SAFETY of every `unsafe` below: values of these types come into being only in code entered through `Instructions::run`,
// that is on a processor that has the instructions; memory is reached through references of the right size alone.

/// The type of eight numbers over registers whose instructions the module around it has under common names.
macro_rules! eight {
    ($(#[$doc:meta])* $name:ident beside $one:ident, $width:literal: $($i:literal)*) => {
        use std::ops::{Add, Div, Mul, Neg, Sub};

        use crate::number::{Arithmetic, LANES, Wide};

        $(#[$doc])*
        #[derive(Debug, Clone, Copy)]
        pub(crate) struct $name([Register; LANES / $width]);

        eight!(@operators $name ($($i)*) Add add, Sub sub, Mul mul, Div div);

        impl Neg for $name {
            type Output = Self;

            #[inline(always)]
            fn neg(self) -> Self {
                // SAFETY: as above.
                Self(unsafe { [$(xor(self.0[$i], set1(-0.0))),*] })
            }
        }

        impl Arithmetic for $name {
            type Real = Self;

            const WIDE: bool = true;

            #[inline(always)]
            fn splat(value: f64) -> Self {
                // SAFETY: as above.
                Self([unsafe { set1(value) }; LANES / $width])
            }

            #[inline(always)]
            fn fma(a: Self, b: Self, c: Self) -> Self {
                // SAFETY: as above.
                Self(unsafe { [$(fmadd(a.0[$i], b.0[$i], c.0[$i])),*] })
            }

            #[inline(always)]
            fn fnma(a: Self, b: Self, c: Self) -> Self {
                // SAFETY: as above.
                Self(unsafe { [$(fnmadd(a.0[$i], b.0[$i], c.0[$i])),*] })
            }

            #[inline(always)]
            fn sqrt(value: Self) -> Self {
                // SAFETY: as above.
                Self(unsafe { [$(sqrt(value.0[$i])),*] })
            }

            #[inline(always)]
            fn abs(value: Self) -> Self {
                // SAFETY: as above.
                Self(unsafe { [$(andnot(set1(-0.0), value.0[$i])),*] })
            }

            #[inline(always)]
            fn at_least(value: Self, bound: Self) -> Self {
                // SAFETY: as above. Of two numbers of which one is none, these instructions give the second.
                Self(unsafe { [$(max(bound.0[$i], value.0[$i])),*] })
            }

            #[inline(always)]
            fn at_most(value: Self, bound: Self) -> Self {
                // SAFETY: as above.
                Self(unsafe { [$(min(bound.0[$i], value.0[$i])),*] })
            }

            #[inline(always)]
            fn copy_sign(size: Self, sign: Self) -> Self {
                // SAFETY: as above.
                Self(unsafe { [$(or(andnot(set1(-0.0), size.0[$i]), and(set1(-0.0), sign.0[$i]))),*] })
            }

            #[inline(always)]
            fn if_less(a: Self, b: Self, then: Self, otherwise: Self) -> Self {
                // SAFETY: as above.
                Self(unsafe { [$(choose(less(a.0[$i], b.0[$i]), then.0[$i], otherwise.0[$i])),*] })
            }

            #[inline(always)]
            fn power_of_two(sum: Self) -> Self {
                // SAFETY: as above.
                Self(unsafe { [$(power_of_two(sum.0[$i])),*] })
            }

            #[inline(always)]
            fn turn(turns: Self, mut s: Self, mut c: Self) -> (Self, Self) {
                // SAFETY: as above.
                $((s.0[$i], c.0[$i]) = unsafe { turn(turns.0[$i], s.0[$i], c.0[$i]) };)*
                (s, c)
            }
        }

        impl Wide for $name {
            type One = crate::number::$one;

            #[inline(always)]
            fn of(values: &[f64; LANES]) -> Self {
                // SAFETY: as above; there are eight values.
                Self(unsafe { [$(loadu(values.as_ptr().add($i * $width))),*] })
            }

            #[inline(always)]
            fn put(self, values: &mut [f64; LANES]) {
                // SAFETY: as above; there is room for eight values.
                unsafe { $(storeu(values.as_mut_ptr().add($i * $width), self.0[$i]);)* }
            }

            #[inline(always)]
            fn less_anywhere(self, other: Self) -> bool {
                // SAFETY: as above.
                unsafe { false $(| any(less(self.0[$i], other.0[$i])))* }
            }

            #[inline(always)]
            fn four_sums(n: [Self; 4]) -> [f64; 4] {
                sums(n[0].0, n[1].0, n[2].0, n[3].0)
            }

            #[inline(always)]
            fn transpose(n: &[Self; LANES]) -> [[f64; LANES]; LANES] {
                transpose([n[0].0, n[1].0, n[2].0, n[3].0, n[4].0, n[5].0, n[6].0, n[7].0])
            }
        }
    };
    (@operators $name:ident $indices:tt $($trait:ident $method:ident),*) => {
        $(eight!(@operator $name $indices $trait $method);)*
    };
    (@operator $name:ident ($($i:literal)*) $trait:ident $method:ident) => {
        impl $trait for $name {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: as above.
                Self(unsafe { [$($method(self.0[$i], other.0[$i])),*] })
            }
        }
    };
}

pub(super) mod sse2 {
    use std::arch::x86_64::{
        __m128d as Register, _mm_add_epi64, _mm_add_pd as add, _mm_and_pd as and, _mm_and_si128,
        _mm_andnot_pd as andnot, _mm_castpd_si128, _mm_castsi128_pd, _mm_cmplt_pd as less, _mm_div_pd as div,
        _mm_loadu_pd as loadu, _mm_max_pd as max, _mm_min_pd as min, _mm_movemask_pd, _mm_mul_pd as mul,
        _mm_or_pd as or, _mm_set1_epi64x, _mm_set1_pd as set1, _mm_slli_epi64, _mm_sqrt_pd as sqrt,
        _mm_storeu_pd as storeu, _mm_sub_epi64, _mm_sub_pd as sub, _mm_unpackhi_pd as high, _mm_unpacklo_pd as low,
        _mm_xor_pd as xor, _mm_xor_si128,
    };

    eight! {
        /// What every x86-64 processor has: no fused multiply-add.
        Sse2 beside Plain, 2: 0 1 2 3
    }

    #[inline(always)]
    unsafe fn fmadd(a: Register, b: Register, c: Register) -> Register {
        // SAFETY: as above.
        unsafe { add(mul(a, b), c) }
    }

    #[inline(always)]
    unsafe fn fnmadd(a: Register, b: Register, c: Register) -> Register {
        // SAFETY: as above.
        unsafe { sub(c, mul(a, b)) }
    }

    #[inline(always)]
    unsafe fn choose(mask: Register, then: Register, otherwise: Register) -> Register {
        // SAFETY: as above.
        unsafe { or(and(mask, then), andnot(mask, otherwise)) }
    }

    #[inline(always)]
    unsafe fn any(mask: Register) -> bool {
        // SAFETY: as above.
        unsafe { _mm_movemask_pd(mask) != 0 }
    }

    #[inline(always)]
    unsafe fn power_of_two(sum: Register) -> Register {
        // SAFETY: as above.
        unsafe {
            let exponent = _mm_slli_epi64::<52>(_mm_castpd_si128(sum));
            _mm_castsi128_pd(_mm_add_epi64(exponent, _mm_set1_epi64x(1023 << 52)))
        }
    }

    #[inline(always)]
    unsafe fn turn(turns: Register, s: Register, c: Register) -> (Register, Register) {
        // SAFETY: as above.
        unsafe {
            let quadrant = _mm_castpd_si128(turns);
            let one = _mm_set1_epi64x(1);
            // 0 − 1 has all bits set.
            let odd = _mm_castsi128_pd(_mm_sub_epi64(_mm_set1_epi64x(0), _mm_and_si128(quadrant, one)));
            let top = _mm_set1_epi64x(i64::MIN);
            let sine_sign = _mm_and_si128(_mm_slli_epi64::<62>(quadrant), top);
            let cosine_sign = _mm_xor_si128(sine_sign, _mm_slli_epi64::<63>(quadrant));
            (xor(choose(odd, c, s), _mm_castsi128_pd(sine_sign)), xor(choose(odd, s, c), _mm_castsi128_pd(cosine_sign)))
        }
    }

    #[inline(always)]
    fn sums(a: [Register; 4], b: [Register; 4], c: [Register; 4], d: [Register; 4]) -> [f64; 4] {
        let mut out = [0.0; 4];
        // SAFETY: as above.
        unsafe {
            let a = add(add(a[0], a[2]), add(a[1], a[3]));
            let b = add(add(b[0], b[2]), add(b[1], b[3]));
            let c = add(add(c[0], c[2]), add(c[1], c[3]));
            let d = add(add(d[0], d[2]), add(d[1], d[3]));
            storeu(out.as_mut_ptr(), add(low(a, b), high(a, b)));
            storeu(out.as_mut_ptr().add(2), add(low(c, d), high(c, d)));
        }
        out
    }

    #[inline(always)]
    fn transpose(n: [[Register; 4]; LANES]) -> [[f64; LANES]; LANES] {
        let mut out = [[0.0; LANES]; LANES];
        for pair in 0..LANES / 2 {
            for register in 0..LANES / 2 {
                let (a, b) = (n[2 * pair][register], n[2 * pair + 1][register]);
                // SAFETY: as above; a row has room for eight.
                unsafe {
                    storeu(out[2 * register].as_mut_ptr().add(2 * pair), low(a, b));
                    storeu(out[2 * register + 1].as_mut_ptr().add(2 * pair), high(a, b));
                }
            }
        }
        out
    }
}

pub(super) mod avx2 {
    use std::arch::x86_64::{
        __m256d as Register, _CMP_LT_OQ, _mm256_add_epi64, _mm256_add_pd as add, _mm256_and_pd as and,
        _mm256_andnot_pd as andnot, _mm256_blendv_pd, _mm256_castpd_si256, _mm256_castsi256_pd, _mm256_cmp_pd,
        _mm256_div_pd as div, _mm256_fmadd_pd as fmadd, _mm256_fnmadd_pd as fnmadd, _mm256_loadu_pd as loadu,
        _mm256_max_pd as max, _mm256_min_pd as min, _mm256_movemask_pd, _mm256_mul_pd as mul, _mm256_or_pd as or,
        _mm256_set1_epi64x, _mm256_set1_pd as set1, _mm256_slli_epi64, _mm256_sqrt_pd as sqrt,
        _mm256_storeu_pd as storeu, _mm256_sub_pd as sub, _mm256_xor_pd as xor,
    };

    use super::{sums_of_four, transpose_halves};

    eight! {
        /// Eight numbers in two registers, with fused multiply-add.
        Avx2 beside Fused, 4: 0 1
    }

    #[inline(always)]
    unsafe fn less(a: Register, b: Register) -> Register {
        // SAFETY: as above.
        unsafe { _mm256_cmp_pd::<_CMP_LT_OQ>(a, b) }
    }

    #[inline(always)]
    unsafe fn choose(mask: Register, then: Register, otherwise: Register) -> Register {
        // SAFETY: as above.
        unsafe { _mm256_blendv_pd(otherwise, then, mask) }
    }

    #[inline(always)]
    unsafe fn any(mask: Register) -> bool {
        // SAFETY: as above.
        unsafe { _mm256_movemask_pd(mask) != 0 }
    }

    #[inline(always)]
    unsafe fn power_of_two(sum: Register) -> Register {
        // SAFETY: as above.
        unsafe {
            let exponent = _mm256_slli_epi64::<52>(_mm256_castpd_si256(sum));
            _mm256_castsi256_pd(_mm256_add_epi64(exponent, _mm256_set1_epi64x(1023 << 52)))
        }
    }

    #[inline(always)]
    unsafe fn turn(turns: Register, s: Register, c: Register) -> (Register, Register) {
        // SAFETY: as above.
        unsafe {
            let quadrant = _mm256_castpd_si256(turns);
            let odd = _mm256_castsi256_pd(_mm256_slli_epi64::<63>(quadrant));
            let sine_sign = and(_mm256_castsi256_pd(_mm256_slli_epi64::<62>(quadrant)), set1(-0.0));
            (xor(choose(odd, c, s), sine_sign), xor(choose(odd, s, c), xor(sine_sign, odd)))
        }
    }

    #[inline(always)]
    fn sums(a: [Register; 2], b: [Register; 2], c: [Register; 2], d: [Register; 2]) -> [f64; 4] {
        // SAFETY: as above.
        unsafe { sums_of_four(add(a[0], a[1]), add(b[0], b[1]), add(c[0], c[1]), add(d[0], d[1])) }
    }

    #[inline(always)]
    fn transpose(n: [[Register; 2]; LANES]) -> [[f64; LANES]; LANES] {
        transpose_halves(&n)
    }
}

pub(super) mod avx512 {
    use std::arch::x86_64::{
        __m256d, __m512d as Register, __mmask8 as Mask, _CMP_LT_OQ, _mm256_add_pd, _mm512_add_epi64,
        _mm512_add_pd as add, _mm512_and_pd as and, _mm512_andnot_pd as andnot, _mm512_castpd_si512,
        _mm512_castpd512_pd256, _mm512_castsi512_pd, _mm512_cmp_pd_mask, _mm512_div_pd as div, _mm512_extractf64x4_pd,
        _mm512_fmadd_pd as fmadd, _mm512_fnmadd_pd as fnmadd, _mm512_loadu_pd as loadu, _mm512_mask_blend_pd,
        _mm512_max_pd as max, _mm512_min_pd as min, _mm512_mul_pd as mul, _mm512_or_pd as or, _mm512_set1_epi64,
        _mm512_set1_pd as set1, _mm512_slli_epi64, _mm512_sqrt_pd as sqrt, _mm512_storeu_pd as storeu,
        _mm512_sub_pd as sub, _mm512_test_epi64_mask, _mm512_xor_pd as xor,
    };

    use super::{sums_of_four, transpose_halves};

    eight! {
        /// Eight numbers in one register.
        Avx512 beside Fused, 8: 0
    }

    #[inline(always)]
    unsafe fn less(a: Register, b: Register) -> Mask {
        // SAFETY: as above.
        unsafe { _mm512_cmp_pd_mask::<_CMP_LT_OQ>(a, b) }
    }

    #[inline(always)]
    unsafe fn choose(mask: Mask, then: Register, otherwise: Register) -> Register {
        // SAFETY: as above.
        unsafe { _mm512_mask_blend_pd(mask, otherwise, then) }
    }

    #[inline(always)]
    unsafe fn any(mask: Mask) -> bool {
        mask != 0
    }

    #[inline(always)]
    unsafe fn power_of_two(sum: Register) -> Register {
        // SAFETY: as above.
        unsafe {
            let exponent = _mm512_slli_epi64::<52>(_mm512_castpd_si512(sum));
            _mm512_castsi512_pd(_mm512_add_epi64(exponent, _mm512_set1_epi64(1023 << 52)))
        }
    }

    #[inline(always)]
    unsafe fn turn(turns: Register, s: Register, c: Register) -> (Register, Register) {
        // SAFETY: as above.
        unsafe {
            let quadrant = _mm512_castpd_si512(turns);
            let odd = _mm512_test_epi64_mask(quadrant, _mm512_set1_epi64(1));
            let sine_sign = and(_mm512_castsi512_pd(_mm512_slli_epi64::<62>(quadrant)), set1(-0.0));
            let cosine_sign = xor(sine_sign, _mm512_castsi512_pd(_mm512_slli_epi64::<63>(quadrant)));
            (xor(choose(odd, c, s), sine_sign), xor(choose(odd, s, c), cosine_sign))
        }
    }

    #[inline(always)]
    fn halves(n: Register) -> [__m256d; 2] {
        // SAFETY: as above.
        unsafe { [_mm512_castpd512_pd256(n), _mm512_extractf64x4_pd::<1>(n)] }
    }

    #[inline(always)]
    fn folded(n: Register) -> __m256d {
        let [low, high] = halves(n);
        // SAFETY: as above.
        unsafe { _mm256_add_pd(low, high) }
    }

    #[inline(always)]
    fn sums(a: [Register; 1], b: [Register; 1], c: [Register; 1], d: [Register; 1]) -> [f64; 4] {
        // SAFETY: as above.
        unsafe { sums_of_four(folded(a[0]), folded(b[0]), folded(c[0]), folded(d[0])) }
    }

    #[inline(always)]
    fn transpose(n: [[Register; 1]; LANES]) -> [[f64; LANES]; LANES] {
        transpose_halves(&[
            halves(n[0][0]),
            halves(n[1][0]),
            halves(n[2][0]),
            halves(n[3][0]),
            halves(n[4][0]),
            halves(n[5][0]),
            halves(n[6][0]),
            halves(n[7][0]),
        ])
    }
}

/// The sum of each of four registers.
#[inline(always)]
unsafe fn sums_of_four(a: __m256d, b: __m256d, c: __m256d, d: __m256d) -> [f64; 4] {
    use std::arch::x86_64::{_mm256_add_pd, _mm256_hadd_pd, _mm256_permute2f128_pd, _mm256_storeu_pd};
    let mut out = [0.0; 4];
    // SAFETY: as above.
    unsafe {
        let (ab, cd) = (_mm256_hadd_pd(a, b), _mm256_hadd_pd(c, d));
        let (low, high) = (_mm256_permute2f128_pd::<0x20>(ab, cd), _mm256_permute2f128_pd::<0x31>(ab, cd));
        _mm256_storeu_pd(out.as_mut_ptr(), _mm256_add_pd(low, high));
    }
    out
}

/// Four rows of four, turned.
#[inline(always)]
fn transpose_four(r: [__m256d; 4]) -> [__m256d; 4] {
    use std::arch::x86_64::{_mm256_permute2f128_pd, _mm256_unpackhi_pd, _mm256_unpacklo_pd};
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
    use std::arch::x86_64::_mm256_storeu_pd;
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
