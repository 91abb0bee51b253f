//! Law `impedance`: a spring and a damper on each task axis, no solve. Replaces lines 6 to 8 of the control step.

use crate::law::inverse::{axes, diagonal, load_rows, times, weighted_gram, wide};
use crate::law::wrench::Wrench;
use crate::law::{Motion, Tick};
use crate::number::{Arithmetic, Axes, AxisScalar, EveryJoint, Lanes, Scalar, Spread};
use crate::plan::Plan;
use crate::{MAX_AXES, Rows};

/// Squarings that isolate the largest eigenvalue: power 2⁶ = 64.
const SQUARINGS: usize = 6;

/// `ρ = (Σ λ_i⁶⁴)^(1/64)` over the eigenvalues of `K_p⁻¹ Jᵀ K J`: stiffness of the axes relative to the servos.
///
/// At least the largest eigenvalue and at most 3 % above it (six equal eigenvalues); smooth where two eigenvalues
/// cross; memoryless. `compliance` holds 1/k_p.
#[inline(always)]
pub(crate) fn rho<J: Lanes>(rows: &[J; MAX_AXES], compliance: J, stiffness: J::Axes) -> Scalar<J> {
    // √K C √K has the same eigenvalues, and is symmetric.
    let (root, c) = (J::Axes::sqrt(stiffness), weighted_gram(rows, compliance));
    let roots = axes(root);
    let mut m = [root; MAX_AXES];
    for r in 0..MAX_AXES {
        m[r] = wide::<J::Axes>(&c[r]) * root * J::Axes::spread(roots[r]);
    }
    // Divide by the trace before each squaring, to prevent overflow.
    let mut traces = [J::One::splat(0.0); SQUARINGS];
    for trace in &mut traces {
        *trace = trace_of(&m);
        m = squared(&m, J::One::splat(1.0) / J::One::at_least(*trace, J::One::splat(f64::MIN_POSITIVE)));
    }
    let mut power = trace_of(&m);
    for trace in traces.iter().rev() {
        power = *trace * J::One::sqrt(power);
    }
    power
}

#[inline(always)]
fn trace_of<W: Axes>(m: &[W; MAX_AXES]) -> AxisScalar<W> {
    let mut sum = W::One::splat(0.0);
    for r in 0..MAX_AXES {
        sum = sum + axes(m[r])[r];
    }
    sum
}

/// `(f M)²` of a symmetric matrix.
#[inline(always)]
fn squared<W: Axes>(m: &[W; MAX_AXES], factor: AxisScalar<W>) -> [W; MAX_AXES] {
    let (factor, mut out) = (W::spread(factor), [W::splat(0.0); MAX_AXES]);
    for r in 0..MAX_AXES {
        let row = axes(m[r] * factor * factor);
        for c in 0..MAX_AXES {
            out[r] = W::fma(W::spread(row[c]), m[c], out[r]);
        }
    }
    out
}

/// Returns the factor ≤ 1 that reduces `ρ` of these gains to `bound`.
#[inline(always)]
fn share<J: Lanes>(tick: &Tick<'_, J>, gains: J::Axes, bound: f64) -> Scalar<J> {
    if !J::Axes::less_anywhere(J::Axes::splat(0.0), gains) {
        return J::One::splat(1.0);
    }
    let (rho, bound) = (rho(tick.rows, J::load(&tick.plan.servos.compliance), gains), J::One::splat(bound));
    J::One::if_less(bound, rho, bound / rho, J::One::splat(1.0))
}

