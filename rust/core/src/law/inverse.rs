//! Small symmetric systems and the damped pseudo-inverse.

use crate::{AxisVec, MAX_AXES, MAX_JOINTS, Rows};

/// A symmetric matrix of task axes.
pub(crate) type Square = [[f64; MAX_AXES]; MAX_AXES];

/// The body six times over, for index 0 to 5: triangular loops within it then have constant bounds, and their numbers stay
/// in registers.
macro_rules! six {
    ($i:ident => $body:block) => {
        six!(@ $i $body 0 1 2 3 4 5);
    };
    (down $i:ident => $body:block) => {
        six!(@ $i $body 5 4 3 2 1 0);
    };
    (@ $i:ident $body:block $($index:literal)*) => {
        $({
            let $i: usize = $index;
            $body
        })*
    };
}

/// `Σ a_i b_i` over the first `n` joints and, being zero, those that fill up the last four.
///
/// Four sums side by side, as vector code wants them.
#[inline(always)]
fn product(a: &[f64; MAX_JOINTS], b: &[f64; MAX_JOINTS], n: usize) -> f64 {
    let mut sums = [a[0] * b[0], a[1] * b[1], a[2] * b[2], a[3] * b[3]];
    for block in 1..n.div_ceil(4).min(MAX_JOINTS / 4) {
        for i in 0..4 {
            sums[i] += a[4 * block + i] * b[4 * block + i];
        }
    }
    (sums[0] + sums[2]) + (sums[1] + sums[3])
}

/// `J diag(d) Jᵀ` of the first `k` rows, whose columns beyond `n` are 0.
#[inline(always)]
pub(crate) fn weighted_gram(rows: &Rows, d: &[f64; MAX_JOINTS], k: usize, n: usize) -> Square {
    let mut out = [[0.0; MAX_AXES]; MAX_AXES];
    six!(r => {
        if r < k {
            let mut scaled = [0.0; MAX_JOINTS];
            for i in 0..n.min(MAX_JOINTS) {
                scaled[i] = rows[r][i] * d[i];
            }
            for c in 0..=r {
                let sum = product(&scaled, &rows[c], n);
                (out[r][c], out[c][r]) = (sum, sum);
            }
        }
    });
    out
}

/// `Jᵀ w` of the first `k` rows and `n` columns.
#[inline(always)]
pub(crate) fn transpose_times(rows: &Rows, w: &AxisVec, k: usize, n: usize) -> [f64; MAX_JOINTS] {
    let mut out = [0.0; MAX_JOINTS];
    for r in 0..k.min(MAX_AXES) {
        for i in 0..n.min(MAX_JOINTS) {
            out[i] += rows[r][i] * w[r];
        }
    }
    out
}

/// `J v` of the first `k` rows, whose columns beyond `n` are 0.
#[inline(always)]
pub(crate) fn times(rows: &Rows, v: &[f64; MAX_JOINTS], k: usize, n: usize) -> AxisVec {
    let mut out = [0.0; MAX_AXES];
    for r in 0..k.min(MAX_AXES) {
        out[r] = product(&rows[r], v, n);
    }
    out
}

/// Cholesky factor of a symmetric, positive definite k × k matrix, of which the lower half is read.
///
/// A pivot that rounding has eaten is replaced by a tiny positive one, so that a singular matrix gives large but finite
/// answers instead of NaN. A row of zeros gives zeros where the right side is zero there.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cholesky {
    l: Square,
    inverse_pivot: AxisVec,
    k: usize,
}

impl Cholesky {
    #[inline(always)]
    pub(crate) fn new(m: &Square, k: usize) -> Self {
        let k = k.min(MAX_AXES);
        let mut l = [[0.0; MAX_AXES]; MAX_AXES];
        let mut inverse_pivot = [0.0; MAX_AXES];
        six!(j => {
            if j < k {
                let mut pivot = m[j][j];
                for c in 0..j {
                    pivot -= l[j][c] * l[j][c];
                }
                let least = (1e-15 * m[j][j]).max(1e-200);
                let inverse = 1.0 / pivot.max(least).sqrt();
                inverse_pivot[j] = inverse;
                for i in j + 1..MAX_AXES {
                    let mut sum = m[i][j];
                    for c in 0..j {
                        sum -= l[i][c] * l[j][c];
                    }
                    l[i][j] = sum * inverse;
                }
            }
        });
        Self { l, inverse_pivot, k }
    }

    /// Solves `M x = b`.
    #[inline(always)]
    pub(crate) fn solve(&self, b: &AxisVec) -> AxisVec {
        let mut x = [0.0; MAX_AXES];
        six!(i => {
            if i < self.k {
                let mut sum = b[i];
                for c in 0..i {
                    sum -= self.l[i][c] * x[c];
                }
                x[i] = sum * self.inverse_pivot[i];
            }
        });
        six!(down i => {
            if i < self.k {
                let mut sum = x[i];
                for r in i + 1..MAX_AXES {
                    sum -= self.l[r][i] * x[r];
                }
                x[i] = sum * self.inverse_pivot[i];
            }
        });
        x
    }

    /// Solves `M X = B` for the rows of `B` (k × n).
    #[inline(always)]
    pub(crate) fn solve_rows(&self, b: &Rows, n: usize) -> Rows {
        let n = n.min(MAX_JOINTS);
        let mut x = [[0.0; MAX_JOINTS]; MAX_AXES];
        six!(i => {
            if i < self.k {
                for j in 0..n {
                    let mut sum = b[i][j];
                    for c in 0..i {
                        sum -= self.l[i][c] * x[c][j];
                    }
                    x[i][j] = sum * self.inverse_pivot[i];
                }
            }
        });
        six!(down i => {
            if i < self.k {
                for j in 0..n {
                    let mut sum = x[i][j];
                    for r in i + 1..MAX_AXES {
                        sum -= self.l[r][i] * x[r][j];
                    }
                    x[i][j] = sum * self.inverse_pivot[i];
                }
            }
        });
        x
    }

    /// `M⁻¹ J D`: the transposed pseudo-inverse that belongs to this factor of `J D Jᵀ`.
    #[inline(always)]
    pub(crate) fn weighted_rows(&self, rows: &Rows, joint_weight: &[f64; MAX_JOINTS], n: usize) -> Rows {
        let mut out = self.solve_rows(rows, n);
        for row in &mut out {
            for i in 0..n.min(MAX_JOINTS) {
                row[i] *= joint_weight[i];
            }
        }
        out
    }

    /// Diagonal of `M⁻¹`.
    #[inline(always)]
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
#[inline(always)]
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
    Cholesky::new(&m, k).weighted_rows(rows, joint_weight, n)
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
        let inverse = factor.solve_rows(&identity, MAX_JOINTS);
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
