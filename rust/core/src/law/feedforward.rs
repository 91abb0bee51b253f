//! Velocity filter, prediction over the known delay, and friction feed-forward: lines 1 and 10.

use crate::number::{Joints, Lanes, NEGLIGIBLE, Scalar, tanh};
use crate::servos::ServoArrays;
use crate::{JointVec, MAX_JOINTS};

/// Largest plausible speed [m/s, rad/s].
pub(crate) const SPEED_BOUND: f64 = 1e3;

/// Joint velocity from measured positions: backlash operator of one encoder count, differences, one-pole filter.
///
/// The backlash acts on this path only. Without it one toggling count is a velocity of `count / (T_f + dt)`. If that
/// exceeds v₀, the friction feed-forward chatters at full size.
#[derive(Debug, Clone, Copy)]
pub(crate) struct VelocityFilter {
    /// Output of the backlash operator [rad].
    pub(crate) held: JointVec,
    /// Filtered velocity [rad/s].
    pub(crate) velocity: JointVec,
}

impl VelocityFilter {
    /// At rest in `q`.
    pub(crate) fn new(q: &JointVec) -> Self {
        Self { held: *q, velocity: [0.0; MAX_JOINTS] }
    }

    /// Filters one reading `q`, `dt` [s] after the last; `count` is the backlash on each side, `time_constant` T_f [s].
    #[inline(always)]
    pub(crate) fn after<J: Lanes>(&self, q: J, count: J, time_constant: f64, dt: f64) -> Filtered<J> {
        let (share, per_second) = (J::splat(dt / (time_constant + dt)), J::splat(1.0 / dt));
        let (before, velocity) = (J::load(&self.held), J::load(&self.velocity));
        let held = J::at_most(J::at_least(before, q - count), q + count);
        // No joint is faster: with a tiny dt the filter must not store an infinity.
        let raw = J::clip((held - before) * per_second, J::splat(SPEED_BOUND));
        let velocity = J::fma(share, raw - velocity, velocity);
        let nothing = J::splat(0.0);
        Filtered { held, velocity: J::if_less(J::abs(velocity), J::splat(NEGLIGIBLE), nothing, velocity) }
    }

    /// Stores the new state.
    #[inline(always)]
    pub(crate) fn keep<J: Joints>(&mut self, filtered: Filtered<J>) {
        filtered.held.store(&mut self.held);
        filtered.velocity.store(&mut self.velocity);
    }
}

/// New state of the filter.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Filtered<J> {
    pub(crate) held: J,
    pub(crate) velocity: J,
}

/// Factors of the friction feed-forward.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fed<S> {
    /// γ b_f and γ b_d.
    pub(crate) friction: S,
    pub(crate) damping: S,
    /// v₀ [rad/s].
    pub(crate) speed: f64,
}

/// Friction torque of the joints, times the feed-forward factors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Resistance<J> {
    /// Part independent of the load [N·m].
    idle: J,
    /// Additional part per N·m of load.
    loaded: J,
}

impl<J: Lanes> Resistance<J> {
    /// `γ (b_f (τ_f + s τ_s) tanh(v/v₀) + b_d d v)` and `γ b_f (μ + s μ_s) tanh(v/v₀)`, `s = 1/(1 + x + x²)`, `x =
    /// |v|/v_s`: the excess of static friction fades with the speed. `toward` replaces v in `tanh(v/v₀)`, because the
    /// velocity of a joint that sticks gives no direction.
    #[inline(always)]
    pub(crate) fn new([v, toward]: [J; 2], servos: &ServoArrays, fed: Fed<Scalar<J>>) -> Self {
        let one = J::splat(1.0);
        let x = J::abs(v) * J::load(&servos.stribeck_slowness);
        let at_rest = one / J::fma(x, x, one + x);
        let way = tanh::<J>(toward * J::splat(1.0 / fed.speed)) * J::spread(fed.friction);
        let dry = J::fma(at_rest, J::load(&servos.stribeck), J::load(&servos.friction));
        let per_load = J::fma(at_rest, J::load(&servos.load_stribeck), J::load(&servos.load_friction));
        let damping = J::load(&servos.damping) * v * J::spread(fed.damping);
        Self { idle: J::fma(dry, way, damping), loaded: per_load * way }
    }

    /// Returns the friction torque of joints that carry `torque` [N·m].
    #[inline(always)]
    pub(crate) fn under(&self, torque: J) -> J {
        J::fma(self.loaded, J::abs(torque), self.idle)
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
    use crate::number::{Arithmetic, EveryJoint};

    #[test]
    fn a_toggling_count_gives_no_velocity_and_a_steady_motion_the_right_one() {
        let count = EveryJoint::splat(1e-3);
        let mut filter = VelocityFilter::new(&[0.0; MAX_JOINTS]);
        for tick in 0..100 {
            let q = EveryJoint::splat(if tick % 2 == 0 { 1e-3 } else { -1e-3 });
            filter.keep(filter.after(q, count, 0.02, 0.01));
        }
        assert!(filter.velocity[0].abs() < 1e-9);
        for tick in 0..200 {
            filter.keep(filter.after(EveryJoint::splat(0.005 * f64::from(tick)), count, 0.02, 0.01));
        }
        assert!((filter.velocity[0] - 0.5).abs() < 1e-9);
        for _ in 0..1000 {
            filter.keep(filter.after(EveryJoint::splat(1.0), count, 0.02, 0.01));
        }
        assert_eq!(filter.velocity.map(f64::to_bits), [0; MAX_JOINTS], "at rest it would decay to denormal numbers");
    }

    #[test]
    fn damping_is_continuous_where_it_sets_in() {
        let at = |sigma| damping_squared(sigma, 0.02, 0.15, 0.15);
        assert!((at(0.15) - at(0.15 - 1e-12)).abs() < 1e-12);
        assert!((at(0.0) - (0.0004 + 0.0225)).abs() < 1e-15);
    }
}
