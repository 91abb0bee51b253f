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

/// Share of the feed-forward of estimated friction and damping that follows the measured velocity; the rest follows the
/// reference and, at rest, the law's torque. The torque of the servos may be twice the requested one, or the friction
/// half the estimate: the whole feed-forward would drive joints that move, and the arm would oscillate.
pub(crate) const MEASURED_SHARE: f64 = 0.5;

/// Joint speed at which the feed-forward for joints at rest has faded to a half [rad/s].
const BREAKAWAY_SPEED: f64 = 0.1;
/// Largest ratio of a torque to the friction in [`breakaway`]: its tanh is 1, and a joint without friction has none.
const MAX_RATIO: f64 = 20.0;

/// Returns the joint speeds [rad/s] toward which friction is compensated on joints that the law drives with the torque
/// `drive` [N·m] at the velocity v: `v₀ drive/τ_f / (1 + (v/0.1 rad/s)²)`. The law's torque has the sign of the deviation,
/// so it starts a joint that sticks, but adds no energy to one that oscillates.
#[inline(always)]
pub(crate) fn breakaway<J: JointVector>(v: J, drive: J, servos: &ServoArrays, friction_gains: FrictionGains) -> J {
    let (one, friction) = (J::splat(1.0), J::load(&servos.friction));
    let ratio = drive / J::max(friction, J::splat(f64::MIN_POSITIVE));
    let x = v * J::splat(1.0 / BREAKAWAY_SPEED);
    J::clamp_abs(ratio, J::splat(MAX_RATIO)) * J::splat(friction_gains.speed) / J::fma(x, x, one)
}
