//! Smallest and largest singular value of the task rows, tracked from step to step.

use crate::math::ldlt6::Ldlt6;
use crate::math::rows::Mat6;
use crate::math::simd::{BaselineF64, RealOps};
use crate::{AxisVec, MAX_AXES};

/// Estimates of the largest and the smallest singular value of scaled task rows, and the singular vectors from which
/// the next step starts.
///
/// Two vectors track the two smallest values. When these values cross, a single vector would stay with the wrong value
/// for many steps.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SingularValues {
    /// Estimated left singular vectors of the two smallest values, that of the smallest first.
    pub(crate) min_vectors: [AxisVec; 2],
    /// Estimated left singular vector of the largest value.
    pub(crate) max_vector: AxisVec,
    /// Estimate of the smallest singular value.
    pub(crate) smallest: f64,
    /// Estimate of the largest singular value.
    pub(crate) largest: f64,
}

impl SingularValues {
    pub(crate) fn start() -> Self {
        // All components are different and not zero, so that hardly any arm has a singular vector orthogonal to both.
        let min_vectors = [[0.5, 0.46, 0.42, 0.38, 0.34, 0.3], [0.34, -0.5, 0.46, -0.42, 0.3, -0.38]];
        Self { min_vectors, max_vector: min_vectors[0], smallest: 0.0, largest: 0.0 }
    }

    /// Sets the components of all vectors after the first `k` axes to zero; updates keep them zero.
    pub(crate) fn restrict(&mut self, k: usize) {
        for vector in self.min_vectors.iter_mut().chain([&mut self.max_vector]) {
            vector.iter_mut().skip(k).for_each(|value| *value = 0.0);
        }
    }

    /// Improves the estimates by `iterations` steps of inverse and power iteration on `gram`.
    ///
    /// `gram` is `JJᵀ` of `k` rows, or `JᵀJ` of `k` joints if there are fewer joints than axes; `factor` is its LDLᵀ
    /// factor. One iteration per step, from the vectors of the last step, tracks a moving arm to about one percent.
    #[inline(always)]
    pub(crate) fn update<A: RealOps<Real = f64>>(&mut self, gram: &Mat6, factor: &Ldlt6, k: usize, iterations: usize) {
        for _ in 0..iterations {
            let before = self.min_vectors;
            let [first, second] = before;
            let solved = [factor.solve::<A>(&first), factor.solve::<A>(&second)];
            (self.min_vectors, self.smallest) = match ritz_2d::<A>(&solved, &before) {
                Some(found) => found,
                None => ritz_scaled(gram, &solved, &before, k),
            };
            let max_vector = apply::<A>(gram, &self.max_vector);
            let size = norm::<A>(&max_vector);
            if size > 0.0 {
                let inverse = 1.0 / size;
                for i in 0..MAX_AXES {
                    self.max_vector[i] = max_vector[i] * inverse;
                }
            }
            self.largest = size.sqrt();
        }
    }
}

/// Applies the Rayleigh–Ritz method to the symmetric matrix M in the span of `a = M⁻¹ w` and `b = M⁻¹ z`. Returns the
/// unit Ritz vectors, that of the smaller Ritz value first, and the square root of the smaller value. `None` if products
/// of a and b could overflow, or if a and b are so nearly parallel that one orthogonalization is not enough.
///
/// The value is computed from dot products only, because it is on the critical path of the step; the vectors are needed
/// only in the next step.
#[inline(always)]
fn ritz_2d<A: RealOps<Real = f64>>([a, b]: &[AxisVec; 2], [w, z]: &[AxisVec; 2]) -> Option<([AxisVec; 2], f64)> {
    let (aa, ab, bb) = (dot::<A>(a, a), dot::<A>(a, b), dot::<A>(b, b));
    // Negated, so that NaN takes the fallback.
    if !(ab * ab < 0.5 * aa * bb && aa < LARGE && bb < LARGE) {
        return None;
    }
    let (wa, za, zb) = (dot::<A>(w, a), dot::<A>(z, a), dot::<A>(z, b));
    // Entries of M in the orthonormal basis û ∥ a, v̂ ∥ c with c = b − t a (Gram–Schmidt). M is symmetric, so w·b = z·a
    // and only one of the two products is computed.
    let per_aa = 1.0 / aa;
    let t = ab * per_aa;
    let per_cc = 1.0 / (bb - t * ab);
    let mixed = za - t * wa;
    let (u, v) = (wa * per_aa, (zb - t * (za + mixed)) * per_cc);
    let squared = mixed * mixed * (per_aa * per_cc);
    let half = 0.5 * (u - v);
    let root = (half * half + squared).sqrt();
    let value = (u * v - squared) / (0.5 * (u + v) + root);
    let (per_a, per_c) = (per_aa.sqrt(), per_cc.sqrt());
    let (x, y) = smaller_eigenvector(half, root, mixed * (per_a * per_c));
    let ([xa, ya], [xc, yc]) = ([x * per_a, y * per_a], [x * per_c, y * per_c]);
    let mut min_vectors = [[0.0; MAX_AXES]; 2];
    for i in 0..MAX_AXES {
        let c = A::fnma(t, a[i], b[i]);
        (min_vectors[0][i], min_vectors[1][i]) = (A::fma(xa, a[i], yc * c), A::fnma(ya, a[i], xc * c));
    }
    Some((min_vectors, value.max(0.0).sqrt()))
}

