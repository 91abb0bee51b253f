//! Vectors of several configurations: one register per joint or per task axis, one configuration per lane.
#![forbid(unsafe_code)]
#![expect(
    clippy::manual_memcpy,
    reason = "copies of slices are calls where they are not inlined; loops become registers"
)]

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::{Broadcast, JointVector, LANES, RealOps, SOA_MAX_JOINTS, SoaLanes, TaskVector};
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

/// `N` values of each of several configurations: one register per value, one configuration per lane.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SoaVec<W, const N: usize>([W; N]);

impl<W: SoaLanes> SoaVec<W, SOA_MAX_JOINTS> {
    /// Returns one register per joint, zeros in the padding.
    #[inline(always)]
    pub(crate) fn to_array(self) -> [W; LANES] {
        let mut out = [W::splat(0.0); LANES];
        for i in 0..SOA_MAX_JOINTS {
            out[i] = self.0[i];
        }
        out
    }
}

impl<W: SoaLanes> JointVector for SoaVec<W, SOA_MAX_JOINTS> {
    type Elem = W;
    type Axes = SoaVec<W, MAX_AXES>;
    type Group = W;

    const GROUPS: usize = SOA_MAX_JOINTS;

    #[inline(always)]
    fn group(&self, i: usize) -> W {
        self.0[i]
    }

    #[inline(always)]
    fn set_group(&mut self, i: usize, value: W) {
        self.0[i] = value;
    }

    #[inline(always)]
    fn load(values: &JointVec) -> Self {
        let mut out = [W::splat(0.0); SOA_MAX_JOINTS];
        for i in 0..SOA_MAX_JOINTS {
            out[i] = W::splat(values[i]);
        }
        Self(out)
    }

    #[inline(always)]
    fn from_joints(values: &[W; MAX_JOINTS]) -> Self {
        let mut out = [W::splat(0.0); SOA_MAX_JOINTS];
        for i in 0..SOA_MAX_JOINTS {
            out[i] = values[i];
        }
        Self(out)
    }

    #[inline(always)]
    fn to_joints(self) -> [W; MAX_JOINTS] {
        let mut out = [W::splat(0.0); MAX_JOINTS];
        for i in 0..SOA_MAX_JOINTS {
            out[i] = self.0[i];
        }
        out
    }

    #[inline(always)]
    fn max_element(self) -> W {
        let mut largest = W::splat(0.0);
        for i in 0..SOA_MAX_JOINTS {
            largest = W::max(largest, self.0[i]);
        }
        largest
    }

    #[inline(always)]
    fn sum4(vectors: [Self; 4]) -> [W; 4] {
        [vectors[0].sum(), vectors[1].sum(), vectors[2].sum(), vectors[3].sum()]
    }

    #[inline(always)]
    fn sum(self) -> W {
        let mut sum = self.0[0];
        for i in 1..SOA_MAX_JOINTS {
            sum = sum + self.0[i];
        }
        sum
    }

    #[inline(always)]
    fn dot4(a: [&Self; 4], b: [&Self; 4]) -> [W; 4] {
        let mut out = [W::splat(0.0); 4];
        for k in 0..4 {
            out[k] = a[k].0[0] * b[k].0[0];
        }
        for i in 1..SOA_MAX_JOINTS {
            for k in 0..4 {
                out[k] = W::fma(a[k].0[i], b[k].0[i], out[k]);
            }
        }
        out
    }
}

impl<W: SoaLanes> TaskVector for SoaVec<W, MAX_AXES> {
    type Elem = W;

    #[inline(always)]
    fn constant(values: &[f64; LANES]) -> Self {
        let mut out = [W::splat(0.0); MAX_AXES];
        for i in 0..MAX_AXES {
            out[i] = W::splat(values[i]);
        }
        Self(out)
    }

    #[inline(always)]
    fn from_axes(values: &[W; MAX_AXES]) -> Self {
        Self(*values)
    }

    #[inline(always)]
    fn to_axes(self) -> [W; MAX_AXES] {
        self.0
    }
}

impl<W: SoaLanes, const N: usize> Broadcast<W> for SoaVec<W, N> {
    #[inline(always)]
    fn broadcast(value: W) -> Self {
        Self([value; N])
    }
}

/// Defines elementwise functions of [`RealOps`].
macro_rules! by_column {
    ($($function:ident($first:ident $(, $argument:ident)*);)*) => {
        $(#[inline(always)]
        fn $function(mut $first: Self $(, $argument: Self)*) -> Self {
            for i in 0..N {
                $first.0[i] = W::$function($first.0[i] $(, $argument.0[i])*);
            }
            $first
        })*
    };
}

impl<W: SoaLanes, const N: usize> RealOps for SoaVec<W, N> {
    type Real = Self;

    const WIDE: bool = true;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self([W::splat(value); N])
    }

    by_column! {
        fma(a, b, c);
        fnma(a, b, c);
        sqrt(value);
        abs(value);
        max(value, bound);
        min(value, bound);
        copy_sign(size, sign);
        select_lt(a, b, then, otherwise);
        exp2_int(sum);
    }

    #[inline(always)]
    fn any_lt(a: Self, b: Self) -> bool {
        let mut any = false;
        for i in 0..N {
            any |= W::any_lt(a.0[i], b.0[i]);
        }
        any
    }

    #[inline(always)]
    fn rotate_quadrant(turns: Self, mut s: Self, mut c: Self) -> (Self, Self) {
        for i in 0..N {
            (s.0[i], c.0[i]) = W::rotate_quadrant(turns.0[i], s.0[i], c.0[i]);
        }
        (s, c)
    }
}

macro_rules! operators {
    ($($trait:ident, $method:ident;)*) => {
        $(impl<W: SoaLanes, const N: usize> $trait for SoaVec<W, N> {
            type Output = Self;

            #[inline(always)]
            fn $method(mut self, other: Self) -> Self {
                for i in 0..N {
                    self.0[i] = self.0[i].$method(other.0[i]);
                }
                self
            }
        })*
    };
}

operators! {
    Add, add;
    Sub, sub;
    Mul, mul;
    Div, div;
}

impl<W: SoaLanes, const N: usize> Neg for SoaVec<W, N> {
    type Output = Self;

    #[inline(always)]
    fn neg(mut self) -> Self {
        for i in 0..N {
            self.0[i] = -self.0[i];
        }
        self
    }
}
