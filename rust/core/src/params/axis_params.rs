//! Parameters of the task axes, defaults filled in.

use crate::MAX_AXES;
use crate::error::{Error, Result};
use crate::model::Model;
use crate::params::impedance::default_stiffness;
use crate::params::workspace::Surveyed;
use crate::params::{AXIS_NAMES, Axis, Law, OnDeviationLimit, Profile, ServoArrays, Settings, Yields, workspace};

/// Largest η without a known `k_p` or a captured gravity offset: above it a gravity error makes the arm drift.
const ETA_UNPROVEN: f64 = 0.95;

/// Parameters of one task axis, defaults filled in.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row {
    /// Index among x, y, z, roll, pitch, yaw.
    pub(crate) axis: usize,
    pub(crate) soft: [f64; 2],
    pub(crate) firm: [f64; 2],
    pub(crate) hold: f64,
    /// The default of `hold` before soft and firm raised it.
    pub(crate) raised_from: Option<f64>,
    pub(crate) yields: [f64; 2],
    /// Spring [N/m, N·m/rad] and damper [N·s/m, N·m·s/rad]; zero except under law `impedance`.
    pub(crate) stiffness: [f64; 2],
    pub(crate) viscosity: [f64; 2],
    pub(crate) eta: f64,
    pub(crate) soft_until: f64,
    pub(crate) firm_from: f64,
    /// Half-width [m or rad] of the transition between the sides.
    pub(crate) band: f64,
    pub(crate) profile: Profile,
    pub(crate) step_limit: f64,
    pub(crate) soft_step_limit: f64,
}

/// Deviation limit of one axis.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DeviationLimit {
    /// Index among x, y, z, roll, pitch, yaw.
    pub(crate) axis: usize,
    /// Largest deviation [m or rad] when pushed toward (−, +); ∞ for a side that yields.
    pub(crate) most: [f64; 2],
    pub(crate) reaction: OnDeviationLimit,
}

/// Returns the axes with a deviation limit; usually none.
pub(super) fn deviation_limits(settings: &Settings, axes: &[usize]) -> Vec<DeviationLimit> {
    let of = |&axis: &usize| {
        let given = &settings.axes[axis];
        given.deviation_limit.map(|limit| DeviationLimit {
            axis,
            most: given.effective_yields().sides().map(|on| if on { f64::INFINITY } else { limit }),
            reaction: given.on_deviation_limit,
        })
    };
    axes.iter().filter_map(of).collect()
}

/// Default strengths: soft, firm, hold of translations and rotations.
fn default_strengths(
    model: &Model,
    settings: &Settings,
    servos: &ServoArrays,
    surveyed: &mut Surveyed,
) -> [[f64; 3]; 2] {
    match settings.law {
        Law::Paper => [[0.5, 10.0, 10.0]; 2],
        Law::Cap | Law::Impedance => {
            let capacity = surveyed.static_capacity(model, &servos.torque);
            let of = |shares: [f64; 3], capacity: f64| shares.map(|share| workspace::round_to_halves(share * capacity));
            [of([0.12, 0.45, 1.2], capacity[0]), of([0.105, 0.2, 0.53], capacity[1])]
        }
    }
}

/// Checks the default strengths: they are zero for an arm that cannot hold itself in most poses.
fn check_defaults(settings: &Settings, axes: &[usize], defaults: &[[f64; 3]; 2]) -> Result<()> {
    for &axis in axes {
        let (given, strengths) = (&settings.axes[axis], &defaults[usize::from(axis >= 3)]);
        let left_out = given.hold.is_none() || (given.effective_yields() != Yields::None && given.soft.is_none());
        if left_out && strengths[2] <= 0.0 {
            return Err(Error::config(
                format!("axes.{}", AXIS_NAMES[axis]),
                "no default strength: in the median of 512 poses gravity takes all the torque that the servos have; \
                 check servos.max_torque [N·m] and the masses, or give soft, firm and hold",
            ));
        }
    }
    Ok(())
}

