//! Law `impedance`: a spring and a damper on each task axis, no solve. Takes the place of lines 6 to 8 of the control step.

use crate::command::goal::clip;
use crate::law::inverse::{Square, times, weighted_gram};
use crate::law::wrench::Wrench;
use crate::law::{Motion, Tick};
use crate::plan::Plan;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Squarings by which the largest eigenvalue is singled out: powers of 2⁶ = 64.
const SQUARINGS: usize = 6;

/// `ρ = (Σ λ_i⁶⁴)^(1/64)` over the eigenvalues of `K_p⁻¹ Jᵀ K J`: how stiff the axes are, in units of the servos.
///
/// Never below the largest eigenvalue and at most 3 % above it (six equal ones); smooth where two of them cross, and
/// without memory. `compliance` holds 1/k_p.
#[inline(always)]
pub(crate) fn rho(rows: &Rows, compliance: &JointVec, stiffness: &AxisVec, k: usize, n: usize) -> f64 {
    // √K C √K has the same eigenvalues, and is symmetric.
    let k = k.min(MAX_AXES);
    let mut m = weighted_gram(rows, compliance, k, n);
    let mut root = [0.0; MAX_AXES];
    for r in 0..k {
        root[r] = stiffness[r].sqrt();
    }
    for r in 0..k {
        for c in 0..k {
            m[r][c] *= root[r] * root[c];
        }
    }
    // The trace is taken out before each squaring, so that nothing overflows.
    let mut traces = [0.0; SQUARINGS + 1];
    for trace in &mut traces[..SQUARINGS] {
        *trace = take_trace(&mut m, k);
        if *trace <= 0.0 {
            return 0.0;
        }
        m = squared(&m, k);
    }
    traces[SQUARINGS] = (0..k).map(|i| m[i][i]).sum();
    traces[..SQUARINGS].iter().rev().fold(traces[SQUARINGS], |power, trace| trace * power.sqrt())
}

/// Divides a matrix by its trace, which is returned.
#[inline(always)]
fn take_trace(m: &mut Square, k: usize) -> f64 {
    let trace: f64 = (0..k).map(|i| m[i][i]).sum();
    let inverse = 1.0 / trace.max(f64::MIN_POSITIVE);
    for row in m {
        for c in 0..k {
            row[c] *= inverse;
        }
    }
    trace
}

/// `M M` of a symmetric matrix.
#[inline(always)]
fn squared(m: &Square, k: usize) -> Square {
    let mut out = [[0.0; MAX_AXES]; MAX_AXES];
    for r in 0..k {
        for c in 0..=r {
            let mut sum = 0.0;
            for inner in 0..k {
                sum += m[r][inner] * m[c][inner];
            }
            (out[r][c], out[c][r]) = (sum, sum);
        }
    }
    out
}

/// `F = clip(f K ẽ + f_D D (twist − v), ±most)` per axis, and `f` ≤ 1; f and f_D keep `f ρ(K)` and `f_D ρ(D)` within
/// their bounds at this pose.
#[inline(always)]
pub(crate) fn force(tick: &Tick<'_>) -> (AxisVec, f64) {
    let (plan, k, n) = (tick.plan, tick.k.min(MAX_AXES), tick.n);
    let share = |gains: &AxisVec, bound: f64| {
        if gains.iter().all(|&gain| gain <= 0.0) {
            return 1.0;
        }
        let rho = rho(tick.rows, &plan.servos.compliance, gains, k, n);
        if rho > bound { bound / rho } else { 1.0 }
    };
    let [most_stiff, most_damped] = plan.impedance_bounds;
    let (stiff, damped) = (share(tick.stiffness, most_stiff), share(tick.viscosity, most_damped));
    let velocity = times(tick.rows, tick.velocity, k, n);
    let mut out = [0.0; MAX_AXES];
    for r in 0..k {
        let spring = stiff * tick.stiffness[r] * tick.adapted[r];
        let damper = damped * tick.viscosity[r] * (tick.twist[r] - velocity[r]);
        out[r] = clip(spring + damper, tick.most[r]);
    }
    (out, stiff)
}

/// f_D of the dampers as they are set, of the firmer side where sides differ.
pub(crate) fn damping_factor(plan: &Plan, rows: &Rows) -> f64 {
    let (mut gains, [_, most]) = ([0.0; MAX_AXES], plan.impedance_bounds);
    for (gain, row) in gains.iter_mut().zip(&plan.rows).take(plan.k) {
        *gain = row.viscosity[0].max(row.viscosity[1]);
    }
    let rho = rho(rows, &plan.servos.compliance, &gains, plan.k, plan.n);
    if rho > most { most / rho } else { 1.0 }
}

/// Null-space motion of a given stiffness, `−κ K_p⁻¹ N ∇cost` [rad]: its torque does no work on the task.
#[inline(always)]
fn null_spring(tick: &Tick<'_>, stiffness: f64) -> JointVec {
    let plan = tick.plan;
    let mut out = tick.null_space().project(tick.gradient);
    for i in 0..tick.n.min(MAX_JOINTS) {
        out[i] *= -stiffness * plan.servos.compliance[i];
    }
    out
}

/// Goals' lead of law `impedance`: `K_p⁻¹ Jᵀ F`, scaled to torque ceilings and speed limits.
#[inline(always)]
pub(crate) fn motion(tick: &Tick<'_>) -> Motion {
    let (force, gain_factor) = force(tick);
    let mut wrench = Wrench::default();
    for r in 0..tick.k.min(MAX_AXES) {
        wrench.soft[r] = tick.softness[r] * force[r];
        wrench.stiff[r] = (1.0 - tick.softness[r]) * force[r];
    }
    let null = match tick.plan.null_stiffness {
        Some(stiffness) => null_spring(tick, stiffness),
        None => tick.null_motion(),
    };
    Motion { gain_factor, ..tick.exert(wrench, null) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rho_is_just_above_the_largest_eigenvalue() {
        let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
        for (r, row) in rows.iter_mut().enumerate() {
            for (i, value) in row.iter_mut().enumerate().take(7) {
                *value = ((3 * r + 5 * i) as f64).sin();
            }
        }
        let mut compliance = [1.0; MAX_JOINTS];
        compliance[..7].copy_from_slice(&[1.0 / 150.0, 1.0 / 150.0, 1e-2, 1e-2, 1.0 / 60.0, 1.0 / 60.0, 1.0 / 60.0]);
        for stiffness in [[800.0_f64, 800.0, 800.0, 20.0, 20.0, 20.0], [0.0, 1e9, 1e-3, 5.0, 0.0, 0.0], [1.0; 6]] {
            let j = nalgebra::DMatrix::from_fn(6, 7, |r, i| rows[r][i] * stiffness[r].sqrt());
            let c = nalgebra::DVector::from_column_slice(&compliance[..7]);
            let largest = (&j * nalgebra::DMatrix::from_diagonal(&c) * j.transpose()).symmetric_eigenvalues().max();
            let got = rho(&rows, &compliance, &stiffness, 6, 7);
            assert!(got >= largest * (1.0 - 1e-12) && got <= 1.0285 * largest, "{got} {largest}");
        }
        assert!(rho(&rows, &compliance, &[0.0; 6], 6, 7) < f64::MIN_POSITIVE);
    }
}
