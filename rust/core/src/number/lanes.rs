//! Several numbers at once: one per joint of an arm, and eight in an array for any architecture.
#![forbid(unsafe_code)]

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::scalar::{Plain, turn};
use super::{Arithmetic, EveryJoint, LANES, Many, Number, Packed, Spread, Wide};
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

/// What stands once for all joints or axes where an `L` has one each.
pub(crate) type Scalar<L> = <<L as Lanes>::One as Arithmetic>::Real;

/// The same of task axes.
pub(crate) type AxisScalar<W> = <<W as Axes>::One as Arithmetic>::Real;

/// One number per joint of an arm, those beyond its last joint included; arithmetic goes joint by joint.
///
/// Of one configuration ([`Joints`]) or of several ([`Columns`](super::Columns)).
pub(crate) trait Lanes: Arithmetic<Real = Self> + Number + Spread<Scalar<Self>> {
    /// One number of the same machine.
    type One: Arithmetic + Spread<Scalar<Self>>;

    /// One number per task axis.
    type Axes: Axes<One = Self::One>;

    /// From memory, the same for every configuration; what does not fit in is taken for 0.
    fn load(values: &JointVec) -> Self;

    /// From a number per joint; what does not fit in is taken for 0.
    fn of_joints(values: &[Scalar<Self>; MAX_JOINTS]) -> Self;

    /// A number per joint, 0 beyond.
    fn array(self) -> [Scalar<Self>; MAX_JOINTS];

    /// The largest number, or 0 if that is larger.
    fn largest(self) -> Scalar<Self>;

    /// The sum over the joints of each.
    fn sums(numbers: [Self; 4]) -> [Scalar<Self>; 4];

    /// The sum over the joints of each product.
    #[inline(always)]
    fn dots(a: [Self; 4], b: [Self; 4]) -> [Scalar<Self>; 4] {
        Self::sums([a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]])
    }

    /// Whether any number is less than the other of its joint.
    #[inline(always)]
    fn any_less(self, other: Self) -> bool {
        Self::less_anywhere(self, other)
    }

    /// The sum over the joints.
    #[inline(always)]
    fn sum(self) -> Scalar<Self> {
        Self::sums([self; 4])[0]
    }
}

/// One number per task axis; arithmetic goes axis by axis.
pub(crate) trait Axes: Arithmetic<Real = Self> + Number + Spread<AxisScalar<Self>> {
    /// One number of the same machine.
    type One: Arithmetic + Spread<AxisScalar<Self>>;

    /// From memory, the same for every configuration.
    fn constant(values: &[f64; LANES]) -> Self;

    /// From a number per axis.
    fn of_axes(values: &[AxisScalar<Self>; MAX_AXES]) -> Self;

    /// A number per axis.
    fn axes(self) -> [AxisScalar<Self>; MAX_AXES];
}

/// One number per joint of one configuration.
pub(crate) trait Joints: Lanes<One: Arithmetic<Real = f64>, Axes: Wide> {
    /// To memory; what is beyond is left as it is.
    fn store(self, values: &mut JointVec);

    /// The same for code that is compiled once.
    #[inline(always)]
    fn every(self) -> EveryJoint {
        EveryJoint::load(&self.array())
    }
}

impl<W: Wide> Axes for W {
    type One = W::One;

    #[inline(always)]
    fn constant(values: &[f64; LANES]) -> Self {
        W::of(values)
    }

    #[inline(always)]
    fn of_axes(v: &[f64; MAX_AXES]) -> Self {
        W::of(&[v[0], v[1], v[2], v[3], v[4], v[5], 0.0, 0.0])
    }

    #[inline(always)]
    fn axes(self) -> [f64; MAX_AXES] {
        let n = self.numbers();
        [n[0], n[1], n[2], n[3], n[4], n[5]]
    }
}

impl<W: Wide> Lanes for W {
    type One = W::One;
    type Axes = W;

    #[inline(always)]
    fn load(values: &JointVec) -> Self {
        values.first_chunk().map_or(W::splat(0.0), W::of)
    }

    #[inline(always)]
    fn of_joints(values: &JointVec) -> Self {
        Self::load(values)
    }

