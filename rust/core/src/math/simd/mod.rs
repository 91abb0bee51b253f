//! Number types of the control step and of batches of kinematics. Formulas are written once and compiled for each
//! instruction set.
//!
//! [`RealOps`] defines the operations, on one `f64` or on several lanes, with or without fused multiply-add. Rust never
//! fuses by itself, and `mul_add` without the instruction is a slow call, so the type decides. [`Isa`] is the set of
//! number types of one instruction set, and [`SimdLevel`] an instruction set that the processor has.
//!
//! In the control step a vector holds the joints or the task axes of one configuration. Formulas over joints are
//! generic over [`JointVector`], which has two kinds of implementation: [`F64x8`] in registers, for arms of at most
//! eight joints, and [`JointVec16`], for larger arms and for code that runs rarely. Formulas over task axes are generic
//! over [`F64x8`]. In batches of kinematics each lane of a register holds another configuration ([`SoaLanes`]).
//!
//! Everything that [`SimdLevel::dispatch`] runs is `#[inline(always)]`: a function that is not inlined would be
//! compiled for the baseline instruction set. For the same reason formulas over [`RealOps`] use loops, not closures.

use std::fmt::Debug;
use std::ops::{Add, Div, Mul, Neg, Sub};

use crate::AxisVec;

mod array;
mod dispatch;
mod elementary;
mod joint_vec16;
mod nontemporal;
mod scalar;
mod vec3;
mod vectors;
#[cfg(target_arch = "x86_64")]
mod x86;

#[cfg(not(target_arch = "x86_64"))]
pub(crate) use array::ArrayF64x8;
pub use dispatch::SimdLevel;
pub(crate) use dispatch::{BaselineF64x8, Isa, Kernel};
pub(crate) use elementary::{atan_over_y, atan2_first_quadrant, is_small_angle, tanh};
pub(crate) use joint_vec16::JointVec16;
pub(crate) use nontemporal::{NONTEMPORAL_MIN_BYTES, NonTemporalWriter, with_nontemporal};
pub(crate) use scalar::BaselineF64;
#[cfg(target_arch = "x86_64")]
pub(crate) use scalar::FmaF64;
pub(crate) use vec3::{PaddedVec3, Real, ScalarVec3, StoreVec3, Vec3Ops};
pub(crate) use vectors::JointVector;
#[cfg(target_arch = "x86_64")]
pub(crate) use x86::sse2::{Sse2x2, Sse2x8};
#[cfg(target_arch = "x86_64")]
// Not re-exported: their methods are safe functions, but use instructions whose presence only `SimdLevel` has checked.
use x86::{
    avx2::{Avx2x4, Avx2x8},
    avx512::Avx512x8,
};

/// Positions [rad, m] and velocities below this are set to 0. A decaying filter would otherwise reach subnormal numbers
/// and stay there; on some processors, a product with them takes a hundred cycles.
pub(crate) const NEGLIGIBLE: f64 = 1e-30;

/// Replaces negligibly small numbers by 0.
#[inline(always)]
pub(crate) fn flush_subnormals<J: JointVector>(q: J) -> J {
    J::select_lt(J::abs(q), J::splat(NEGLIGIBLE), J::splat(0.0), q)
}

/// Number of values in an [`F64x8`], and maximum number of lanes of a register.
pub(crate) const LANES: usize = 8;

/// A type with `+ − * /` and negation.
pub(crate) trait Number:
    Copy + Debug + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
}

impl<T> Number for T where
    T: Copy
        + Debug
        + Add<Output = Self>
        + Sub<Output = Self>
        + Mul<Output = Self>
        + Div<Output = Self>
        + Neg<Output = Self>
{
}

