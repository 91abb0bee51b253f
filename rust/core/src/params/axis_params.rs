//! Parameters of the task axes, with defaults filled in.

use crate::error::{Error, Result};
use crate::math::rounding;
use crate::model::Model;
use crate::params::impedance::default_stiffness;
use crate::params::joint_space::{self, JointSpaceStats};
use crate::params::{AXIS_NAMES, Axis, CompliantSide, OnDeviationLimit, Profile, ServoArrays, Settings};
use crate::{JointVec, MAX_AXES};

/// Largest adaptation η if neither `k_p` is known nor a gravity offset was captured: with a larger η, a gravity error
/// would make the arm drift.
const MAX_UNVERIFIED_ETA: f64 = 0.95;

/// Strengths of one task axis [N, N·m; N·m under law `paper`]; pairs are (pushed toward −, pushed toward +).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisStrength {
    /// Strength of a yielding side at a small deviation.
    pub soft: [f64; 2],
    /// Strength of a yielding side at a large deviation.
    pub firm: [f64; 2],
    /// Strength of a side that does not yield.
    pub hold: f64,
}

/// Spring and damper of one task axis under law `impedance`; pairs are (pushed toward −, pushed toward +).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxisImpedance {
    /// Stiffness [N/m, N·m/rad].
    pub stiffness: [f64; 2],
    /// Damping [N·s/m, N·m·s/rad].
    pub damping: [f64; 2],
}

/// Parameters of one task axis, with defaults filled in; pairs are (pushed toward −, pushed toward +).
#[derive(Debug, Clone, Copy)]
pub(crate) struct AxisParams {
    /// Index of the axis among x, y, z, roll, pitch, yaw.
    pub(crate) axis: usize,
    /// Strength of a yielding side at a small deviation [N, N·m; N·m under law `paper`].
    pub(crate) soft: [f64; 2],
    /// Strength of a yielding side at a large deviation [N, N·m; N·m under law `paper`].
    pub(crate) firm: [f64; 2],
    /// Strength of a side that does not yield [N, N·m; N·m under law `paper`].
    pub(crate) hold: f64,
    /// Default of `hold` before a larger `firm` raised it; `None` if it was not raised.
    pub(crate) default_hold: Option<f64>,
    /// 1 for a side that yields, else 0.
    pub(crate) yields: [f64; 2],
    /// Stiffness [N/m, N·m/rad]; 0 except under law `impedance`.
    pub(crate) stiffness: [f64; 2],
    /// Damping [N·s/m, N·m·s/rad]; 0 except under law `impedance`.
    pub(crate) damping: [f64; 2],
    /// Target adaptation η.
    pub(crate) eta: f64,
    /// Deviation [m or rad] below which the compliance is 1.
    pub(crate) soft_until: f64,
    /// Deviation [m or rad] above which the compliance is 0.
    pub(crate) firm_from: f64,
    /// Half-width [m or rad] of the band around deviation zero in which the axis blends between its sides.
    pub(crate) band: f64,
    /// Strength as a function of the deviation.
    pub(crate) profile: Profile,
    /// Limit of the commanded velocity of the stiff axis [m/s or rad/s].
    pub(crate) step_limit: f64,
    /// Limit of the commanded velocity of the yielding axis [m/s or rad/s].
    pub(crate) soft_step_limit: f64,
}

impl AxisParams {
    /// Returns true if the axis yields to a push in either direction.
    pub(crate) fn is_compliant(&self) -> bool {
        self.yields.iter().any(|&side| side > 0.0)
    }
}

/// Deviation limit of one task axis.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DeviationLimit {
    /// Index of the axis among x, y, z, roll, pitch, yaw.
    pub(crate) axis: usize,
    /// Largest deviation [m or rad] while pushed toward (−, +); ∞ for a side that yields.
    pub(crate) max: [f64; 2],
    /// Behaviour of the target beyond the limit.
    pub(crate) reaction: OnDeviationLimit,
}

/// Returns the deviation limits of the axes that have one.
pub(super) fn deviation_limits(settings: &Settings, axes: &[usize]) -> Vec<DeviationLimit> {
    let of = |&axis: &usize| {
        let user = &settings.axes[axis];
        user.deviation_limit.map(|limit| DeviationLimit {
            axis,
            max: user.compliant_side().sides().map(|on| if on { f64::INFINITY } else { limit }),
            reaction: user.on_deviation_limit,
        })
    };
    axes.iter().filter_map(of).collect()
}

/// Returns the default strengths soft, firm and hold, of translations and of rotations [N, N·m; N·m under law `paper`].
fn default_strengths(
    model: &Model,
    settings: &Settings,
    servos: &ServoArrays,
    joint_space_stats: &mut JointSpaceStats,
) -> [[f64; 3]; 2] {
    if !settings.law.by_force() {
        return [[0.5, 10.0, 10.0]; 2];
    }
    let capacity = joint_space_stats.static_capacity(model, &servos.torque);
    let of = |shares: [f64; 3], capacity: f64| shares.map(|share| rounding::round_to_halves(share * capacity));
    [of([0.12, 0.45, 1.2], capacity[0]), of([0.105, 0.2, 0.53], capacity[1])]
}

