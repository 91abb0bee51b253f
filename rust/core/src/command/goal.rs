//! Goals of the servos: their parts, their bounds at position limits, and their rate limit (slew).

use crate::MAX_AXES;
use crate::command::DEFAULT_OFFSET_LIMIT;
use crate::command::torque_limit::LimitTerms;
use crate::law::{LawInput, LawOutput};
use crate::math::cold;
use crate::math::rows::tr_mul;
use crate::math::simd::{F64x8, JointVector, RealOps};
use crate::params::{Features, Params, Settings};
use crate::task::ArmState;
use crate::task::demand::AxisDemand;

/// Distance beyond a position limit [rad] over which an outward lead fades to zero. The distance is longer if the loop
/// delay requires a smaller slope.
const STOP_WIDTH: f64 = 0.02;

/// Reduces a `lead` [rad] that exerts a force if its joint, at `q`, is beyond a position limit and the lead points
/// farther out.
///
/// The goal may exceed the limit, because a joint at its stop could not exert a torque otherwise, but it must not push
/// the joint farther out. `slope` is the largest reduction per rad beyond the limit; with a steeper one,
/// the joint would oscillate because of the delay.
#[inline(always)]
pub(crate) fn fade_past_limit<J: JointVector>(lead: J, q: J, lower: J, upper: J, slope: f64) -> J {
    let zero = J::splat(0.0);
    let overtravel = J::max(J::select_lt(zero, lead, q - upper, lower - q), zero);
    let size = J::abs(lead);
    let faded = J::fnma(J::min(size / J::splat(STOP_WIDTH), J::splat(slope)), overtravel, size);
    J::copy_sign(J::max(faded, zero), lead)
}

/// Parts of the joint goals, computed from the result of the law.
#[derive(Clone, Copy)]
pub(crate) struct JointTargets<J: JointVector> {
    pub(crate) motion: LawOutput<J>,
    /// Joint torque budgets τ^q [N·m], equation (11) of the paper; `None` under laws other than `paper`.
    pub(crate) budget: Option<J>,
    /// Part of the goals that moves the arm, before the slew [rad]; it stays within the position limits.
    pub(crate) q_goal: J,
    /// Part of the goals that exerts a force; it may exceed the position limits [rad].
    pub(crate) q_force_offset: J,
    /// Part of the goals that holds the arm against gravity [rad].
    pub(crate) q_gravity_offset: J,
    pub(crate) feed_forward: J,
}

impl<J: JointVector> JointTargets<J> {
    /// Computes the parts of the goals from the result of the law, without redistribution at position limits.
    #[inline(always)]
    pub(crate) fn new(
        params: &Params,
        input: &LawInput<'_, J>,
        arm: &ArmState<'_, J>,
        (motion, budget): (LawOutput<J>, Option<J>),
    ) -> Self {
        let (kp, compliance) = (J::load(&params.servos.kp), J::load(&params.servos.compliance));
        let (mut soft_offset, mut friction, mut feed_forward) =
            (motion.soft_offset, motion.feed_forward, motion.feed_forward);
        // Soft offset and friction feed-forward are zero under law `paper`.
        if input.features.law.by_force() {
            let (lower, upper) = (J::load(&params.lower), J::load(&params.upper));
            soft_offset = fade_past_limit(soft_offset, arm.q, lower, upper, params.limit_fade_slope);
            friction = fade_past_limit(friction * compliance, arm.q, lower, upper, params.limit_fade_slope);
            feed_forward = kp * friction;
        }
        let q_gravity_offset = if input.features.gravity {
            let offset = &params.gravity_offset;
            J::fma(arm.gravity_in_goal, J::load(&offset.compliance), J::load(&offset.lead))
        } else {
            J::splat(0.0)
        };
        Self {
            motion: LawOutput { soft_offset, ..motion },
            budget,
            q_goal: arm.q + input.integral + motion.stiff_offset + motion.null,
            q_force_offset: soft_offset + friction + q_gravity_offset,
            q_gravity_offset,
            feed_forward,
        }
    }

