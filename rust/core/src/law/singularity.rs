//! Singularity state of the task rows: damping, projector damping and the fade of feed-forward and prediction.

use crate::law::nullspace::fade_squared;
use crate::math::ldlt6::Factor;
use crate::math::rows::{Square, rows_array, weighted_gram};
use crate::math::simd::{Axes, Joints, Lanes, Scalar, Spread};
use crate::math::singular_values::SingularValues;
use crate::params::Plan;
use crate::{MAX_AXES, Rows};

/// Iterations for the extreme singular vectors: from scratch, and per step when tracked.
const ITERATIONS: (usize, usize) = (30, 1);

/// Singularity state of a step's task rows.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Condition<R = f64> {
    /// λ².
    pub(crate) damping: R,
    /// μ² of the exact projector.
    pub(crate) mu_squared: R,
    /// Factor of the scaled rows' `JJᵀ`, if computed.
    pub(crate) factor: Option<Factor<R>>,
    /// γ: factor on feed-forward and prediction.
    pub(crate) gamma: R,
}

/// γ of line 7: fades feed-forward and prediction near singular poses, `clip(3 σ/σ₀, ½, 1)`.
#[inline(always)]
pub(crate) fn fade(sigma: f64, sigma_0: f64) -> f64 {
    if sigma_0 > 0.0 { (3.0 * sigma / sigma_0).clamp(0.5, 1.0) } else { 1.0 }
}

/// λ² of line 7.
#[inline(always)]
pub(crate) fn damping_squared(sigma: f64, lambda_0: f64, sigma_0: f64, lambda_max: f64) -> f64 {
    let mut squared = lambda_0 * lambda_0;
    if sigma < sigma_0 {
        let ratio = sigma / sigma_0;
        squared += (1.0 - ratio * ratio) * lambda_max * lambda_max;
    }
    squared
}

/// λ² of each row.
#[inline(always)]
pub(crate) fn row_damping<J: Lanes>(plan: &Plan, condition: &Condition<Scalar<J>>) -> J::Axes {
    J::Axes::constant(&plan.lanes.damping_scale) * J::Axes::spread(condition.damping)
}

/// Line 7: updates σ, sets γ, returns λ².
#[inline(always)]
pub(crate) fn condition<J: Joints>(
    plan: &Plan,
    scaled: &[J; MAX_AXES],
    values: &mut SingularValues,
    cold: bool,
) -> Condition {
    let limits = plan.damping;
    if !plan.follows_sigma {
        return Condition { damping: limits.lambda_0 * limits.lambda_0, mu_squared: 0.0, factor: None, gamma: 1.0 };
    }
    let (redundant, axes) = (plan.k <= plan.n, plan.k.min(plan.n));
    let gram = if redundant { weighted_gram(scaled, J::splat(1.0)) } else { joint_gram(&rows_array(scaled)) };
    let factor = Factor::new::<J::One>(&gram);
    if cold {
        values.restrict(axes);
    }
    values.update::<J::One>(&gram, &factor, axes, if cold { ITERATIONS.0 } else { ITERATIONS.1 });
    let sigma = values.smallest;
    Condition {
        damping: damping_squared(sigma, limits.lambda_0, limits.sigma_0, limits.lambda_max),
        mu_squared: fade_squared(sigma, values.largest),
        factor: redundant.then_some(factor),
        gamma: fade(sigma, limits.sigma_0),
    }
}

/// Returns `JᵀJ`, for fewer joints than axes: it has the same nonzero singular values, without the zeros that `JJᵀ`
/// always has.
#[cold]
#[inline(never)]
fn joint_gram(scaled: &Rows) -> Square {
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
