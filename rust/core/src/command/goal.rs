//! Goals: scaling of parts, joints at their position limits, slew.

use crate::{JointVec, MAX_JOINTS, Rows};

/// Factors in [0, 1], one per part, so that `|base + Σ f_p part_p| ≤ bound` for every joint.
///
/// Parts give way in their order: the second is scaled only when the first, gone altogether, was not enough.
#[inline(always)]
pub(crate) fn scale_to_fit<const P: usize>(
    base: &JointVec,
    parts: [&JointVec; P],
    bound: &JointVec,
    n: usize,
) -> [f64; P] {
    // Nearly always everything fits: that is found out without a branch per joint.
    let mut beyond = false;
    for i in 0..n.min(MAX_JOINTS) {
        let mut all = base[i];
        for part in parts {
            all += part[i];
        }
        beyond |= all.abs() > bound[i];
    }
    if beyond { shrink(base, parts, bound, n) } else { [1.0; P] }
}

#[inline(never)]
fn shrink<const P: usize>(base: &JointVec, parts: [&JointVec; P], bound: &JointVec, n: usize) -> [f64; P] {
    let mut factors = [1.0; P];
    for p in 0..P {
        let mut least: f64 = 1.0;
        let mut fits = true;
        for i in 0..n.min(MAX_JOINTS) {
            let mut others = base[i];
            for o in 0..P {
                if o != p {
                    others += factors[o] * parts[o][i];
                }
            }
            let part = parts[p][i];
            let all = others + part;
            // A part that moves this joint by no more than rounding cannot mend it and must not vanish for it; nor may
            // it for a sum that the part before has brought to the bound up to rounding.
            let rounding = 1e-9 * bound[i];
            if all.abs() > bound[i] + rounding {
                fits = false;
                if part.abs() > rounding {
                    let edge = bound[i].copysign(all);
                    least = least.min(((edge - others) / part).clamp(0.0, 1.0));
                }
            }
        }
        if fits {
            break;
        }
        factors[p] = least;
    }
    factors
}

/// How far beyond its position limit [rad] a joint still pushes outward, where the delay lets it fade that fast.
const STOP_WIDTH: f64 = 0.02;

/// A `lead` [rad] that serves a force, of a joint at `q`: what points out of the limits shrinks once q is beyond them.
///
/// It may pass the limit, for a joint at its stop could not exert a torque otherwise; but nothing is to push the joint
/// itself farther out. `slope` is by how much it shrinks per rad at most: a stop stiffer than that rings with the delay.
#[inline(always)]
pub(crate) fn fade_beyond(lead: f64, q: f64, lower: f64, upper: f64, slope: f64) -> f64 {
    let beyond = at_least(if lead > 0.0 { q - upper } else { lower - q }, 0.0);
    let size = lead.abs();
    at_least(size - at_most(size / STOP_WIDTH, slope) * beyond, 0.0).copysign(lead)
}

/// Finds joints that are to move beyond a position limit, and the lead that brings them onto the limit.
///
/// Returns whether a joint was added to `locked`. A locked joint keeps the lead it still has and the others take over what
/// it cannot do, so that the rest of the task stays right; it is not unlocked within a tick.
#[inline(always)]
pub(crate) fn lock(
    goal: &JointVec,
    without_lead: &JointVec,
    lower: &JointVec,
    upper: &JointVec,
    locked: &mut [bool; MAX_JOINTS],
    fixed_lead: &mut JointVec,
    n: usize,
) -> bool {
    let mut added = false;
    for i in 0..n.min(MAX_JOINTS) {
        if !locked[i] && (goal[i] > upper[i] || goal[i] < lower[i]) {
            locked[i] = true;
            fixed_lead[i] = goal[i].clamp(lower[i], upper[i]) - without_lead[i];
            added = true;
        }
    }
    added
}

