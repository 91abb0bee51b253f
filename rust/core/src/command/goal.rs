//! Goals: scaling of parts, joints at their position limits, slew.

use crate::MAX_AXES;
use crate::command::torque_limit::Load;
use crate::law::{Motion, Tick};
use crate::math::rows::transpose_times;
use crate::math::simd::{Arithmetic, Axes, Lanes, Scalar};
use crate::params::{Law, Plan, Settings};
use crate::task::Seen;
use crate::task::demand::Wish;

/// Distance beyond a position limit [rad] over which an outward lead fades to zero, if the delay allows that slope.
const STOP_WIDTH: f64 = 0.02;

/// Fades the outward part of a `lead` [rad] that exerts a force, for joints at `q` beyond their limits.
///
/// The goal may exceed the limit, otherwise a joint at its stop could exert no torque. But it must not push the joint
/// itself farther out. `slope` is the largest reduction per rad: a stiffer stop rings with the delay.
#[inline(always)]
pub(crate) fn fade_beyond<J: Lanes>(lead: J, q: J, lower: J, upper: J, slope: f64) -> J {
    let zero = J::splat(0.0);
    let beyond = J::at_least(J::if_less(zero, lead, q - upper, lower - q), zero);
    let size = J::abs(lead);
    let faded = J::fnma(J::at_most(size / J::splat(STOP_WIDTH), J::splat(slope)), beyond, size);
    J::copy_sign(J::at_least(faded, zero), lead)
}

/// Largest lead [rad] under law `paper` without known servos.
const LEAD_UNKNOWN: f64 = 0.3;

/// Result of the law.
#[derive(Clone, Copy)]
pub(crate) struct Solution<J: Lanes> {
    pub(crate) motion: Motion<J>,
    /// τ^q of (11) [N·m]; `None` under laws whose torque limits do not use it.
    pub(crate) budget: Option<J>,
    /// Part of the goals that moves the arm, before the slew [rad]; it stays within the position limits.
    pub(crate) moving: J,
    /// Part of the goals that exerts a force; it may exceed the position limits [rad].
    pub(crate) beside: J,
    /// Part of the goals that carries gravity [rad].
    pub(crate) weight: J,
    pub(crate) feed_forward: J,
}

impl<J: Lanes> Solution<J> {
    /// Lines 7 to 11 from the law's result, as if no joint had a position limit.
    #[inline(always)]
    pub(crate) fn new(
        plan: &Plan,
        tick: &Tick<'_, J>,
        seen: &Seen<'_, J>,
        (motion, budget): (Motion<J>, Option<J>),
    ) -> Self {
        let (kp, compliance) = (J::load(&plan.servos.kp), J::load(&plan.servos.compliance));
        let (mut force_lead, mut resistance) = (motion.force_lead, motion.feed_forward);
        // Both are zero under law `paper`.
        if plan.law.by_force() {
            let (lower, upper) = (J::load(&plan.lower), J::load(&plan.upper));
            force_lead = fade_beyond(force_lead, seen.q, lower, upper, plan.stop_slope);
            resistance = fade_beyond(resistance * compliance, seen.q, lower, upper, plan.stop_slope);
        }
        let weight = seen.gravity_in_goal * J::load(&plan.gravity_compliance);
        Self {
            motion: Motion { force_lead, ..motion },
            budget,
            moving: seen.q + tick.integral + motion.lead + motion.null,
            beside: force_lead + resistance + weight,
            weight,
            feed_forward: kp * resistance,
        }
    }

    /// Returns the terms from which line 12 computes the limits under the rule of demand, for measured positions and
    /// the stored lead [rad].
    #[inline(always)]
    pub(crate) fn load(
        &self,
        plan: &Plan,
        settings: &Settings,
        (q, integral): (J, J),
        seen: &Seen<'_, J>,
        wish: &Wish<J::Axes>,
    ) -> Load<J> {
        let motion = &self.motion;
        let wrench = motion.wrench.whole();
        let pull = transpose_times(seen.rows, &wrench.axes());
        // Null-space part, and the joint's part of the wrench that a position limit removed.
        let lead = J::fnma(J::load(&plan.servos.compliance), pull, motion.lead + motion.force_lead + motion.null);
        let ahead = seen.q - q;
        Load {
            gravity: seen.gravity_in_limit,
            feed_forward: self.feed_forward,
            task: transpose_times(seen.rows, &J::Axes::clip(wrench, wish.most).axes()),
            offset: J::load(&plan.servos.kp) * (lead + integral + ahead),
            gravity_scale: settings.paper_options.gravity_scale,
            margin: J::load(&plan.margin),
        }
    }

