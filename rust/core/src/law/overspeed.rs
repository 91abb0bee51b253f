//! Reduction of forces that would accelerate a tool that is already too fast.
//!
//! The speed of the reference is bounded, that of the tool along soft axes is not: near a singular pose a slow motion
//! of a stiff axis needs a fast one of the joints, and a soft axis that was far from its target returns under a
//! constant force.

use crate::AxisVec;
use crate::math::cold;
use crate::math::simd::F64x8;
use crate::math::spatial::dot;
use crate::params::OverspeedParams;

/// An axis whose share of the tool's speed is this or more loses its force entirely. Below, the loss is proportional to
/// the share, so that an axis that carries a load keeps its force while a hand moves the tool along another one.
const FULL_SHARE: f64 = 0.1;

/// Factors on the forces of the task axes in one step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Overspeed<W> {
    /// Velocity of the tool along the task axes [m/s, rad/s].
    velocity: W,
    /// Factor, 0 to 1, on a force in the direction of this velocity.
    factor: W,
}

impl<W: F64x8> Overspeed<W> {
    /// Computes the factors for a tool that moves with `twist` (6,) [m/s, rad/s], and along the task axes with
    /// `velocity` [m/s, rad/s]. `None`: no force is to be reduced.
    #[inline(always)]
    pub(crate) fn new(params: &OverspeedParams, twist: &AxisVec, velocity: W) -> Option<Self> {
        let blocks = [[twist[0], twist[1], twist[2]], [twist[3], twist[4], twist[5]]];
        let squared = blocks.map(|v| dot::<W::Elem>(&v, &v));
        let [[linear, _], [angular, _]] = params.ramps;
        if squared[0] <= linear * linear && squared[1] <= angular * angular {
            return None;
        }
        cold();
        let (mut excess, mut fastest) = (0.0_f64, 0.0_f64);
        for (squared, [start, width]) in squared.into_iter().zip(params.ramps) {
            let speed = squared.sqrt();
            excess = excess.max((speed - start) / width);
            fastest = fastest.max(speed / start);
        }
        let share = W::abs(velocity) * W::from_array(&params.per_start) / W::splat(FULL_SHARE * fastest);
        let factor = W::splat(1.0) - W::splat(excess.min(1.0)) * W::min(share, W::splat(1.0));
        Some(Self { velocity, factor })
    }

    /// Returns `force` [N, N·m], reduced on the axes along which it would accelerate the tool.
    #[inline(always)]
    pub(crate) fn limit(&self, force: W) -> W {
        W::select_lt(W::splat(0.0), force * self.velocity, force * self.factor, force)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::simd::{JointVec16, JointVector, RealOps};

    type Axes = <JointVec16 as JointVector>::Axes;

    /// Returns the forces that remain of 10 N along x, y, z, toward + and −, at a velocity (3,) [m/s].
    fn limited(velocity: [f64; 3]) -> [[f64; 3]; 2] {
        let twist = [velocity[0], velocity[1], velocity[2], 0.0, 0.0, 9.0];
        let params = OverspeedParams::new(&[0, 1, 2], [0.25, 1.0]);
        let overspeed = Overspeed::<Axes>::new(&params, &twist, Axes::from_axes(&twist));
        [10.0, -10.0].map(|force| {
            let force = Axes::splat(force);
            let [x, y, z, ..] = overspeed.map_or(force, |o| o.limit(force)).to_axes();
            [x, y, z]
        })
    }

    #[test]
    fn only_forces_that_accelerate_a_tool_beyond_its_speed_limit_are_reduced() {
        let expect = |velocity, plus: [f64; 3], minus: [f64; 3]| {
            for (limited, expected) in limited(velocity).into_iter().flatten().zip([plus, minus].into_iter().flatten())
            {
                assert!((limited - expected).abs() < 1e-9, "{velocity:?}: {limited} instead of {expected} N");
            }
        };
        expect([0.3, 0.1, 0.0], [10.0; 3], [-10.0; 3]);
        expect([0.37, 0.0, 0.0], [5.0, 10.0, 10.0], [-10.0; 3]);
        expect([-0.45, 0.1, 0.0], [10.0, 0.0, 10.0], [0.0, -10.0, -10.0]);
    }

    #[test]
    fn an_axis_that_hardly_moves_keeps_most_of_its_force() {
        let [plus, _] = limited([1.0, 0.02, 0.0]);
        assert!((plus[1] - 8.0).abs() < 1e-3, "{plus:?}");
    }

    #[test]
    fn rotation_counts_only_if_the_task_has_an_axis_of_rotation() {
        let twist = [0.0, 0.0, 0.0, 0.0, 0.0, 9.0];
        let factor = |axes: &[usize]| {
            let params = OverspeedParams::new(axes, [0.25, 1.0]);
            let one = Axes::splat(1.0);
            Overspeed::new(&params, &twist, one).map_or(one, |o| o.limit(one)).to_axes()[0]
        };
        assert!(factor(&[0, 1, 2]) > 0.999 && factor(&[0, 5]) < 1e-9);
    }
}
