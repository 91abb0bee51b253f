//! Joint velocity from measured positions.

use crate::math::simd::{JointVector, NEGLIGIBLE};
use crate::{JointVec, MAX_JOINTS};

/// Largest plausible speed of a joint [rad/s, m/s].
pub(crate) const SPEED_BOUND: f64 = 1e3;

/// Joint velocity from measured positions: backlash operator of one encoder step, difference quotient, one-pole filter.
///
/// Without the backlash operator, a reading that toggles between two encoder steps would have a velocity of
/// `encoder_step / (T_f + dt)`. If that exceeds the speed v₀ of the friction feed-forward, the feed-forward would
/// toggle between plus and minus its full value.
#[derive(Debug, Clone, Copy)]
pub(crate) struct VelocityFilter {
    /// Output of the backlash operator [rad].
    pub(crate) backlash_output: JointVec,
    /// Filtered velocity [rad/s].
    pub(crate) velocity: JointVec,
}

impl VelocityFilter {
    /// Creates a filter at rest at `q` [rad].
    pub(crate) fn new(q: &JointVec) -> Self {
        Self { backlash_output: *q, velocity: [0.0; MAX_JOINTS] }
    }

    /// Returns the filter's state after a reading `q` [rad], `dt` [s] after the last one. `encoder_step` [rad] is the
    /// half-width of the backlash operator, which hides the encoder's counts; `time_constant` is T_f of the low-pass
    /// [s].
    #[inline(always)]
    pub(crate) fn update<J: JointVector>(&self, q: J, encoder_step: J, time_constant: f64, dt: f64) -> Filtered<J> {
        let (share, per_second) = (J::splat(dt / (time_constant + dt)), J::splat(1.0 / dt));
        let (before, velocity) = (J::load(&self.backlash_output), J::load(&self.velocity));
        let backlash_output = J::min(J::max(before, q - encoder_step), q + encoder_step);
        // Bounded, because the quotient can be infinite for a tiny `dt`, and an infinity would stay in the filter.
        let raw = J::clamp_abs((backlash_output - before) * per_second, J::splat(SPEED_BOUND));
        let velocity = J::fma(share, raw - velocity, velocity);
        let zero = J::splat(0.0);
        Filtered { backlash_output, velocity: J::select_lt(J::abs(velocity), J::splat(NEGLIGIBLE), zero, velocity) }
    }

    /// Stores the state that [`VelocityFilter::update`] returned.
    #[inline(always)]
    pub(crate) fn set<J: JointVector>(&mut self, filtered: Filtered<J>) {
        filtered.backlash_output.store(&mut self.backlash_output);
        filtered.velocity.store(&mut self.velocity);
    }
}

/// State of the filter after a reading.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Filtered<J> {
    /// Output of the backlash operator [rad].
    pub(crate) backlash_output: J,
    /// Filtered velocity [rad/s].
    pub(crate) velocity: J,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::simd::{JointVec16, RealOps};

    #[test]
    fn a_toggling_count_gives_no_velocity_and_a_steady_motion_its_velocity() {
        let encoder_step = JointVec16::splat(1e-3);
        let mut filter = VelocityFilter::new(&[0.0; MAX_JOINTS]);
        for tick in 0..100 {
            let q = JointVec16::splat(if tick % 2 == 0 { 1e-3 } else { -1e-3 });
            filter.set(filter.update(q, encoder_step, 0.02, 0.01));
        }
        assert!(filter.velocity[0].abs() < 1e-9);
        for tick in 0..200 {
            filter.set(filter.update(JointVec16::splat(0.005 * f64::from(tick)), encoder_step, 0.02, 0.01));
        }
        assert!((filter.velocity[0] - 0.5).abs() < 1e-9);
        for _ in 0..1000 {
            filter.set(filter.update(JointVec16::splat(1.0), encoder_step, 0.02, 0.01));
        }
        assert_eq!(filter.velocity.map(f64::to_bits), [0; MAX_JOINTS], "at rest it would decay to denormal numbers");
    }
}
