//! Creates the issues of a feasibility check from the worst values along a path.

use crate::analysis::check::{Issue, NEAR_SINGULAR};
use crate::analysis::display::{displacement, number, unit};
use crate::analysis::push_path::PathResult;
use crate::controller::Controller;
use crate::math::rounding::{round_down, round_up};
use crate::params::AXIS_NAMES;

/// Largest value along a path, and the index of its posture. A quantity whose smallest value is the worst is stored
/// negated.
#[derive(Clone, Copy)]
pub(super) struct Worst {
    pub(super) value: f64,
    pub(super) pose: usize,
}

impl Worst {
    pub(super) const NONE: Self = Self { value: f64::NEG_INFINITY, pose: 0 };

    pub(super) fn update(&mut self, value: f64, pose: usize) {
        if value > self.value {
            *self = Self { value, pose };
        }
    }
}

/// Smallest [`PathResult::sigma`] (negated) over the postures of a path, with that push and the friction along the axis
/// at its start [N, N·m].
pub(super) type PathSingularity = (Worst, Option<(PathResult, f64)>);

/// Smallest displacement at which a push reaches a joint stop [m, rad] (negated) over the postures of a path, with the
/// index of the joint and the deviation at which the axis exerts its full strength [m, rad].
pub(super) type PathStop = (Worst, Option<(usize, f64)>);

pub(super) fn joint_issues(
    controller: &Controller,
    weight: &[Worst],
    limit: &[Worst],
    outside: &[Worst],
) -> Vec<Issue> {
    let mut out = Vec::new();
    for (i, name) in controller.model().joint_names().iter().enumerate() {
        let mut add = |worst: Worst, reason: String, setting: Option<&str>, value: Option<f64>| {
            let (about, setting) = (name.clone(), setting.map(Into::into));
            out.push(Issue { pose: worst.pose, about, required: true, reason, setting, value });
        };
        if outside[i].value > 1e-6 {
            add(outside[i], format!("is {} rad beyond its position limit", number(outside[i].value)), None, None);
        }
        let usable = controller.params.servos.torque[i];
        if weight[i].value > 0.0 {
            let needs = usable + weight[i].value;
            add(
                weight[i],
                format!(
                    "needs {} N·m to hold the arm, the servo has {}: another pose or less payload",
                    number(needs),
                    number(usable)
                ),
                None,
                None,
            );
        } else if limit[i].value > 0.0 {
            let missing = number(limit[i].value);
            add(
                limit[i],
                format!(
                    "cannot hold the arm: its limit is {missing} N·m short of its load; include gravity in the limits (gravity=True)"
                ),
                Some("gravity"),
                None,
            );
        }
    }
    out
}

/// Adds an issue for each side on which a push reaches a joint stop before the axis exerts its full strength; the force
/// of the stop then adds to that of the axis.
pub(super) fn stop_issues(controller: &Controller, r: usize, near: [PathStop; 2], out: &mut Vec<Issue>) {
    if !controller.params.law.by_force() {
        return; // The strengths of law `paper` are torque budgets, which cannot be compared with the force of a stop.
    }
    let axis = controller.params.per_axis[r].axis;
    let name = AXIS_NAMES[axis];
    for (side, (worst, what)) in near.into_iter().enumerate() {
        let distance = -worst.value;
        if let Some((joint, full)) = what.filter(|&(_, full)| distance < full) {
            out.push(Issue {
                pose: worst.pose,
                about: format!("{}{name}", ["−", "+"][side]),
                required: false,
                reason: format!(
                    "{} meets its position limit when the axis is pushed by {}, before it gives its whole cap at {}: \
                     from there the stop takes part of a push",
                    controller.model().joint_names()[joint],
                    displacement(axis, distance),
                    displacement(axis, full)
                ),
                setting: None,
                value: None,
            });
        }
    }
}

