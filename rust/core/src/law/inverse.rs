//! Small symmetric systems and the damped pseudo-inverse.

use crate::{AxisVec, MAX_AXES, MAX_JOINTS, Rows};

/// A symmetric matrix of task axes.
pub(crate) type Square = [[f64; MAX_AXES]; MAX_AXES];

/// `J diag(d) Jᵀ` of the first `k` rows.
#[inline]
pub(crate) fn weighted_gram(rows: &Rows, d: &[f64; MAX_JOINTS], k: usize, n: usize) -> Square {
    let (k, n) = (k.min(MAX_AXES), n.min(MAX_JOINTS));
    let mut out = [[0.0; MAX_AXES]; MAX_AXES];
    for r in 0..k {
        let mut scaled = [0.0; MAX_JOINTS];
        for i in 0..n {
            scaled[i] = rows[r][i] * d[i];
        }
        for c in 0..=r {
            let mut sum = 0.0;
            for i in 0..n {
                sum += scaled[i] * rows[c][i];
            }
            out[r][c] = sum;
            out[c][r] = sum;
        }
    }
    out
}

/// `Jᵀ w` of the first `k` rows.
#[inline]
pub(crate) fn transpose_times(rows: &Rows, w: &AxisVec, k: usize) -> [f64; MAX_JOINTS] {
    let mut out = [0.0; MAX_JOINTS];
    for r in 0..k.min(MAX_AXES) {
        for i in 0..MAX_JOINTS {
            out[i] += rows[r][i] * w[r];
        }
    }
    out
}

/// `J v` of the first `k` rows.
#[inline]
pub(crate) fn times(rows: &Rows, v: &[f64; MAX_JOINTS], k: usize) -> AxisVec {
    let mut out = [0.0; MAX_AXES];
    for r in 0..k.min(MAX_AXES) {
        for i in 0..MAX_JOINTS {
            out[r] += rows[r][i] * v[i];
        }
    }
    out
}

/// Cholesky factor of a symmetric, positive definite k × k matrix.
///
/// A pivot that rounding has eaten is replaced by a tiny positive one, so that a singular matrix gives large but finite
/// answers instead of NaN.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cholesky {
    l: Square,
    inverse_pivot: AxisVec,
    k: usize,
}

impl Cholesky {
    #[inline]
    pub(crate) fn new(m: &Square, k: usize) -> Self {
        let k = k.min(MAX_AXES);
        let mut l = [[0.0; MAX_AXES]; MAX_AXES];
        let mut inverse_pivot = [0.0; MAX_AXES];
        for j in 0..k {
            let mut pivot = m[j][j];
            for c in 0..j {
                pivot -= l[j][c] * l[j][c];
            }
            let least = (1e-15 * m[j][j]).max(1e-200);
            let root = pivot.max(least).sqrt();
            let inverse = 1.0 / root;
            l[j][j] = root;
            inverse_pivot[j] = inverse;
            for i in j + 1..k {
                let mut sum = m[i][j];
                for c in 0..j {
                    sum -= l[i][c] * l[j][c];
                }
                l[i][j] = sum * inverse;
            }
        }
        Self { l, inverse_pivot, k }
    }

    /// Solves `M x = b`.
    #[inline]
    pub(crate) fn solve(&self, b: &AxisVec) -> AxisVec {
        let k = self.k.min(MAX_AXES);
        let mut x = [0.0; MAX_AXES];
        for i in 0..k {
            let mut sum = b[i];
            for c in 0..i {
                sum -= self.l[i][c] * x[c];
            }
            x[i] = sum * self.inverse_pivot[i];
        }
        for i in (0..k).rev() {
            let mut sum = x[i];
            for r in i + 1..k {
                sum -= self.l[r][i] * x[r];
            }
            x[i] = sum * self.inverse_pivot[i];
        }
        x
    }

    /// Solves `M X = B` for the rows of `B` (k × n).
    #[inline]
    pub(crate) fn solve_rows(&self, b: &Rows) -> Rows {
        let k = self.k.min(MAX_AXES);
        let mut x = *b;
        for i in 0..k {
            for c in 0..i {
                let factor = self.l[i][c];
                for j in 0..MAX_JOINTS {
                    x[i][j] -= factor * x[c][j];
                }
            }
            for value in &mut x[i] {
                *value *= self.inverse_pivot[i];
            }
        }
        for i in (0..k).rev() {
            for r in i + 1..k {
                let factor = self.l[r][i];
                for j in 0..MAX_JOINTS {
                    x[i][j] -= factor * x[r][j];
                }
            }
            for value in &mut x[i] {
                *value *= self.inverse_pivot[i];
            }
        }
        x
    }

    /// Diagonal of `M⁻¹`.
    #[inline]
    pub(crate) fn inverse_diagonal(&self) -> AxisVec {
        let mut out = [0.0; MAX_AXES];
        for (i, value) in out.iter_mut().enumerate().take(self.k) {
            let mut unit = [0.0; MAX_AXES];
            unit[i] = 1.0;
            *value = self.solve(&unit)[i];
        }
        out
    }
}

/// Transposed damped pseudo-inverse of (3): row r holds column r of `J⁺ = D Jᵀ (J D Jᵀ + Λ)⁻¹`.
///
/// `joint_weight` holds the diagonal of `D` (1 where joints count alike), `damping` the diagonal of `Λ` (λ², in the
/// squared units of its row).
#[inline]
pub(crate) fn pseudo_inverse(
    rows: &Rows,
    joint_weight: &[f64; MAX_JOINTS],
    damping: &AxisVec,
    k: usize,
    n: usize,
) -> Rows {
    let mut m = weighted_gram(rows, joint_weight, k, n);
    for r in 0..k.min(MAX_AXES) {
        m[r][r] += damping[r];
    }
    let mut out = Cholesky::new(&m, k).solve_rows(rows);
    for row in out.iter_mut().take(k) {
        for (value, weight) in row.iter_mut().zip(joint_weight) {
            *value *= weight;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows() -> Rows {
        let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
        for (r, row) in rows.iter_mut().enumerate() {
            for (i, value) in row.iter_mut().enumerate().take(7) {
                *value = ((r * 7 + i) as f64 * 0.7).sin();
            }
        }
        rows
    }

    fn x_times(m: &Square, x: &AxisVec) -> AxisVec {
        m.map(|row| row.iter().zip(x).map(|(a, b)| a * b).sum())
    }

    #[test]
    fn solve_and_solve_rows_invert() {
        let mut m = weighted_gram(&rows(), &[1.0; MAX_JOINTS], 6, 7);
        (0..6).for_each(|i| m[i][i] += 0.1);
        let factor = Cholesky::new(&m, 6);
        let x = [1.0, -2.0, 3.0, 0.5, 0.0, 1.5];
        let back = factor.solve(&x_times(&m, &x));
        assert!(x.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-12));
        let mut identity = [[0.0; MAX_JOINTS]; MAX_AXES];
        (0..6).for_each(|i| identity[i][i] = 1.0);
        let inverse = factor.solve_rows(&identity);
        for (i, value) in factor.inverse_diagonal().iter().enumerate() {
            assert!((value - inverse[i][i]).abs() < 1e-12);
        }
    }

    #[test]
    fn a_singular_matrix_gives_finite_answers() {
        let factor = Cholesky::new(&[[0.0; MAX_AXES]; MAX_AXES], 6);
        assert!(factor.solve(&[1.0; MAX_AXES]).iter().all(|x| x.is_finite()));
    }
}
