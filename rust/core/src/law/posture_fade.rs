//! Fades out the posture task of the null space when a push leads a joint toward its position limit.
//!
//! With a joint at its stop, the other joints follow the push through the null space, away from the posture. A full
//! posture task would then be felt along the axis, in guided motion as several times the cap. Without a push the
//! posture task stays: it leads joints away from their stops, for example out of a folded pose.

use crate::math::rows::axes;
use crate::math::simd::{Arithmetic, Axes, Joints};
use crate::params::Plan;
use crate::task::compliance::unit;
use crate::task::demand::Wish;

/// If the posture itself is nearer to the limit, the fade begins at its distance, at least at this share of the
/// distance above.
const LEAST: f64 = 0.4;

/// Share of that distance after which the posture task is zero.
const GONE: f64 = 0.5;

/// Returns the factor on the posture task at `q`: 1 away from all position limits, at `rest`, or without a push; down
/// to 0 where a push has led a joint to its limit.
#[inline(always)]
pub(crate) fn posture_share<J: Joints>(plan: &Plan, q: J, rest: J, wish: &Wish<J::Axes>) -> f64 {
    let (lower, upper, clear) = (J::load(&plan.lower), J::load(&plan.upper), J::load(&plan.clearance));
    let (below, above) = (q - lower, upper - q);
    if !J::at_most(below, above).any_less(clear) {
        return 1.0;
    }
    let missing = J::at_least(gone(below, rest - lower, clear), gone(above, upper - rest, clear)).largest();
    if missing > 0.0 { 1.0 - missing.min(1.0) * pushed(plan, wish) } else { 1.0 }
}

/// Returns how far the arm is pushed, 0 to 1: 0 below the deviation at which the compliance of a yielding axis begins
/// to fall, 1 at twice that deviation.
#[inline(always)]
fn pushed<W: Axes<One: Arithmetic<Real = f64>>>(plan: &Plan, wish: &Wish<W>) -> f64 {
    let slope = W::constant(&plan.lanes.push_slope);
    let felt = unit::<W>(W::fma(W::abs(wish.deviation), slope, W::splat(-1.0))) * wish.softness;
    axes(felt).into_iter().fold(0.0, f64::max)
}

/// Returns the share of the posture task that a stop at distance `room` removes: zero at the distance `at_rest` of the
/// posture itself, so that the fade changes nothing there.
#[inline(always)]
fn gone<J: Joints>(room: J, at_rest: J, clear: J) -> J {
    let width = J::at_most(J::at_least(at_rest, J::splat(LEAST) * clear), clear);
    (J::at_most(at_rest, width) - room) / (J::splat(GONE) * width)
}
