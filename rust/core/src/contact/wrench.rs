//! Linear estimate of the wrench, with its error bound, from residual joint torques.

use crate::math::ldlt6::{Ldlt6, factor_gram};
use crate::math::rows::{JointMatrix, load_rows, store_rows};
use crate::math::simd::{BaselineF64, BaselineF64x8, JointVec16, JointVector, LANES};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Linear estimate `F = G r` from residual torques `r = JᵀF + ε` with `|ε_i| ≤ u_i` and `|F_k| ≤ max_wrench_k`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Estimator {
    /// Gain `G = (J W Jᵀ + P⁻¹)⁻¹ J W` with `W = diag(1/u²)`, `P = diag(max_wrench²)`: k × n.
    gain: Rows,
    /// Bound on the bias that P⁻¹ causes, `|G Jᵀ − I| max_wrench` [N, N·m]; along unobservable axes it is `max_wrench`.
    regularization_bias: AxisVec,
    k: usize,
    n: usize,
}

impl Estimator {
    /// Creates the estimator for `k` Jacobian rows of `n` joints. All entries of `uncertainty` u [N·m] and `max_wrench`
    /// [N, N·m] must be positive.
    #[inline]
    pub(super) fn new(rows: &Rows, uncertainty: &JointVec, max_wrench: &AxisVec, k: usize, n: usize) -> Self {
        let (k, n) = (k.min(MAX_AXES), n.min(MAX_JOINTS));
        let mut weight = [0.0; MAX_JOINTS];
        for i in 0..n {
            weight[i] = 1.0 / (uncertainty[i] * uncertainty[i]);
        }
        let mut prior = [0.0; MAX_AXES];
        for r in 0..k {
            prior[r] = 1.0 / (max_wrench[r] * max_wrench[r]);
        }
        let (factor, gain) = if n <= LANES {
            factor_and_gain::<BaselineF64x8>(rows, &weight, &prior)
        } else {
            factor_and_gain::<JointVec16>(rows, &weight, &prior)
        };
        let mut regularization_bias = [0.0; MAX_AXES];
        for c in 0..k {
            // G Jᵀ − I = −(J W Jᵀ + P⁻¹)⁻¹ P⁻¹; this form has no cancellation.
            let mut prior_column = [0.0; MAX_AXES];
            prior_column[c] = prior[c];
            let column = factor.solve::<BaselineF64>(&prior_column);
            for r in 0..k {
                regularization_bias[r] += column[r].abs() * max_wrench[c];
            }
        }
        Self { gain, regularization_bias, k, n }
    }

    /// Returns `G v` [N, N·m] for joint torques v [N·m].
    #[inline]
    pub(super) fn apply(&self, v: &JointVec) -> AxisVec {
        let mut out = [0.0; MAX_AXES];
        for r in 0..self.k {
            for i in 0..self.n {
                out[r] += self.gain[r][i] * v[i];
            }
        }
        out
    }

    /// Returns the standard deviations of the estimate [N, N·m] for noise of the joint torques: `noise` [N·m] is
    /// independent between joints; each column of `shared` [N·m] is an independent noise that acts on all joints.
    #[inline]
    pub(super) fn noise(&self, noise: &JointVec, shared: &JointMatrix) -> AxisVec {
        let mut out = [0.0; MAX_AXES];
        for r in 0..self.k {
            let (mut squares, mut columns) = (0.0, [0.0; MAX_JOINTS]);
            for i in 0..self.n {
                squares += (self.gain[r][i] * noise[i]).powi(2);
                for j in 0..MAX_JOINTS {
                    columns[j] += self.gain[r][i] * shared[i][j];
                }
            }
            out[r] = (squares + columns.iter().map(|x| x * x).sum::<f64>()).sqrt();
        }
        out
    }

    /// Returns the bound on the error of the estimate, `|G| u + |G Jᵀ − I| max_wrench` [N, N·m].
    #[inline]
    pub(super) fn bound(&self, uncertainty: &JointVec) -> AxisVec {
        let mut out = self.regularization_bias;
        for r in 0..self.k {
            for i in 0..self.n {
                out[r] += self.gain[r][i].abs() * uncertainty[i];
            }
        }
        out
    }
}

/// Returns the factor of `J W Jᵀ + P⁻¹` and the gain G, for `weight` the diagonal of W and `prior` that of P⁻¹.
#[inline(never)]
fn factor_and_gain<J: JointVector>(rows: &Rows, weight: &JointVec, prior: &AxisVec) -> (Ldlt6, Rows) {
    let (rows, weight) = (load_rows::<J>(rows), J::load(weight));
    let factor = factor_gram(&rows, weight, prior);
    let gain = store_rows(&factor.weighted_rows(&rows, weight));
    (factor, gain)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(seed: f64) -> Rows {
        let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
        for (r, row) in rows.iter_mut().enumerate() {
            for (i, value) in row.iter_mut().enumerate().take(7) {
                *value = ((r * 7 + i) as f64 * seed).sin();
            }
        }
        rows
    }

    const MAX: AxisVec = [100.0, 100.0, 100.0, 20.0, 20.0, 20.0];

    #[test]
    fn the_error_stays_within_its_bound() {
        for seed in 1..200 {
            let rows = rows(0.37 + f64::from(seed) * 0.071);
            let noise = |i: usize| (((i + 1) as f64 * 12.9898 + f64::from(seed)).sin() * 43_758.545_3).fract();
            let (mut u, mut r) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
            let truth: AxisVec = std::array::from_fn(|k| MAX[k] * noise(k));
            for i in 0..7 {
                u[i] = 0.01 + noise(i + 10).abs();
                r[i] = (0..6).map(|k| rows[k][i] * truth[k]).sum::<f64>() + u[i] * noise(i + 20).signum();
            }
            let estimator = Estimator::new(&rows, &u, &MAX, 6, 7);
            let (found, bound) = (estimator.apply(&r), estimator.bound(&u));
            for k in 0..6 {
                assert!((found[k] - truth[k]).abs() <= bound[k] * (1.0 + 1e-9) + 1e-9, "{k} {found:?} {truth:?}");
                assert!(bound[k].is_finite());
            }
        }
    }

    #[test]
    fn an_unobservable_axis_has_the_largest_plausible_uncertainty() {
        let mut rows = rows(0.7);
        rows[2] = [0.0; MAX_JOINTS];
        let estimator = Estimator::new(&rows, &[0.1; MAX_JOINTS], &MAX, 6, 7);
        assert!((estimator.bound(&[0.1; MAX_JOINTS])[2] - 100.0).abs() < 1e-9);
        assert!(estimator.apply(&[1.0; MAX_JOINTS])[2].abs() < 1e-12, "and nothing is felt there");
        assert!(estimator.bound(&[0.1; MAX_JOINTS])[0] < 50.0, "the others are not touched by it");
    }
}
