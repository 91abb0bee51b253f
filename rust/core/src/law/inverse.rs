//! Small symmetric systems, the damped pseudo-inverse, and the smallest singular value.

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

/// Estimates of the largest and the smallest singular value of scaled task rows, with the vectors to start from.
///
/// Two vectors follow the weak end: where the two smallest values cross, one alone stays with the wrong one for many ticks
/// (an arm with planar joints crosses without mixing).
#[derive(Debug, Clone, Copy)]
pub(crate) struct SingularValues {
    weak: [AxisVec; 2],
    strong: AxisVec,
    /// Smallest singular value.
    pub(crate) smallest: f64,
    /// Largest singular value.
    pub(crate) largest: f64,
}

impl SingularValues {
    pub(crate) fn start() -> Self {
        // No component is zero and no two are equal: no eigenvector of a usual arm is orthogonal to both.
        let weak = [[0.5, 0.46, 0.42, 0.38, 0.34, 0.3], [0.34, -0.5, 0.46, -0.42, 0.3, -0.38]];
        Self { weak, strong: weak[0], smallest: 0.0, largest: 0.0 }
    }

    /// Improves the estimates by `iterations` of the inverse and the power iteration on `gram`.
    ///
    /// `gram` is `JJᵀ` (k × k), or `JᵀJ` where there are fewer joints than axes. Warm-started, one iteration a tick
    /// follows a moving arm to about a percent.
    #[inline]
    pub(crate) fn update(&mut self, gram: &Square, k: usize, iterations: usize) {
        let k = k.min(MAX_AXES);
        let trace: f64 = (0..k).map(|i| gram[i][i]).sum();
        let mut shifted = *gram;
        for (i, row) in shifted.iter_mut().enumerate().take(k) {
            row[i] += 1e-14 * trace + 1e-200;
        }
        let factor = Cholesky::new(&shifted, k);
        for _ in 0..iterations {
            let [first, second] = self.weak;
            let u = normalised(factor.solve(&first), first, k);
            let v = without(factor.solve(&second), &u, k);
            self.weak = weaker_first(gram, u, v, k);
            self.strong = normalised(apply(gram, &self.strong, k), self.strong, k);
        }
        self.smallest = rayleigh(gram, &self.weak[0], k);
        self.largest = rayleigh(gram, &self.strong, k);
    }
}

/// The part of `v` across the unit vector `u`, of length 1; some other unit vector where `v` is along `u`, zero where
/// there is none.
fn without(v: AxisVec, u: &AxisVec, k: usize) -> AxisVec {
    let along = |v: &AxisVec| (0..k).map(|i| v[i] * u[i]).sum::<f64>();
    let across = |v: &AxisVec| {
        let share = along(v);
        let mut out = [0.0; MAX_AXES];
        (0..k).for_each(|i| out[i] = v[i] - share * u[i]);
        out
    };
    let rest = across(&normalised(v, *u, k));
    if (0..k).map(|i| rest[i] * rest[i]).sum::<f64>() > 1e-20 {
        return normalised(across(&normalised(rest, rest, k)), rest, k);
    }
    let mut unit = [0.0; MAX_AXES];
    let least = (0..k).fold(0, |best, i| if u[i].abs() < u[best].abs() { i } else { best });
    unit[least] = 1.0;
    let rest = across(&unit);
    if k > 1 { normalised(rest, rest, k) } else { [0.0; MAX_AXES] }
}

/// The pair of unit vectors turned in its plane (Rayleigh and Ritz), the one of the smaller value first.
fn weaker_first(gram: &Square, u: AxisVec, v: AxisVec, k: usize) -> [AxisVec; 2] {
    let (gu, gv) = (apply(gram, &u, k), apply(gram, &v, k));
    let (mut a, mut b, mut d) = (0.0, 0.0, 0.0);
    for i in 0..k {
        a += u[i] * gu[i];
        b += u[i] * gv[i];
        d += v[i] * gv[i];
    }
    let half = 0.5 * (a - d);
    let root = (half * half + b * b).sqrt();
    // Eigenvector of [[a, b], [b, d]] for its smaller value, in the form that does not cancel.
    let (x, y) = if half > 0.0 { (b, -(half + root)) } else { (root - half, -b) };
    let length = (x * x + y * y).sqrt();
    // A single axis has no second vector.
    if k < 2 || !(length > 0.0) {
        return [u, v];
    }
    let (x, y) = (x / length, y / length);
    let mut out = [[0.0; MAX_AXES]; 2];
    for i in 0..k {
        out[0][i] = x * u[i] + y * v[i];
        out[1][i] = x * v[i] - y * u[i];
    }
    out
}

fn apply(m: &Square, v: &AxisVec, k: usize) -> AxisVec {
    let mut out = [0.0; MAX_AXES];
    for i in 0..k {
        for j in 0..k {
            out[i] += m[i][j] * v[j];
        }
    }
    out
}

/// √(vᵀMv) of a unit vector.
fn rayleigh(m: &Square, v: &AxisVec, k: usize) -> f64 {
    let mv = apply(m, v, k);
    (0..k).map(|i| v[i] * mv[i]).sum::<f64>().max(0.0).sqrt()
}

fn normalised(v: AxisVec, fallback: AxisVec, k: usize) -> AxisVec {
    let scale = v.iter().take(k).fold(0.0_f64, |a, x| a.max(x.abs()));
    if !(scale > 0.0 && scale.is_finite()) {
        return fallback;
    }
    let length = v.iter().take(k).map(|x| (x / scale) * (x / scale)).sum::<f64>().sqrt();
    let mut out = [0.0; MAX_AXES];
    for i in 0..k {
        out[i] = v[i] / scale / length;
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

    #[test]
    fn solve_and_solve_rows_invert() {
        let mut m = weighted_gram(&rows(), &[1.0; MAX_JOINTS], 6, 7);
        (0..6).for_each(|i| m[i][i] += 0.1);
        let factor = Cholesky::new(&m, 6);
        let x = [1.0, -2.0, 3.0, 0.5, 0.0, 1.5];
        let back = factor.solve(&apply(&m, &x, 6));
        assert!(x.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-12));
        let mut identity = [[0.0; MAX_JOINTS]; MAX_AXES];
        (0..6).for_each(|i| identity[i][i] = 1.0);
        let inverse = factor.solve_rows(&identity);
        for (i, value) in factor.inverse_diagonal().iter().enumerate() {
            assert!((value - inverse[i][i]).abs() < 1e-12);
        }
    }

    #[test]
    fn singular_values_agree_with_an_svd() {
        let rows = rows();
        let gram = weighted_gram(&rows, &[1.0; MAX_JOINTS], 6, 7);
        let reference = nalgebra::DMatrix::from_fn(6, 7, |r, c| rows[r][c]).singular_values();
        let mut values = SingularValues::start();
        values.update(&gram, 6, 60);
        assert!((values.largest - reference.max()).abs() < 1e-9);
        assert!((values.smallest - reference.min()).abs() < 1e-6, "{} {reference}", values.smallest);
    }

    #[test]
    fn a_singular_matrix_gives_finite_answers() {
        let factor = Cholesky::new(&[[0.0; MAX_AXES]; MAX_AXES], 6);
        assert!(factor.solve(&[1.0; MAX_AXES]).iter().all(|x| x.is_finite()));
        let mut values = SingularValues::start();
        values.update(&[[0.0; MAX_AXES]; MAX_AXES], 6, 2);
        assert!(values.smallest.abs() < 1e-50);
    }
}
