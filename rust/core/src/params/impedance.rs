//! Stiffness of law `impedance`: defaults, and bounds from delay and servos.

use crate::error::{Error, Result};
use crate::math::rounding::{self, round_down};
use crate::math::rows::{load_rows, weighted_gram};
use crate::math::simd::{F64x8, JointVec16, JointVector};
use crate::math::spectral::rho;
use crate::model::Model;
use crate::params::resolved::{GAIN_DELAY_BOUND, REFERENCE_REACH};
use crate::params::{AXIS_NAMES, Frame, Params, ServoArrays, Settings, joint_space};
use crate::{AxisVec, MAX_AXES, MAX_JOINTS};

/// Default stiffness of translations [N/m] and rotations [N·m/rad], tuned on `arm7`; scaled for other arms.
const REFERENCE_STIFFNESS: [f64; 2] = [800.0, 20.0];
/// Mean k_p [N·m/rad] of `arm7`, on which the default stiffness was tuned.
const REFERENCE_KP: f64 = 780.0 / 7.0;

/// Largest `ρ(D) (T_e + T_f)` [s²] at which the arm does not oscillate under the dampers, with the effective delay T_e
/// and the time constant T_f of the velocity filter.
const DAMPING_DELAY_BOUND: f64 = 0.007;

/// Largest effective delay T_e [s] at which well damped servos allow a stiffness ratio ρ of `WELL_DAMPED_RATIO`.
const WELL_DAMPED_DELAY: f64 = 0.03;
/// Largest ratio ρ of the axes' stiffness to the servos' own that well damped servos allow.
const WELL_DAMPED_RATIO: f64 = 3.0;

/// Largest ratio ρ for servos that need a large lead and whose stiffness is estimated: it may be twice the estimate, and
/// forces then reverse 1.4 times as fast.
const ESTIMATED_RATIO: f64 = 2.0;

/// Largest lead at full torque [rad] with which goals at their default speed limit of 1 rad/s reverse a force in time for
/// a ratio ρ above `WELL_DAMPED_RATIO`.
const QUICK_LEAD: f64 = 0.15;

/// Returns the largest ratios ρ of the axes' stiffness [1] and damping [s] to the servos' stiffness at a delay [s]; ∞
/// with `accept_high_stiffness`. With T_e = delay + half a period: `max(1, 0.03 s / T_e)` for stiffness, at least 3 for
/// well damped servos up to a T_e of 0.03 s, at most 3 (2 if the servos are estimated) if a servo needs a lead of more
/// than [`QUICK_LEAD`]; `0.007 s² / (T_e + T_f)` for damping.
pub(super) fn bounds(settings: &Settings, delay: f64, servos: &ServoArrays, n: usize) -> [f64; 2] {
    if settings.accept_high_stiffness {
        return [f64::INFINITY; 2];
    }
    let late = delay + 0.5 / settings.rate;
    let least = if servos.well_damped(n) && late <= WELL_DAMPED_DELAY { WELL_DAMPED_RATIO } else { 1.0 };
    let max = if is_slow(servos, n) { slow_ratio(servos) } else { f64::INFINITY };
    let stiffness = (GAIN_DELAY_BOUND / late).max(least).min(max);
    [stiffness, DAMPING_DELAY_BOUND / (late + settings.tracking.velocity_filter)]
}

/// Returns the largest ratio ρ for servos that need a large lead.
fn slow_ratio(servos: &ServoArrays) -> f64 {
    if servos.estimated { ESTIMATED_RATIO } else { WELL_DAMPED_RATIO }
}

/// Returns true if a servo needs a lead of more than [`QUICK_LEAD`] for its full torque.
fn is_slow(servos: &ServoArrays, n: usize) -> bool {
    (0..n.min(MAX_JOINTS)).any(|i| servos.lead_at_full_torque(i) > QUICK_LEAD)
}

