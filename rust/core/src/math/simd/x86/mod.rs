//! Vector types of x86-64: in registers of two, four or eight numbers.
#![expect(unsafe_code, reason = "vector instructions; they are entered only through `SimdLevel::dispatch`")]

use std::arch::x86_64::__m256d;

// SAFETY of every `unsafe` below: values of these types are created only in code entered through `SimdLevel::dispatch`,
// that is on a processor with the instructions; memory is accessed only through references of the right size.

/// Defines a vector type over registers, from the instructions that the calling module imports under common names.
macro_rules! simd_type {
    ($(#[$doc:meta])* $name:ident, $count:literal in registers of $width:literal: $($i:literal)*) => {
        $(#[$doc])*
        #[derive(Debug, Clone, Copy)]
        pub(crate) struct $name([Register; $count / $width]);

        simd_type!(@operators $name ($($i)*) Add add, Sub sub, Mul mul, Div div);

        impl Neg for $name {
            type Output = Self;

            #[inline(always)]
            fn neg(self) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                Self(unsafe { [$(xor(self.0[$i], set1(-0.0))),*] })
            }
        }

        impl RealOps for $name {
            type Real = Self;

            const WIDE: bool = true;

            #[inline(always)]
            fn splat(value: f64) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                Self([unsafe { set1(value) }; $count / $width])
            }

            #[inline(always)]
            fn fma(a: Self, b: Self, c: Self) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                Self(unsafe { [$(fmadd(a.0[$i], b.0[$i], c.0[$i])),*] })
            }

            #[inline(always)]
            fn fnma(a: Self, b: Self, c: Self) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                Self(unsafe { [$(fnmadd(a.0[$i], b.0[$i], c.0[$i])),*] })
            }

            #[inline(always)]
            fn sqrt(value: Self) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                Self(unsafe { [$(sqrt(value.0[$i])),*] })
            }

            #[inline(always)]
            fn abs(value: Self) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                Self(unsafe { [$(andnot(set1(-0.0), value.0[$i])),*] })
            }

            #[inline(always)]
            fn max(value: Self, bound: Self) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`. If either operand is NaN, these
                // instructions return the second.
                Self(unsafe { [$(max(bound.0[$i], value.0[$i])),*] })
            }

            #[inline(always)]
            fn min(value: Self, bound: Self) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                Self(unsafe { [$(min(bound.0[$i], value.0[$i])),*] })
            }

            #[inline(always)]
            fn copy_sign(size: Self, sign: Self) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                Self(unsafe { [$(or(andnot(set1(-0.0), size.0[$i]), and(set1(-0.0), sign.0[$i]))),*] })
            }

            #[inline(always)]
            fn select_lt(a: Self, b: Self, then: Self, otherwise: Self) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                Self(unsafe { [$(blend(cmp_lt(a.0[$i], b.0[$i]), then.0[$i], otherwise.0[$i])),*] })
            }

            #[inline(always)]
            fn exp2_int(shifted: Self) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                Self(unsafe { [$(exp2_int(shifted.0[$i])),*] })
            }

            #[inline(always)]
            fn rotate_quadrant(shifted: Self, mut s: Self, mut c: Self) -> (Self, Self) {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                $((s.0[$i], c.0[$i]) = unsafe { rotate_quadrant(shifted.0[$i], s.0[$i], c.0[$i]) };)*
                (s, c)
            }
        }

        impl SimdVec for $name {
            const COUNT: usize = $count;

            #[inline(always)]
            fn from_array(values: &[f64; LANES]) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`; there are eight values.
                Self(unsafe { [$(loadu(values.as_ptr().add($i * $width))),*] })
            }

            #[inline(always)]
            fn store_array(self, values: &mut [f64; LANES]) {
                // SAFETY: the processor has the instructions, see `SimdLevel`; there is room for eight values.
                unsafe { $(storeu(values.as_mut_ptr().add($i * $width), self.0[$i]);)* }
            }
        }
    };
    (@operators $name:ident $indices:tt $($trait:ident $method:ident),*) => {
        $(simd_type!(@operator $name $indices $trait $method);)*
    };
    (@operator $name:ident ($($i:literal)*) $trait:ident $method:ident) => {
        impl $trait for $name {
            type Output = Self;

            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                Self(unsafe { [$($method(self.0[$i], other.0[$i])),*] })
            }
        }
    };
}

