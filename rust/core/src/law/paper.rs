//! Law `paper`: velocity-based task-space control with torque budgets, equations (3)–(11).

use crate::command::goal::{clip, scale_to_fit};
use crate::law::activation::{Activation, activation, null_column};
use crate::law::cap::Demand;
use crate::law::inverse::{Cholesky, Square, pseudo_inverse, transpose_times, weighted_gram};
use crate::law::wrench::Wrench;
use crate::law::{Motion, Tick};
use crate::settings::Follow;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// `J⁺ Δx` of (5) [rad/s].
#[inline]
pub(crate) fn joint_velocity(pinv_transposed: &Rows, dx: &AxisVec, k: usize) -> JointVec {
    transpose_times(pinv_transposed, dx, k)
}

/// Task velocity within what the budgets can do: `|Δx_j| ≤ τ_j / (h Σ_i k_i |J⁺_ij|)`.
///
/// A box of joint limits has no directions; the same budget on the goal keeps the signs of `J⁺`, so (8) and (9) act on
/// one axis alone.
#[inline]
pub(crate) fn within_budget(
    pinv_transposed: &Rows,
    dx: &AxisVec,
    budget: &AxisVec,
    kp: &JointVec,
    horizon: f64,
    k: usize,
) -> AxisVec {
    let mut out = *dx;
    for r in 0..k.min(MAX_AXES) {
        let mut cost = 0.0;
        for i in 0..MAX_JOINTS {
            cost += kp[i] * pinv_transposed[r][i].abs();
        }
        let most = budget[r] / (horizon * cost).max(f64::MIN_POSITIVE);
        out[r] = clip(dx[r], most);
    }
    out
}

/// Lead of the goals when yielding rows leave the inverse kinematics [rad]:
/// `K_p⁻¹ J_rᵀ (C_rr + λ²/k̄)⁻¹ s_r + Σ_S K_p⁻¹ J_jᵀ κ_j s_j` with `κ_j = [(C + λ²/k̄)⁻¹]_jj`.
#[inline]
pub(crate) fn free_lead(rows: &Rows, compliance: &JointVec, demand: &Demand<'_>, k: usize) -> JointVec {
    let mut wrench = demand.stiff_force(k);
    let mut m: Square = *demand.compliance;
    for r in 0..k.min(MAX_AXES) {
        m[r][r] += demand.damping[r];
    }
    let stiffness = Cholesky::new(&m, k).inverse_diagonal();
    for r in 0..k.min(MAX_AXES) {
        wrench[r] += demand.softness[r] * stiffness[r] * demand.bounded_step[r];
    }
    let mut lead = transpose_times(rows, &wrench, k);
    for (value, c) in lead.iter_mut().zip(compliance) {
        *value *= c;
    }
    lead
}

/// Goals' lead of law `paper`, `h K_q (J⁺Δx − α N∇g)`, and the activation matrix.
///
/// With `budget_on_goal` each axis' step is clamped to its τ^x.
pub(crate) fn motion(tick: &Tick<'_>) -> (Motion, Activation) {
    let plan = tick.plan;
    let (k, n, h) = (plan.k, plan.n, tick.horizon);
    let pinv = pseudo_inverse(tick.rows, &plan.joint_weight, tick.damping, k, n);
    let mut dx = tick.bounded_step.map(|s| s / h);
    if plan.budget_on_goal {
        dx = within_budget(&pinv, &dx, tick.most, &plan.servos.kp, h, k);
    }
    let step = dx.map(|v| v * h);
    let task = match plan.follow {
        Follow::Hold => joint_velocity(&pinv, &step, k),
        Follow::Free => {
            let compliance = weighted_gram(tick.rows, &plan.servos.compliance, k, n);
            let damping = tick.damping.map(|squared| squared / plan.servos.kp_mean);
            let demand = Demand {
                compliance: &compliance,
                damping: &damping,
                step: &step,
                bounded_step: &step,
                softness: tick.softness,
                cap: tick.strength,
            };
            free_lead(tick.rows, &plan.servos.compliance, &demand, k)
        }
    };
    let null_space = tick.null_space();
    let null = null_space.project(&tick.gradient.map(|g| -plan.alpha * h * g));
    let mut lead = gained(plan, &task);
    let mut null = gained(plan, &null);
    plan.bound_null_speed(&mut null, h);
    let reach = plan.joint_speed.map(|speed| speed * h);
    let [null_factor, task_factor] = scale_to_fit(&[0.0; MAX_JOINTS], [&null, &lead], &reach, n);
    for i in 0..MAX_JOINTS {
        lead[i] *= task_factor;
        null[i] *= null_factor;
    }
    let null_shares = if k < n {
        null_column(&null_space.project(tick.gradient), || null_space.matrix(), n)
    } else {
        [0.0; MAX_JOINTS]
    };
    let shares = activation(&pinv, null_shares, k, n);
    let factors = [null_factor, task_factor, task_factor];
    let force_lead = [0.0; MAX_JOINTS];
    (Motion { lead, force_lead, null, wrench: Wrench::default(), factors, gain_factor: 1.0 }, shares)
}

/// `K_q v`.
#[inline]
fn gained(plan: &crate::plan::Plan, v: &JointVec) -> JointVec {
    let mut out = [0.0; MAX_JOINTS];
    for i in 0..plan.n.min(MAX_JOINTS) {
        for j in 0..plan.n.min(MAX_JOINTS) {
            out[i] += plan.kq[i][j] * v[j];
        }
    }
    out
}