/// Returns the default stiffness of axes that do not yield, of translations [N/m] and rotations [N·m/rad]; zero under
/// other laws. For servos that need a large lead, it is within its bound in the median configuration.
pub(super) fn default_stiffness(model: &Model, settings: &Settings, servos: &ServoArrays, axes: &[usize]) -> [f64; 2] {
    if !settings.law.has_springs() {
        return [0.0; 2];
    }
    let stiffer = servos.kp_mean / REFERENCE_KP;
    let longer = if model.reach() > 0.0 { model.reach() / REFERENCE_REACH } else { 1.0 };
    let default = [REFERENCE_STIFFNESS[0] * stiffer / (longer * longer), REFERENCE_STIFFNESS[1] * stiffer]
        .map(rounding::round_to_halves);
    if !is_slow(servos, model.n()) {
        return default;
    }
    let mut gains = [0.0; MAX_AXES];
    for (gain, &axis) in gains.iter_mut().zip(axes) {
        *gain = default[usize::from(axis >= 3)];
    }
    let excess = median_ratio(model, servos, axes, &settings.task.frame, &gains) / slow_ratio(servos);
    if excess > 1.0 { default.map(|k| round_down(k / excess)) } else { default }
}

/// Returns an error if the arm would oscillate with the user's stiffness or damping in more than half of the sampled
/// configurations, or if the stiffness of the null-space motion exceeds its bound.
///
/// In a configuration that requires lower gains, the step reduces them, including the default stiffness of other axes;
/// see [`rho`].
pub(super) fn check(model: &Model, settings: &Settings, params: &Params) -> Result<()> {
    let [max_stiffness, max_damping] = params.impedance_bounds;
    if let Some(stiffness) = settings.null_space.stiffness {
        let softest = params.servos.kp[..params.n].iter().copied().fold(f64::INFINITY, f64::min);
        let max = max_stiffness * softest;
        if stiffness > max {
            let bound = format!("[0, {max:.3}]: {}", why(settings));
            return Err(Error::out_of_range("null_space.stiffness [N·m/rad]", stiffness, bound));
        }
    }
    let (mut stiffness, mut damping) = ([0.0; MAX_AXES], [0.0; MAX_AXES]);
    for (r, row) in params.per_axis.iter().enumerate().take(params.k) {
        if settings.axes[row.axis].stiffness.is_some() {
            stiffness[r] = row.stiffness[0].max(row.stiffness[1]);
        }
        damping[r] = row.damping[0].max(row.damping[1]);
    }
    for (field, units, asked, max) in [
        ("stiffness", ["N/m", "N·m/rad"], stiffness, max_stiffness),
        ("damping", ["N·s/m", "N·m·s/rad"], damping, max_damping),
    ] {
        let ratio = overshoot(model, params, &asked, max);
        if ratio > 1.0 {
            let listed = |value: &dyn Fn(usize) -> f64| {
                let rows = (0..params.k).filter(|&r| asked[r] > 0.0).map(|r| (r, params.per_axis[r].axis));
                let each = rows
                    .map(|(r, axis)| format!("{}={} {}", AXIS_NAMES[axis], value(r), units[usize::from(axis >= 3)]));
                each.collect::<Vec<_>>().join(", ")
            };
            let (user, nearest) = (listed(&|r| asked[r]), listed(&|r| round_down(asked[r] / ratio)));
            return Err(Error::config(
                format!("axes.{field}"),
                format!(
                    "{user} is {ratio:.2} times the bound for the median pose, and {}: use {nearest}, shorten delay \
                     and period, or accept the risk: Settings(accept_high_stiffness=True)",
                    why(settings)
                ),
            ));
        }
    }
    Ok(())
}

/// Returns the ratio [`rho`] of the axes' gains (stiffness or damping) to the servos' stiffness, as the median over the
/// joint space and divided by its bound `max`; 0 if `max` is infinite.
fn overshoot(model: &Model, params: &Params, gains: &AxisVec, max: f64) -> f64 {
    if max.is_infinite() || gains.iter().all(|&gain| gain <= 0.0) {
        return 0.0;
    }
    median_ratio(model, &params.servos, &params.axes, &params.frame, gains) / max
}

/// Returns the ratio [`rho`] of the axes' gains to the servos' stiffness, as the median over the joint space.
fn median_ratio(model: &Model, servos: &ServoArrays, axes: &[usize], frame: &Frame, gains: &AxisVec) -> f64 {
    let compliance = JointVec16::load(&servos.compliance);
    let gains = <JointVec16 as JointVector>::Axes::from_axes(gains);
    joint_space::median_over_rows(model, axes, frame, |rows| rho(&weighted_gram(&load_rows(rows), compliance), gains))
}

/// Returns the reason for a bound, for error messages.
fn why(settings: &Settings) -> String {
    format!("with a delay of {} s at {} Hz and these servos a stiffer loop oscillates", settings.delay, settings.rate)
}
