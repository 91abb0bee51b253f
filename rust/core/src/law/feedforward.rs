//! Velocity, prediction over the known delay, and what the joints themselves resist: lines 1 and 10.

use crate::number::tanh;
use crate::{JointVec, MAX_JOINTS};

/// Largest speed [m/s, rad/s] that is taken for a real one.
pub(crate) const SPEED_BOUND: f64 = 1e3;

/// Joint velocity from measured positions: differences behind one encoder count of play, then a one-pole filter.
///
/// The play acts on this path only. Without it one toggling count is a velocity of `count / (T_f + dt)`, and once that
/// exceeds v₀ the friction feed-forward chatters at full size.
#[derive(Debug, Clone, Copy)]
pub(crate) struct VelocityFilter {
    /// Position behind the play [rad].
    held: JointVec,
    /// Filtered velocity [rad/s].
    pub(crate) velocity: JointVec,
}

impl VelocityFilter {
    /// At rest in `q`.
    pub(crate) fn new(q: &JointVec) -> Self {
        Self { held: *q, velocity: [0.0; MAX_JOINTS] }
    }

    /// Takes one reading `q` after `dt` [s]; `count` is the play on each side, `time_constant` T_f [s].
    #[inline(always)]
    pub(crate) fn update(&mut self, q: &JointVec, count: &JointVec, time_constant: f64, dt: f64, n: usize) {
        let (share, per_second) = (dt / (time_constant + dt), 1.0 / dt);
        for i in 0..n.min(MAX_JOINTS) {
            let held = self.held[i].max(q[i] - count[i]).min(q[i] + count[i]);
            // Nothing turns faster: a vanishing dt must not make an infinity that the filter would keep.
            let raw = ((held - self.held[i]) * per_second).clamp(-SPEED_BOUND, SPEED_BOUND);
            self.velocity[i] += share * (raw - self.velocity[i]);
            self.held[i] = held;
        }
    }

    /// Takes a velocity that the caller knows better.
    #[inline(always)]
    pub(crate) fn set(&mut self, q: &JointVec, dq: &JointVec) {
        self.held = *q;
        self.velocity = *dq;
    }
}

/// Feed-forward torque `γ (b_f τ_f tanh(v / v₀) + b_d d v)` [N·m].
#[inline(always)]
pub(crate) fn resistance(
    v: &JointVec,
    friction: &JointVec,
    damping: &JointVec,
    shares: (f64, f64),
    friction_speed: f64,
    gamma: f64,
    n: usize,
) -> JointVec {
    let mut out = [0.0; MAX_JOINTS];
    let slope = 1.0 / friction_speed;
    for i in 0..n.min(MAX_JOINTS) {
        let dry = shares.0 * friction[i] * tanh(v[i] * slope);
        out[i] = gamma * (dry + shares.1 * damping[i] * v[i]);
    }
    out
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
    fn a_toggling_count_gives_no_velocity_and_a_steady_motion_the_right_one() {
        let count = [1e-3; MAX_JOINTS];
        let mut filter = VelocityFilter::new(&[0.0; MAX_JOINTS]);
        for tick in 0..100 {
            let q = [if tick % 2 == 0 { 1e-3 } else { -1e-3 }; MAX_JOINTS];
            filter.update(&q, &count, 0.02, 0.01, 1);
        }
        assert!(filter.velocity[0].abs() < 1e-9);
        for tick in 0..200 {
            filter.update(&[0.005 * f64::from(tick); MAX_JOINTS], &count, 0.02, 0.01, 1);
        }
        assert!((filter.velocity[0] - 0.5).abs() < 1e-9);
    }

    #[test]
    fn damping_is_continuous_where_it_sets_in() {
        let at = |sigma| damping_squared(sigma, 0.02, 0.15, 0.15);
        assert!((at(0.15) - at(0.15 - 1e-12)).abs() < 1e-12);
        assert!((at(0.0) - (0.0004 + 0.0225)).abs() < 1e-15);
    }
}
