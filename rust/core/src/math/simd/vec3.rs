//! 3-vector: in one register for a single configuration, else component by component.
#![forbid(unsafe_code)]

use super::{Arithmetic, Number};

/// Memory of a [`Triple`] of one configuration; the last number is padding.
pub(crate) type Cell = [f64; 4];

/// 3-vector operations.
pub(crate) trait Triple: Copy {
    /// Scalar of the same instruction set.
    type One: Arithmetic;

    /// Creates it from its components.
    fn of(numbers: [Real<Self>; 3]) -> Self;

    /// Returns its components.
    fn numbers(self) -> [Real<Self>; 3];

    /// `f v`.
    fn times(self, f: Real<Self>) -> Self;

    /// `v + f w`.
    fn plus(self, f: Real<Self>, w: Self) -> Self;

    /// `v − f w`.
    fn minus(self, f: Real<Self>, w: Self) -> Self;

    /// Copies a vector to every configuration.
    #[inline(always)]
    fn constant(v: &[f64; 3]) -> Self {
        Self::of([Self::One::splat(v[0]), Self::One::splat(v[1]), Self::One::splat(v[2])])
    }
}

/// A [`Triple`] of one configuration that can be stored.
pub(crate) trait Kept: Triple<One: Arithmetic<Real = f64>> {
    /// Stores to memory.
    fn keep(self, cell: &mut Cell);

    /// Loads from memory.
    fn kept(cell: &Cell) -> Self;
}

/// Component type of a [`Triple`].
pub(crate) type Real<T> = <<T as Triple>::One as Arithmetic>::Real;

/// Three separate components.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Three<A: Arithmetic>([A::Real; 3]);

impl<A: Arithmetic> Triple for Three<A> {
    type One = A;

    #[inline(always)]
    fn of(numbers: [A::Real; 3]) -> Self {
        Self(numbers)
    }

    #[inline(always)]
    fn numbers(self) -> [A::Real; 3] {
        self.0
    }

    #[inline(always)]
    fn times(self, f: A::Real) -> Self {
        let [x, y, z] = self.0;
        Self([f * x, f * y, f * z])
    }

    #[inline(always)]
    fn plus(self, f: A::Real, w: Self) -> Self {
        let ([x, y, z], [a, b, c]) = (self.0, w.0);
        Self([A::fma(f, a, x), A::fma(f, b, y), A::fma(f, c, z)])
    }

    #[inline(always)]
    fn minus(self, f: A::Real, w: Self) -> Self {
        let ([x, y, z], [a, b, c]) = (self.0, w.0);
        Self([A::fnma(f, a, x), A::fnma(f, b, y), A::fnma(f, c, z)])
    }
}

impl<A: Arithmetic<Real = f64>> Kept for Three<A> {
    #[inline(always)]
    fn keep(self, cell: &mut Cell) {
        cell[..3].copy_from_slice(&self.0);
    }

    #[inline(always)]
    fn kept(cell: &Cell) -> Self {
        Self([cell[0], cell[1], cell[2]])
    }
}

/// Registers of four numbers, the last of which is padding.
pub(crate) trait Short: Arithmetic<Real = Self> + Number {
    /// Scalar of the same instruction set.
    type One: Arithmetic<Real = f64>;

    /// Loads from memory.
    fn get(cell: &Cell) -> Self;

    /// Stores to memory.
    fn set(self, cell: &mut Cell);
}

impl<S: Short> Triple for S {
    type One = S::One;

    #[inline(always)]
    fn of([x, y, z]: [f64; 3]) -> Self {
        S::get(&[x, y, z, 0.0])
    }

    #[inline(always)]
    fn numbers(self) -> [f64; 3] {
        let mut cell = [0.0; 4];
        self.set(&mut cell);
        [cell[0], cell[1], cell[2]]
    }

    #[inline(always)]
    fn times(self, f: f64) -> Self {
        S::splat(f) * self
    }

    #[inline(always)]
    fn plus(self, f: f64, w: Self) -> Self {
        S::fma(S::splat(f), w, self)
    }

    #[inline(always)]
    fn minus(self, f: f64, w: Self) -> Self {
        S::fnma(S::splat(f), w, self)
    }
}

impl<S: Short> Kept for S {
    #[inline(always)]
    fn keep(self, cell: &mut Cell) {
        self.set(cell);
    }

    #[inline(always)]
    fn kept(cell: &Cell) -> Self {
        S::get(cell)
    }
}
