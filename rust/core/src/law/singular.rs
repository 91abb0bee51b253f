//! The smallest and the largest singular value, followed from tick to tick.

use crate::law::inverse::{Cholesky, Square};
use crate::{AxisVec, MAX_AXES};

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
    use crate::MAX_JOINTS;
    use crate::law::inverse::weighted_gram;

    #[test]
    fn singular_values_agree_with_an_svd() {
        let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
        for (r, row) in rows.iter_mut().enumerate() {
            for (i, value) in row.iter_mut().enumerate().take(7) {
                *value = ((7 * r * r + 3 * i * i + r * i) as f64 * 0.7).sin();
            }
        }
        let gram = weighted_gram(&rows, &[1.0; MAX_JOINTS], 6, 7);
        let exact = crate::law::svd::singular_values(&nalgebra::DMatrix::from_fn(6, 7, |r, c| rows[r][c]));
        let mut values = SingularValues::start();
        values.update(&gram, 6, 200);
        assert!(exact.min() > 0.1, "the matrix has full rank");
        assert!((values.largest - exact.max()).abs() < 1e-9, "{} {exact}", values.largest);
        assert!((values.smallest - exact.min()).abs() < 1e-9, "{} {exact}", values.smallest);
    }

    #[test]
    fn a_zero_matrix_has_a_zero_value() {
        let mut values = SingularValues::start();
        values.update(&[[0.0; MAX_AXES]; MAX_AXES], 6, 2);
        assert!(values.smallest.abs() < 1e-50);
    }
}
