//! Vector types in registers of two numbers, for every x86-64 processor.

// SAFETY of every `unsafe` below: as in the parent module, whose types are used only where the processor has their
// instructions.

use std::arch::x86_64::{
    __m128d as Register, _mm_add_epi64, _mm_add_pd as add, _mm_and_pd as and, _mm_and_si128, _mm_andnot_pd as andnot,
    _mm_castpd_si128, _mm_castsi128_pd, _mm_cmplt_pd as cmp_lt, _mm_cmpnlt_pd as cmp_not_lt, _mm_div_pd as div,
    _mm_load_sd, _mm_loadu_pd as loadu, _mm_max_pd as max, _mm_min_pd as min, _mm_movemask_pd, _mm_mul_pd as mul,
    _mm_or_pd as or, _mm_set1_epi64x, _mm_set1_pd as set1, _mm_slli_epi64, _mm_sqrt_pd as sqrt,
    _mm_storeu_pd as storeu, _mm_sub_epi64, _mm_sub_pd as sub, _mm_unpackhi_pd as high, _mm_unpacklo_pd as low,
    _mm_xor_pd as xor, _mm_xor_si128,
};

use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::math::simd::vec3::Vec3Register;
use crate::math::simd::{F64x8, LANES, PaddedVec3, RealOps, SimdVec, SoaLanes, chunk8, chunk8_mut};

simd_type! {
    /// A vector of eight numbers in four registers, without fused multiply-add.
    Sse2x8, 8 in registers of 2: 0 1 2 3
}

f64x8! { Sse2x8 of Sse2x2 beside BaselineF64 and Sse2x4, registers of 2: 0 1 2 3 }

simd_type! {
    /// A vector of two numbers in one register, without fused multiply-add.
    Sse2x2, 2 in registers of 2: 0
}

soa_lanes! { Sse2x2, each row an Sse2x8: 0 1 }

simd_type! {
    /// A vector of four numbers in two registers, without fused multiply-add.
    Sse2x4, 4 in registers of 2: 0 1
}

vec3_register! { Sse2x4 beside BaselineF64, registers of 2: 0 1 }

/// Loads up to two of `count` numbers, zeros in lanes after the last.
#[inline(always)]
unsafe fn first_of(values: *const f64, count: usize) -> Register {
    // SAFETY: every x86-64 processor has SSE2; `values` points to `count` numbers, and no more are read.
    unsafe {
        match count {
            0 => set1(0.0),
            1 => _mm_load_sd(values),
            _ => loadu(values),
        }
    }
}

#[inline(always)]
unsafe fn fmadd(a: Register, b: Register, c: Register) -> Register {
    // SAFETY: every x86-64 processor has SSE2.
    unsafe { add(mul(a, b), c) }
}

#[inline(always)]
unsafe fn fnmadd(a: Register, b: Register, c: Register) -> Register {
    // SAFETY: every x86-64 processor has SSE2.
    unsafe { sub(c, mul(a, b)) }
}

#[inline(always)]
unsafe fn blend(mask: Register, then: Register, otherwise: Register) -> Register {
    // SAFETY: every x86-64 processor has SSE2.
    unsafe { or(and(mask, then), andnot(mask, otherwise)) }
}

#[inline(always)]
unsafe fn mask_any(mask: Register) -> bool {
    // SAFETY: every x86-64 processor has SSE2.
    unsafe { _mm_movemask_pd(mask) != 0 }
}

#[inline(always)]
unsafe fn exp2_int(shifted: Register) -> Register {
    // SAFETY: every x86-64 processor has SSE2.
    unsafe {
        let exponent = _mm_slli_epi64::<52>(_mm_castpd_si128(shifted));
        _mm_castsi128_pd(_mm_add_epi64(exponent, _mm_set1_epi64x(1023 << 52)))
    }
}

#[inline(always)]
unsafe fn rotate_quadrant(shifted: Register, s: Register, c: Register) -> (Register, Register) {
    // SAFETY: every x86-64 processor has SSE2.
    unsafe {
        let quadrant = _mm_castpd_si128(shifted);
        let one = _mm_set1_epi64x(1);
        // 0 − 1 has all bits set, as the mask requires; 0 − 0 has none.
        let odd = _mm_castsi128_pd(_mm_sub_epi64(_mm_set1_epi64x(0), _mm_and_si128(quadrant, one)));
        let top = _mm_set1_epi64x(i64::MIN);
        let sine_sign = _mm_and_si128(_mm_slli_epi64::<62>(quadrant), top);
        let cosine_sign = _mm_xor_si128(sine_sign, _mm_slli_epi64::<63>(quadrant));
        (xor(blend(odd, c, s), _mm_castsi128_pd(sine_sign)), xor(blend(odd, s, c), _mm_castsi128_pd(cosine_sign)))
    }
}

#[inline(always)]
fn reduce_halves(n: [Register; 4]) -> Register {
    // SAFETY: every x86-64 processor has SSE2.
    unsafe { add(add(n[0], n[2]), add(n[1], n[3])) }
}

/// Returns the products of the two vectors, the upper half added to the lower.
#[inline(always)]
fn dot_halves(a: [Register; 4], b: [Register; 4]) -> Register {
    // SAFETY: every x86-64 processor has SSE2.
    reduce_halves(unsafe { [mul(a[0], b[0]), mul(a[1], b[1]), mul(a[2], b[2]), mul(a[3], b[3])] })
}

#[inline(always)]
fn sum4([a, b, c, d]: [Register; 4]) -> [f64; 4] {
    let mut out = [0.0; 4];
    // SAFETY: every x86-64 processor has SSE2.
    unsafe {
        storeu(out.as_mut_ptr(), add(low(a, b), high(a, b)));
        storeu(out.as_mut_ptr().add(2), add(low(c, d), high(c, d)));
    }
    out
}

#[inline(always)]
fn transposed(n: [Register; LANES]) -> [[Register; 4]; 2] {
    // SAFETY: every x86-64 processor has SSE2.
    unsafe {
        [
            [low(n[0], n[1]), low(n[2], n[3]), low(n[4], n[5]), low(n[6], n[7])],
            [high(n[0], n[1]), high(n[2], n[3]), high(n[4], n[5]), high(n[6], n[7])],
        ]
    }
}

#[inline(always)]
fn transposed_back([a, b]: [[Register; 4]; 2]) -> [Register; LANES] {
    // SAFETY: every x86-64 processor has SSE2.
    unsafe {
        [
            low(a[0], b[0]),
            high(a[0], b[0]),
            low(a[1], b[1]),
            high(a[1], b[1]),
            low(a[2], b[2]),
            high(a[2], b[2]),
            low(a[3], b[3]),
            high(a[3], b[3]),
        ]
    }
}

#[inline(always)]
fn components(cells: &[PaddedVec3; LANES]) -> [[Register; 4]; 3] {
    // SAFETY: every x86-64 processor has SSE2.
    let mut out = unsafe { [[set1(0.0); 4]; 3] };
    for pair in 0..4 {
        let (a, b) = (&cells[2 * pair], &cells[2 * pair + 1]);
        // SAFETY: every x86-64 processor has SSE2; a cell has four numbers.
        unsafe {
            let (xy, more) = (loadu(a.as_ptr()), loadu(b.as_ptr()));
            (out[0][pair], out[1][pair]) = (low(xy, more), high(xy, more));
            out[2][pair] = low(loadu(a.as_ptr().add(2)), loadu(b.as_ptr().add(2)));
        }
    }
    out
}
