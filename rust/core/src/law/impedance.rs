//! Law `impedance`: a spring and a damper on each task axis, no solve. Replaces lines 6 to 8 of the control step.

use crate::law::wrench::Wrench;
use crate::law::{AxisPush, ControlLaw, LawInput, LawOutput};
use crate::math::rows::{diagonal, load_rows, mul, weighted_gram};
use crate::math::simd::{Broadcast, JointVec16, JointVector, RealOps, Scalar, TaskVector};
use crate::math::spectral::rho;
use crate::params::Params;
use crate::{MAX_AXES, Rows};

/// Returns the factor ≤ 1 that reduces `ρ` of these gains to `bound`.
#[inline(always)]
fn share<J: JointVector>(input: &LawInput<'_, J>, gains: J::Axes, bound: f64) -> Scalar<J> {
    if !J::Axes::any_lt(J::Axes::splat(0.0), gains) {
        return J::Elem::splat(1.0);
    }
    let (rho, bound) = (rho(input.rows, J::load(&input.params.servos.compliance), gains), J::Elem::splat(bound));
    J::Elem::select_lt(bound, rho, bound / rho, J::Elem::splat(1.0))
}

/// Returns `F = clip(f K ẽ + f_D D (twist − v), ±max)` per axis, and `f` ≤ 1; f and f_D keep `f ρ(K)` and `f_D ρ(D)`
/// within their bounds at this pose.
#[inline(always)]
fn force<J: JointVector>(input: &LawInput<'_, J>) -> (J::Axes, J, Scalar<J>) {
    let (demand, [max_stiffness, max_damping]) = (input.demand, input.params.impedance_bounds);
    let stiff = share(input, demand.stiffness, max_stiffness);
    let damped = share(input, demand.damping, max_damping);
    let velocity: J::Axes = TaskVector::from_axes(&mul(input.rows, input.velocity));
    let spring = J::Axes::broadcast(stiff) * demand.stiffness * demand.adapted;
    let mut force = J::Axes::fma(J::Axes::broadcast(damped) * demand.damping, demand.twist - velocity, spring);
    let mut ahead = J::splat(0.0);
    if input.params.pace.on {
        let gram = weighted_gram(input.rows, J::load(&input.params.servos.compliance));
        let (pacing_force, speed) = input.pacing_force(diagonal(&gram));
        (force, ahead) = (force + pacing_force, speed);
    }
    (J::Axes::clamp_abs(force, demand.max_strength), ahead, stiff)
}

/// Law `impedance`.
pub(crate) struct Impedance;

impl ControlLaw for Impedance {
    /// Lead of the goals under law `impedance`: `K_p⁻¹ Jᵀ F`, scaled to torque ceilings and speed limits.
    #[inline(always)]
    fn solve<J: JointVector>(input: &LawInput<'_, J>) -> (LawOutput<J>, Option<J>) {
        let (force, ahead, gain_factor) = force(input);
        let softness = input.demand.softness;
        let wrench = Wrench { soft: softness * force, stiff: (J::Axes::splat(1.0) - softness) * force };
        let null = match input.params.null_stiffness {
            // Null-space motion of a given stiffness, `−κ K_p⁻¹ N ∇cost` [rad]: its torque does no work on the task.
            Some(stiffness) => {
                let compliance = J::load(&input.params.servos.compliance);
                input.null_space().project(input.gradient) * J::splat(-stiffness) * compliance
            }
            None => input.null_motion(),
        };
        (LawOutput { gain_factor, ..input.joint_offsets(wrench, null, input.friction(ahead)) }, None)
    }

    /// `f K ẽ`.
    fn force_at(push: &AxisPush<'_>) -> f64 {
        push.gain_factor * push.params.per_axis[push.row].stiffness[push.side] * push.share * push.deviation
    }

    /// The factor of the last step, which depends on delay and pose.
    fn gain_factor(_params: &Params, last: f64) -> f64 {
        last
    }

    /// Returns f_D for the dampers in the settings; if the sides differ, for the firmer side.
    fn damping_factor(params: &Params, rows: &Rows) -> f64 {
        let (mut gains, [_, max]) = ([0.0; MAX_AXES], params.impedance_bounds);
        for (gain, row) in gains.iter_mut().zip(&params.per_axis).take(params.k) {
            *gain = row.damping[0].max(row.damping[1]);
        }
        let rho = rho(&load_rows(rows), JointVec16::load(&params.servos.compliance), TaskVector::from_axes(&gains));
        if rho > max { max / rho } else { 1.0 }
    }
}
