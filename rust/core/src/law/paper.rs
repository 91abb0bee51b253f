//! Law `paper`: velocity-based task-space control with torque budgets, equations (3)–(11).

use crate::law::activation::{Activation, null_column};
use crate::law::cap::Demand;
use crate::law::nullspace::NullSpace;
use crate::law::scaling::scale_to_fit;
use crate::law::wrench::Wrench;
use crate::law::{Motion, Tick};
use crate::math::ldlt6::Factor;
use crate::math::rows::{axes, damped, diagonal, transpose_times, weighted_gram, wide};
use crate::math::simd::{Arithmetic, Axes, Lanes};
use crate::params::{Follow, Law, Plan, Projector};
use crate::{MAX_AXES, MAX_JOINTS};

/// Clamps the task step to the budgets: `|s_j| ≤ τ_j / Σ_i k_i |J⁺_ij|`.
///
/// Joint limits alone do not keep the direction of the motion. The same budget on the goal keeps the signs of `J⁺`, so
/// that (8) and (9) act on one axis alone.
#[inline(always)]
fn within_budget<J: Lanes>(pinv_transposed: &[J; MAX_AXES], step: J::Axes, budget: J::Axes, kp: J) -> J::Axes {
    let (zero, mut cost) = (J::splat(0.0), [J::splat(0.0); MAX_AXES]);
    for r in 0..MAX_AXES {
        cost[r] = kp * J::abs(pinv_transposed[r]);
    }
    let [a, b, c, d] = J::sums([cost[0], cost[1], cost[2], cost[3]]);
    let [e, f, ..] = J::sums([cost[4], cost[5], zero, zero]);
    let cost = J::Axes::at_least(wide(&[a, b, c, d, e, f]), J::Axes::splat(f64::MIN_POSITIVE));
    J::Axes::clip(step, budget / cost)
}

/// Lead of the goals with yielding rows removed from the inverse kinematics [rad]:
/// `K_p⁻¹ J_rᵀ (C_rr + λ²/k̄)⁻¹ s_r + Σ_S K_p⁻¹ J_jᵀ κ_j s_j` with `κ_j = [(C + λ²/k̄)⁻¹]_jj`.
#[inline(always)]
fn free_lead<J: Lanes>(tick: &Tick<'_, J>, step: J::Axes) -> J {
    let compliance = J::load(&tick.plan.servos.compliance);
    let c = weighted_gram(tick.rows, compliance);
    let demand = Demand {
        compliance: &c,
        damping: tick.plan.per_stiffness(tick.damping),
        step,
        bounded_step: step,
        softness: tick.wish.softness,
        cap: tick.wish.strength,
    };
    let factor = Factor::new::<J::One>(&damped(c, &axes(demand.damping)));
    let soft = demand.softness * wide(&factor.inverse_diagonal::<J::One>()) * step;
    compliance * transpose_times(tick.rows, &(demand.stiff_force() + soft).axes())
}

/// Lead [rad] that keeps the stiff axes at the velocity of their reference.
#[inline(always)]
fn pacing_lead<J: Lanes>(tick: &Tick<'_, J>) -> J {
    let compliance = J::load(&tick.plan.servos.compliance);
    let own = diagonal(&weighted_gram(tick.rows, compliance));
    compliance * transpose_times(tick.rows, &tick.paced(own).0.axes())
}

/// Lead of the goals under law `paper`, `h K_q (J⁺Δx − α N∇g)`, and the joint budgets τ^q of (11).
///
/// With `budget_on_goal` each axis' step is clamped to its τ^x.
#[inline(always)]
pub(crate) fn motion<J: Lanes>(tick: &Tick<'_, J>) -> (Motion<J>, J) {
    let (plan, damped) = (tick.plan, damped_space(tick));
    let pinv = damped.pseudo_inverse();
    let mut step = tick.wish.bounded;
    if plan.budget_on_goal {
        step = within_budget(&pinv, step, tick.wish.most, J::load(&plan.servos.kp));
    }
    let task = match plan.follow {
        Follow::Hold => transpose_times(&pinv, &step.axes()),
        Follow::Free => free_lead(tick, step),
    };
    let task = if plan.pace.on { task + pacing_lead(tick) } else { task };
    let (null_space, along) = match plan.projector {
        Projector::Paper => (damped, damped.project_by(&pinv, tick.gradient)),
        Projector::Exact => {
            let exact = tick.null_space();
            (exact, exact.project(tick.gradient))
        }
    };
    within_limits(tick, &pinv, task, &null_space, along)
}

/// Returns true if the settings select the law as published, without the additions of this package.
pub(crate) fn is_printed(plan: &Plan) -> bool {
    plan.law == Law::Paper
        && plan.follow == Follow::Hold
        && plan.projector == Projector::Paper
        && !plan.budget_on_goal
        && !plan.follows_sigma
}

/// [`motion`] as published.
#[inline(always)]
pub(crate) fn printed<J: Lanes>(tick: &Tick<'_, J>) -> (Motion<J>, J) {
    let damped = damped_space(tick);
    let pinv = damped.pseudo_inverse();
    let task = transpose_times(&pinv, &tick.wish.bounded.axes());
    within_limits(tick, &pinv, task, &damped, damped.project_by(&pinv, tick.gradient))
}

/// Returns the null space for the damped pseudo-inverse of (3).
#[inline(always)]
fn damped_space<'a, J: Lanes>(tick: &Tick<'a, J>) -> NullSpace<'a, J> {
    let plan = tick.plan;
    NullSpace::new(tick.rows, J::load(&plan.inverse_weight), &axes(tick.damping), (plan.k, plan.n))
}

/// Limits the motion of `task` and of `along` in the null space [rad] to the speed limits; also returns the budgets of
/// (11).
#[inline(always)]
fn within_limits<J: Lanes>(
    tick: &Tick<'_, J>,
    pinv: &[J; MAX_AXES],
    task: J,
    null_space: &NullSpace<'_, J>,
    along: J,
) -> (Motion<J>, J) {
    let (plan, h) = (tick.plan, tick.horizon);
    let (lead, null) = (gained(plan, task), gained(plan, along * J::splat(-plan.alpha * h)));
    let null = plan.bound_null_speed(null, h);
    let [null_factor, task_factor] = scale_to_fit(J::splat(0.0), [null, lead], plan.reach(h));
    let null_shares = if plan.k < plan.n { null_column(along, null_space) } else { J::splat(0.0) };
    let budget = Activation::new(pinv, null_shares).distribute(tick.wish.most, plan.null_torque);
    let motion = Motion {
        lead: lead * J::spread(task_factor),
        force_lead: J::splat(0.0),
        null: null * J::spread(null_factor),
        wrench: Wrench::none(),
        factors: [null_factor, task_factor, task_factor],
        feed_forward: J::splat(0.0),
        gain_factor: J::One::splat(1.0),
    };
    (motion, budget)
}

/// `K_q v`.
#[inline(always)]
fn gained<J: Lanes>(plan: &Plan, v: J) -> J {
    if let Some(gain) = plan.kq_scalar {
        return v * J::splat(gain);
    }
    let (values, mut out) = (v.array(), J::splat(0.0));
    for i in 0..plan.n.min(MAX_JOINTS) {
        out = J::fma(J::load(&plan.kq_columns[i]), J::spread(values[i]), out);
    }
    out
}
