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
use super::{BaselineF64, Broadcast, F64x8, RealOps, SoaLanes};

/// Environment variable that selects a slower instruction set: `baseline`, `avx2` or `avx512`.
const FORCED: &str = "PLIANT_INSTRUCTIONS";

/// Number types of one instruction set.
pub(crate) trait Isa {
    /// Scalar.
    type Elem: RealOps<Real = f64> + Broadcast<f64>;
    /// Eight values of one configuration, one per joint or per task axis.
    type F64x8: F64x8<Elem = Self::Elem>;
    /// One value of each of several configurations.
    type F64xN: SoaLanes;
}

/// Code that is compiled for every instruction set; `run` and everything that it calls must be `#[inline(always)]`.
pub(crate) trait Kernel {
    /// Result.
    type Output;

    /// Runs the code with the number types of one instruction set.
    fn run<M: Isa>(self) -> Self::Output;
}

/// Instruction set that every processor of the architecture has.
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
    // One configuration is never stepped on AVX-512, see `dispatch_narrow`.
    type F64x8 = Avx2x8;
    type F64xN = Avx512x8;
}

/// An instruction set that this processor has.
///
/// Results differ between sets by rounding: below 1e-11 of their size at λ ≥ 0.02. On one set they are bit-identical.
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

    /// All sets that this processor has, slowest first.
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

    /// Returns the set in use: the widest one, or the one named by `PLIANT_INSTRUCTIONS` if this processor has it.
    pub fn detect() -> Self {
        static CHOSEN: OnceLock<SimdLevel> = OnceLock::new();
        *CHOSEN.get_or_init(|| {
            let all = Self::available();
            let forced = std::env::var(FORCED).unwrap_or_default();
            let found = all.iter().find(|set| set.name() == forced).or_else(|| all.last());
            found.copied().unwrap_or(Self::BASELINE)
        })
    }

    /// `baseline`, `avx2` or `avx512`.
    pub fn name(self) -> &'static str {
        match self.0 {
            Set::Baseline => "baseline",
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => "avx512",
        }
    }

    /// Runs code for single configurations: as [`SimdLevel::dispatch`], but at most with AVX2.
    ///
    /// Arrays of seven or eight numbers gain nothing from wider registers (kinematics even lose a tenth), and a third
    /// copy of the control step would be a third of the wheel's size.
    #[inline]
    pub(crate) fn dispatch_narrow<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            Set::Baseline => baseline(kernel),
            // SAFETY: as in `run`; a processor with AVX-512 has AVX2, see `available`.
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 | Set::Avx512 => unsafe { avx2(kernel) },
        }
    }

    /// Runs code with this instruction set.
    #[inline]
    pub(crate) fn dispatch<K: Kernel>(self, kernel: K) -> K::Output {
        match self.0 {
            Set::Baseline => baseline(kernel),
            // SAFETY: values of this kind are made in `available` alone, which checks the processor for all required
            // features.
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => unsafe { avx2(kernel) },
            // SAFETY: as above.
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

/// Not inlined, like the others: the caller may be optimised for size.
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
