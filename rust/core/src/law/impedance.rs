//! Law `impedance`: a spring and a damper on each task axis, without inverse kinematics.

use crate::law::wrench::{Wrench, WrenchDemand, WrenchLaw};
use crate::law::{AxisPush, ControlLaw, LawInput};
use crate::math::rows::{Mat6, diagonal, load_rows, mul, weighted_gram};
use crate::math::simd::{F64x8, JointVec16, JointVector, RealOps};
use crate::math::spectral::rho;
use crate::params::Params;
use crate::{MAX_AXES, Rows};

/// Returns the factor ≤ 1 on these gains with which their ratio ρ to the servos' stiffness is at most `bound`.
#[inline(always)]
fn share<W: F64x8>(compliance: &Mat6, gains: W, bound: f64) -> f64 {
    if !W::any_lt(W::splat(0.0), gains) {
        return 1.0;
    }
    let rho = rho(compliance, gains);
    if rho > bound { bound / rho } else { 1.0 }
}

/// Returns the force `F = clip(f K ẽ + f_D D (twist − v) + pacing force, ±max)` [N, N·m] of each axis, the joint speeds
/// [rad/s] at the velocity of the reference, and the factor f. K and D are stiffness and damping of the axes, ẽ the
/// adapted deviation, v the velocity of the tool. At this pose, f and f_D ≤ 1 keep `f ρ(K)` and `f_D ρ(D)` within their
/// bounds; ρ is the ratio of the gains to the servos' stiffness.
#[inline(always)]
fn force<J: JointVector>(input: &LawInput<'_, J>, compliance: &Mat6) -> (J::Axes, J, f64) {
    let (demand, mut shares) = (input.demand, [1.0; 2]);
    // A loop, because two calls would be inlined twice.
    for (i, gains) in [demand.stiffness, demand.damping].into_iter().enumerate() {
        shares[i] = share(compliance, gains, input.params.impedance_bounds[i]);
    }
    let [stiff, damped] = shares;
    let velocity = J::Axes::from_axes(&mul(input.rows, input.velocity));
    let spring = J::Axes::splat(stiff) * demand.stiffness * demand.adapted;
    let mut force = J::Axes::fma(J::Axes::splat(damped) * demand.damping, demand.twist - velocity, spring);
    let mut ahead = J::splat(0.0);
    if input.params.pace.on {
        let (pacing_force, speed) = input.pacing_force(diagonal(compliance));
        (force, ahead) = (force + pacing_force, speed);
    }
    (J::Axes::clamp_abs(force, demand.max_strength), ahead, stiff)
}

/// The law `impedance`.
pub(crate) struct Impedance;

impl WrenchLaw for Impedance {
    #[inline(always)]
    fn wrench<J: JointVector>(input: &LawInput<'_, J>, compliance: &Mat6) -> WrenchDemand<J> {
        let (force, ahead, gain_factor) = force(input, compliance);
        let softness = input.demand.softness;
        let wrench = Wrench { soft: softness * force, stiff: (J::Axes::splat(1.0) - softness) * force };
        WrenchDemand { wrench, ahead, null_stiffness: input.params.null_stiffness, gain_factor }
    }
}

impl ControlLaw for Impedance {
    /// Returns the spring force `f K ẽ` of an axis [N, N·m].
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
        let rho = rho(&weighted_gram(&load_rows(rows), JointVec16::load(&params.servos.compliance)), gains);
        if rho > max { max / rho } else { 1.0 }
    }
}