/// Arithmetic on numbers that hold one value (`Real = f64`) or several.
pub(crate) trait RealOps: Copy + Debug + 'static {
    /// The number type: `f64`, or a vector with one value per joint, per axis or per configuration.
    type Real: Number;

    /// True if a number has several lanes: of joints, axes or configurations.
    const WIDE: bool;

    /// Copies a value to every lane.
    fn splat(value: f64) -> Self::Real;

    /// Returns `a b + c`, with a fused multiply-add if the instruction set has it.
    fn fma(a: Self::Real, b: Self::Real, c: Self::Real) -> Self::Real;

    /// Returns `c − a b`, with a fused multiply-add if the instruction set has it.
    fn fnma(a: Self::Real, b: Self::Real, c: Self::Real) -> Self::Real;

    /// Returns `√value`.
    fn sqrt(value: Self::Real) -> Self::Real;

    /// Returns `|value|`.
    fn abs(value: Self::Real) -> Self::Real;

    /// Returns the larger of two numbers; NaN if `value` is NaN.
    fn max(value: Self::Real, bound: Self::Real) -> Self::Real;

    /// Returns the smaller of two numbers; NaN if `value` is NaN.
    fn min(value: Self::Real, bound: Self::Real) -> Self::Real;

    /// Returns `value` clamped to ± `bound`; NaN if `value` is NaN. Unlike `f64::clamp`, does not panic for a NaN
    /// bound.
    #[inline(always)]
    fn clamp_abs(value: Self::Real, bound: Self::Real) -> Self::Real {
        Self::min(Self::max(value, -bound), bound)
    }

    /// Returns `size` with the sign of `sign`.
    fn copy_sign(size: Self::Real, sign: Self::Real) -> Self::Real;

    /// Selects per lane: returns `then` if `a < b`, else `otherwise`.
    fn select_lt(a: Self::Real, b: Self::Real, then: Self::Real, otherwise: Self::Real) -> Self::Real;

    /// Returns 2ⁱ for the integer i in the low mantissa bits of `shifted` = i + [`ROUND`].
    fn exp2_int(shifted: Self::Real) -> Self::Real;

    /// Rotates `(s, c)`, sine and cosine, by i quarter turns, for the integer i in the low mantissa bits of `shifted` =
    /// i + [`ROUND`].
    fn rotate_quadrant(shifted: Self::Real, s: Self::Real, c: Self::Real) -> (Self::Real, Self::Real);
}

/// A SIMD vector in registers.
pub(crate) trait SimdVec: RealOps<Real = Self> + Number {
    /// Number of lanes, at most [`LANES`].
    const COUNT: usize;

    /// Loads the first [`SimdVec::COUNT`] numbers of `values`.
    fn from_array(values: &[f64; LANES]) -> Self;

    /// Stores the lanes into the first [`SimdVec::COUNT`] entries of `values`.
    fn store_array(self, values: &mut [f64; LANES]);

    /// Returns the lanes as an array, zeros after the last lane.
    #[inline(always)]
    fn to_array(self) -> [f64; LANES] {
        let mut out = [0.0; LANES];
        self.store_array(&mut out);
        out
    }
}

/// A vector with one value of each of several configurations.
pub(crate) trait SoaLanes: SimdVec {
    /// Loads eight numbers from each of several rows, which begin `stride` numbers apart; vector i of the result has
    /// number i of every row. An incomplete row counts as zeros.
    fn load_transposed(rows: &[f64], stride: usize) -> [Self; LANES];

    /// Stores eight numbers into each of several rows, which begin `stride` numbers apart, in the order of the rows;
    /// `columns[i]` has number i of every row. A row that does not fit is skipped.
    fn store_transposed(columns: &[Self; LANES], rows: &mut [f64], stride: usize);
}

/// Returns the eight numbers from index `at` on; zeros if there are fewer.
#[inline(always)]
fn chunk8(values: &[f64], at: usize) -> &[f64; LANES] {
    match values.get(at..) {
        Some(rest) => rest.first_chunk().unwrap_or(&[0.0; LANES]),
        None => &[0.0; LANES],
    }
}

/// Returns the eight numbers from index `at` on, for writing; `None` if there are fewer.
#[inline(always)]
fn chunk8_mut(values: &mut [f64], at: usize) -> Option<&mut [f64; LANES]> {
    values.get_mut(at..)?.first_chunk_mut()
}

/// A vector of eight values of one configuration: one per joint or per task axis.
pub(crate) trait F64x8: SimdVec {
    /// Scalar operations of the same instruction set.
    type Elem: RealOps<Real = f64>;

    /// 3-vector of the same instruction set.
    type Vec3: StoreVec3<Elem = Self::Elem>;

    /// One register of the vector.
    type Register: RealOps<Real = Self::Register>;

    /// Number of registers, at most 4.
    const REGISTERS: usize;

    /// Returns the register of this index.
    fn register(self, index: usize) -> Self::Register;

    /// Replaces the register of this index.
    fn set_register(&mut self, index: usize, register: Self::Register);

