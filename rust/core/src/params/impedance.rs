//! Stiffness of law `impedance`: defaults, and bounds from delay and servos.

use crate::error::{Error, Result};
use crate::math::rows::{load_rows, wide};
use crate::math::simd::{EveryJoint, Lanes};
use crate::math::spectral::rho;
use crate::model::Model;
use crate::params::resolved::{GAIN_DELAY_BOUND, REFERENCE_REACH};
use crate::params::{AXIS_NAMES, Law, Plan, ServoArrays, Settings, workspace};
use crate::{AxisVec, MAX_AXES, Rows};

/// Reference stiffness of translations [N/m] and rotations [N·m/rad], and the mean k_p of the arm used for tuning.
const REFERENCE: [f64; 2] = [800.0, 20.0];
const REFERENCE_KP: f64 = 780.0 / 7.0;

/// Largest `ρ(D) (T_e + T_f)` [s²] at which dampers do not oscillate: their velocity is filtered.
const DAMPING_DELAY_BOUND: f64 = 0.007;

/// Largest delay [s] at which well damped servos allow a stiffness of `WELL_DAMPED`.
const WELL_DAMPED_DELAY: f64 = 0.03;
const WELL_DAMPED: f64 = 3.0;

/// Returns the largest ρ at a delay [s], to which half a period is added: of stiffness `max(1, 0.03 s / T_e)`, at least
/// 3 for well damped servos up to a T_e of 0.03 s; of damping `0.007 s² / (T_e + T_f)`.
pub(super) fn bounds(settings: &Settings, delay: f64, well_damped: bool) -> [f64; 2] {
    if settings.accept_high_stiffness {
        return [f64::INFINITY; 2];
    }
    let late = delay + 0.5 / settings.rate;
    let least = if well_damped && late <= WELL_DAMPED_DELAY { WELL_DAMPED } else { 1.0 };
    [(GAIN_DELAY_BOUND / late).max(least), DAMPING_DELAY_BOUND / (late + settings.tracking.velocity_filter)]
}

/// Stiffness of axes that do not yield, translations and rotations; zero under the other laws.
pub(super) fn default_stiffness(model: &Model, settings: &Settings, servos: &ServoArrays) -> [f64; 2] {
    if settings.law != Law::Impedance {
        return [0.0; 2];
    }
    let stiffer = servos.kp_mean / REFERENCE_KP;
    let longer = if model.reach() > 0.0 { model.reach() / REFERENCE_REACH } else { 1.0 };
    [REFERENCE[0] * stiffer / (longer * longer), REFERENCE[1] * stiffer].map(workspace::round_to_halves)
}

/// Refuses given stiffness and damping that would ring in more than half of the poses.
///
/// The step reduces the gains further if a pose requires it, see [`rho`]. It also reduces the default stiffness of
/// other axes.
pub(super) fn check(model: &Model, settings: &Settings, plan: &Plan) -> Result<()> {
    let [most_stiff, most_damped] = plan.impedance_bounds;
    if let Some(stiffness) = settings.null_space.stiffness {
        let softest = plan.servos.kp[..plan.n].iter().copied().fold(f64::INFINITY, f64::min);
        let most = most_stiff * softest;
        if stiffness > most {
            let bound = format!("[0, {most:.3}]: {}", why(settings));
            return Err(Error::out_of_range("null_space.stiffness [N·m/rad]", stiffness, bound));
        }
    }
    let (mut stiffness, mut damping) = ([0.0; MAX_AXES], [0.0; MAX_AXES]);
    for (r, row) in plan.rows.iter().enumerate().take(plan.k) {
        if settings.axes[row.axis].stiffness.is_some() {
            stiffness[r] = row.stiffness[0].max(row.stiffness[1]);
        }
        damping[r] = row.viscosity[0].max(row.viscosity[1]);
    }
    for (field, units, asked, most) in [
        ("stiffness", ["N/m", "N·m/rad"], stiffness, most_stiff),
        ("damping", ["N·s/m", "N·m·s/rad"], damping, most_damped),
    ] {
        let ratio = overshoot(model, plan, &asked, most);
        if ratio > 1.0 {
            let listed = |value: &dyn Fn(usize) -> f64| {
                let rows = (0..plan.k).filter(|&r| asked[r] > 0.0).map(|r| (r, plan.rows[r].axis));
                let each = rows
                    .map(|(r, axis)| format!("{}={} {}", AXIS_NAMES[axis], value(r), units[usize::from(axis >= 3)]));
                each.collect::<Vec<_>>().join(", ")
            };
            let (given, nearest) = (listed(&|r| asked[r]), listed(&|r| floor_to_two_digits(asked[r] / ratio)));
            return Err(Error::config(
                format!("axes.{field}"),
                format!(
                    "{given} is {ratio:.2} times what the median pose can have, and {}: use {nearest}, shorten delay and \
                     period, or accept the risk: Settings(accept_high_stiffness=True)",
                    why(settings)
                ),
            ));
        }
    }
    Ok(())
}

/// Returns ρ of these gains in the median pose, divided by its bound.
fn overshoot(model: &Model, plan: &Plan, gains: &AxisVec, most: f64) -> f64 {
    if most.is_infinite() || gains.iter().all(|&gain| gain <= 0.0) {
        return 0.0;
    }
    let compliance = EveryJoint::load(&plan.servos.compliance);
    let of = |rows: &Rows| rho(&load_rows(rows), compliance, wide(gains));
    workspace::median_over_rows(model, &plan.axes, &plan.frame, of) / most
}

fn why(settings: &Settings) -> String {
    format!("with a delay of {} s at {} Hz a stiffer loop oscillates", settings.delay, settings.rate)
}

/// Rounds a value down to two significant digits.
fn floor_to_two_digits(value: f64) -> f64 {
    let step = 10.0_f64.powf(value.log10().floor() - 1.0);
    // Powers of ten below one are not exact: multiply so that the printed number has two digits.
    let digits = (value / step).floor();
    if step < 1.0 { digits / (1.0 / step).round() } else { digits * step }
}