/// Bound on squared lengths, so that a product of four lengths is finite.
const LARGE: f64 = 1e150;

/// Returns the unit eigenvector of `[[a, b], [b, d]]` for its smaller eigenvalue, given half of a − d and
/// `root = √(half² + b²)`.
#[inline(always)]
fn smaller_eigenvector(half: f64, root: f64, b: f64) -> (f64, f64) {
    // Of the two equivalent forms, use the one without cancellation.
    let (x, y) = if half > 0.0 { (b, -(half + root)) } else { (root - half, -b) };
    let length = (x * x + y * y).sqrt();
    if length > 0.0 { (x / length, y / length) } else { (1.0, 0.0) }
}

/// Computes [`ritz_2d`] for vectors of any length and direction; normalizes them first.
#[cold]
#[inline(never)]
fn ritz_scaled(gram: &Mat6, [a, b]: &[AxisVec; 2], [w, z]: &[AxisVec; 2], k: usize) -> ([AxisVec; 2], f64) {
    let (u, v) = (ImagePair::new(*a, *w), ImagePair::new(*b, *z));
    match v.orthogonalize(&u) {
        Some(v) => ritz_pair(&u, &v),
        None => restart(gram, &u.v, k),
    }
}

/// A unit vector `v` and the product `mv` = `M v`, which inverse iteration gives without a matrix product.
#[derive(Clone, Copy)]
struct ImagePair {
    v: AxisVec,
    mv: AxisVec,
}

impl ImagePair {
    /// Creates the pair from `v = M⁻¹ b` and `b`, both divided by the length of `v`.
    fn new(v: AxisVec, b: AxisVec) -> Self {
        let size = norm::<BaselineF64>(&v);
        // With a singular matrix, the square of the length may overflow.
        if size > 0.0 && size.is_finite() {
            Self { v, mv: b }.scaled(1.0 / size)
        } else {
            Self::normalize_scaled(&v, &b)
        }
    }

    #[cold]
    #[inline(never)]
    fn normalize_scaled(v: &AxisVec, b: &AxisVec) -> Self {
        let scale = v.iter().fold(0.0_f64, |a, x| a.max(x.abs()));
        if !(scale > 0.0 && scale.is_finite()) {
            return Self { v: *b, mv: [0.0; MAX_AXES] };
        }
        let smaller = Self { v: *v, mv: *b }.scaled(1.0 / scale);
        smaller.scaled(1.0 / norm::<BaselineF64>(&smaller.v))
    }

    fn scaled(mut self, factor: f64) -> Self {
        for i in 0..MAX_AXES {
            self.v[i] *= factor;
            self.mv[i] *= factor;
        }
        self
    }

    /// Returns the component orthogonal to the unit vector `u`, normalized; `None` if it is only rounding error.
    fn orthogonalize(mut self, u: &Self) -> Option<Self> {
        // Two passes, because the first leaves a rounding error along `u`.
        for _ in 0..2 {
            let share = dot::<BaselineF64>(&self.v, &u.v);
            for i in 0..MAX_AXES {
                self.v[i] -= share * u.v[i];
                self.mv[i] -= share * u.mv[i];
            }
        }
        let size = norm::<BaselineF64>(&self.v);
        (size > 1e-10).then(|| self.scaled(1.0 / size))
    }
}