    /// Creates the vector from one number per task axis, zeros in the spare lanes.
    #[inline(always)]
    fn from_axes(v: &AxisVec) -> Self {
        Self::from_array(&[v[0], v[1], v[2], v[3], v[4], v[5], 0.0, 0.0])
    }

    /// Returns the numbers of the task axes.
    #[inline(always)]
    fn to_axes(self) -> AxisVec {
        let n = self.to_array();
        [n[0], n[1], n[2], n[3], n[4], n[5]]
    }

    /// Loads the first numbers of the slice, zeros in lanes after its end.
    fn load_partial(values: &[f64]) -> Self;

    /// Returns true if `a < b` in any lane.
    fn any_lt(a: Self, b: Self) -> bool;

    /// Returns true if `a < b` is false in any lane, also because of a NaN.
    fn any_not_lt(a: Self, b: Self) -> bool;

    /// Returns the sum of the lanes of each vector.
    fn hsum4(vectors: [Self; 4]) -> [f64; 4];

    /// Returns the dot product of each pair of vectors.
    fn hdot4(a: [Self; 4], b: [Self; 4]) -> [f64; 4];

    /// Returns the three components of the vectors in `cells`, one vector per lane.
    fn components(cells: &[PaddedVec3; LANES]) -> [Self; 3];
}

/// π/2 as a sum of three parts. The first two have 33 bits, so that their products with an integer below 2²⁰ are exact.
const HALF_PI: [f64; 3] = [1.570_796_326_734_125_6, 6.077_100_506_303_966e-11, 2.022_266_248_795_950_6e-21];

/// 1.5·2⁵². The sum of this and a number x has the integer nearest to x in its low mantissa bits; subtracting it again
/// gives that integer as a number.
const ROUND: f64 = 6_755_399_441_055_744.0;