    /// Returns the goals before the slew [rad]. Under law `paper` they lead no farther than the limits can use.
    #[inline(always)]
    pub(crate) fn goal(&self, plan: &Plan, settings: &Settings, limit: J) -> J {
        let mut goal = self.moving + self.beside;
        if plan.law == Law::Paper {
            let lead = self.motion.lead + self.motion.null;
            goal = goal + (J::clip(lead, lead_limit(plan, settings, limit)) - lead);
        }
        let beyond = J::load(&plan.beyond);
        let (lower, upper) = (J::load(&plan.lower) - beyond, J::load(&plan.upper) + beyond);
        J::at_most(J::at_least(goal, lower), upper)
    }
}

/// Returns the largest lead of the goals under law `paper` [rad]: slightly more than the torque limit can use.
#[inline(always)]
fn lead_limit<J: Lanes>(plan: &Plan, settings: &Settings, limit: J) -> J {
    match settings.paper_options.lead_limit {
        Some(lead) => J::splat(lead),
        None if plan.servos.has_kp => (limit + J::load(&plan.margin)) * J::load(&plan.servos.compliance),
        None => J::splat(LEAD_UNKNOWN),
    }
}

/// Goals of the servos, and their part that carries gravity [rad].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Goals<J> {
    pub(crate) goal: J,
    pub(crate) weight: J,
}

/// Moves the goals from `before` toward `to` by at most `step` [rad] each, all by the same share of the remaining
/// distance; returns that share. Moves their gravity parts toward those of `to` first, each joint independently.
///
/// Independent joint speeds would take the tool off its path, and move it faster than its target. Therefore the joint
/// with the longest distance slows the others. The gravity part does not wait for other joints. A NaN goal stays NaN,
/// so that the step can refuse to send it.
#[inline(always)]
pub(crate) fn slew<J: Lanes>(before: Goals<J>, to: Goals<J>, step: f64) -> (Goals<J>, Scalar<J>) {
    let step = J::splat(step);
    let lift = J::clip(to.weight - before.weight, step);
    let motion = (to.goal - to.weight) - (before.goal - before.weight);
    let (way, room) = (J::abs(motion), step - J::abs(lift));
    let mut share = J::One::splat(1.0);
    if room.any_less(way) {
        let missing = J::if_less(room, way, J::splat(1.0) - room / way, J::splat(0.0));
        share = share - missing.largest();
    }
    (Goals { goal: before.goal + lift + J::spread(share) * motion, weight: before.weight + lift }, share)
}