/// Implements [`F64x8`] for a vector of eight numbers.
macro_rules! f64x8 {
    ($name:ident of $register:ident beside $one:ident and $vec3_register:ident,
        registers of $width:literal: $($i:literal)*) => {
        impl F64x8 for $name {
            type Elem = crate::math::simd::$one;
            type Vec3 = $vec3_register;
            type Register = $register;

            const REGISTERS: usize = LANES / $width;

            #[inline(always)]
            fn register(self, index: usize) -> $register {
                $register([self.0[index]])
            }

            #[inline(always)]
            fn set_register(&mut self, index: usize, register: $register) {
                self.0[index] = register.0[0];
            }

            #[inline(always)]
            fn load_partial(values: &[f64]) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`. Register i loads at most the
                // `len − i · width` values that exist from offset i · width on; with a count of 0 it reads no memory.
                Self(unsafe {
                    [$(first_of(values.as_ptr().wrapping_add($i * $width), values.len().saturating_sub($i * $width))),*]
                })
            }

            #[inline(always)]
            fn any_lt(a: Self, b: Self) -> bool {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                unsafe { false $(| mask_any(cmp_lt(a.0[$i], b.0[$i])))* }
            }

            #[inline(always)]
            fn any_not_lt(a: Self, b: Self) -> bool {
                // SAFETY: the processor has the instructions, see `SimdLevel`.
                unsafe { false $(| mask_any(cmp_not_lt(a.0[$i], b.0[$i])))* }
            }

            #[inline(always)]
            fn hsum4(n: [Self; 4]) -> [f64; 4] {
                sum4([reduce_halves(n[0].0), reduce_halves(n[1].0), reduce_halves(n[2].0), reduce_halves(n[3].0)])
            }

            #[inline(always)]
            fn hdot4(a: [Self; 4], b: [Self; 4]) -> [f64; 4] {
                sum4([
                    dot_halves(a[0].0, b[0].0),
                    dot_halves(a[1].0, b[1].0),
                    dot_halves(a[2].0, b[2].0),
                    dot_halves(a[3].0, b[3].0),
                ])
            }

            #[inline(always)]
            fn components(cells: &[PaddedVec3; LANES]) -> [Self; 3] {
                let [x, y, z] = components(cells);
                [Self(x), Self(y), Self(z)]
            }
        }
    };
}

/// Implements [`Vec3Register`] for a vector of four numbers.
macro_rules! vec3_register {
    ($name:ident beside $one:ident, registers of $width:literal: $($i:literal)*) => {
        impl Vec3Register for $name {
            type Elem = crate::math::simd::$one;

            #[inline(always)]
            fn load_cell(cell: &PaddedVec3) -> Self {
                // SAFETY: the processor has the instructions, see `SimdLevel`; there are four values.
                Self(unsafe { [$(loadu(cell.as_ptr().add($i * $width))),*] })
            }

            #[inline(always)]
            fn store_cell(self, cell: &mut PaddedVec3) {
                // SAFETY: the processor has the instructions, see `SimdLevel`; there is room for four values.
                unsafe { $(storeu(cell.as_mut_ptr().add($i * $width), self.0[$i]);)* }
            }
        }
    };
}

/// Implements [`SoaLanes`] for a single register.
macro_rules! soa_lanes {
    ($name:ident, each row an $row:ident: $($i:literal)*) => {
        impl SoaLanes for $name {
            #[inline(always)]
            fn load_transposed(rows: &[f64], stride: usize) -> [Self; LANES] {
                let n = transposed_back([$($row::from_array(chunk8(rows, $i * stride)).0),*]);
                [
                    Self([n[0]]),
                    Self([n[1]]),
                    Self([n[2]]),
                    Self([n[3]]),
                    Self([n[4]]),
                    Self([n[5]]),
                    Self([n[6]]),
                    Self([n[7]]),
                ]
            }

            #[inline(always)]
            fn store_transposed(n: &[Self; LANES], rows: &mut [f64], stride: usize) {
                let n = [n[0].0[0], n[1].0[0], n[2].0[0], n[3].0[0], n[4].0[0], n[5].0[0], n[6].0[0], n[7].0[0]];
                let transposed = transposed(n);
                $(if let Some(row) = chunk8_mut(rows, $i * stride) {
                    $row(transposed[$i]).store_array(row);
                })*
            }
        }
    };
}

pub(super) mod avx2;
pub(super) mod avx512;
pub(super) mod sse2;

/// Returns the sum of the lanes of each of four registers.
#[inline(always)]
fn hsum_of_four([a, b, c, d]: [__m256d; 4]) -> [f64; 4] {
    use std::arch::x86_64::{_mm256_add_pd, _mm256_hadd_pd, _mm256_permute2f128_pd, _mm256_storeu_pd};
    let mut out = [0.0; 4];
    // SAFETY: the processor has the instructions, see `SimdLevel`.
    unsafe {
        let (ab, cd) = (_mm256_hadd_pd(a, b), _mm256_hadd_pd(c, d));
        let (low, high) = (_mm256_permute2f128_pd::<0x20>(ab, cd), _mm256_permute2f128_pd::<0x31>(ab, cd));
        _mm256_storeu_pd(out.as_mut_ptr(), _mm256_add_pd(low, high));
    }
    out
}

/// Transposes a 4 × 4 matrix, one row per register.
#[inline(always)]
fn transpose_4x4(r: [__m256d; 4]) -> [__m256d; 4] {
    use std::arch::x86_64::{_mm256_permute2f128_pd, _mm256_unpackhi_pd, _mm256_unpacklo_pd};
    // SAFETY: the processor has the instructions, see `SimdLevel`.
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
