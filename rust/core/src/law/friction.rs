//! Friction and damping feed-forward: line 10.

use crate::math::simd::{JointVector, Number, RealOps, Scalar, tanh};
use crate::params::{ServoArrays, Settings};

/// Factors of the friction feed-forward.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrictionGains<S> {
    /// γ b_f and γ b_d.
    pub(crate) friction: S,
    pub(crate) damping: S,
    /// v₀ [rad/s].
    pub(crate) speed: f64,
}

impl<S> FrictionGains<S> {
    /// Returns the factors for γ; not used by law `paper`.
    #[inline(always)]
    pub(crate) fn new<A: RealOps<Real = S>>(settings: &Settings, gamma: S) -> Self
    where
        S: Number,
    {
        let share = |of: f64| gamma * A::splat(of);
        Self {
            friction: share(settings.compensation.friction),
            damping: share(settings.compensation.damping),
            speed: settings.paper_options.friction_speed,
        }
    }
}

/// Friction torque of the joints, times the feed-forward factors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrictionFeedForward<J> {
    /// Part independent of the load [N·m].
    unloaded: J,
    /// Additional part per N·m of load.
    per_load: J,
}

impl<J: JointVector> FrictionFeedForward<J> {
    /// `γ (b_f (τ_f + s τ_s) tanh(v/v₀) + b_d d v)` and `γ b_f (μ + s μ_s) tanh(v/v₀)`, `s = 1/(1 + x + x²)`, `x =
    /// |v|/v_s`: the excess of static friction fades with the speed. `toward` replaces v in `tanh(v/v₀)`, because the
    /// velocity of a joint that sticks gives no direction.
    #[inline(always)]
    pub(crate) fn new([v, toward]: [J; 2], servos: &ServoArrays, friction_gains: FrictionGains<Scalar<J>>) -> Self {
        let one = J::splat(1.0);
        let x = J::abs(v) * J::load(&servos.inv_stribeck_speed);
        let at_rest = one / J::fma(x, x, one + x);
        let direction =
            tanh::<J>(toward * J::splat(1.0 / friction_gains.speed)) * J::broadcast(friction_gains.friction);
        let dry = J::fma(at_rest, J::load(&servos.stribeck), J::load(&servos.friction));
        let per_load = J::fma(at_rest, J::load(&servos.load_stribeck), J::load(&servos.load_friction));
        let damping = J::load(&servos.damping) * v * J::broadcast(friction_gains.damping);
        Self { unloaded: J::fma(dry, direction, damping), per_load: per_load * direction }
    }

    /// Returns the friction torque of joints that carry `torque` [N·m].
    #[inline(always)]
    pub(crate) fn at_load(&self, torque: J) -> J {
        J::fma(self.per_load, J::abs(torque), self.unloaded)
    }
}
