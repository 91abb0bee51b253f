//! Fades out the posture task of the null space while a push drives a joint toward its position limit.
//!
//! With a joint at its stop, the other joints follow the push through the null space, away from the posture. At full
//! strength, the posture task would then add to the force along the axis: several times the cap when a hand guides the
//! arm. Without a push the posture task stays, because it moves joints away from their stops, e.g. out of a folded
//! configuration.

use crate::math::simd::{F64x8, JointVector};
use crate::params::Params;
use crate::task::compliance::clamp01;
use crate::task::demand::AxisDemand;

/// Smallest width of the fade, as a share of the clearance. The fade is narrower than the clearance if the rest posture
/// is closer to the limit than the clearance.
const MIN_WIDTH: f64 = 0.4;

/// Share of the fade's width over which the posture task falls from full to zero.
const ZERO_AT: f64 = 0.5;

/// Returns the factor on the posture task at `q`: 1 far from position limits, at the rest posture `rest`, and without a
/// push; it falls to 0 as a push moves a joint to its limit.
#[inline(always)]
pub(crate) fn posture_gain<J: JointVector>(params: &Params, q: J, rest: J, demand: &AxisDemand<J::Axes>) -> f64 {
    let (lower, upper, clear) = (J::load(&params.lower), J::load(&params.upper), J::load(&params.clearance));
    let (below, above) = (q - lower, upper - q);
    if !J::min(below, above).is_any_lt(clear) {
        return 1.0;
    }
    let missing = J::max(stop_fade(below, rest - lower, clear), stop_fade(above, upper - rest, clear)).max_element();
    if missing > 0.0 { 1.0 - missing.min(1.0) * push_fraction(params, demand) } else { 1.0 }
}

/// Returns the strength of a push on the yielding axes, 0 to 1: 0 below a deviation of `soft_until` (at least a tenth
/// of `firm_from`), 1 at twice that deviation.
#[inline(always)]
fn push_fraction<W: F64x8>(params: &Params, demand: &AxisDemand<W>) -> f64 {
    let slope = W::from_array(&params.axis_simd.push_slope);
    let felt = clamp01::<W>(W::fma(W::abs(demand.deviation), slope, W::splat(-1.0))) * demand.softness;
    felt.to_axes().into_iter().fold(0.0, f64::max)
}

/// Returns the share of the posture task that a stop at the distance `room` [rad or m] removes; `clear` is the
/// clearance. It is 0 at `at_rest`, the distance in the rest posture, so that the fade does not change the equilibrium.
#[inline(always)]
fn stop_fade<J: JointVector>(room: J, at_rest: J, clear: J) -> J {
    let width = J::min(J::max(at_rest, J::splat(MIN_WIDTH) * clear), clear);
    (J::min(at_rest, width) - room) / (J::splat(ZERO_AT) * width)
}
