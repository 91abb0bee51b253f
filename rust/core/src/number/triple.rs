//! A vector of space: its three numbers in one register where a single configuration is walked, else one by one.
#![forbid(unsafe_code)]

use super::{Arithmetic, Number};

/// Room for a [`Triple`] of one configuration in memory; the last number means nothing.
pub(crate) type Cell = [f64; 4];

/// Three numbers that count together.
pub(crate) trait Triple: Copy {
    /// One number of the same machine.
    type One: Arithmetic;

    /// From its numbers.
    fn of(numbers: [Real<Self>; 3]) -> Self;

    /// Its numbers.
    fn numbers(self) -> [Real<Self>; 3];

    /// `f v`.
    fn times(self, f: Real<Self>) -> Self;

    /// `v + f w`.
    fn plus(self, f: Real<Self>, w: Self) -> Self;

    /// `v − f w`.
    fn minus(self, f: Real<Self>, w: Self) -> Self;

    /// The same in every configuration.
    #[inline(always)]
    fn constant(v: &[f64; 3]) -> Self {
        Self::of([Self::One::splat(v[0]), Self::One::splat(v[1]), Self::One::splat(v[2])])
    }
}

/// A [`Triple`] of one configuration.
pub(crate) trait Kept: Triple<One: Arithmetic<Real = f64>> {
    /// To memory.
    fn keep(self, cell: &mut Cell);

    /// From memory.
    fn kept(cell: &Cell) -> Self;
}

/// Number of which a [`Triple`] has three.
pub(crate) type Real<T> = <<T as Triple>::One as Arithmetic>::Real;

/// Three numbers, each by itself.
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

/// Registers of four numbers, of which the last means nothing.
pub(crate) trait Short: Arithmetic<Real = Self> + Number {
    /// One number of the same machine.
    type One: Arithmetic<Real = f64>;

    /// From memory.
    fn get(cell: &Cell) -> Self;

    /// To memory.
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
