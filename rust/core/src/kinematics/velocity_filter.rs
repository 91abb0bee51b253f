//! Joint velocity from measured positions: line 1 of the control step.

use crate::math::simd::{JointVector, NEGLIGIBLE, SingleArmJoints};
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
    pub(crate) backlash_output: JointVec,
    /// Filtered velocity [rad/s].
    pub(crate) velocity: JointVec,
}

impl VelocityFilter {
    /// At rest in `q`.
    pub(crate) fn new(q: &JointVec) -> Self {
        Self { backlash_output: *q, velocity: [0.0; MAX_JOINTS] }
    }

    /// Filters one reading `q`, `dt` [s] after the last; `count` is the backlash on each side, `time_constant` T_f [s].
    #[inline(always)]
    pub(crate) fn update<J: JointVector>(&self, q: J, count: J, time_constant: f64, dt: f64) -> Filtered<J> {
        let (share, per_second) = (J::splat(dt / (time_constant + dt)), J::splat(1.0 / dt));
        let (before, velocity) = (J::load(&self.backlash_output), J::load(&self.velocity));
        let backlash_output = J::min(J::max(before, q - count), q + count);
        // No joint is faster: with a tiny dt the filter must not store an infinity.
        let raw = J::clamp_abs((backlash_output - before) * per_second, J::splat(SPEED_BOUND));
        let velocity = J::fma(share, raw - velocity, velocity);
        let zero = J::splat(0.0);
        Filtered { backlash_output, velocity: J::select_lt(J::abs(velocity), J::splat(NEGLIGIBLE), zero, velocity) }
    }

    /// Stores the new state.
    #[inline(always)]
    pub(crate) fn set<J: SingleArmJoints>(&mut self, filtered: Filtered<J>) {
        filtered.backlash_output.store(&mut self.backlash_output);
        filtered.velocity.store(&mut self.velocity);
    }
}

/// New state of the filter.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Filtered<J> {
    pub(crate) backlash_output: J,
    pub(crate) velocity: J,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::simd::{JointVec16, RealOps};

    #[test]
    fn a_toggling_count_gives_no_velocity_and_a_steady_motion_its_velocity() {
        let count = JointVec16::splat(1e-3);
        let mut filter = VelocityFilter::new(&[0.0; MAX_JOINTS]);
        for tick in 0..100 {
            let q = JointVec16::splat(if tick % 2 == 0 { 1e-3 } else { -1e-3 });
            filter.set(filter.update(q, count, 0.02, 0.01));
        }
        assert!(filter.velocity[0].abs() < 1e-9);
        for tick in 0..200 {
            filter.set(filter.update(JointVec16::splat(0.005 * f64::from(tick)), count, 0.02, 0.01));
        }
        assert!((filter.velocity[0] - 0.5).abs() < 1e-9);
        for _ in 0..1000 {
            filter.set(filter.update(JointVec16::splat(1.0), count, 0.02, 0.01));
        }
        assert_eq!(filter.velocity.map(f64::to_bits), [0; MAX_JOINTS], "at rest it would decay to denormal numbers");
    }
}
