//! Feed-forward of friction and damping.

use crate::math::simd::{JointVector, tanh};
use crate::params::{ServoArrays, Settings};

/// Factors of the friction and damping feed-forward.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrictionGains {
    /// γ b_f, on dry friction.
    pub(crate) friction: f64,
    /// γ b_d, on viscous damping.
    pub(crate) damping: f64,
    /// Speed v₀ [rad/s] at which the dry friction saturates.
    pub(crate) speed: f64,
}

impl FrictionGains {
    /// Returns the factors of the settings for the singularity fade γ; law `paper` does not use them.
    #[inline(always)]
    pub(crate) fn new(settings: &Settings, gamma: f64) -> Self {
        Self {
            friction: gamma * settings.compensation.friction,
            damping: gamma * settings.compensation.damping,
            speed: settings.paper_options.friction_speed,
        }
    }
}

/// Torque of friction and damping at each joint times the feed-forward factors, as a function of the load.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrictionFeedForward<J> {
    /// Part that does not depend on the load [N·m].
    unloaded: J,
    /// Additional torque per N·m of load torque [1].
    per_load: J,
}

impl<J: JointVector> FrictionFeedForward<J> {
    /// Computes `γ (b_f (τ_f + s τ_s) tanh(v/v₀) + b_d d v)` and, per load torque, `γ b_f (μ + s μ_s) tanh(v/v₀)`. With
    /// `s = 1/(1 + x + x²)`, `x = |v|/v_s`, the excess of static friction fades with the speed. `toward` replaces v in
    /// `tanh(v/v₀)`, because the velocity of a joint that sticks has no direction.
    #[inline(always)]
    pub(crate) fn new([v, toward]: [J; 2], servos: &ServoArrays, friction_gains: FrictionGains) -> Self {
        let one = J::splat(1.0);
        let x = J::abs(v) * J::load(&servos.inv_stribeck_speed);
        let at_rest = one / J::fma(x, x, one + x);
        let direction = tanh::<J>(toward * J::splat(1.0 / friction_gains.speed)) * J::splat(friction_gains.friction);
        let dry = J::fma(at_rest, J::load(&servos.stribeck), J::load(&servos.friction));
        let per_load = J::fma(at_rest, J::load(&servos.load_stribeck), J::load(&servos.load_friction));
        let damping = J::load(&servos.damping) * v * J::splat(friction_gains.damping);
        Self { unloaded: J::fma(dry, direction, damping), per_load: per_load * direction }
    }

    /// Returns the feed-forward torque [N·m] of joints that carry the load `torque` [N·m].
    #[inline(always)]
    pub(crate) fn at_load(&self, torque: J) -> J {
        J::fma(self.per_load, J::abs(torque), self.unloaded)
    }
}
