//! Vectors with one number per joint of an arm, or one per task axis.
#![forbid(unsafe_code)]

use super::{Arithmetic, Cell, EveryJoint, Kept, LANES, Number, Spread, Wide};
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

/// Scalar type of `L`: one value for all joints or axes.
pub(crate) type Scalar<L> = <<L as Lanes>::One as Arithmetic>::Real;

/// Scalar type of `W`.
pub(crate) type AxisScalar<W> = <<W as Axes>::One as Arithmetic>::Real;

/// One number per joint of an arm, padding included; elementwise arithmetic.
///
/// For one configuration ([`Joints`]) or for several ([`Columns`](super::Columns)).
pub(crate) trait Lanes: Arithmetic<Real = Self> + Number + Spread<Scalar<Self>> {
    /// Scalar of the same instruction set.
    type One: Arithmetic + Spread<Scalar<Self>>;

    /// One number per task axis.
    type Axes: Axes<One = Self::One>;

    /// Elements computed together: all joints of one configuration, or one joint of several.
    type Group: Spread<Scalar<Self>, Real: Number>;

    /// Number of groups.
    const GROUPS: usize;

    /// Outlines whole formulas, as each operation is (code size): the type does not fit in registers and runs on the
    /// baseline instruction set.
    const CALLED: bool = false;

    /// Group `i`.
    fn group(&self, i: usize) -> <Self::Group as Arithmetic>::Real;

    /// Sets group `i`.
    fn set_group(&mut self, i: usize, value: <Self::Group as Arithmetic>::Real);

    /// Loads values, the same for every configuration; elements that the type does not hold must be 0.
    fn load(values: &JointVec) -> Self;

    /// Creates it from one number per joint; elements that the type does not hold must be 0.
    fn of_joints(values: &[Scalar<Self>; MAX_JOINTS]) -> Self;

    /// Returns one number per joint, zeros after the last.
    fn array(self) -> [Scalar<Self>; MAX_JOINTS];

    /// Returns the largest number, at least 0.
    fn largest(self) -> Scalar<Self>;

    /// Returns the sum over the joints of each vector.
    fn sums(numbers: [Self; 4]) -> [Scalar<Self>; 4];

    /// Returns the dot product over the joints of each pair.
    fn dots(a: [&Self; 4], b: [&Self; 4]) -> [Scalar<Self>; 4];

    /// Returns true if any element is less than the other's.
    #[inline(always)]
    fn any_less(self, other: Self) -> bool {
        Self::less_anywhere(self, other)
    }

    /// Returns the sum over the joints.
    #[inline(always)]
    fn sum(self) -> Scalar<Self> {
        Self::sums([self; 4])[0]
    }
}

/// One number per task axis; elementwise arithmetic.
pub(crate) trait Axes: Arithmetic<Real = Self> + Number + Spread<AxisScalar<Self>> {
    /// Scalar of the same instruction set.
    type One: Arithmetic + Spread<AxisScalar<Self>>;

    /// Loads values, the same for every configuration.
    fn constant(values: &[f64; LANES]) -> Self;

    /// Creates it from one number per axis.
    fn of_axes(values: &[AxisScalar<Self>; MAX_AXES]) -> Self;

    /// Returns one number per axis.
    fn axes(self) -> [AxisScalar<Self>; MAX_AXES];
}

/// One number per joint of one configuration.
pub(crate) trait Joints: Lanes<One: Arithmetic<Real = f64>, Axes: Wide> {
    /// 3-vector of the same instruction set.
    type Triple: Kept<One = Self::One>;

    /// Loads the numbers of an arm's joints, zeros in the padding.
    fn read(values: &[f64]) -> Self;

    /// Returns the three components of one vector per joint.
    fn components(cells: &[Cell]) -> [Self; 3];

    /// Returns the first numbers, zeros after the last joint.
    fn few<const N: usize>(self) -> [f64; N];

    /// Stores to memory; elements that the type does not hold are unchanged.
    fn store(self, values: &mut JointVec);

    /// Converts to the type of code that is compiled once.
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
    type Group = W;

    const GROUPS: usize = 1;

    #[inline(always)]
    fn group(&self, _: usize) -> W {
        *self
    }

    #[inline(always)]
    fn set_group(&mut self, _: usize, value: W) {
        *self = value;
    }

    #[inline(always)]
    fn load(values: &JointVec) -> Self {
        match values.first_chunk() {
            Some(first) => W::of(first),
            None => W::splat(0.0),
        }
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
        let mut n = self.numbers();
        // By halves: a sequential sum would be one long dependency chain.
        for half in [4, 2, 1] {
            for i in 0..half {
                n[i] = Self::One::at_least(n[i], n[i + half]);
            }
        }
        Self::One::at_least(0.0, n[0])
    }

    #[inline(always)]
    fn sums(numbers: [Self; 4]) -> [f64; 4] {
        W::four_sums(numbers)
    }

    #[inline(always)]
    fn dots(a: [&Self; 4], b: [&Self; 4]) -> [f64; 4] {
        W::four_dots([*a[0], *a[1], *a[2], *a[3]], [*b[0], *b[1], *b[2], *b[3]])
    }
}

impl<W: Wide> Joints for W {
    type Triple = W::Triple;

    #[inline(always)]
    fn read(values: &[f64]) -> Self {
        W::part(values)
    }

    #[inline(always)]
    fn components(cells: &[Cell]) -> [Self; 3] {
        // No `map_or`: its closure would be compiled for the baseline instruction set.
        match cells.first_chunk() {
            Some(first) => W::components(first),
            None => [W::splat(0.0); 3],
        }
    }

    #[inline(always)]
    fn few<const N: usize>(self) -> [f64; N] {
        let mut out = [0.0; N];
        if let Some(first) = out.first_chunk_mut() {
            W::put(self, first);
        }
        out
    }

    #[inline(always)]
    fn store(self, values: &mut JointVec) {
        if let Some(first) = values.first_chunk_mut() {
            W::put(self, first);
        }
    }
}
