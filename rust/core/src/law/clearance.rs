//! The posture lets go of an arm that a push leads against a position limit.
//!
//! A joint at its stop leaves the push to the others, and their way along the axis is then another one: through the null
//! space, away from the posture. A posture that insists is felt along the axis, in guided motion with several times the cap.
//! Without a push it stays: it is what leads a joint away from its stop, as out of the pose in which an arm was folded up.

use crate::JointVec;
use crate::law::inverse::axes;
use crate::number::{Arithmetic, Axes, Joints};
use crate::plan::Plan;
use crate::task::compliance::unit;
use crate::task::wish::Wish;

/// Room [rad] below which the posture lets go, at most; and as a share of the joint's range, for short ones.
const ROOM: (f64, f64) = (0.05, 0.05);

/// Where the posture itself is nearer, it lets go from there on, over no less than this share of that.
const LEAST: f64 = 0.4;

/// Share of that way after which it has let go altogether.
const GONE: f64 = 0.5;

/// Room [rad or m] of each joint below which [`posture_share`] is not one.
pub(crate) fn clearance(lower: &JointVec, upper: &JointVec) -> JointVec {
    std::array::from_fn(|i| ROOM.0.min(ROOM.1 * (upper[i] - lower[i])))
}

/// How much of the posture is held at `q`: 1 clear of all position limits, at `rest`, or without a push; down to 0 where a
/// push has led a joint to its limit.
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

/// Whether a push is felt, from 0 to 1: 1 where an axis that yields is twice the deviation away at which its compliance
/// begins to fall, 0 below that deviation.
#[inline(always)]
fn pushed<W: Axes<One: Arithmetic<Real = f64>>>(plan: &Plan, wish: &Wish<W>) -> f64 {
    let slope = W::constant(&plan.lanes.push_slope);
    let felt = unit::<W>(W::fma(W::abs(wish.deviation), slope, W::splat(-1.0))) * wish.softness;
    axes(felt).into_iter().fold(0.0, f64::max)
}

/// Share of the posture that a stop takes away over whose distance `room` is left: none from where the posture itself is,
/// so that nothing changes `at_rest`.
#[inline(always)]
fn gone<J: Joints>(room: J, at_rest: J, clear: J) -> J {
    let width = J::at_most(J::at_least(at_rest, J::splat(LEAST) * clear), clear);
    (J::at_most(at_rest, width) - room) / (J::splat(GONE) * width)
}
