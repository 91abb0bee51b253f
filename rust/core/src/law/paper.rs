//! Law `paper`: task-space velocity control with joint torque budgets, equations (3) to (11) of the paper.

use crate::law::activation::{Activation, null_column};
use crate::law::cap::CapProblem;
use crate::law::nullspace::NullSpace;
use crate::law::scaling::scale_to_fit;
use crate::law::wrench::Wrench;
use crate::law::{AxisPush, ControlLaw, LawInput, LawOutput};
use crate::math::ldlt6::Ldlt6;
use crate::math::rows::{damped, diagonal, tr_mul, weighted_gram};
use crate::math::simd::{F64x8, JointVector, RealOps};
use crate::params::{Follow, Projector};
use crate::{MAX_AXES, MAX_JOINTS};

/// Clamps the step of each task axis to its torque budget: `|s_j| ≤ τ_j / Σ_i k_i |J⁺_ij|`.
///
/// A torque limit acts on one joint, so joint torque limits alone would change the direction of the motion. The clamp
/// per axis keeps the direction: the compliance of an axis then affects that axis only.
#[inline(always)]
fn within_budget<J: JointVector>(pinv_transposed: &[J; MAX_AXES], step: J::Axes, budget: J::Axes, kp: J) -> J::Axes {
    let (zero, mut cost) = (J::splat(0.0), [J::splat(0.0); MAX_AXES]);
    for r in 0..MAX_AXES {
        cost[r] = kp * J::abs(pinv_transposed[r]);
    }
    let [a, b, c, d] = J::sum4([cost[0], cost[1], cost[2], cost[3]]);
    let [e, f, ..] = J::sum4([cost[4], cost[5], zero, zero]);
    let cost = J::Axes::max(J::Axes::from_axes(&[a, b, c, d, e, f]), J::Axes::splat(f64::MIN_POSITIVE));
    J::Axes::clamp_abs(step, budget / cost)
}

/// Returns the lead of the goals (goal − q) [rad]. The inverse kinematics contain only the stiff rows r; each yielding
/// row j in S is added: `K_p⁻¹ J_rᵀ (C_rr + λ²/k̄)⁻¹ s_r + Σ_S K_p⁻¹ J_jᵀ κ_j s_j` with `κ_j = [(C + λ²/k̄)⁻¹]_jj`. C,
/// λ²/k̄ and s are those of [`CapProblem`].
#[inline(always)]
fn decoupled_offset<J: JointVector>(input: &LawInput<'_, J>, step: J::Axes) -> J {
    let compliance = J::load(&input.params.servos.compliance);
    let c = weighted_gram(input.rows, compliance);
    let problem = CapProblem {
        compliance: &c,
        damping: input.params.per_stiffness(input.damping),
        step,
        bounded_step: step,
        softness: input.demand.softness,
        cap: input.demand.strength,
    };
    let factor = Ldlt6::new::<J::Elem>(&damped(c, &problem.damping.to_axes()));
    let soft = problem.softness * J::Axes::from_axes(&factor.inverse_diagonal::<J::Elem>()) * step;
    compliance * tr_mul(input.rows, &(problem.stiff_force() + soft).to_axes())
}

/// Returns the additional lead of the goals [rad] that keeps the stiff axes at the velocity of their reference.
#[inline(always)]
fn pacing_offset<J: JointVector>(input: &LawInput<'_, J>) -> J {
    let compliance = J::load(&input.params.servos.compliance);
    let c_diagonal = diagonal(&weighted_gram(input.rows, compliance));
    compliance * tr_mul(input.rows, &input.pacing_force(c_diagonal).0.to_axes())
}

/// Returns the lead of the goals, `K_q (h J⁺Δx − α h N∇g)` [rad], and the joint torque budgets τ^q [N·m] of
/// equation (11) of the paper. K_q is the gain of the joints, h the horizon, Δx the task velocity, α the gain of the
/// null-space motion, N the null-space projector and ∇g the gradient of its cost.
///
/// With `budget_on_goal`, the step of each axis is clamped to its budget τ^x.
#[inline(always)]
pub(crate) fn solve<J: JointVector>(input: &LawInput<'_, J>) -> (LawOutput<J>, J) {
    let params = input.params;
    let (is_variant, size) = (input.features.paper_variants, (params.k, params.n));
    let weight = if is_variant { J::load(&params.joint_weight_inv) } else { J::splat(1.0) };
    let damped = NullSpace::new(input.rows, weight, &input.damping.to_axes(), size);
    let pinv = damped.pseudo_inverse();
    let mut step = input.demand.clamped_displacement;
    if is_variant && params.budget_on_goal {
        step = within_budget(&pinv, step, input.demand.max_strength, J::load(&params.servos.kp));
    }
    let task = match params.follow {
        Follow::Free if is_variant => decoupled_offset(input, step),
        _ => tr_mul(&pinv, &step.to_axes()),
    };
    let task = if input.features.tool_speed && params.pace.on { task + pacing_offset(input) } else { task };
    let (null_space, along) = match params.projector {
        Projector::Exact if is_variant => {
            let exact = input.null_space();
            (exact, exact.project(input.gradient))
        }
        _ => (damped, damped.project_by(&pinv, input.gradient)),
    };
    within_limits(input, &pinv, task, &null_space, along)
}

/// The law `paper`.
pub(crate) struct Paper;

impl ControlLaw for Paper {
    /// Returns ∞, because the budgets bound joint torques, not forces.
    fn force_at(_push: &AxisPush<'_>) -> f64 {
        f64::INFINITY
    }
}

/// Scales the task motion `task` and the null-space motion, `along` [rad] times −α h, to the joint speed limits. Also
/// returns the joint torque budgets τ^q of equation (11) of the paper.
#[inline(always)]
fn within_limits<J: JointVector>(
    input: &LawInput<'_, J>,
    pinv: &[J; MAX_AXES],
    task: J,
    null_space: &NullSpace<'_, J>,
    along: J,
) -> (LawOutput<J>, J) {
    let (params, h) = (input.params, input.horizon);
    let (offset, null) = (gained(input, task), gained(input, along * J::splat(-params.alpha * h)));
    let null = params.bound_null_speed(null, h);
    let [null_factor, task_factor] = scale_to_fit(J::splat(0.0), [null, offset], params.reach(h));
    let null_shares = if params.k < params.n { null_column(along, null_space) } else { J::splat(0.0) };
    let budget = Activation::new(pinv, null_shares).distribute(input.demand.max_strength, params.null_torque);
    let motion = LawOutput {
        stiff_offset: offset * J::splat(task_factor),
        soft_offset: J::splat(0.0),
        null: null * J::splat(null_factor),
        wrench: Wrench::zero(),
        torque: J::splat(0.0),
        factors: [null_factor, task_factor, task_factor],
        feed_forward: J::splat(0.0),
        gain_factor: 1.0,
    };
    (motion, budget)
}

/// Returns `K_q v`, with the joint gain K_q of equation (5).
#[inline(always)]
fn gained<J: JointVector>(input: &LawInput<'_, J>, v: J) -> J {
    let params = input.params;
    if !input.features.paper_variants || params.kq_scalar.is_some() {
        return v * J::splat(params.kq_scalar.unwrap_or(1.0));
    }
    let (values, mut out) = (v.to_joints(), J::splat(0.0));
    for i in 0..params.n.min(MAX_JOINTS) {
        out = J::fma(J::load(&params.kq_columns[i]), J::splat(values[i]), out);
    }
    out
}