/// Computes the Rayleigh–Ritz values of an orthonormal pair: the rotated unit vectors, that of the smaller value first,
/// and the square root of that value.
fn ritz_pair(u: &ImagePair, v: &ImagePair) -> ([AxisVec; 2], f64) {
    let (a, b, d) = (dot::<BaselineF64>(&u.v, &u.mv), dot::<BaselineF64>(&u.v, &v.mv), dot::<BaselineF64>(&v.v, &v.mv));
    let half = 0.5 * (a - d);
    let (x, y) = smaller_eigenvector(half, (half * half + b * b).sqrt(), b);
    let (mut min_vectors, mut image) = ([[0.0; MAX_AXES]; 2], [0.0; MAX_AXES]);
    for i in 0..MAX_AXES {
        min_vectors[0][i] = x * u.v[i] + y * v.v[i];
        min_vectors[1][i] = x * v.v[i] - y * u.v[i];
        image[i] = x * u.mv[i] + y * v.mv[i];
    }
    (min_vectors, dot::<BaselineF64>(&min_vectors[0], &image).max(0.0).sqrt())
}

/// Returns `u` and a unit vector orthogonal to `u` (zero if there is only one axis), from which the next step starts,
/// and the singular value estimated from `u`.
#[cold]
#[inline(never)]
fn restart(gram: &Mat6, u: &AxisVec, k: usize) -> ([AxisVec; 2], f64) {
    let mut unit = ImagePair { v: [0.0; MAX_AXES], mv: [0.0; MAX_AXES] };
    unit.v[(0..k.min(MAX_AXES)).fold(0, |best, i| if u[i].abs() < u[best].abs() { i } else { best })] = 1.0;
    let second = unit.orthogonalize(&ImagePair { v: *u, mv: [0.0; MAX_AXES] }).map_or([0.0; MAX_AXES], |image| image.v);
    ([*u, second], dot::<BaselineF64>(u, &apply::<BaselineF64>(gram, u)).max(0.0).sqrt())
}

#[inline(always)]
fn apply<A: RealOps<Real = f64>>(m: &Mat6, v: &AxisVec) -> AxisVec {
    let mut out = [0.0; MAX_AXES];
    for j in 0..MAX_AXES {
        for i in 0..MAX_AXES {
            out[i] = A::fma(m[i][j], v[j], out[i]);
        }
    }
    out
}

#[inline(always)]
fn dot<A: RealOps<Real = f64>>(a: &AxisVec, b: &AxisVec) -> f64 {
    // Pairwise, because a sequential sum would be one long dependency chain.
    let (first, second) = (A::fma(a[1], b[1], a[0] * b[0]), A::fma(a[3], b[3], a[2] * b[2]));
    (first + second) + A::fma(a[5], b[5], a[4] * b[4])
}

#[inline(always)]
fn norm<A: RealOps<Real = f64>>(v: &AxisVec) -> f64 {
    A::sqrt(dot::<A>(v, v))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MAX_JOINTS;
    use crate::math::rows::{load_rows, weighted_gram};
    use crate::math::simd::JointVec16;

    #[test]
    fn singular_values_agree_with_an_svd() {
        let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
        for (r, row) in rows.iter_mut().enumerate() {
            for (i, value) in row.iter_mut().enumerate().take(7) {
                *value = ((7 * r * r + 3 * i * i + r * i) as f64 * 0.7).sin();
            }
        }
        let gram = weighted_gram(&load_rows(&rows), JointVec16::splat(1.0));
        let exact = crate::math::svd::singular_values(&nalgebra::DMatrix::from_fn(6, 7, |r, c| rows[r][c]));
        let mut values = SingularValues::start();
        values.update::<BaselineF64>(&gram, &Ldlt6::new::<BaselineF64>(&gram), 6, 200);
        assert!(exact.min() > 0.1, "the matrix has full rank");
        assert!((values.largest - exact.max()).abs() < 1e-9, "{} {exact}", values.largest);
        assert!((values.smallest - exact.min()).abs() < 1e-9, "{} {exact}", values.smallest);
    }

    #[test]
    fn a_zero_matrix_has_a_zero_value() {
        let mut values = SingularValues::start();
        let zero = [[0.0; MAX_AXES]; MAX_AXES];
        values.update::<BaselineF64>(&zero, &Ldlt6::new::<BaselineF64>(&zero), 6, 2);
        assert!(values.smallest.abs() < 1e-50);
    }
}
