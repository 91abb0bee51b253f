//! 3-vectors: in one register for a single configuration, else one register per component.
#![forbid(unsafe_code)]

use super::{Number, RealOps};

/// A 3-vector of one configuration in memory; the last number is padding.
pub(crate) type PaddedVec3 = [f64; 4];

/// A 3-vector of one configuration or of several.
pub(crate) trait Vec3Ops: Copy {
    /// Scalar operations of the same instruction set.
    type Elem: RealOps;

    /// Creates the vector from its components.
    fn from_components(components: [Real<Self>; 3]) -> Self;

    /// Returns the three components.
    fn components(self) -> [Real<Self>; 3];

    /// Returns `f v`.
    fn scaled(self, factor: Real<Self>) -> Self;

    /// Returns `v + f w`.
    fn add_scaled(self, factor: Real<Self>, w: Self) -> Self;

    /// Returns `v − f w`.
    fn sub_scaled(self, factor: Real<Self>, w: Self) -> Self;

    /// Broadcasts a constant vector to all configurations.
    #[inline(always)]
    fn constant(v: &[f64; 3]) -> Self {
        Self::from_components([Self::Elem::splat(v[0]), Self::Elem::splat(v[1]), Self::Elem::splat(v[2])])
    }

    /// As [`Vec3Ops::constant`], from a padded vector.
    #[inline(always)]
    fn constant_cell(cell: &PaddedVec3) -> Self {
        Self::constant(&[cell[0], cell[1], cell[2]])
    }
}

/// A 3-vector of one configuration that can be stored to memory.
pub(crate) trait StoreVec3: Vec3Ops<Elem: RealOps<Real = f64>> {
    /// Stores the vector to memory.
    fn store(self, cell: &mut PaddedVec3);

    /// Loads the vector from memory.
    fn load(cell: &PaddedVec3) -> Self;
}

/// Type of one component of the 3-vector `T`: one number per configuration.
pub(crate) type Real<T> = <<T as Vec3Ops>::Elem as RealOps>::Real;

/// A 3-vector as three separate numbers, each of one configuration or of several.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ScalarVec3<A: RealOps>([A::Real; 3]);

impl<A: RealOps> Vec3Ops for ScalarVec3<A> {
    type Elem = A;

    #[inline(always)]
    fn from_components(components: [A::Real; 3]) -> Self {
        Self(components)
    }

    #[inline(always)]
    fn components(self) -> [A::Real; 3] {
        self.0
    }

    #[inline(always)]
    fn scaled(self, factor: A::Real) -> Self {
        let [x, y, z] = self.0;
        Self([factor * x, factor * y, factor * z])
    }

    #[inline(always)]
    fn add_scaled(self, factor: A::Real, w: Self) -> Self {
        let ([x, y, z], [a, b, c]) = (self.0, w.0);
        Self([A::fma(factor, a, x), A::fma(factor, b, y), A::fma(factor, c, z)])
    }

    #[inline(always)]
    fn sub_scaled(self, factor: A::Real, w: Self) -> Self {
        let ([x, y, z], [a, b, c]) = (self.0, w.0);
        Self([A::fnma(factor, a, x), A::fnma(factor, b, y), A::fnma(factor, c, z)])
    }
}

impl<A: RealOps<Real = f64>> StoreVec3 for ScalarVec3<A> {
    #[inline(always)]
    fn store(self, cell: &mut PaddedVec3) {
        cell[..3].copy_from_slice(&self.0);
    }

    #[inline(always)]
    fn load(cell: &PaddedVec3) -> Self {
        Self([cell[0], cell[1], cell[2]])
    }
}

/// A 3-vector of one configuration in registers of four numbers, the last of which is padding.
pub(crate) trait Vec3Register: RealOps<Real = Self> + Number {
    /// Scalar operations of the same instruction set.
    type Elem: RealOps<Real = f64>;

    /// Loads the vector from memory.
    fn load_cell(cell: &PaddedVec3) -> Self;

    /// Stores the vector to memory.
    fn store_cell(self, cell: &mut PaddedVec3);
}

impl<S: Vec3Register> Vec3Ops for S {
    type Elem = S::Elem;

    #[inline(always)]
    fn from_components([x, y, z]: [f64; 3]) -> Self {
        S::load_cell(&[x, y, z, 0.0])
    }

    #[inline(always)]
    fn constant_cell(cell: &PaddedVec3) -> Self {
        S::load_cell(cell)
    }

    #[inline(always)]
    fn components(self) -> [f64; 3] {
        let mut cell = [0.0; 4];
        self.store_cell(&mut cell);
        [cell[0], cell[1], cell[2]]
    }

    #[inline(always)]
    fn scaled(self, factor: f64) -> Self {
        S::splat(factor) * self
    }

    #[inline(always)]
    fn add_scaled(self, factor: f64, w: Self) -> Self {
        S::fma(S::splat(factor), w, self)
    }

    #[inline(always)]
    fn sub_scaled(self, factor: f64, w: Self) -> Self {
        S::fnma(S::splat(factor), w, self)
    }
}

impl<S: Vec3Register> StoreVec3 for S {
    #[inline(always)]
    fn store(self, cell: &mut PaddedVec3) {
        self.store_cell(cell);
    }

    #[inline(always)]
    fn load(cell: &PaddedVec3) -> Self {
        S::load_cell(cell)
    }
}