/// Returns an error if an axis uses a default strength that is zero, as for an arm that cannot hold its own weight in
/// most configurations.
fn check_defaults(
    model: &Model,
    settings: &Settings,
    usable: &JointVec,
    axes: &[usize],
    defaults: &[[f64; 3]; 2],
) -> Result<()> {
    for &axis in axes {
        let (user, strengths) = (&settings.axes[axis], &defaults[usize::from(axis >= 3)]);
        let left_out = user.hold.is_none() || (user.compliant_side() != CompliantSide::None && user.soft.is_none());
        if left_out && strengths[2] <= 0.0 {
            let payload =
                model.payload().map_or(String::new(), |payload| format!(" of the payload ({} kg)", payload.mass));
            return Err(Error::config(
                format!("axes.{}", AXIS_NAMES[axis]),
                format!(
                    "no default strength, because gravity takes all the torque that the servos have in the median of \
                     512 poses{}: check masses [kg] and centres of mass [m]{payload}, and servos.max_torque [N·m], or \
                     give soft, firm and hold",
                    joint_space::excess_weight(model, usable)
                ),
            ));
        }
    }
    Ok(())
}

/// Returns the parameters of each task axis, padded to six rows; an error for inconsistent settings.
pub(super) fn resolve_rows(
    model: &Model,
    settings: &Settings,
    servos: &ServoArrays,
    axes: &[usize],
    stiffness_known: bool,
    joint_space_stats: &mut JointSpaceStats,
) -> Result<[AxisParams; MAX_AXES]> {
    let is_complete = |axis: &Axis| axis.soft.is_some() && axis.firm.is_some() && axis.hold.is_some();
    let defaults = if axes.iter().all(|&axis| is_complete(&settings.axes[axis])) {
        [[0.0; 3]; 2]
    } else {
        default_strengths(model, settings, servos, joint_space_stats)
    };
    check_defaults(model, settings, &servos.torque, axes, &defaults)?;
    let springs = default_stiffness(model, settings, servos, axes);
    let mut rows = [None; MAX_AXES];
    for (slot, &axis) in rows.iter_mut().zip(axes) {
        let block = usize::from(axis >= 3);
        *slot = Some(resolve_row(settings, axis, defaults[block], springs[block], stiffness_known)?);
    }
    let spare = resolve_row(&Settings::default(), 0, [0.0; 3], 0.0, true)?;
    Ok(rows.map(|row| row.unwrap_or(spare)))
}

/// Returns the upper bound of the adaptation η: 0.95 if a gravity error could make the arm drift, else 1 (η itself
/// stays below 1).
pub(crate) fn max_adaptation(settings: &Settings, stiffness_known: bool) -> f64 {
    let safe = !settings.law.by_force() || stiffness_known || settings.accept_high_adaptation;
    if safe { 1.0 } else { MAX_UNVERIFIED_ETA }
}

fn resolve_row(
    settings: &Settings,
    axis: usize,
    defaults: [f64; 3],
    spring: f64,
    stiffness_known: bool,
) -> Result<AxisParams> {
    let (user, name) = (&settings.axes[axis], AXIS_NAMES[axis]);
    let paper = !settings.law.by_force();
    let [soft, firm, hold] = defaults;
    // Adjust the defaults to the values that the user has set, so that soft ≤ firm ≤ hold.
    let soft = user.soft.unwrap_or_else(|| user.firm.map_or([soft; 2], |firm| firm.map(|f| f.min(soft))));
    let firm = user.firm.unwrap_or_else(|| soft.map(|s| s.max(firm)));
    let least = firm[0].max(firm[1]);
    let default_hold = (user.hold.is_none() && least > hold).then_some(hold);
    let hold = user.hold.unwrap_or_else(|| least.max(hold));
    let yields = user.compliant_side();
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
    if user.adaptation > max_adaptation(settings, stiffness_known) {
        return Err(Error::out_of_range(
            format!("axes.{name}.adaptation"),
            user.adaptation,
            format!(
                "[0, {MAX_UNVERIFIED_ETA}] while k_p is not known within 10 %: a gravity error would make the arm drift. \
                 Identify k_p (Servos(..., stiffness_known=True)), capture gravity, or accept the risk: Settings(accept_high_adaptation=True)"
            ),
        ));
    }
    let translation = axis < 3;
    let soft_until = user.soft_until.unwrap_or(if translation { 0.01 } else { 0.04 });
    let firm_from = user.firm_from.unwrap_or(if translation { 0.10 } else { 0.40 });
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
    Ok(AxisParams {
        axis,
        soft,
        firm,
        hold,
        default_hold,
        yields: yields.sides().map(|on| f64::from(u8::from(on))),
        stiffness: user.stiffness.unwrap_or_else(|| yields.sides().map(|on| if on { 0.0 } else { spring })),
        damping: user.damping.unwrap_or_default(),
        eta: user.adaptation,
        soft_until,
        firm_from,
        band: soft_until * settings.paper_options.direction_band.unwrap_or(if paper { 0.0 } else { 0.1 }),
        profile: user.profile,
        step_limit: user.max_velocity.unwrap_or(if translation { 0.4 } else { 2.0 }),
        soft_step_limit: user.soft_step_limit.unwrap_or(soft_step),
    })
}
