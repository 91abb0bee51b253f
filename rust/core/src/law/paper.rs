//! Law `paper`: velocity-based task-space control with torque budgets, equations (3)–(11).

use crate::command::goal::{clip, scale_to_fit};
use crate::law::activation::{activation, null_column};
use crate::law::cap::Demand;
use crate::law::inverse::{Cholesky, Square, transpose_times, weighted_gram};
use crate::law::nullspace::NullSpace;
use crate::law::wrench::Wrench;
use crate::law::{Motion, Tick};
use crate::plan::Plan;
use crate::settings::{Follow, Projector};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// `J⁺ Δx` of (5) [rad/s].
#[inline(always)]
pub(crate) fn joint_velocity(pinv_transposed: &Rows, dx: &AxisVec, k: usize, n: usize) -> JointVec {
    transpose_times(pinv_transposed, dx, k, n)
}

/// Task velocity within what the budgets can do: `|Δx_j| ≤ τ_j / (h Σ_i k_i |J⁺_ij|)`.
///
/// A box of joint limits has no directions; the same budget on the goal keeps the signs of `J⁺`, so (8) and (9) act on
/// one axis alone.
#[inline(never)]
pub(crate) fn within_budget(
    pinv_transposed: &Rows,
    dx: &AxisVec,
    budget: &AxisVec,
    kp: &JointVec,
    horizon: f64,
    (k, n): (usize, usize),
) -> AxisVec {
    let mut out = *dx;
    for r in 0..k.min(MAX_AXES) {
        let mut cost = 0.0;
        for i in 0..n.min(MAX_JOINTS) {
            cost += kp[i] * pinv_transposed[r][i].abs();
        }
        let most = budget[r] / (horizon * cost).max(f64::MIN_POSITIVE);
        out[r] = clip(dx[r], most);
    }
    out
}

/// Lead of the goals when yielding rows leave the inverse kinematics [rad]:
/// `K_p⁻¹ J_rᵀ (C_rr + λ²/k̄)⁻¹ s_r + Σ_S K_p⁻¹ J_jᵀ κ_j s_j` with `κ_j = [(C + λ²/k̄)⁻¹]_jj`.
#[inline(never)]
pub(crate) fn free_lead(rows: &Rows, compliance: &JointVec, demand: &Demand<'_>, k: usize, n: usize) -> JointVec {
    let mut wrench = demand.stiff_force(k);
    let mut m: Square = *demand.compliance;
    for r in 0..k.min(MAX_AXES) {
        m[r][r] += demand.damping[r];
    }
    let stiffness = Cholesky::new(&m, k).inverse_diagonal();
    for r in 0..k.min(MAX_AXES) {
        wrench[r] += demand.softness[r] * stiffness[r] * demand.bounded_step[r];
    }
    let mut lead = transpose_times(rows, &wrench, k, n);
    for i in 0..n.min(MAX_JOINTS) {
        lead[i] *= compliance[i];
    }
    lead
}

/// Goals' lead of law `paper`, `h K_q (J⁺Δx − α N∇g)`, and the joint budgets τ^q of (11).
///
/// With `budget_on_goal` each axis' step is clamped to its τ^x.
#[inline(always)]
pub(crate) fn motion(tick: &Tick<'_>) -> (Motion, JointVec) {
    let plan = tick.plan;
    let (k, n, h) = (tick.k, tick.n, tick.horizon);
    let damped = NullSpace::new(tick.rows, &plan.joint_weight, tick.damping, k, n).padded(plan.k, plan.n);
    let pinv = damped.pseudo_inverse();
    let mut dx = [0.0; MAX_AXES];
    for r in 0..k {
        dx[r] = tick.bounded_step[r] / h;
    }
    if plan.budget_on_goal {
        dx = within_budget(&pinv, &dx, tick.most, &plan.servos.kp, h, (k, n));
    }
    let mut step = [0.0; MAX_AXES];
    for r in 0..k {
        step[r] = dx[r] * h;
    }
    let task = match plan.follow {
        Follow::Hold => joint_velocity(&pinv, &step, k, n),
        Follow::Free => {
            let compliance = weighted_gram(tick.rows, &plan.servos.compliance, k, n);
            let damping = plan.per_stiffness(tick.damping);
            let demand = Demand {
                compliance: &compliance,
                damping: &damping,
                step: &step,
                bounded_step: &step,
                softness: tick.softness,
                cap: tick.strength,
            };
            free_lead(tick.rows, &plan.servos.compliance, &demand, k, n)
        }
    };
    let null_space = match plan.projector {
        Projector::Paper => damped,
        Projector::Exact => tick.null_space(),
    };
    let along = null_space.project(tick.gradient);
    let mut null = [0.0; MAX_JOINTS];
    for i in 0..n {
        null[i] = -plan.alpha * h * along[i];
    }
    let mut lead = gained(plan, &task, n);
    let mut null = gained(plan, &null, n);
    plan.bound_null_speed(&mut null, h, n);
    let reach = plan.reach(h, n);
    let [null_factor, task_factor] = scale_to_fit(&[0.0; MAX_JOINTS], [&null, &lead], &reach, n);
    for i in 0..n {
        lead[i] *= task_factor;
        null[i] *= null_factor;
    }
    let null_shares =
        if plan.k < plan.n { null_column(&along, || null_space.matrix(), plan.n) } else { [0.0; MAX_JOINTS] };
    let budget = activation(&pinv, null_shares, k, n).distribute(tick.most, plan.null_torque, k, n);
    let factors = [null_factor, task_factor, task_factor];
    let (force_lead, feed_forward) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
    let motion = Motion { lead, force_lead, null, wrench: Wrench::default(), factors, feed_forward, gain_factor: 1.0 };
    (motion, budget)
}

/// `K_q v`.
#[inline(always)]
fn gained(plan: &Plan, v: &JointVec, n: usize) -> JointVec {
    let n = n.min(MAX_JOINTS);
    let mut out = *v;
    match plan.kq_scalar {
        Some(gain) => {
            for i in 0..n {
                out[i] *= gain;
            }
        }
        None => {
            for i in 0..n {
                out[i] = (0..n).map(|j| plan.kq[i][j] * v[j]).sum();
            }
        }
    }
    out
}
