//! Feed-forward of friction and damping.

use crate::math::simd::{JointVector, tanh};
use crate::params::{ServoArrays, Settings};

/// Parameters of the friction and damping feed-forward.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrictionGains {
    /// Factor γ b_f on dry friction: singularity fade γ times compensated share b_f.
    pub(crate) friction: f64,
    /// Factor γ b_d on viscous damping, with the compensated share b_d.
    pub(crate) damping: f64,
    /// Speed v₀ [rad/s] at which the feed-forward of dry friction saturates.
    pub(crate) speed: f64,
}

impl FrictionGains {
    /// Returns the parameters under these settings at the singularity fade γ; law `paper` does not use them.
    #[inline(always)]
    pub(crate) fn new(settings: &Settings, gamma: f64) -> Self {
        Self {
            friction: gamma * settings.compensation.friction,
            damping: gamma * settings.compensation.damping,
            speed: settings.paper_options.friction_speed,
        }
    }
}

/// Returns the feed-forward [N·m] of joints that carry the torque `load` [N·m]:
/// `γ (b_f (τ_f + s τ_s + (μ + s μ_s) |load|) tanh(v/v₀) + b_d d v)`. The Stribeck friction τ_s, μ_s fades with the speed:
/// `s = 1/(1 + x + x²)`, `x = |v|/v_s`. In `tanh(v/v₀)`, `toward` replaces v, because the velocity of a joint that sticks
/// has no direction.
#[inline(always)]
pub(crate) fn feed_forward<J: JointVector>(
    [v, toward]: [J; 2],
    load: J,
    servos: &ServoArrays,
    friction_gains: FrictionGains,
) -> J {
    let one = J::splat(1.0);
    let x = J::abs(v) * J::load(&servos.inv_stribeck_speed);
    let at_rest = one / J::fma(x, x, one + x);
    let direction = tanh::<J>(toward * J::splat(1.0 / friction_gains.speed)) * J::splat(friction_gains.friction);
    let dry = J::fma(at_rest, J::load(&servos.stribeck), J::load(&servos.friction));
    let per_load = J::fma(at_rest, J::load(&servos.load_stribeck), J::load(&servos.load_friction));
    let damping = J::load(&servos.damping) * v * J::splat(friction_gains.damping);
    J::fma(per_load * direction, J::abs(load), J::fma(dry, direction, damping))
}

/// Share of the feed-forward of estimated friction and damping that follows the measured velocity; the rest follows that
/// of the reference. The torque of the servos may be twice the requested one, or the friction half the estimate: the
/// whole feed-forward would drive joints that move, and the arm would oscillate.
pub(crate) const MEASURED_SHARE: f64 = 0.5;