/// Joint speeds [rad/s] for the servos' own profiles: the speed at which one joint alone keeps the tool within its
/// `[linear, angular]` speed, but at least the goals' own `slew` [rad/s] and at most the `joint` speed limit.
///
/// Joints that work against each other turn faster than the tool's speed suggests. A profile slower than the goals lags
/// behind them, and the servo then pulls with an unintended lead, on soft axes too. `world` is the Jacobian in base
/// axes.
#[inline(always)]
pub(crate) fn register_speed<J: Lanes>(world: &[J; MAX_AXES], tool: [f64; 2], slew: f64, joint: J) -> J {
    let mut out = J::splat(f64::INFINITY);
    for block in 0..2 {
        if tool[block].is_infinite() {
            continue;
        }
        let [x, y, z] = [world[3 * block], world[3 * block + 1], world[3 * block + 2]];
        let lever = J::sqrt(J::fma(z, z, J::fma(y, y, x * x)));
        out = J::at_most(out, J::splat(tool[block]) / J::at_least(lever, J::splat(1e-9)));
    }
    J::at_most(J::at_least(out, J::splat(slew)), joint)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MAX_JOINTS;
    use crate::math::simd::{Arithmetic, EveryJoint};

    fn vector(values: &[f64]) -> EveryJoint {
        let mut out = [0.0; MAX_JOINTS];
        out[..values.len()].copy_from_slice(values);
        EveryJoint::load(&out)
    }

    fn first(values: EveryJoint) -> f64 {
        values.array()[0]
    }

    /// Returns goals and gravity parts after a slew by at most `step`.
    fn slewed(goal: [f64; 2], weight: [f64; 2], to: [f64; 2], new: [f64; 2], step: f64) -> [[f64; 2]; 2] {
        let goals = |goal: &[f64], weight: &[f64]| Goals { goal: vector(goal), weight: vector(weight) };
        let (out, _) = slew(goals(&goal, &weight), goals(&to, &new), step);
        [out.goal, out.weight].map(|values| [values.array()[0], values.array()[1]])
    }

    fn near(a: [f64; 2], b: [f64; 2]) -> bool {
        a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-14)
    }

    #[test]
    fn goals_keep_their_direction_and_the_gravity_part_moves_first() {
        let none = [0.0; 2];
        let [goal, _] = slewed([0.5, 0.2], none, [2.5, -0.3], none, 0.1);
        assert!(near(goal, [0.6, 0.175]), "a twentieth of the way, for both: {goal:?}");
        let [goal, _] = slewed([0.5, 0.2], none, [2.5, -0.3], none, f64::INFINITY);
        assert!(near(goal, [2.5, -0.3]));
        // The first joint takes up its gravity part; the second moves by the remaining share, which is zero for both.
        let [goal, weight] = slewed(none, none, [0.3, 0.02], [0.3, 0.0], 0.1);
        assert!(near(weight, [0.1, 0.0]) && near(goal, [0.1, 0.02]), "{goal:?} {weight:?}");
        let [goal, weight] = slewed([0.1, 0.0], [0.1, 0.0], [0.35, 0.02], [0.15, 0.0], 0.1);
        assert!(near(weight, [0.15, 0.0]) && near(goal, [0.2, 0.005]), "{goal:?} {weight:?}");
    }

    #[test]
    fn a_goal_that_is_not_finite_stays_so() {
        let none = [0.0; 2];
        assert!(slewed(none, none, [f64::NAN, 0.0], none, 0.1)[0][0].is_nan());
        assert!(slewed(none, none, [0.0, 0.0], [f64::NAN, 0.0], 0.1)[0][0].is_nan());
        assert!(slewed(none, none, [f64::INFINITY, 0.0], none, 0.1)[0].iter().any(|goal| !goal.is_finite()));
    }

    #[test]
    fn an_outward_lead_fades_once_the_joint_is_beyond_its_limit() {
        let at = |lead: f64, q: f64, slope| {
            let [lead, q, one] = [lead, q, 1.0].map(EveryJoint::splat);
            first(fade_beyond(lead, q, -one, one, slope))
        };
        for q in [-0.5, 1.0, -7.0] {
            assert!((at(0.1, q, 2.0) - 0.1).abs() < 1e-15, "inward or inside: untouched");
        }
        assert!((at(0.1, 1.02, 2.0) - 0.06).abs() < 1e-15 && (at(-0.1, -1.02, 2.0) + 0.06).abs() < 1e-15);
        assert!((at(0.01, 1.01, 2.0) - 0.005).abs() < 1e-15, "a small one is gone after 0.02 rad");
        assert!(at(0.1, 1.5, 2.0).abs() < 1e-15 && (at(0.1, 1.5, 0.0) - 0.1).abs() < 1e-15);
        assert!(at(f64::NAN, 1.5, 2.0).is_nan());
    }

    #[test]
    fn profile_speeds_lie_between_goal_slew_and_joint_speed() {
        let world = [0.5, 0.0, 0.0, 0.0, 0.0, 0.1].map(EveryJoint::splat);
        let at = |tool, slew, joint| first(register_speed(&world, tool, slew, EveryJoint::splat(joint)));
        for (tool, slew, joint, expected) in [
            ([0.25, 1.0], 0.1, 3.0, 0.5),
            ([5.0, 0.2], 0.1, 3.0, 2.0),
            ([0.25, 1.0], 1.0, 3.0, 1.0),
            ([0.25, 1.0], 1.0, 0.8, 0.8),
            ([f64::INFINITY; 2], 1.0, 3.0, 3.0),
        ] {
            assert!((at(tool, slew, joint) - expected).abs() < 1e-12, "{tool:?} {slew} {joint}");
        }
    }
}
