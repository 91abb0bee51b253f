//! Singular values of the task rows, and the quantities computed from them: damping λ² of the inverse kinematics,
//! damping μ² of the null-space projector, and the fade γ of feed-forward and prediction.

use crate::law::nullspace::projector_damping_sq;
use crate::math::cold;
use crate::math::ldlt6::Ldlt6;
use crate::math::rows::{Mat6, store_rows, weighted_gram};
use crate::math::simd::{JointVector, RealOps, SimdVec};
use crate::math::singular_values::SingularValues;
use crate::params::{Features, Params};
use crate::{MAX_AXES, Rows};

/// Iterations for the extreme singular vectors, without vectors of a previous step.
const COLD_ITERATIONS: usize = 30;

/// Iterations per step for the extreme singular vectors, started from those of the last step.
const TRACKING_ITERATIONS: usize = 1;

/// Damping and fade that follow from the singular values of a step's task rows.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SingularityState {
    /// Squared damping λ² for rows scaled to the arm's length; times `damping_scale` it has the unit of a row.
    pub(crate) damping: f64,
    /// Squared damping μ² of the exact null-space projector.
    pub(crate) mu_squared: f64,
    /// LDLᵀ factor of `JJᵀ` with the scaled rows J; `None` if the settings need no singular values, or with more axes
    /// than joints.
    pub(crate) factor: Option<Ldlt6>,
    /// Factor γ on feed-forward and prediction.
    pub(crate) gamma: f64,
}

/// Returns γ, which fades feed-forward and prediction near singular poses: `clip(3 σ/σ₀, ½, 1)`, or 1 if σ₀ is 0.
#[inline(always)]
pub(crate) fn singularity_fade(sigma: f64, sigma_0: f64) -> f64 {
    let tripled = 3.0 * sigma;
    if tripled < sigma_0 {
        cold();
        return (tripled / sigma_0).max(0.5);
    }
    1.0
}

/// Returns the squared damping λ² for the smallest singular value σ: `λ₀² + (1 − (σ/σ₀)²) λ_max²` below σ₀, else λ₀².
#[inline(always)]
pub(crate) fn damping_squared(sigma: f64, lambda_0: f64, sigma_0: f64, lambda_max: f64) -> f64 {
    let mut squared = lambda_0 * lambda_0;
    if sigma < sigma_0 {
        cold();
        let ratio = sigma / sigma_0;
        squared += (1.0 - ratio * ratio) * lambda_max * lambda_max;
    }
    squared
}

/// Returns the squared damping λ² of each task row, in the units of that row.
#[inline(always)]
pub(crate) fn row_damping<J: JointVector>(params: &Params, singularity: &SingularityState) -> J::Axes {
    J::Axes::from_array(&params.axis_simd.damping_scale) * J::Axes::splat(singularity.damping)
}

/// Updates `values` to the singular values of the scaled rows and returns damping and fade. `cold`: `values` are not
/// those of the last step.
#[inline(always)]
pub(crate) fn singularity_state<J: JointVector>(
    params: &Params,
    features: Features,
    scaled: &[J; MAX_AXES],
    values: &mut SingularValues,
    cold: bool,
) -> SingularityState {
    let constants = params.damping;
    if !features.singular_values {
        return SingularityState {
            damping: constants.lambda_0 * constants.lambda_0,
            mu_squared: 0.0,
            factor: None,
            gamma: 1.0,
        };
    }
    let (has_enough_joints, axes) = (params.k <= params.n, params.k.min(params.n));
    let gram = if has_enough_joints { weighted_gram(scaled, J::splat(1.0)) } else { joint_gram(&store_rows(scaled)) };
    let factor = Ldlt6::new::<J::Elem>(&gram);
    if cold {
        values.restrict(axes);
    }
    values.update::<J::Elem>(&gram, &factor, axes, if cold { COLD_ITERATIONS } else { TRACKING_ITERATIONS });
    let sigma = values.smallest;
    SingularityState {
        damping: damping_squared(sigma, constants.lambda_0, constants.sigma_0, constants.lambda_max),
        mu_squared: projector_damping_sq(sigma, values.largest),
        factor: has_enough_joints.then_some(factor),
        gamma: singularity_fade(sigma, constants.sigma_0),
    }
}

/// Returns `JᵀJ`, which replaces `JJᵀ` for a task with more axes than joints: it has the same nonzero eigenvalues,
/// without the zeros.
#[cold]
#[inline(never)]
fn joint_gram(scaled: &Rows) -> Mat6 {
    let mut gram = [[0.0; MAX_AXES]; MAX_AXES];
    for (i, row) in gram.iter_mut().enumerate() {
        for (j, value) in row.iter_mut().enumerate() {
            *value = scaled.iter().map(|r| r[i] * r[j]).sum();
        }
    }
    gram
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damping_is_continuous_at_sigma_0() {
        let at = |sigma| damping_squared(sigma, 0.02, 0.15, 0.15);
        assert!((at(0.15) - at(0.15 - 1e-12)).abs() < 1e-12);
        assert!((at(0.0) - (0.0004 + 0.0225)).abs() < 1e-15);
    }
}
