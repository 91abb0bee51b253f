//! Velocity, prediction over the known delay, and what the joints themselves resist: lines 1 and 10.

use crate::number::tanh;
use crate::servos::ServoArrays;
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
    pub(crate) held: JointVec,
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

/// What the joints resist with, as far as it is fed forward.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Resistance {
    /// Whatever the joints carry [N·m].
    pub(crate) idle: JointVec,
    /// In addition per N·m that they carry.
    pub(crate) loaded: JointVec,
}

impl Resistance {
    /// Of nothing.
    pub(crate) const NONE: Self = Self { idle: [0.0; MAX_JOINTS], loaded: [0.0; MAX_JOINTS] };

    /// `γ (b_f (τ_f + s τ_s) tanh(v/v₀) + b_d d v)` and `γ b_f (μ + s μ_s) tanh(v/v₀)`, `s = 1/(1 + x + x²)`, `x = |v|/v_s`:
    /// what friction at rest has more than in motion fades with the speed.
    #[inline(always)]
    pub(crate) fn new(
        v: &JointVec,
        servos: &ServoArrays,
        shares: (f64, f64),
        friction_speed: f64,
        gamma: f64,
        n: usize,
    ) -> Self {
        let (mut out, slope) = (Self::NONE, 1.0 / friction_speed);
        for i in 0..n.min(MAX_JOINTS) {
            let x = v[i].abs() * servos.stribeck_slowness[i];
            let at_rest = 1.0 / (1.0 + x + x * x);
            let way = tanh(v[i] * slope);
            let dry = servos.friction[i] + at_rest * servos.stribeck[i];
            out.idle[i] = gamma * (shares.0 * dry * way + shares.1 * servos.damping[i] * v[i]);
            out.loaded[i] = gamma * shares.0 * (servos.load_friction[i] + at_rest * servos.load_stribeck[i]) * way;
        }
        out
    }

    /// The torque of joint `i` that carries `torque` [N·m].
    #[inline(always)]
    pub(crate) fn under(&self, i: usize, torque: f64) -> f64 {
        self.idle[i] + self.loaded[i] * torque.abs()
    }
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
