//! Vector types with one number per joint of an arm, or one per task axis.
#![forbid(unsafe_code)]

use super::{Broadcast, F64x8, JointVec16, LANES, Number, PaddedVec3, RealOps, StoreVec3};
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

/// Scalar type of the joint vector `L`: one value that holds for all joints, per configuration.
pub(crate) type Scalar<L> = <<L as JointVector>::Elem as RealOps>::Real;

/// Scalar type of the task vector `W`: the value of one axis, per configuration.
pub(crate) type AxisScalar<W> = <<W as TaskVector>::Elem as RealOps>::Real;

/// A vector of one number per joint of an arm, padding included; arithmetic is elementwise.
///
/// It holds one configuration ([`SingleArmJoints`]) or several ([`SoaVec`](super::SoaVec)).
pub(crate) trait JointVector: RealOps<Real = Self> + Number + Broadcast<Scalar<Self>> {
    /// Scalar operations of the same instruction set.
    type Elem: RealOps + Broadcast<Scalar<Self>>;

    /// Task vector of the same instruction set.
    type Axes: TaskVector<Elem = Self::Elem>;

    /// Elements that one operation computes: all joints of one configuration, or one joint of several.
    type Group: Broadcast<Scalar<Self>, Real: Number>;

    /// Number of groups that make up the vector.
    const GROUPS: usize;

    /// True to compile whole formulas as calls, for smaller code: for a type that does not fit in registers and runs on
    /// the baseline instruction set.
    const OUTLINED: bool = false;

    /// Returns group `i`.
    fn group(&self, i: usize) -> <Self::Group as RealOps>::Real;

    /// Sets group `i` to `value`.
    fn set_group(&mut self, i: usize, value: <Self::Group as RealOps>::Real);

    /// Loads one number per joint, broadcast to all configurations; numbers for which the type has no element must be
    /// 0.
    fn load(values: &JointVec) -> Self;

    /// Creates the vector from one scalar per joint; scalars for which the type has no element must be 0.
    fn from_joints(values: &[Scalar<Self>; MAX_JOINTS]) -> Self;

    /// Returns one scalar per joint, zeros after the last.
    fn to_joints(self) -> [Scalar<Self>; MAX_JOINTS];

    /// Returns the largest element, at least 0.
    fn max_element(self) -> Scalar<Self>;

    /// Returns the sum over the joints of each of four vectors.
    fn sum4(vectors: [Self; 4]) -> [Scalar<Self>; 4];

    /// Returns the dot product over the joints of each of four pairs.
    fn dot4(a: [&Self; 4], b: [&Self; 4]) -> [Scalar<Self>; 4];

    /// Returns true if any element is less than the same element of `other`.
    #[inline(always)]
    fn is_any_lt(self, other: Self) -> bool {
        Self::any_lt(self, other)
    }

    /// Returns the sum of the elements over the joints.
    #[inline(always)]
    fn sum(self) -> Scalar<Self> {
        Self::sum4([self; 4])[0]
    }
}

/// A vector of one number per task axis; arithmetic is elementwise.
pub(crate) trait TaskVector: RealOps<Real = Self> + Number + Broadcast<AxisScalar<Self>> {
    /// Scalar operations of the same instruction set.
    type Elem: RealOps + Broadcast<AxisScalar<Self>>;

    /// Loads one number per axis, broadcast to all configurations.
    fn constant(values: &[f64; LANES]) -> Self;

    /// Creates the vector from one scalar per axis.
    fn from_axes(values: &[AxisScalar<Self>; MAX_AXES]) -> Self;

    /// Returns one scalar per axis.
    fn to_axes(self) -> [AxisScalar<Self>; MAX_AXES];
}

/// A vector of one number per joint of one configuration.
pub(crate) trait SingleArmJoints: JointVector<Elem: RealOps<Real = f64>, Axes: F64x8> {
    /// 3-vector of the same instruction set.
    type Vec3: StoreVec3<Elem = Self::Elem>;

    /// Loads one number per joint of the arm, zeros in the padding.
    fn load_slice(values: &[f64]) -> Self;

    /// Returns the three components of 3-vectors in memory, one vector per joint.
    fn components(cells: &[PaddedVec3]) -> [Self; 3];

    /// Returns the first `N` numbers, zeros after the last joint.
    fn prefix<const N: usize>(self) -> [f64; N];

    /// Stores to memory; entries for which the type has no element are unchanged.
    fn store(self, values: &mut JointVec);

    /// Converts to [`JointVec16`], for code that is compiled once.
    #[inline(always)]
    fn to_joint_vec16(self) -> JointVec16 {
        JointVec16::load(&self.to_joints())
    }
}

impl<W: F64x8> TaskVector for W {
    type Elem = W::Elem;

    #[inline(always)]
    fn constant(values: &[f64; LANES]) -> Self {
        W::from_array(values)
    }

    #[inline(always)]
    fn from_axes(v: &[f64; MAX_AXES]) -> Self {
        W::from_array(&[v[0], v[1], v[2], v[3], v[4], v[5], 0.0, 0.0])
    }

    #[inline(always)]
    fn to_axes(self) -> [f64; MAX_AXES] {
        let n = self.to_array();
        [n[0], n[1], n[2], n[3], n[4], n[5]]
    }
}

impl<W: F64x8> JointVector for W {
    type Elem = W::Elem;
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
            Some(first) => W::from_array(first),
            None => W::splat(0.0),
        }
    }

    #[inline(always)]
    fn from_joints(values: &JointVec) -> Self {
        Self::load(values)
    }

    #[inline(always)]
    fn to_joints(self) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        self.store(&mut out);
        out
    }

    #[inline(always)]
    fn max_element(self) -> f64 {
        let mut n = self.to_array();
        // By halves: a sequential maximum would be one long dependency chain.
        for half in [4, 2, 1] {
            for i in 0..half {
                n[i] = Self::Elem::max(n[i], n[i + half]);
            }
        }
        Self::Elem::max(0.0, n[0])
    }

    #[inline(always)]
    fn sum4(vectors: [Self; 4]) -> [f64; 4] {
        W::hsum4(vectors)
    }

    #[inline(always)]
    fn dot4(a: [&Self; 4], b: [&Self; 4]) -> [f64; 4] {
        W::hdot4([*a[0], *a[1], *a[2], *a[3]], [*b[0], *b[1], *b[2], *b[3]])
    }
}

impl<W: F64x8> SingleArmJoints for W {
    type Vec3 = W::Vec3;

    #[inline(always)]
    fn load_slice(values: &[f64]) -> Self {
        W::load_partial(values)
    }

    #[inline(always)]
    fn components(cells: &[PaddedVec3]) -> [Self; 3] {
        // No `map_or`: its closure would be compiled for the baseline instruction set.
        match cells.first_chunk() {
            Some(first) => W::components(first),
            None => [W::splat(0.0); 3],
        }
    }

    #[inline(always)]
    fn prefix<const N: usize>(self) -> [f64; N] {
        let mut out = [0.0; N];
        if let Some(first) = out.first_chunk_mut() {
            W::store_array(self, first);
        }
        out
    }

    #[inline(always)]
    fn store(self, values: &mut JointVec) {
        if let Some(first) = values.first_chunk_mut() {
            W::store_array(self, first);
        }
    }
}