/// Moves the goals from `before` toward `to` by at most `step` [rad] each, all by the same share of what is left, and
/// their `weight` toward that of `to`, each by itself and first; returns the new weight.
///
/// Joints that went each as far as they may would take the tool off its path, and faster than its target moves: one that
/// has farthest to go holds the others up. What carries the arm waits for nobody.
/// A `to` that is not a number stays one, so that the step can refuse to send it.
#[inline(always)]
pub(crate) fn slew(
    before: (&JointVec, &JointVec),
    to: &mut JointVec,
    weight: &JointVec,
    step: f64,
    n: usize,
) -> JointVec {
    let (mut carried, mut motion, mut share) = (*before.1, [0.0; MAX_JOINTS], 1.0);
    for i in 0..n.min(MAX_JOINTS) {
        let lift = clip(weight[i] - before.1[i], step);
        carried[i] += lift;
        motion[i] = (to[i] - weight[i]) - (before.0[i] - before.1[i]);
        let (way, room) = (motion[i].abs(), step - lift.abs());
        share = at_most(share, if way > room { room / way } else { 1.0 });
    }
    for i in 0..n.min(MAX_JOINTS) {
        to[i] = before.0[i] + (carried[i] - before.1[i]) + share * motion[i];
    }
    carried
}

/// The larger of two numbers; NaN where `value` is.
#[inline(always)]
pub(crate) fn at_least(value: f64, bound: f64) -> f64 {
    if value < bound { bound } else { value }
}

/// The smaller of two numbers; NaN where `value` is.
#[inline(always)]
pub(crate) fn at_most(value: f64, bound: f64) -> f64 {
    if value > bound { bound } else { value }
}

/// `value` within ± `most`; NaN where `value` is, and no panic where `most` is.
#[inline(always)]
pub(crate) fn clip(value: f64, most: f64) -> f64 {
    at_most(at_least(value, -most), most)
}