/// Returns `F = clip(f K ẽ + f_D D (twist − v), ±most)` per axis, and `f` ≤ 1; f and f_D keep `f ρ(K)` and `f_D ρ(D)`
/// within their bounds at this pose.
#[inline(always)]
fn force<J: Lanes>(tick: &Tick<'_, J>) -> (J::Axes, J, Scalar<J>) {
    let (wish, [most_stiff, most_damped]) = (tick.wish, tick.plan.impedance_bounds);
    let stiff = share(tick, wish.stiffness, most_stiff);
    let damped = share(tick, wish.viscosity, most_damped);
    let velocity: J::Axes = wide(&times(tick.rows, tick.velocity));
    let spring = J::Axes::spread(stiff) * wish.stiffness * wish.adapted;
    let mut force = J::Axes::fma(J::Axes::spread(damped) * wish.viscosity, wish.twist - velocity, spring);
    let mut ahead = J::splat(0.0);
    if tick.plan.pace.on {
        let gram = weighted_gram(tick.rows, J::load(&tick.plan.servos.compliance));
        let (paced, speed) = tick.paced(diagonal(&gram));
        (force, ahead) = (force + paced, speed);
    }
    (J::Axes::clip(force, wish.most), ahead, stiff)
}

/// Returns f_D for the dampers in the settings; if the sides differ, for the firmer side.
pub(crate) fn damping_factor(plan: &Plan, rows: &Rows) -> f64 {
    let (mut gains, [_, most]) = ([0.0; MAX_AXES], plan.impedance_bounds);
    for (gain, row) in gains.iter_mut().zip(&plan.rows).take(plan.k) {
        *gain = row.viscosity[0].max(row.viscosity[1]);
    }
    let rho = rho(&load_rows(rows), EveryJoint::load(&plan.servos.compliance), wide(&gains));
    if rho > most { most / rho } else { 1.0 }
}

/// Lead of the goals under law `impedance`: `K_p⁻¹ Jᵀ F`, scaled to torque ceilings and speed limits.
#[inline(always)]
pub(crate) fn motion<J: Lanes>(tick: &Tick<'_, J>) -> Motion<J> {
    let (force, ahead, gain_factor) = force(tick);
    let softness = tick.wish.softness;
    let wrench = Wrench { soft: softness * force, stiff: (J::Axes::splat(1.0) - softness) * force };
    let null = match tick.plan.null_stiffness {
        // Null-space motion of a given stiffness, `−κ K_p⁻¹ N ∇cost` [rad]: its torque does no work on the task.
        Some(stiffness) => {
            let compliance = J::load(&tick.plan.servos.compliance);
            tick.null_space().project(tick.gradient) * J::splat(-stiffness) * compliance
        }
        None => tick.null_motion(),
    };
    Motion { gain_factor, ..tick.exert(wrench, null, tick.resistance(ahead)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{JointVec, MAX_JOINTS};

    #[test]
    fn rho_is_just_above_the_largest_eigenvalue() {
        let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
        for (r, row) in rows.iter_mut().enumerate() {
            for (i, value) in row.iter_mut().enumerate().take(7) {
                *value = ((3 * r + 5 * i) as f64).sin();
            }
        }
        let mut compliance: JointVec = [1.0; MAX_JOINTS];
        compliance[..7].copy_from_slice(&[1.0 / 150.0, 1.0 / 150.0, 1e-2, 1e-2, 1.0 / 60.0, 1.0 / 60.0, 1.0 / 60.0]);
        let of =
            |stiffness: &[f64; 6]| rho::<EveryJoint>(&load_rows(&rows), EveryJoint::load(&compliance), wide(stiffness));
        for stiffness in [[800.0_f64, 800.0, 800.0, 20.0, 20.0, 20.0], [0.0, 1e9, 1e-3, 5.0, 0.0, 0.0], [1.0; 6]] {
            let j = nalgebra::DMatrix::from_fn(6, 7, |r, i| rows[r][i] * stiffness[r].sqrt());
            let c = nalgebra::DVector::from_column_slice(&compliance[..7]);
            let largest = (&j * nalgebra::DMatrix::from_diagonal(&c) * j.transpose()).symmetric_eigenvalues().max();
            let got = of(&stiffness);
            assert!(got >= largest * (1.0 - 1e-12) && got <= 1.0285 * largest, "{got} {largest}");
        }
        assert!(of(&[0.0; 6]) < f64::MIN_POSITIVE);
    }
}