/// Returns sine and cosine of `angle` [rad], with an error of at most 2.3e-16 for |angle| up to
/// [`COORDINATE_BOUND`](crate::pose::COORDINATE_BOUND).
///
/// It has no branches, tables or calls, so a loop over joints can be vectorized, and results are identical on every
/// system. The angle is reduced to |r| ≤ π/4 (Cody and Waite); the first omitted term of the Taylor series is below
/// 5e-17.
#[inline(always)]
pub(crate) fn sin_cos<A: RealOps>(angle: A::Real) -> (A::Real, A::Real) {
    let c = A::splat;
    let shifted = A::fma(angle, c(std::f64::consts::FRAC_2_PI), c(ROUND));
    let quarter_turns = shifted - c(ROUND);
    let r = A::fnma(quarter_turns, c(HALF_PI[1]), A::fnma(quarter_turns, c(HALF_PI[0]), angle));
    let r = A::fnma(quarter_turns, c(HALF_PI[2]), r);
    let r2 = r * r;
    let r4 = r2 * r2;
    let r8 = r4 * r4;
    // Terms in pairs, so that the additions of one series run in parallel.
    let low = A::fma(r2, c(1.0 / 120.0), c(-1.0 / 6.0));
    let low = A::fma(r4, A::fma(r2, c(1.0 / 362_880.0), c(-1.0 / 5_040.0)), low);
    let high = A::fma(r2, c(1.0 / 6_227_020_800.0), c(-1.0 / 39_916_800.0));
    let high = A::fnma(r4, c(1.0 / 1_307_674_368_000.0), high);
    let sine = A::fma(r * r2, A::fma(r8, high, low), r);
    let low = A::fnma(r2, c(1.0 / 720.0), c(1.0 / 24.0));
    let low = A::fma(r4, A::fnma(r2, c(1.0 / 3_628_800.0), c(1.0 / 40_320.0)), low);
    let high = A::fnma(r2, c(1.0 / 87_178_291_200.0), c(1.0 / 479_001_600.0));
    let high = A::fma(r4, c(1.0 / 20_922_789_888_000.0), high);
    let cosine = A::fma(r4, A::fma(r8, high, low), A::fnma(c(0.5), r2, c(1.0)));
    A::rotate_quadrant(shifted, sine, cosine)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Kernel: sines and cosines of eight angles, by the scalar and by the vector type.
    struct Sines<'a>(&'a [f64; LANES]);

    impl Kernel for Sines<'_> {
        type Output = [[(f64, f64); LANES]; 2];

        fn run<M: Isa>(self) -> Self::Output {
            let one = self.0.map(sin_cos::<M::Elem>);
            let (s, c) = sin_cos::<M::F64x8>(M::F64x8::from_array(self.0));
            let (s, c) = (s.to_array(), c.to_array());
            [one, std::array::from_fn(|i| (s[i], c[i]))]
        }
    }

    /// Number of vectors of angles that are compared. Miri takes milliseconds for each.
    const VECTORS: usize = if cfg!(miri) { 20 } else { 20_000 };
    /// Largest number of quarter turns in either direction.
    const QUARTERS: i32 = if cfg!(miri) { 8 } else { 1000 };

    /// Returns the largest difference from the system's functions over a dense sequence of angles within ±`largest`.
    fn worst(simd_level: SimdLevel, largest: f64) -> f64 {
        let mut off: f64 = 0.0;
        for i in 0..VECTORS {
            let at =
                |lane: usize| ((i * LANES + lane) as f64 * 0.618_033_988_749_895).fract() * 2.0 * largest - largest;
            let angles = std::array::from_fn(at);
            for all in simd_level.dispatch(Sines(&angles)) {
                for ((sine, cosine), angle) in all.iter().zip(angles) {
                    off = off.max((sine - angle.sin()).abs()).max((cosine - angle.cos()).abs());
                }
            }
        }
        off
    }

    #[test]
    fn sines_agree_with_the_system_up_to_rounding() {
        for simd_level in SimdLevel::available() {
            for largest in [1e-9, 0.8, 3.2, 100.0, 1e4, 1e6] {
                let off = worst(simd_level, largest);
                assert!(off <= 2.3e-16, "{simd_level}, within ±{largest}: {off:e}");
            }
        }
    }

    #[test]
    fn sines_at_multiples_of_a_quarter_turn() {
        for simd_level in SimdLevel::available() {
            for i in -QUARTERS..QUARTERS {
                let angle = f64::from(i) * std::f64::consts::FRAC_PI_2;
                for all in simd_level.dispatch(Sines(&[angle; LANES])) {
                    let (sine, cosine) = all[i.unsigned_abs() as usize % LANES];
                    assert!((sine - angle.sin()).abs() <= 1.2e-16 && (cosine - angle.cos()).abs() <= 1.2e-16, "{i}");
                }
            }
            let [(sine, cosine), ..] = simd_level.dispatch(Sines(&[0.0; LANES]))[1];
            assert_eq!([sine.to_bits(), cosine.to_bits()], [0.0_f64.to_bits(), 1.0_f64.to_bits()]);
        }
    }

    /// Kernel: loads eight numbers of each configuration from rows of the given stride, and stores them again.
    struct Turned<'a>(&'a [f64], usize);

    impl Kernel for Turned<'_> {
        type Output = (usize, [[f64; LANES]; LANES], Vec<f64>);

        fn run<M: Isa>(self) -> Self::Output {
            let columns = M::F64xN::load_transposed(self.0, self.1);
            let mut rows = vec![-1.0; self.0.len()];
            M::F64xN::store_transposed(&columns, &mut rows, self.1);
            (M::F64xN::COUNT, columns.map(M::F64xN::to_array), rows)
        }
    }

    #[test]
    fn rows_are_transposed_and_restored() {
        for simd_level in SimdLevel::available() {
            for stride in [LANES, 11, 42] {
                let table: Vec<f64> = (0..LANES * stride).map(|i| i as f64).collect();
                let (count, columns, rows) = simd_level.dispatch(Turned(&table, stride));
                for (at, row) in rows.iter().enumerate() {
                    let (r, c) = (at / stride, at % stride);
                    let inside = r < count && c < LANES;
                    assert_eq!(row.to_bits(), if inside { at as f64 } else { -1.0 }.to_bits(), "{simd_level} {r} {c}");
                    if inside {
                        assert_eq!(columns[c][r].to_bits(), (at as f64).to_bits(), "{simd_level} {r} {c}");
                    }
                }
            }
        }
    }

    #[test]
    fn an_incomplete_row_is_neither_read_nor_written() {
        for simd_level in SimdLevel::available() {
            let (_, columns, rows) = simd_level.dispatch(Turned(&[1.0; LANES + 3], LANES));
            assert!(rows[LANES..].iter().all(|&value| value < 0.0), "{simd_level}");
            assert!(columns.iter().all(|column| column[0] > 0.0 && column[1].abs() < 1.0), "{simd_level}");
        }
    }
}
