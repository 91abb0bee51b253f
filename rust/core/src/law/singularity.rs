//! Singularity state of the task rows: damping, projector damping and the fade of feed-forward and prediction.

use crate::math::ldlt6::Factor;

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn damping_is_continuous_where_it_sets_in() {
        let at = |sigma| damping_squared(sigma, 0.02, 0.15, 0.15);
        assert!((at(0.15) - at(0.15 - 1e-12)).abs() < 1e-12);
        assert!((at(0.0) - (0.0004 + 0.0225)).abs() < 1e-15);
    }
}
