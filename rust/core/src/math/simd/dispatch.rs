//! Instruction sets of the processor, and the entry points into code compiled for them.
#![cfg_attr(
    target_arch = "x86_64",
    expect(unsafe_code, reason = "code compiled for an instruction set is entered only where the processor has it")
)]

use std::fmt;
use std::sync::OnceLock;

#[cfg(not(target_arch = "x86_64"))]
pub(crate) use super::ArrayF64x8 as BaselineF64x8;
#[cfg(not(target_arch = "x86_64"))]
use super::ArrayF64x8 as BaselineF64xN;
#[cfg(target_arch = "x86_64")]
use super::Sse2x2 as BaselineF64xN;
#[cfg(target_arch = "x86_64")]
pub(crate) use super::Sse2x8 as BaselineF64x8;
#[cfg(target_arch = "x86_64")]
use super::{Avx2x4, Avx2x8, Avx512x8, FmaF64};
use super::{BaselineF64, F64x8, RealOps, SoaLanes};

/// Environment variable that selects an instruction set by name: `baseline`, `avx2` or `avx512`.
const INSTRUCTIONS_VARIABLE: &str = "PLIANT_INSTRUCTIONS";

/// The number types of one instruction set.
pub(crate) trait Isa {
    /// Scalar operations of the instruction set.
    type Elem: RealOps<Real = f64>;
    /// Vector of eight values of one configuration, one per joint or per task axis.
    type F64x8: F64x8<Elem = Self::Elem>;
    /// Vector with one value of each of several configurations.
    type F64xN: SoaLanes;
}

/// Code that is compiled for every instruction set. `run` and everything that it calls must be `#[inline(always)]`.
pub(crate) trait Kernel {
    /// Result of [`Kernel::run`].
    type Output;

    /// Runs the code with the number types of one instruction set.
    fn run<M: Isa>(self) -> Self::Output;
}

/// Number types of the instruction set that every processor of the architecture has.
pub(crate) struct Baseline;

impl Isa for Baseline {
    type Elem = BaselineF64;
    type F64x8 = BaselineF64x8;
    type F64xN = BaselineF64xN;
}

#[cfg(target_arch = "x86_64")]
impl Isa for Avx2x8 {
    type Elem = FmaF64;
    type F64x8 = Avx2x8;
    type F64xN = Avx2x4;
}

#[cfg(target_arch = "x86_64")]
impl Isa for Avx512x8 {
    type Elem = FmaF64;
    // Code for one configuration never runs with AVX-512, see `dispatch_narrow`.
    type F64x8 = Avx2x8;
    type F64xN = Avx512x8;
}

/// An instruction set that this processor has.
///
/// Results are bit-identical within a set and differ between sets by rounding: by less than 1e-11, relative, for a
/// damping λ ≥ 0.02, singular values σ ≥ 0.01 σ_max and periods of at least 1 ms, unless rounding decides between two
/// cases of law `paper`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SimdLevel(Set);

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Set {
    Baseline,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl SimdLevel {
    /// The instruction set that every processor of this architecture has.
    pub const BASELINE: Self = Self(Set::Baseline);

    /// Returns all sets that this processor has, slowest first.
    pub fn available() -> Vec<Self> {
        #[allow(unused_mut, reason = "other architectures have one set")]
        let mut all = vec![Self::BASELINE];
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2")
                && is_x86_feature_detected!("fma")
                && is_x86_feature_detected!("bmi1")
                && is_x86_feature_detected!("bmi2");
            if avx2 {
                all.push(Self(Set::Avx2));
            }
            let avx512 = is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512bw");
            if avx2 && avx512 {
                all.push(Self(Set::Avx512));
            }
        }
        all
    }

    /// Returns the set in use: the one that the environment variable `PLIANT_INSTRUCTIONS` names if this processor has
    /// it, else the widest one.
    pub fn detect() -> Self {
        static CHOSEN: OnceLock<SimdLevel> = OnceLock::new();
        *CHOSEN.get_or_init(|| {
            let all = Self::available();
            let requested = std::env::var(INSTRUCTIONS_VARIABLE).unwrap_or_default();
            let found = all.iter().find(|set| set.name() == requested).or_else(|| all.last());
            found.copied().unwrap_or(Self::BASELINE)
        })
    }

    /// Returns the name: `baseline`, `avx2` or `avx512`.
    pub fn name(self) -> &'static str {
        match self.0 {
            Set::Baseline => "baseline",
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => "avx512",
        }
    }

    /// Runs code for one configuration with this instruction set, but at most with AVX2.
    ///
    /// Vectors of seven or eight numbers are not faster in wider registers (kinematics are a tenth slower), and a third
    /// copy of the control step would increase the size of the Python wheel by a third.
    #[inline]
    pub(crate) fn dispatch_narrow<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            Set::Baseline => baseline(kernel),
            // SAFETY: as in `dispatch`; a processor with AVX-512 has AVX2, see `available`.
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 | Set::Avx512 => unsafe { avx2(kernel) },
        }
    }

    /// Runs code for several configurations, one per lane of a register, with this instruction set.
    #[inline]
    pub(crate) fn dispatch<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            Set::Baseline => baseline(kernel),
            // SAFETY: only `available` creates this value, after it has checked that the processor has all required
            // features.
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => unsafe { avx2(kernel) },
            // SAFETY: as for `Set::Avx2`.
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => unsafe { avx512(kernel) },
        }
    }
}

impl fmt::Display for SimdLevel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Runs code with the baseline instruction set. Like `avx2` and `avx512` it is not inlined, because its caller may be
/// optimized for size.
#[inline(never)]
fn baseline<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Baseline>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma,bmi1,bmi2")]
fn avx2<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Avx2x8>()
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma,bmi1,bmi2")]
fn avx512<K: Kernel>(kernel: K) -> K::Output {
    kernel.run::<Avx512x8>()
}
