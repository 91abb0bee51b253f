//! Vector types with one number per joint of an arm.
#![forbid(unsafe_code)]

use super::{F64x8, JointVec16, Number, PaddedVec3, RealOps, StoreVec3};
use crate::{JointVec, MAX_JOINTS};

/// A vector of one number per joint of an arm, padding included; arithmetic is elementwise.
pub(crate) trait JointVector: RealOps<Real = Self> + Number {
    /// Scalar operations of the same instruction set.
    type Elem: RealOps<Real = f64>;

    /// Vector of the same instruction set with one number per task axis.
    type Axes: F64x8<Elem = Self::Elem>;

    /// 3-vector of the same instruction set.
    type Vec3: StoreVec3<Elem = Self::Elem>;

    /// One register of the vector; the vector itself if it is not in registers.
    type Register: RealOps<Real = Self::Register>;

    /// Number of registers, at most 4.
    const REGISTERS: usize;

    /// Returns the register of this index.
    fn register(self, index: usize) -> Self::Register;

    /// Replaces the register of this index.
    fn set_register(&mut self, index: usize, register: Self::Register);

    /// True to compile whole formulas as calls, for smaller code; for a type that does not fit in registers.
    const OUTLINED: bool = false;

    /// Loads one number per joint; numbers for which the type has no element must be 0.
    fn load(values: &JointVec) -> Self;

    /// Loads one number per joint of the arm, zeros in the padding.
    fn load_slice(values: &[f64]) -> Self;

    /// Stores to memory; entries for which the type has no element are unchanged.
    fn store(self, values: &mut JointVec);

    /// Returns one number per joint, zeros after the last.
    #[inline(always)]
    fn to_joints(self) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        self.store(&mut out);
        out
    }

    /// Returns the first `N` numbers, zeros after the last joint.
    fn prefix<const N: usize>(self) -> [f64; N];

    /// Returns the three components of 3-vectors in memory, one vector per joint.
    fn components(cells: &[PaddedVec3]) -> [Self; 3];

    /// Returns the largest element, at least 0.
    fn max_element(self) -> f64;

    /// Returns true if any element is less than the same element of `other`.
    fn is_any_lt(self, other: Self) -> bool;

    /// Returns true if any element is not less than the same element of `other`, or is NaN.
    fn is_any_not_lt(self, other: Self) -> bool;

    /// Returns the sum over the joints of each of four vectors.
    fn sum4(vectors: [Self; 4]) -> [f64; 4];

    /// Returns the dot product over the joints of each of four pairs.
    fn dot4(a: [&Self; 4], b: [&Self; 4]) -> [f64; 4];

    /// Returns the sum of the elements over the joints.
    #[inline(always)]
    fn sum(self) -> f64 {
        Self::sum4([self; 4])[0]
    }

    /// Converts to [`JointVec16`], for code that is compiled once.
    #[inline(always)]
    fn to_joint_vec16(self) -> JointVec16 {
        JointVec16::load(&self.to_joints())
    }
}

impl<W: F64x8> JointVector for W {
    type Elem = W::Elem;
    type Axes = W;
    type Vec3 = W::Vec3;
    type Register = W::Register;

    const REGISTERS: usize = W::REGISTERS;

    #[inline(always)]
    fn register(self, index: usize) -> W::Register {
        W::register(self, index)
    }

    #[inline(always)]
    fn set_register(&mut self, index: usize, register: W::Register) {
        W::set_register(self, index, register);
    }

    #[inline(always)]
    fn load(values: &JointVec) -> Self {
        match values.first_chunk() {
            Some(first) => W::from_array(first),
            None => W::splat(0.0),
        }
    }

    #[inline(always)]
    fn load_slice(values: &[f64]) -> Self {
        W::load_partial(values)
    }

    #[inline(always)]
    fn store(self, values: &mut JointVec) {
        if let Some(first) = values.first_chunk_mut() {
            W::store_array(self, first);
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
    fn components(cells: &[PaddedVec3]) -> [Self; 3] {
        // No `map_or`: its closure would be compiled for the baseline instruction set.
        match cells.first_chunk() {
            Some(first) => W::components(first),
            None => [W::splat(0.0); 3],
        }
    }

    #[inline(always)]
    fn max_element(self) -> f64 {
        let mut n = self.to_array();
        // By halves, because a sequential maximum would be one long dependency chain.
        for half in [4, 2, 1] {
            for i in 0..half {
                n[i] = Self::Elem::max(n[i], n[i + half]);
            }
        }
        Self::Elem::max(0.0, n[0])
    }

    #[inline(always)]
    fn is_any_lt(self, other: Self) -> bool {
        W::any_lt(self, other)
    }

    #[inline(always)]
    fn is_any_not_lt(self, other: Self) -> bool {
        W::any_not_lt(self, other)
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