    /// Returns the terms of the torque limits at the measured positions `q`, with the lead `integral` that the
    /// integrator has stored [rad].
    #[inline(always)]
    pub(crate) fn limit_terms(
        &self,
        params: &Params,
        settings: &Settings,
        (q, integral): (J, J),
        arm: &ArmState<'_, J>,
        demand: &AxisDemand<J::Axes>,
    ) -> LimitTerms<J> {
        let (motion, wrench) = (&self.motion, self.motion.wrench.total());
        let mut task = motion.torque;
        if J::Axes::any_lt(demand.max_strength, J::Axes::abs(wrench)) {
            cold();
            task = tr_mul(arm.rows, &J::Axes::clamp_abs(wrench, demand.max_strength).to_axes());
        }
        // Subtract the lead that exerts the wrench. The null-space lead remains, less the motion that position limits
        // cut.
        let lead = J::fnma(
            J::load(&params.servos.compliance),
            motion.torque,
            motion.stiff_offset + motion.soft_offset + motion.null,
        );
        let ahead = arm.q - q;
        LimitTerms {
            gravity: arm.gravity_in_limit,
            feed_forward: self.feed_forward,
            task,
            offset: J::load(&params.servos.kp) * (lead + integral + ahead),
            gravity_scale: settings.paper_options.gravity_scale,
            margin: J::load(&params.limit_margin),
        }
    }

    /// Returns the goals before the slew [rad]. Under law `paper` their lead is at most [`lead_limit`].
    #[inline(always)]
    pub(crate) fn goal(&self, params: &Params, settings: &Settings, features: Features, limit: J) -> J {
        let mut goal = self.q_goal + self.q_force_offset;
        if !features.law.by_force() {
            let lead = self.motion.stiff_offset + self.motion.null;
            goal = goal + (J::clamp_abs(lead, lead_limit(params, settings, limit)) - lead);
        }
        let overtravel = J::load(&params.overtravel);
        let (lower, upper) = (J::load(&params.lower) - overtravel, J::load(&params.upper) + overtravel);
        J::min(J::max(goal, lower), upper)
    }
}

/// Returns the largest lead of the goals under law `paper` [rad]: that of the settings, if given; otherwise slightly
/// more than the lead at which a servo reaches its torque limit; [`DEFAULT_OFFSET_LIMIT`] if k_p is unknown.
#[inline(always)]
fn lead_limit<J: JointVector>(params: &Params, settings: &Settings, limit: J) -> J {
    match settings.paper_options.lead_limit {
        Some(lead) => J::splat(lead),
        None if params.servos.has_kp => (limit + J::load(&params.limit_margin)) * J::load(&params.servos.compliance),
        None => J::splat(DEFAULT_OFFSET_LIMIT),
    }
}

/// Goals of the servos [rad], and the part of them that holds the arm against gravity [rad].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Goals<J> {
    pub(crate) goal: J,
    pub(crate) gravity_offset: J,
}

/// Moves each goal from `before` toward `to` by at most `step` [rad]. The gravity parts move first, each joint
/// independently; then all goals move by the same share of the remaining distance. Returns the goals and that share.
///
/// The common share keeps the tool on its path and at the speed of its target: the joint with the longest distance
/// slows the others. A NaN goal stays NaN, so that the step can refuse to send it.
#[inline(always)]
pub(crate) fn slew<J: JointVector>(before: Goals<J>, to: Goals<J>, step: f64) -> (Goals<J>, f64) {
    if step.is_infinite() {
        return (to, 1.0);
    }
    let step = J::splat(step);
    let lift = J::clamp_abs(to.gravity_offset - before.gravity_offset, step);
    let motion = (to.goal - to.gravity_offset) - (before.goal - before.gravity_offset);
    let (distance, room) = (J::abs(motion), step - J::abs(lift));
    let mut share = 1.0;
    if room.is_any_lt(distance) {
        // If the gravity part of a joint uses up its whole step, a remaining motion of the size of rounding errors must not
        // stop the other joints.
        let free = J::max(room, step * J::splat(1e-9));
        let missing = J::select_lt(free, distance, J::splat(1.0) - room / distance, J::splat(0.0));
        share -= missing.max_element();
    }
    (Goals { goal: before.goal + lift + J::splat(share) * motion, gravity_offset: before.gravity_offset + lift }, share)
}

