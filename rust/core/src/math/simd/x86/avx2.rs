//! Vector types in registers of four numbers, for processors with AVX2 and fused multiply-add.

// SAFETY of every `unsafe` below: as in the parent module, whose types are used only where the processor has their
// instructions.

use std::arch::x86_64::{
    __m256d as Register, _CMP_LT_OQ, _CMP_NLT_UQ, _mm256_add_epi64, _mm256_add_pd as add, _mm256_and_pd as and,
    _mm256_andnot_pd as andnot, _mm256_blendv_pd, _mm256_castpd_si256, _mm256_castsi256_pd, _mm256_cmp_pd,
    _mm256_div_pd as div, _mm256_fmadd_pd as fmadd, _mm256_fnmadd_pd as fnmadd, _mm256_loadu_pd as loadu,
    _mm256_loadu_si256, _mm256_maskload_pd, _mm256_max_pd as max, _mm256_min_pd as min, _mm256_movemask_pd,
    _mm256_mul_pd as mul, _mm256_or_pd as or, _mm256_set1_epi64x, _mm256_set1_pd as set1, _mm256_slli_epi64,
    _mm256_sqrt_pd as sqrt, _mm256_storeu_pd as storeu, _mm256_sub_pd as sub, _mm256_xor_pd as xor,
};

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::{hsum_of_four as sum4, transpose_4x4};
use crate::math::simd::vec3::Vec3Register;
use crate::math::simd::{F64x8, LANES, PaddedVec3, RealOps, SimdVec, SoaLanes, chunk8, chunk8_mut};

simd_type! {
    /// A vector of eight numbers in two registers, with fused multiply-add.
    Avx2x8, 8 in registers of 4: 0 1
}

f64x8! { Avx2x8 of Avx2x4 beside FmaF64 and Avx2x4, registers of 4: 0 1 }

simd_type! {
    /// A vector of four numbers in one register, with fused multiply-add.
    Avx2x4, 4 in registers of 4: 0
}

soa_lanes! { Avx2x4, each row an Avx2x8: 0 1 2 3 }

vec3_register! { Avx2x4 beside FmaF64, registers of 4: 0 }

/// Loads up to four of `count` numbers, zeros in lanes after the last.
#[inline(always)]
unsafe fn first_of(values: *const f64, count: usize) -> Register {
    const MASKS: [i64; 8] = [-1, -1, -1, -1, 0, 0, 0, 0];
    // SAFETY: the processor has the instructions, see `SimdLevel`; `values` points to `count` numbers, and the mask is
    // set for no more.
    unsafe { _mm256_maskload_pd(values, _mm256_loadu_si256(MASKS.as_ptr().add(4 - count.min(4)).cast())) }
}

#[inline(always)]
unsafe fn cmp_lt(a: Register, b: Register) -> Register {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe { _mm256_cmp_pd::<_CMP_LT_OQ>(a, b) }
}

#[inline(always)]
unsafe fn cmp_not_lt(a: Register, b: Register) -> Register {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe { _mm256_cmp_pd::<_CMP_NLT_UQ>(a, b) }
}

#[inline(always)]
unsafe fn blend(mask: Register, then: Register, otherwise: Register) -> Register {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe { _mm256_blendv_pd(otherwise, then, mask) }
}

#[inline(always)]
unsafe fn mask_any(mask: Register) -> bool {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe { _mm256_movemask_pd(mask) != 0 }
}

#[inline(always)]
unsafe fn exp2_int(shifted: Register) -> Register {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe {
        let exponent = _mm256_slli_epi64::<52>(_mm256_castpd_si256(shifted));
        _mm256_castsi256_pd(_mm256_add_epi64(exponent, _mm256_set1_epi64x(1023 << 52)))
    }
}

#[inline(always)]
unsafe fn rotate_quadrant(shifted: Register, s: Register, c: Register) -> (Register, Register) {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe {
        let quadrant = _mm256_castpd_si256(shifted);
        let odd = _mm256_castsi256_pd(_mm256_slli_epi64::<63>(quadrant));
        let sine_sign = and(_mm256_castsi256_pd(_mm256_slli_epi64::<62>(quadrant)), set1(-0.0));
        (xor(blend(odd, c, s), sine_sign), xor(blend(odd, s, c), xor(sine_sign, odd)))
    }
}

#[inline(always)]
fn reduce_halves(n: [Register; 2]) -> Register {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe { add(n[0], n[1]) }
}

/// Returns the products of the two vectors, the upper half added to the lower.
#[inline(always)]
fn dot_halves(a: [Register; 2], b: [Register; 2]) -> Register {
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe { fmadd(a[0], b[0], mul(a[1], b[1])) }
}

#[inline(always)]
fn transposed(n: [Register; LANES]) -> [[Register; 2]; 4] {
    let [a, b, c, d] = transpose_4x4([n[0], n[1], n[2], n[3]]);
    let [e, f, g, h] = transpose_4x4([n[4], n[5], n[6], n[7]]);
    [[a, e], [b, f], [c, g], [d, h]]
}

#[inline(always)]
fn transposed_back([[a, e], [b, f], [c, g], [d, h]]: [[Register; 2]; 4]) -> [Register; LANES] {
    let ([a, b, c, d], [e, f, g, h]) = (transpose_4x4([a, b, c, d]), transpose_4x4([e, f, g, h]));
    [a, b, c, d, e, f, g, h]
}

/// Returns the three components of the four vectors from index `first` on.
#[inline(always)]
fn components_of_four(cells: &[PaddedVec3; LANES], first: usize) -> [Register; 3] {
    // SAFETY: the processor has the instructions, see `SimdLevel`; a cell has four numbers.
    let rows = unsafe {
        [
            loadu(cells[first].as_ptr()),
            loadu(cells[first + 1].as_ptr()),
            loadu(cells[first + 2].as_ptr()),
            loadu(cells[first + 3].as_ptr()),
        ]
    };
    let [x, y, z, _] = transpose_4x4(rows);
    [x, y, z]
}

#[inline(always)]
fn components(cells: &[PaddedVec3; LANES]) -> [[Register; 2]; 3] {
    let ([a, b, c], [d, e, f]) = (components_of_four(cells, 0), components_of_four(cells, 4));
    [[a, d], [b, e], [c, f]]
}