/// Joint speeds [rad/s] that keep the tool within its `[linear, angular]` speed by one joint alone, and the joint's own.
#[inline(always)]
pub(crate) fn register_speed(world: &Rows, tool: [f64; 2], joint: &JointVec, n: usize) -> JointVec {
    let mut out = *joint;
    for i in 0..n.min(MAX_JOINTS) {
        let squared = |from: usize| {
            world[from][i] * world[from][i]
                + world[from + 1][i] * world[from + 1][i]
                + world[from + 2][i] * world[from + 2][i]
        };
        let most = |speed: f64, squared: f64| speed / at_least(squared.sqrt(), 1e-9);
        out[i] = at_most(at_most(joint[i], most(tool[0], squared(0))), most(tool[1], squared(3)));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vector(values: &[f64]) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        out[..values.len()].copy_from_slice(values);
        out
    }

    #[test]
    fn the_first_part_gives_way_first() {
        let base = vector(&[1.0, 0.0]);
        let (soft, stiff, bound) = (vector(&[4.0, 1.0]), vector(&[6.0, 1.0]), vector(&[9.0, 9.0]));
        let factors = |bound: &JointVec| scale_to_fit(&base, [&soft, &stiff], bound, 2).map(f64::to_bits);
        assert_eq!(factors(&bound), [0.5, 1.0].map(f64::to_bits));
        let bound = vector(&[4.0, 9.0]);
        assert_eq!(factors(&bound), [0.0, 0.5].map(f64::to_bits));
        let bound = vector(&[20.0, 9.0]);
        assert_eq!(factors(&bound), [1.0, 1.0].map(f64::to_bits));
    }

    #[test]
    fn a_rounding_error_at_the_bound_takes_nothing_away() {
        let base = vector(&[-4.1, 0.0]);
        for bound in [10.3, 10.7, 9.9, 6.4] {
            for soft in [17.3, 21.9, 30.1] {
                let parts = [&vector(&[soft, 0.0]), &vector(&[1e-17, 3.0])];
                let factors = scale_to_fit(&base, parts, &vector(&[bound, 9.0]), 2);
                assert!((factors[1] - 1.0).abs() < 1e-9, "{factors:?}");
            }
        }
    }

    /// Goals and weights after a slew by at most `step`.
    fn slewed(goal: [f64; 2], weight: [f64; 2], to: [f64; 2], new: [f64; 2], step: f64) -> [[f64; 2]; 2] {
        let mut out = vector(&to);
        let carried = slew((&vector(&goal), &vector(&weight)), &mut out, &vector(&new), step, 2);
        [[out[0], out[1]], [carried[0], carried[1]]]
    }

    fn near(a: [f64; 2], b: [f64; 2]) -> bool {
        a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-14)
    }

    #[test]
    fn goals_keep_their_direction_and_the_weight_comes_first() {
        let none = [0.0; 2];
        let [goal, _] = slewed([0.5, 0.2], none, [2.5, -0.3], none, 0.1);
        assert!(near(goal, [0.6, 0.175]), "a twentieth of the way, for both: {goal:?}");
        let [goal, _] = slewed([0.5, 0.2], none, [2.5, -0.3], none, f64::INFINITY);
        assert!(near(goal, [2.5, -0.3]));
        // The first joint takes up its weight; the second moves on with what is left to neither.
        let [goal, weight] = slewed(none, none, [0.3, 0.02], [0.3, 0.0], 0.1);
        assert!(near(weight, [0.1, 0.0]) && near(goal, [0.1, 0.02]), "{goal:?} {weight:?}");
        let [goal, weight] = slewed([0.1, 0.0], [0.1, 0.0], [0.35, 0.02], [0.15, 0.0], 0.1);
        assert!(near(weight, [0.15, 0.0]) && near(goal, [0.2, 0.005]), "{goal:?} {weight:?}");
    }

    #[test]
    fn what_is_not_a_number_is_not_hidden() {
        let none = [0.0; 2];
        assert!(slewed(none, none, [f64::NAN, 0.0], none, 0.1)[0][0].is_nan());
        assert!(slewed(none, none, [0.0, 0.0], [f64::NAN, 0.0], 0.1)[0][0].is_nan());
        assert!(slewed(none, none, [f64::INFINITY, 0.0], none, 0.1)[0].iter().any(|goal| !goal.is_finite()));
    }

    #[test]
    fn a_force_leads_beyond_the_limit_but_not_the_joint() {
        let at = |lead, q, slope| fade_beyond(lead, q, -1.0, 1.0, slope);
        for q in [-0.5, 1.0, -7.0] {
            assert!((at(0.1, q, 2.0) - 0.1).abs() < 1e-15, "inward or inside: untouched");
        }
        assert!((at(0.1, 1.02, 2.0) - 0.06).abs() < 1e-15 && (at(-0.1, -1.02, 2.0) + 0.06).abs() < 1e-15);
        assert!((at(0.01, 1.01, 2.0) - 0.005).abs() < 1e-15, "a small one is gone after 0.02 rad");
        assert!(at(0.1, 1.5, 2.0).abs() < 1e-15 && (at(0.1, 1.5, 0.0) - 0.1).abs() < 1e-15);
        assert!(at(f64::NAN, 1.5, 2.0).is_nan());
    }

    #[test]
    fn a_base_beyond_the_bound_leaves_nothing() {
        let factors = scale_to_fit(&vector(&[5.0]), [&vector(&[1.0]), &vector(&[1.0])], &vector(&[2.0]), 1);
        assert_eq!(factors.map(f64::to_bits), [0, 0]);
    }

    #[test]
    fn a_goal_beyond_the_limit_keeps_the_lead_that_is_left() {
        let (mut locked, mut lead) = ([false; MAX_JOINTS], [0.0; MAX_JOINTS]);
        let added =
            lock(&vector(&[1.2]), &vector(&[0.7]), &vector(&[-1.0]), &vector(&[1.0]), &mut locked, &mut lead, 1);
        assert!(added && locked[0] && (lead[0] - 0.3).abs() < 1e-15);
    }
}
