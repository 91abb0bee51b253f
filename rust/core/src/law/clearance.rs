//! The posture lets go of an arm that a push leads against a position limit.
//!
//! A joint at its stop leaves the push to the others, and their way along the axis is then another one: through the null
//! space, away from the posture. A posture that insists is felt along the axis, in guided motion with several times the cap.

use crate::JointVec;
use crate::number::Joints;
use crate::plan::Plan;

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

/// How much of the posture is held at `q`, from 0 with a joint at its limit to 1 clear of all of them, or at `rest`.
#[inline(always)]
pub(crate) fn posture_share<J: Joints>(plan: &Plan, q: J, rest: &JointVec) -> f64 {
    let room = J::at_most(q - J::load(&plan.lower), J::load(&plan.upper) - q);
    if room.any_less(J::load(&plan.clearance)) { near_a_stop(plan, &q.array(), rest) } else { 1.0 }
}

#[cold]
#[inline(never)]
fn near_a_stop(plan: &Plan, q: &JointVec, rest: &JointVec) -> f64 {
    let mut share: f64 = 1.0;
    for i in 0..plan.n {
        for (room, at_rest) in
            [(q[i] - plan.lower[i], rest[i] - plan.lower[i]), (plan.upper[i] - q[i], plan.upper[i] - rest[i])]
        {
            // From where the posture itself is: at rest nothing changes.
            let width = at_rest.max(LEAST * plan.clearance[i]).min(plan.clearance[i]);
            share = share.min(1.0 - (at_rest.min(width) - room) / (GONE * width));
        }
    }
    share.max(0.0)
}
