//! Singular value decomposition for code outside the control step.
//!
//! One-sided Jacobi rotations (Hestenes): short, accurate at every rank, and convergent within a few sweeps. The
//! decomposition of nalgebra 0.35 loses whole singular values of rank-deficient matrices.

use nalgebra::{DMatrix, DVector};

/// Maximum number of sweeps over all pairs of columns; usually at most ten are needed.
const MAX_SWEEPS: usize = 60;

/// Decomposition `m = u diag(sigma) vᵀ`, the singular values largest first; columns of `u` that belong to σ = 0 are 0.
#[derive(Debug, Clone)]
pub(crate) struct Svd {
    pub(crate) u: DMatrix<f64>,
    pub(crate) sigma: DVector<f64>,
    pub(crate) v: DMatrix<f64>,
}

impl Svd {
    /// Decomposes a finite matrix of any shape; `None` if the rotations do not converge.
    pub(crate) fn new(m: &DMatrix<f64>) -> Option<Self> {
        if m.nrows() >= m.ncols() {
            return Self::tall(m);
        }
        Self::tall(&m.transpose()).map(|turned| Self { u: turned.v, sigma: turned.sigma, v: turned.u })
    }

    /// Decomposes a matrix with at least as many rows as columns by rotating pairs of columns until all are orthogonal:
    /// `m v = u diag(sigma)`.
    fn tall(m: &DMatrix<f64>) -> Option<Self> {
        let n = m.ncols();
        let scale = m.amax();
        if scale == 0.0 {
            return Some(Self {
                u: DMatrix::zeros(m.nrows(), n),
                sigma: DVector::zeros(n),
                v: DMatrix::identity(n, n),
            });
        }
        let mut b = m / scale;
        let mut v = DMatrix::identity(n, n);
        let at_rest = (0..MAX_SWEEPS).any(|_| {
            let mut turned = false;
            for p in 0..n {
                for q in p + 1..n {
                    turned |= orthogonalise(&mut b, &mut v, p, q);
                }
            }
            !turned
        });
        if !at_rest {
            return None;
        }
        let lengths: Vec<f64> = b.column_iter().map(|column| column.norm()).collect();
        // Insertion: there are few columns, and a sort of the standard library takes 8 kB of code.
        let mut order: Vec<usize> = Vec::with_capacity(n);
        for i in 0..n {
            let at = order.partition_point(|&before| lengths[before].total_cmp(&lengths[i]).is_ge());
            order.insert(at, i);
        }
        let unit = |i: usize| if lengths[i] > 0.0 { 1.0 / lengths[i] } else { 0.0 };
        Some(Self {
            u: DMatrix::from_fn(m.nrows(), n, |r, c| b[(r, order[c])] * unit(order[c])),
            sigma: DVector::from_fn(n, |c, _| scale * lengths[order[c]]),
            v: DMatrix::from_fn(n, n, |r, c| v[(r, order[c])]),
        })
    }
}

/// Rotates columns p and q so that they are orthogonal; returns `false` if they already are.
fn orthogonalise(b: &mut DMatrix<f64>, v: &mut DMatrix<f64>, p: usize, q: usize) -> bool {
    let (alpha, beta) = (b.column(p).norm_squared(), b.column(q).norm_squared());
    let gamma = b.column(p).dot(&b.column(q));
    // Skip a pair that is already orthogonal, or in which one column is nearly zero and so has no direction.
    if gamma.abs() <= 1e-15 * (alpha * beta).sqrt() || alpha.min(beta) < 1e-300 {
        return false;
    }
    let zeta = (beta - alpha) / (2.0 * gamma);
    let t = 1.0_f64.copysign(zeta) / (zeta.abs() + zeta.hypot(1.0));
    let cosine = 1.0 / t.hypot(1.0);
    let sine = cosine * t;
    for matrix in [b, v] {
        for r in 0..matrix.nrows() {
            let (x, y) = (matrix[(r, p)], matrix[(r, q)]);
            matrix[(r, p)] = cosine * x - sine * y;
            matrix[(r, q)] = sine * x + cosine * y;
        }
    }
    true
}

/// Returns the singular values, largest first; NaN for a matrix that is not finite or if the rotations do not converge.
pub(crate) fn singular_values(m: &DMatrix<f64>) -> DVector<f64> {
    let not_converged = || DVector::from_element(m.nrows().min(m.ncols()), f64::NAN);
    if m.iter().all(|value| value.is_finite()) {
        Svd::new(m).map_or_else(not_converged, |svd| svd.sigma)
    } else {
        not_converged()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a matrix of the given rank; different for each seed.
    fn matrix(rows: usize, columns: usize, rank: usize, seed: usize) -> DMatrix<f64> {
        let noise = |i: usize| ((i + 1) as f64 * 12.9898 + seed as f64 * 78.233).sin() * 43_758.545_3;
        let factor = |r: usize, c: usize, from: usize| DMatrix::from_fn(r, c, |i, j| noise(from + i * c + j).fract());
        factor(rows, rank, 0) * factor(rank, columns, 1000)
    }

    #[test]
    fn every_shape_and_rank_is_reconstructed() {
        for seed in 0..200 {
            for (rows, columns, rank) in
                [(6, 7, 6), (6, 7, 1), (6, 7, 5), (3, 3, 1), (6, 3, 2), (2, 2, 1), (6, 16, 6), (1, 7, 1), (6, 1, 1)]
            {
                let m = matrix(rows, columns, rank, seed) * 10.0_f64.powf((seed % 40) as f64 * 10.0 - 200.0);
                let svd = Svd::new(&m).unwrap();
                let back = &svd.u * DMatrix::from_diagonal(&svd.sigma) * svd.v.transpose();
                assert!((back - &m).amax() <= 1e-13 * m.amax(), "{rows}×{columns} of rank {rank}, seed {seed}");
                let small = svd.sigma.iter().filter(|&&s| s > 1e-12 * svd.sigma[0]).count();
                assert_eq!(small, rank);
                assert!(svd.sigma.as_slice().is_sorted_by(|a, b| a >= b));
            }
        }
    }

    #[test]
    fn zero_and_nan_matrices() {
        assert!(Svd::new(&DMatrix::zeros(6, 7)).unwrap().sigma.amax() < f64::MIN_POSITIVE);
        assert!(singular_values(&DMatrix::from_element(2, 3, f64::NAN)).iter().all(|s| s.is_nan()));
    }
}
