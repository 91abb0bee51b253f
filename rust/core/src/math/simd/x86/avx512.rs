//! Vector type in registers of eight numbers with masks, for processors with AVX-512.

// SAFETY of every `unsafe` below: as in the parent module, whose types are used only where the processor has their
// instructions.

use std::arch::x86_64::{
    __m512d as Register, __mmask8 as Mask, _CMP_LT_OQ, _mm512_add_epi64, _mm512_add_pd as add, _mm512_and_pd as and,
    _mm512_andnot_pd as andnot, _mm512_castpd_si512, _mm512_castsi512_pd, _mm512_cmp_pd_mask, _mm512_div_pd as div,
    _mm512_fmadd_pd as fmadd, _mm512_fnmadd_pd as fnmadd, _mm512_loadu_pd as loadu, _mm512_mask_blend_pd,
    _mm512_max_pd as max, _mm512_min_pd as min, _mm512_mul_pd as mul, _mm512_or_pd as or, _mm512_set1_epi64,
    _mm512_set1_pd as set1, _mm512_shuffle_f64x2 as shuffle, _mm512_slli_epi64, _mm512_sqrt_pd as sqrt,
    _mm512_storeu_pd as storeu, _mm512_sub_pd as sub, _mm512_test_epi64_mask, _mm512_unpackhi_pd as high,
    _mm512_unpacklo_pd as low, _mm512_xor_pd as xor,
};

use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::math::simd::{LANES, RealOps, SimdVec, SoaLanes, chunk8, chunk8_mut};

simd_type! {
    /// A vector of eight numbers in one register, with fused multiply-add.
    Avx512x8, 8 in registers of 8: 0
}

soa_lanes! { Avx512x8, each row an Avx512x8: 0 1 2 3 4 5 6 7 }

#[inline(always)]
unsafe fn cmp_lt(a: Register, b: Register) -> Mask {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe { _mm512_cmp_pd_mask::<_CMP_LT_OQ>(a, b) }
}

#[inline(always)]
unsafe fn blend(mask: Mask, then: Register, otherwise: Register) -> Register {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe { _mm512_mask_blend_pd(mask, otherwise, then) }
}

#[inline(always)]
unsafe fn exp2_int(shifted: Register) -> Register {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe {
        let exponent = _mm512_slli_epi64::<52>(_mm512_castpd_si512(shifted));
        _mm512_castsi512_pd(_mm512_add_epi64(exponent, _mm512_set1_epi64(1023 << 52)))
    }
}

#[inline(always)]
unsafe fn rotate_quadrant(shifted: Register, s: Register, c: Register) -> (Register, Register) {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe {
        let quadrant = _mm512_castpd_si512(shifted);
        let odd = _mm512_test_epi64_mask(quadrant, _mm512_set1_epi64(1));
        let sine_sign = and(_mm512_castsi512_pd(_mm512_slli_epi64::<62>(quadrant)), set1(-0.0));
        let cosine_sign = xor(sine_sign, _mm512_castsi512_pd(_mm512_slli_epi64::<63>(quadrant)));
        (xor(blend(odd, c, s), sine_sign), xor(blend(odd, s, c), cosine_sign))
    }
}

/// Transposes an 8 × 8 matrix, one row per register.
#[inline(always)]
fn transpose_8x8(n: [Register; LANES]) -> [Register; LANES] {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe {
        // First transpose pairs of numbers (even and odd columns), then quarters of registers.
        let even = [low(n[0], n[1]), low(n[2], n[3]), low(n[4], n[5]), low(n[6], n[7])];
        let odd = [high(n[0], n[1]), high(n[2], n[3]), high(n[4], n[5]), high(n[6], n[7])];
        let ([a, c, e, g], [b, d, f, h]) = (transpose_quarters(even), transpose_quarters(odd));
        [a, b, c, d, e, f, g, h]
    }
}

/// Transposes a 4 × 4 matrix whose entries are quarters of a register, two numbers each.
#[inline(always)]
unsafe fn transpose_quarters(n: [Register; 4]) -> [Register; 4] {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe {
        let (a, b) = (shuffle::<0x88>(n[0], n[1]), shuffle::<0xdd>(n[0], n[1]));
        let (c, d) = (shuffle::<0x88>(n[2], n[3]), shuffle::<0xdd>(n[2], n[3]));
        [shuffle::<0x88>(a, c), shuffle::<0x88>(b, d), shuffle::<0xdd>(a, c), shuffle::<0xdd>(b, d)]
    }
}

#[inline(always)]
fn transposed(n: [Register; LANES]) -> [[Register; 1]; LANES] {
    let n = transpose_8x8(n);
    [[n[0]], [n[1]], [n[2]], [n[3]], [n[4]], [n[5]], [n[6]], [n[7]]]
}

#[inline(always)]
fn transposed_back([[a], [b], [c], [d], [e], [f], [g], [h]]: [[Register; 1]; LANES]) -> [Register; LANES] {
    transpose_8x8([a, b, c, d, e, f, g, h])
}
