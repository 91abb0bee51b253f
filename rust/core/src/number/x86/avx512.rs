//! Registers of eight numbers, with masks.

// SAFETY of every `unsafe` below: see the module above.

use std::arch::x86_64::{
    __m256d, __m512d as Register, __mmask8 as Mask, _CMP_LT_OQ, _mm256_add_pd, _mm256_loadu_pd, _mm256_setzero_pd,
    _mm256_storeu_pd, _mm512_add_epi64, _mm512_add_pd as add, _mm512_and_pd as and, _mm512_andnot_pd as andnot,
    _mm512_castpd_si512, _mm512_castpd256_pd512, _mm512_castpd512_pd256, _mm512_castsi512_pd, _mm512_cmp_pd_mask,
    _mm512_div_pd as div, _mm512_extractf64x4_pd, _mm512_fmadd_pd as fmadd, _mm512_fnmadd_pd as fnmadd,
    _mm512_insertf64x4, _mm512_loadu_pd as loadu, _mm512_mask_blend_pd, _mm512_maskz_loadu_pd, _mm512_max_pd as max,
    _mm512_min_pd as min, _mm512_mul_pd as mul, _mm512_or_pd as or, _mm512_set1_epi64, _mm512_set1_pd as set1,
    _mm512_slli_epi64, _mm512_sqrt_pd as sqrt, _mm512_storeu_pd as storeu, _mm512_sub_pd as sub,
    _mm512_test_epi64_mask, _mm512_xor_pd as xor,
};

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::avx2::{Four, components_of_four};
use super::{sums_of_four as sums, transpose_four};
use crate::number::{Arithmetic, Cell, LANES, Many, Packed, Spread, Wide};

numbers! {
    /// Eight numbers in one register.
    Avx512, 8 in registers of 8: 0
}

wide! { Avx512 beside Fused and Four }

many! { Avx512 }

/// The first of `count` numbers, 0 behind the last.
#[inline(always)]
unsafe fn first_of(numbers: *const f64, count: usize) -> Register {
    let mask = Mask::MAX >> (LANES - count.min(LANES));
    // SAFETY: as above; `numbers` has `count`, and the mask is set for no more.
    unsafe { _mm512_maskz_loadu_pd(if count == 0 { 0 } else { mask }, numbers) }
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
fn folded([n]: [Register; 1]) -> __m256d {
    let [low, high] = halves(n);
    // SAFETY: as above.
    unsafe { _mm256_add_pd(low, high) }
}

/// Products, folded.
#[inline(always)]
fn dotted([a]: [Register; 1], [b]: [Register; 1]) -> __m256d {
    // SAFETY: as above.
    folded(unsafe { [mul(a, b)] })
}

#[inline(always)]
fn transpose(n: [Register; LANES]) -> [[f64; LANES]; LANES] {
    let n = [
        halves(n[0]),
        halves(n[1]),
        halves(n[2]),
        halves(n[3]),
        halves(n[4]),
        halves(n[5]),
        halves(n[6]),
        halves(n[7]),
    ];
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

#[inline(always)]
fn columns(rows: &[[f64; LANES]; LANES]) -> [Register; LANES] {
    // SAFETY: as above.
    let mut out = unsafe { [set1(0.0); LANES] };
    for half in 0..2 {
        // SAFETY: as above.
        let mut quarters = unsafe { [[_mm256_setzero_pd(); 4]; 2] };
        for i in 0..LANES {
            // SAFETY: as above; a row has eight.
            quarters[i / 4][i % 4] = unsafe { _mm256_loadu_pd(rows[i].as_ptr().add(4 * half)) };
        }
        let (first, second) = (transpose_four(quarters[0]), transpose_four(quarters[1]));
        for i in 0..4 {
            // SAFETY: as above.
            out[4 * half + i] = unsafe { _mm512_insertf64x4::<1>(_mm512_castpd256_pd512(first[i]), second[i]) };
        }
    }
    out
}

#[inline(always)]
fn components(cells: &[Cell; LANES]) -> [[Register; 1]; 3] {
    let (low, high) = (components_of_four(cells, 0), components_of_four(cells, 4));
    // SAFETY: as above.
    let mut out = unsafe { [[set1(0.0)]; 3] };
    for i in 0..3 {
        // SAFETY: as above.
        out[i] = unsafe { [_mm512_insertf64x4::<1>(_mm512_castpd256_pd512(low[i]), high[i])] };
    }
    out
}