/// Returns the joint speeds [rad/s] for the servos' motion profiles: the speed at which one joint alone keeps the tool
/// within the speeds `tool` [m/s, rad/s], but at least the `slew` of the goals and at most the speed limit `joint`.
///
/// The lower bound `slew` is for joints whose motions cancel at the tool: they may turn faster than the tool's speed
/// suggests. A servo whose profile is slower than its goal lags behind and exerts an unintended force, also on soft
/// axes. `j_base` is the Jacobian in base axes.
#[inline(always)]
pub(crate) fn profile_velocity<J: JointVector>(j_base: &[J; MAX_AXES], tool: [f64; 2], slew: f64, joint: J) -> J {
    let mut out = J::splat(f64::INFINITY);
    for block in 0..2 {
        if tool[block].is_infinite() {
            continue;
        }
        let [x, y, z] = [j_base[3 * block], j_base[3 * block + 1], j_base[3 * block + 2]];
        let lever = J::sqrt(J::fma(z, z, J::fma(y, y, x * x)));
        out = J::min(out, J::splat(tool[block]) / J::max(lever, J::splat(1e-9)));
    }
    J::min(J::max(out, J::splat(slew)), joint)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MAX_JOINTS;
    use crate::math::simd::{JointVec16, RealOps};

    fn vector(values: &[f64]) -> JointVec16 {
        let mut out = [0.0; MAX_JOINTS];
        out[..values.len()].copy_from_slice(values);
        JointVec16::load(&out)
    }

    fn first(values: JointVec16) -> f64 {
        values.to_joints()[0]
    }

    /// Returns goals and gravity offsets of two joints after one call of `slew` with this `step`.
    fn slewed(goal: [f64; 2], gravity_offset: [f64; 2], to: [f64; 2], new: [f64; 2], step: f64) -> [[f64; 2]; 2] {
        let goals =
            |goal: &[f64], gravity_offset: &[f64]| Goals { goal: vector(goal), gravity_offset: vector(gravity_offset) };
        let (out, _) = slew(goals(&goal, &gravity_offset), goals(&to, &new), step);
        [out.goal, out.gravity_offset].map(|values| [values.to_joints()[0], values.to_joints()[1]])
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
        // Joint 0 moves its gravity part by the whole step. The rest of its goal does not change, so joint 1 arrives.
        let [goal, gravity_offset] = slewed(none, none, [0.3, 0.02], [0.3, 0.0], 0.1);
        assert!(near(gravity_offset, [0.1, 0.0]) && near(goal, [0.1, 0.02]), "{goal:?} {gravity_offset:?}");
        let [goal, gravity_offset] = slewed([0.1, 0.0], [0.1, 0.0], [0.35, 0.02], [0.15, 0.0], 0.1);
        assert!(near(gravity_offset, [0.15, 0.0]) && near(goal, [0.2, 0.005]), "{goal:?} {gravity_offset:?}");
    }

    #[test]
    fn a_rounding_error_beside_a_moving_gravity_part_stops_no_other_joint() {
        for noise in [0.0, 1e-17, -1e-15, 1e-13] {
            let [goal, gravity_offset] = slewed([0.0; 2], [0.0; 2], [0.3 + noise, 0.02], [0.3, 0.0], 0.1);
            assert!((gravity_offset[0] - 0.1).abs() < 1e-15 && (goal[1] - 0.02).abs() < 1e-15, "{noise}: {goal:?}");
        }
        // A motion beyond rounding error does stop the other joint.
        let [goal, _] = slewed([0.0; 2], [0.0; 2], [0.3 + 1e-6, 0.02], [0.3, 0.0], 0.1);
        assert!(goal[1].abs() < 1e-15, "{goal:?}");
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
            let [lead, q, one] = [lead, q, 1.0].map(JointVec16::splat);
            first(fade_past_limit(lead, q, -one, one, slope))
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
        let j_base = [0.5, 0.0, 0.0, 0.0, 0.0, 0.1].map(JointVec16::splat);
        let at = |tool, slew, joint| first(profile_velocity(&j_base, tool, slew, JointVec16::splat(joint)));
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