pub(super) fn resolve_rows(
    model: &Model,
    settings: &Settings,
    servos: &ServoArrays,
    axes: &[usize],
    stiffness_known: bool,
    surveyed: &mut Surveyed,
) -> Result<[Row; MAX_AXES]> {
    let given = |axis: &Axis| axis.soft.is_some() && axis.firm.is_some() && axis.hold.is_some();
    let defaults = if axes.iter().all(|&axis| given(&settings.axes[axis])) {
        [[0.0; 3]; 2]
    } else {
        default_strengths(model, settings, servos, surveyed)
    };
    check_defaults(settings, axes, &defaults)?;
    let springs = default_stiffness(model, settings, servos);
    let mut rows = [None; MAX_AXES];
    for (slot, &axis) in rows.iter_mut().zip(axes) {
        let block = usize::from(axis >= 3);
        *slot = Some(resolve_row(settings, axis, defaults[block], springs[block], stiffness_known)?);
    }
    let spare = resolve_row(&Settings::default(), 0, [0.0; 3], 0.0, true)?;
    Ok(rows.map(|row| row.unwrap_or(spare)))
}

fn resolve_row(
    settings: &Settings,
    axis: usize,
    defaults: [f64; 3],
    spring: f64,
    stiffness_known: bool,
) -> Result<Row> {
    let (given, name) = (&settings.axes[axis], AXIS_NAMES[axis]);
    let paper = settings.law == Law::Paper;
    let [soft, firm, hold] = defaults;
    // Default values adapt to the given ones.
    let soft = given.soft.unwrap_or_else(|| given.firm.map_or([soft; 2], |firm| firm.map(|f| f.min(soft))));
    let firm = given.firm.unwrap_or_else(|| soft.map(|s| s.max(firm)));
    let least = firm[0].max(firm[1]);
    let raised_from = (given.hold.is_none() && least > hold).then_some(hold);
    let hold = given.hold.unwrap_or_else(|| least.max(hold));
    let yields = given.effective_yields();
    for side in 0..2 {
        let pushed = ["−", "+"][side];
        if yields.sides()[side] && !(soft[side] <= firm[side] && firm[side] <= hold) {
            return Err(Error::config(
                format!("axes.{name}"),
                format!(
                    "needs soft ≤ firm ≤ hold, got soft={}, firm={}, hold={hold} pushed toward {pushed}",
                    soft[side], firm[side]
                ),
            ));
        }
    }
    if !paper && given.adaptation > ETA_UNPROVEN && !stiffness_known && !settings.accept_high_adaptation {
        return Err(Error::out_of_range(
            format!("axes.{name}.adaptation"),
            given.adaptation,
            format!(
                "[0, {ETA_UNPROVEN}] while k_p is not known within 10 %: a gravity error would make the arm drift. \
                 Identify k_p (Servos(..., stiffness_known=True)), capture gravity, or accept the risk: Settings(accept_high_adaptation=True)"
            ),
        ));
    }
    let translation = axis < 3;
    let soft_until = given.soft_until.unwrap_or(if translation { 0.01 } else { 0.04 });
    let firm_from = given.firm_from.unwrap_or(if translation { 0.10 } else { 0.40 });
    if soft_until >= firm_from {
        return Err(Error::out_of_range(
            format!("axes.{name}.soft_until"),
            soft_until,
            format!("[0, firm_from = {firm_from})"),
        ));
    }
    let soft_step = match (paper, translation) {
        (true, true) => 0.1,
        (true, false) => 0.5,
        (false, _) => f64::INFINITY,
    };
    Ok(Row {
        axis,
        soft,
        firm,
        hold,
        raised_from,
        yields: yields.sides().map(|on| f64::from(u8::from(on))),
        stiffness: given.stiffness.unwrap_or_else(|| yields.sides().map(|on| if on { 0.0 } else { spring })),
        viscosity: given.damping.unwrap_or_default(),
        eta: given.adaptation,
        soft_until,
        firm_from,
        band: soft_until * settings.paper_options.direction_band.unwrap_or(if paper { 0.0 } else { 0.1 }),
        profile: given.profile,
        step_limit: given.max_velocity.unwrap_or(if translation { 0.4 } else { 2.0 }),
        soft_step_limit: given.soft_step_limit.unwrap_or(soft_step),
    })
}