/// Adds an issue for each side on which a push leads to a point that is near singular: with a smallest singular value
/// below [`NEAR_SINGULAR`] times σ₀.
pub(super) fn path_issues(controller: &Controller, r: usize, past: [PathSingularity; 2], out: &mut Vec<Issue>) {
    let (axis, least) = (controller.params.per_axis[r].axis, NEAR_SINGULAR * controller.params.damping.sigma_0);
    for (side, (worst, what)) in past.into_iter().enumerate() {
        if let Some((push, friction)) = what.filter(|(push, _)| push.sigma < least && push.at > 0.0) {
            out.push(Issue {
                pose: worst.pose,
                about: format!("{}{}", ["−", "+"][side], AXIS_NAMES[axis]),
                required: false,
                reason: format!(
                    "pushed by {} the arm is near a singular pose (σ_min {}, below {}), where joint friction along \
                     the axis is {} {unit} instead of {} {unit}",
                    displacement(axis, push.at),
                    number(push.sigma),
                    number(least),
                    number(push.friction),
                    number(friction),
                    unit = unit(axis),
                ),
                setting: None,
                value: None,
            });
        }
    }
}

/// Returns an issue if the force on a hand after a host loss exceeds its bound although the torque limits hold no more
/// than the arm's weight; otherwise `None`.
pub(super) fn host_loss_issue(controller: &Controller, worst: Worst, row: usize, sign: f64) -> Option<Issue> {
    let max = controller.params.max_host_loss_force.filter(|max| worst.value > max * (1.0 + 1e-9))?;
    Some(Issue {
        pose: worst.pose,
        about: format!("{}{}", if sign < 0.0 { "−" } else { "+" }, AXIS_NAMES[controller.params.per_axis[row].axis]),
        required: true,
        reason: format!(
            "torque_limits.max_host_loss_force is {} N, but limits that just hold the arm leave {} N to a hand",
            number(max),
            number(worst.value)
        ),
        setting: Some("torque_limits.max_host_loss_force".into()),
        value: Some(round_up(worst.value)),
    })
}

pub(super) fn axis_issues(
    controller: &Controller,
    r: usize,
    capacity_deficit: [Worst; 2],
    friction_left: Worst,
    out: &mut Vec<Issue>,
) {
    if !controller.params.law.by_force() {
        return; // The strengths of law `paper` are torque budgets, which cannot be compared with forces.
    }
    let row = &controller.params.per_axis[r];
    let (name, user, unit) = (AXIS_NAMES[row.axis], &controller.settings().axes[row.axis], unit(row.axis));
    for side in 0..2 {
        let (has, about) = (-capacity_deficit[side].value, format!("{}{name}", ["−", "+"][side]));
        let asked: &[(&str, f64, bool)] = if row.yields[side] > 0.0 {
            &[("firm", row.firm[side], user.firm.is_some()), ("soft", row.soft[side], user.soft.is_some())]
        } else {
            &[("hold", row.hold, user.hold.is_some())]
        };
        for &(field, strength, required) in asked {
            if strength > has {
                let max = round_down(has).max(0.0);
                out.push(Issue {
                    pose: capacity_deficit[side].pose,
                    about: about.clone(),
                    required,
                    reason: format!(
                        "{field} is {} {unit}, the servos' torque ends at {} {unit}",
                        number(strength),
                        number(has)
                    ),
                    setting: (has > 0.0).then(|| format!("axes.{name}.{field}")),
                    value: (has > 0.0).then_some(max),
                });
            }
        }
        if row.yields[side] > 0.0 && row.soft[side] < friction_left.value {
            out.push(Issue {
                pose: friction_left.pose,
                about,
                required: user.soft.is_some(),
                reason: format!(
                    "soft is {} {unit}, friction leaves {} {unit}: it cannot track",
                    number(row.soft[side]),
                    number(friction_left.value)
                ),
                setting: Some(format!("axes.{name}.soft")),
                value: Some(round_up(friction_left.value)),
            });
        }
    }
}
