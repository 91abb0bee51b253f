//! Stiffness of law `impedance`: defaults, and what delay and servos allow.

use crate::MAX_AXES;
use crate::error::{Error, Result};
use crate::law::impedance::rho;
use crate::model::Model;
use crate::plan::{GAIN_DELAY_BOUND, Plan, REFERENCE_REACH};
use crate::servos::ServoArrays;
use crate::settings::{Law, Settings};
use crate::survey;
use crate::task::axes::AXIS_NAMES;

/// Stiffness of translations [N/m] and rotations [N·m/rad] of the arm on which they were found, and its mean k_p.
const REFERENCE: [f64; 2] = [800.0, 20.0];
const REFERENCE_KP: f64 = 780.0 / 7.0;

/// Largest ρ at a delay [s]: `max(1, 0.03 s / T_e)` with half a period added to the delay.
pub(super) fn bound(settings: &Settings, delay: f64) -> f64 {
    if settings.accept.iter().any(|risk| risk == "stiffness") {
        return f64::INFINITY;
    }
    (GAIN_DELAY_BOUND / (delay + 0.5 / settings.rate)).max(1.0)
}

/// Stiffness of axes that do not yield, translations and rotations; zero under the other laws.
pub(super) fn default_stiffness(model: &Model, settings: &Settings, servos: &ServoArrays) -> [f64; 2] {
    if settings.law != Law::Impedance {
        return [0.0; 2];
    }
    let stiffer = servos.kp_mean / REFERENCE_KP;
    let longer = if model.reach() > 0.0 { model.reach() / REFERENCE_REACH } else { 1.0 };
    [REFERENCE[0] * stiffer / (longer * longer), REFERENCE[1] * stiffer].map(survey::round_to_halves)
}

/// Refuses stiffness that was asked for and that more than half of the poses could not have: it would ring there.
///
/// What a pose demands beyond that is taken off tick by tick, see [`rho`]; so is the default stiffness of other axes.
pub(super) fn check(model: &Model, settings: &Settings, plan: &Plan) -> Result<()> {
    let most = plan.stiffness_bound;
    if let Some(stiffness) = settings.null_stiffness {
        let softest = plan.servos.kp[..plan.n].iter().copied().fold(f64::INFINITY, f64::min);
        if stiffness > most * softest {
            return Err(Error::limit(
                "null_stiffness [N·m/rad]",
                stiffness,
                format!("[0, {:.3}]: {}", most * softest, why(settings)),
            ));
        }
    }
    let mut asked = [0.0; MAX_AXES];
    for (slot, row) in asked.iter_mut().zip(&plan.rows).take(plan.k) {
        if settings.axes[row.axis].stiffness.is_some() {
            *slot = row.stiffness[0].max(row.stiffness[1]);
        }
    }
    if most.is_infinite() || asked.iter().all(|&stiffness| stiffness <= 0.0) {
        return Ok(());
    }
    let compliance = &plan.servos.compliance;
    let median =
        survey::median_over_rows(model, &plan.axes, &plan.frame, |rows| rho(rows, compliance, &asked, plan.k, plan.n));
    if median <= most {
        return Ok(());
    }
    let nearest: Vec<String> = plan
        .rows
        .iter()
        .zip(asked)
        .filter(|&(_, stiffness)| stiffness > 0.0)
        .map(|(row, stiffness)| {
            let unit = if row.axis < 3 { "N/m" } else { "N·m/rad" };
            format!("{}={} {unit}", AXIS_NAMES[row.axis], floor_to_two_digits(stiffness * most / median))
        })
        .collect();
    Err(Error::config(
        "axes.stiffness",
        format!(
            "is {median:.2} times the servos' own in the median pose, and {}, at most {most:.2} times: use {}, shorten delay \
             and period, or take the risk by name: Settings(accept=(\"stiffness\",))",
            why(settings),
            nearest.join(", ")
        ),
    ))
}

fn why(settings: &Settings) -> String {
    format!("with a delay of {} s at {} Hz a stiffer loop oscillates", settings.delay, settings.rate)
}

/// A value rounded down to two significant digits.
fn floor_to_two_digits(value: f64) -> f64 {
    let step = 10.0_f64.powf(value.log10().floor() - 1.0);
    // Powers of ten below one are not exact: print what was meant.
    let digits = (value / step).floor();
    if step < 1.0 { digits / (1.0 / step).round() } else { digits * step }
}
