//! Feed-forward of friction and damping.

use crate::math::simd::{F64x8, JointVector, RealOps, tanh};
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

/// Feed-forward torque for friction and damping of each joint, as a linear function of the load torque.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FrictionFeedForward<J> {
    /// Part that does not depend on the load [N·m].
    unloaded: J,
    /// Additional torque per N·m of load torque [1].
    per_load: J,
}

impl<J: JointVector> FrictionFeedForward<J> {
    /// Computes `γ (b_f (τ_f + s τ_s) tanh(v/v₀) + b_d d v)` and, per load torque, `γ b_f (μ + s μ_s) tanh(v/v₀)`. The
    /// Stribeck friction τ_s, μ_s fades with the speed: `s = 1/(1 + x + x²)`, `x = |v|/v_s`. In `tanh(v/v₀)`, `toward`
    /// replaces v, because the velocity of a joint that sticks has no direction.
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

/// Share of the feed-forward of estimated friction and damping that is exerted without a force of the law that would
/// stop the joints: the true friction may be half the estimate.
pub(crate) const UNOPPOSED_SHARE: f64 = 0.5;

/// Motion of the joints and of the task axes, and the forces of the law that would stop it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct OpposedMotion<J: JointVector> {
    /// Joint velocity [rad/s].
    pub(crate) joints: J,
    /// Velocity of the task axes [m/s, rad/s].
    pub(crate) axes: J::Axes,
    /// Factor on `axes` that makes translations and rotations comparable.
    pub(crate) row_scale: J::Axes,
    /// Power of the law along each task axis [W]: that of the present force of a yielding axis, which opposes the motion,
    /// and that of the hold of a stiff axis at the velocity of its reference.
    pub(crate) power: J::Axes,
}

impl<J: JointVector> OpposedMotion<J> {
    /// Returns the share of the estimated `feed_forward` [N·m] with which the arm does not move by itself if friction
    /// and damping are half of the estimate: at least [`UNOPPOSED_SHARE`].
    ///
    /// The power of the rest is attributed to the task axes in proportion to their velocities, and each part is at most
    /// the power of the axis' own force. Each axis is compared by itself, because joints that move one axis move others
    /// a little: in a comparison of sums, the force of a stiff axis would permit a feed-forward that drives an axis
    /// without strength.
    #[inline(always)]
    pub(crate) fn share(&self, feed_forward: J) -> f64 {
        let power = (1.0 - UNOPPOSED_SHARE) * J::abs(feed_forward * self.joints).sum();
        let speed = J::Axes::abs(self.axes);
        let scaled = speed * self.row_scale;
        let total: f64 = scaled.to_axes().iter().sum();
        let parts = scaled * J::Axes::splat(power / total.max(f64::MIN_POSITIVE));
        let opposed: f64 = J::Axes::min(parts, self.power).to_axes().iter().sum();
        if opposed < power { UNOPPOSED_SHARE + (1.0 - UNOPPOSED_SHARE) * opposed / power } else { 1.0 }
    }
}