    #[inline(always)]
    fn array(self) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        self.store(&mut out);
        out
    }

    #[inline(always)]
    fn largest(self) -> f64 {
        let mut largest = 0.0;
        for value in self.numbers() {
            largest = Self::One::at_least(largest, value);
        }
        largest
    }

    #[inline(always)]
    fn sums(numbers: [Self; 4]) -> [f64; 4] {
        W::four_sums(numbers)
    }
}

impl<W: Wide> Joints for W {
    #[inline(always)]
    fn store(self, values: &mut JointVec) {
        if let Some(first) = values.first_chunk_mut() {
            W::put(self, first);
        }
    }
}

/// Eight numbers in an array, vector code left to the compiler: architectures whose registers nobody has written down.
#[cfg_attr(target_arch = "x86_64", allow(dead_code, reason = "x86-64 has registers of its own"))]
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Array([f64; LANES]);

macro_rules! operators {
    ($($trait:ident, $method:ident;)*) => {
        $(impl $trait for Array {
            type Output = Self;

            #[inline(always)]
            fn $method(mut self, other: Self) -> Self {
                for i in 0..LANES {
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

impl Neg for Array {
    type Output = Self;

    #[inline(always)]
    fn neg(mut self) -> Self {
        for value in &mut self.0 {
            *value = -*value;
        }
        self
    }
}

/// Functions of an array that do the same with every number.
macro_rules! by_lane {
    ($($function:ident($first:ident $(, $argument:ident)*);)*) => {
        $(#[inline(always)]
        fn $function(mut $first: Self $(, $argument: Self)*) -> Self {
            for i in 0..LANES {
                $first.0[i] = Plain::$function($first.0[i] $(, $argument.0[i])*);
            }
            $first
        })*
    };
}

impl Arithmetic for Array {
    type Real = Self;

    const WIDE: bool = true;

    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self([value; LANES])
    }

    by_lane! {
        fma(a, b, c);
        fnma(a, b, c);
        sqrt(value);
        abs(value);
        at_least(value, bound);
        at_most(value, bound);
        copy_sign(size, sign);
        if_less(a, b, then, otherwise);
        power_of_two(sum);
    }

    #[inline(always)]
    fn less_anywhere(a: Self, b: Self) -> bool {
        let mut any = false;
        for i in 0..LANES {
            any |= a.0[i] < b.0[i];
        }
        any
    }

    #[inline(always)]
    fn turn(turns: Self, mut s: Self, mut c: Self) -> (Self, Self) {
        for i in 0..LANES {
            (s.0[i], c.0[i]) = turn(turns.0[i], s.0[i], c.0[i]);
        }
        (s, c)
    }
}

impl Packed for Array {
    const COUNT: usize = LANES;

    #[inline(always)]
    fn of(values: &[f64; LANES]) -> Self {
        Self(*values)
    }

    #[inline(always)]
    fn put(self, values: &mut [f64; LANES]) {
        *values = self.0;
    }
}

impl Spread<f64> for Array {
    #[inline(always)]
    fn spread(value: f64) -> Self {
        Self::splat(value)
    }
}

impl Spread<Self> for Array {
    #[inline(always)]
    fn spread(value: Self) -> Self {
        value
    }
}

impl Wide for Array {
    type One = Plain;

    #[inline(always)]
    fn four_sums(numbers: [Self; 4]) -> [f64; 4] {
        let mut out = [0.0; 4];
        for (sum, Self(n)) in out.iter_mut().zip(numbers) {
            *sum = ((n[0] + n[4]) + (n[1] + n[5])) + ((n[2] + n[6]) + (n[3] + n[7]));
        }
        out
    }
}

impl Many for Array {
    #[inline(always)]
    fn transpose(numbers: &[Self; LANES]) -> [[f64; LANES]; LANES] {
        let mut out = [[0.0; LANES]; LANES];
        for i in 0..LANES {
            for j in 0..LANES {
                out[i][j] = numbers[j].0[i];
            }
        }
        out
    }

    #[inline(always)]
    fn columns(rows: &[[f64; LANES]; LANES]) -> [Self; LANES] {
        let mut out = [Self([0.0; LANES]); LANES];
        for i in 0..LANES {
            for j in 0..LANES {
                out[i].0[j] = rows[j][i];
            }
        }
        out
    }
}
