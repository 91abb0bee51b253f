//! Law `impedance`: a spring and a damper on each task axis, without inverse kinematics.

use crate::law::wrench::Wrench;
use crate::law::{AxisPush, ControlLaw, LawInput, LawOutput};
use crate::math::rows::{diagonal, load_rows, mul, weighted_gram};
use crate::math::simd::{F64x8, JointVec16, JointVector, RealOps};
use crate::math::spectral::rho;
use crate::params::Params;
use crate::{MAX_AXES, Rows};

/// Returns the factor ≤ 1 on these gains with which their ratio ρ to the servos' stiffness is at most `bound`.
#[inline(always)]
fn share<J: JointVector>(input: &LawInput<'_, J>, gains: J::Axes, bound: f64) -> f64 {
    if !J::Axes::any_lt(J::Axes::splat(0.0), gains) {
        return 1.0;
    }
    let rho = rho(input.rows, J::load(&input.params.servos.compliance), gains);
    if rho > bound { bound / rho } else { 1.0 }
}

/// Returns the force `F = clip(f K ẽ + f_D D (twist − v) + pacing force, ±max)` [N, N·m] of each axis, the joint speeds
/// [rad/s] at the velocity of the reference, and the factor f. K and D are stiffness and damping of the axes, ẽ the
/// adapted deviation, v the velocity of the tool. At this pose, f and f_D ≤ 1 keep `f ρ(K)` and `f_D ρ(D)` within their
/// bounds; ρ is the ratio of the gains to the servos' stiffness.
#[inline(always)]
fn force<J: JointVector>(input: &LawInput<'_, J>) -> (J::Axes, J, f64) {
    let (demand, [max_stiffness, max_damping]) = (input.demand, input.params.impedance_bounds);
    let stiff = share(input, demand.stiffness, max_stiffness);
    let damped = share(input, demand.damping, max_damping);
    let velocity = J::Axes::from_axes(&mul(input.rows, input.velocity));
    let spring = J::Axes::splat(stiff) * demand.stiffness * demand.adapted;
    let mut force = J::Axes::fma(J::Axes::splat(damped) * demand.damping, demand.twist - velocity, spring);
    let mut ahead = J::splat(0.0);
    if input.params.pace.on {
        let gram = weighted_gram(input.rows, J::load(&input.params.servos.compliance));
        let (pacing_force, speed) = input.pacing_force(diagonal(&gram));
        (force, ahead) = (force + pacing_force, speed);
    }
    (J::Axes::clamp_abs(force, demand.max_strength), ahead, stiff)
}

/// The law `impedance`.
pub(crate) struct Impedance;

impl ControlLaw for Impedance {
    /// Returns the lead of the goals `K_p⁻¹ Jᵀ F` [rad], scaled to the usable torques and the speed limits.
    #[inline(always)]
    fn solve<J: JointVector>(input: &LawInput<'_, J>) -> (LawOutput<J>, Option<J>) {
        let (force, ahead, gain_factor) = force(input);
        let softness = input.demand.softness;
        let wrench = Wrench { soft: softness * force, stiff: (J::Axes::splat(1.0) - softness) * force };
        let null = match input.params.null_stiffness {
            // Null-space motion of a given stiffness κ, `−κ K_p⁻¹ N ∇cost` [rad]: its torque does no work on the task.
            Some(stiffness) => {
                let compliance = J::load(&input.params.servos.compliance);
                input.null_space().project(input.gradient) * J::splat(-stiffness) * compliance
            }
            None => input.null_motion(),
        };
        (LawOutput { gain_factor, ..input.joint_offsets(wrench, null, input.friction(ahead)) }, None)
    }

    /// Returns `f K ẽ`.
    fn force_at(push: &AxisPush<'_>) -> f64 {
        push.gain_factor * push.params.per_axis[push.row].stiffness[push.side] * push.share * push.deviation
    }

    /// Returns `last`: the factor depends on delay and pose, so only a step can compute it.
    fn gain_factor(_params: &Params, last: f64) -> f64 {
        last
    }

    /// Returns the factor f_D ≤ 1 on the dampers of the settings. If the two sides of an axis have different dampings,
    /// it is computed for the larger one.
    fn damping_factor(params: &Params, rows: &Rows) -> f64 {
        let (mut gains, [_, max]) = ([0.0; MAX_AXES], params.impedance_bounds);
        for (gain, row) in gains.iter_mut().zip(&params.per_axis).take(params.k) {
            *gain = row.damping[0].max(row.damping[1]);
        }
        let gains = <JointVec16 as JointVector>::Axes::from_axes(&gains);
        let rho = rho(&load_rows(rows), JointVec16::load(&params.servos.compliance), gains);
        if rho > max { max / rho } else { 1.0 }
    }
}
