//! Law `impedance`: a spring and a damper on each task axis, no solve. Replaces lines 6 to 8 of the control step.

use crate::law::wrench::Wrench;
use crate::law::{Motion, Tick};
use crate::math::rows::{diagonal, load_rows, times, weighted_gram, wide};
use crate::math::simd::{Arithmetic, EveryJoint, Lanes, Scalar, Spread};
use crate::math::spectral::rho;
use crate::params::Plan;
use crate::{MAX_AXES, Rows};

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
