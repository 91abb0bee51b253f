//! Feasibility check: compares the settings with the capabilities of the arm in a pose or on a path, and names the
//! settings to change.

use crate::analysis::axis_strength::StepAnalysis;
use crate::analysis::display::number;
use crate::analysis::issues::{
    PathSingularity, PathStop, Worst, axis_issues, host_loss_issue, joint_issues, path_issues, stop_issues,
};
use crate::analysis::report::{at_rest, current_limits, host_loss_now, push_path};
use crate::controller::Controller;
use crate::error::{Error, Result};
use crate::kinematics::statics::static_force;
use crate::kinematics::{IkOptions, JointFrames};
use crate::math::rows::pad;
use crate::params::{AXIS_NAMES, Frame};
use crate::pose::Pose as ToolPose;

/// A pose counts as near singular if its smallest singular value σ_min is below this share of σ₀, the threshold of the
/// damping.
pub(super) const NEAR_SINGULAR: f64 = 0.1;

/// One requirement of the settings that the arm does not meet, or a note about a pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Issue {
    /// Index of the posture on the path for which the requirement is missed most.
    pub pose: usize,
    /// Subject of the issue: an axis with its side (`+y`), a joint, `σ_min` or `target`.
    pub about: String,
    /// True if the issue makes the path not achievable; false for notes, e.g. on a default value that is not met.
    pub required: bool,
    /// Explanation with the required and the available value.
    pub reason: String,
    /// Setting to change, e.g. `axes.y.firm`; `None` if no setting helps.
    pub setting: Option<String>,
    /// Nearest value of `setting` that works; `None` if it is not known.
    pub value: Option<f64>,
}

/// Result of a feasibility check of a path.
#[derive(Debug, Clone, PartialEq)]
pub struct FeasibilityReport {
    /// True if no issue is `required`: the arm can meet all values that the user set.
    pub achievable: bool,
    /// Number of postures checked.
    pub poses: usize,
    /// Issues found, those with `required` first.
    pub issues: Vec<Issue>,
    /// Names of the task axes; the entries of the vectors below follow this order.
    pub axes: Vec<&'static str>,
    /// Static force that the full usable torque holds along each axis against a push toward (−, +) [N, N·m]: the
    /// smallest over all postures.
    pub capacity: Vec<[f64; 2]>,
    /// Index of the posture with the smallest `capacity` for each axis and side.
    pub worst_pose: Vec<[usize; 2]>,
    /// Largest friction along each axis that the feed-forward does not compensate [N, N·m], over all postures; an axis
    /// with a smaller `soft` cannot track a moving target.
    pub friction_left: Vec<f64>,
    /// Smallest displacement of each axis, pushed toward (−, +), at which a joint reaches its position limit [m, rad];
    /// ∞ if no joint does within 0.15 m or 0.4 rad, and for sides that do not yield.
    pub stop_distance: Vec<[f64; 2]>,
    /// Smallest singular value of the scaled task rows over all postures.
    pub sigma_min: f64,
    /// Index of the posture with the singular value `sigma_min`.
    pub sigma_pose: usize,
    /// Smallest [`AxisReport::path_sigma`](crate::AxisReport::path_sigma) of each axis and side over all postures; ∞
    /// for sides that do not yield.
    pub path_sigma: Vec<[f64; 2]>,
}

/// Checks the settings in every posture [rad] of a path, with the arm at rest on its target. Does not change the
/// controller.
///
/// # Errors
/// As [`Controller::step`]; [`Error::Shape`] for an empty path.
///
/// ```
/// # use pliant_core::analysis::check_path;
/// # use pliant_core::{Axis, Controller, Model, ModelOptions, Servos, Settings};
/// # fn main() -> pliant_core::Result<()> {
/// # let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
/// # let model = std::sync::Arc::new(Model::from_urdf_str(include_str!("../../robots/arm7.urdf"), &options)?);
/// let mut settings = Settings::default();
/// settings.set_axes("z", Axis { hold: Some(500.0), ..Axis::default() })?; // [N]
/// let servos = Servos::new(vec![150.0], vec![10.7]);
/// let controller = Controller::new(model.clone(), settings, Some(servos))?;
///
/// let check = check_path(&controller, &[vec![-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17]])?;
/// assert!(!check.achievable);
/// let issue = &check.issues[0];
/// assert_eq!(issue.setting.as_deref(), Some("axes.z.hold"));
/// # Ok(())
/// # }
/// ```
pub fn check_path(controller: &Controller, path: &[Vec<f64>]) -> Result<FeasibilityReport> {
    if path.is_empty() {
        let expected = format!("(N, {}) with N of at least 1", controller.params.n);
        return Err(Error::Shape { what: "path".into(), got: format!("(0, {})", controller.params.n), expected });
    }
    for (index, q) in path.iter().enumerate() {
        controller.joint_target("q", q).map_err(|error| error.in_row("path", index))?;
    }
    let (k, n, torque) = (controller.params.k, controller.params.n, controller.params.servos.torque);
    let mut capacity_deficit = vec![[Worst::NONE; 2]; k];
    let mut friction_left = vec![Worst::NONE; k];
    let mut near = vec![[(Worst::NONE, None); 2] as [PathStop; 2]; k];
    let mut past = vec![[(Worst::NONE, None); 2] as [PathSingularity; 2]; k];
    let (mut weight, mut limit, mut outside) = (vec![Worst::NONE; n], vec![Worst::NONE; n], vec![Worst::NONE; n]);
    let mut singular = Worst::NONE;
    let mut host_loss = (Worst::NONE, 0, 1.0);
    for (index, q) in path.iter().enumerate() {
        let rest = at_rest(controller, q)?;
        let (record, limits) = (&rest.diagnostics(), current_limits(&rest));
        let pose = StepAnalysis::new(&rest.params, rest.settings(), record);
        let friction = pose.friction();
        let mut frames = JointFrames::default();
        rest.model().chain().forward(&record.q, &mut frames);
        let static_friction = std::array::from_fn(|i| rest.params.servos.friction_at_rest(i, record.gravity[i]));
        let push_path = push_path(&rest, &frames, &static_friction);
        if controller.params.max_host_loss_force.is_some() {
            let goal = pad(rest.command.goal(), 0.0);
            let (force, row, sign) =
                host_loss_now(&rest, &frames, &goal, &limits, &static_friction).worst_push(f64::INFINITY);
            if force > host_loss.0.value {
                host_loss = (Worst { value: force, pose: index }, row, sign);
            }
        }
        for r in 0..k {
            for (side, sign) in [-1.0, 1.0].into_iter().enumerate() {
                let force = static_force(&record.rows[r], sign, &torque, &record.gravity, n);
                capacity_deficit[r][side].update(-force, index);
                if rest.params.per_axis[r].yields[side] <= 0.0 {
                    continue;
                }
                let push = push_path.simulate(r, sign);
                if -push.sigma > past[r][side].0.value {
                    let worst = Worst { value: -push.sigma, pose: index };
                    past[r][side] = (worst, Some((push, friction[r])));
                }
                if let Some(stop) = push.stop
                    && -stop.distance > near[r][side].0.value
                {
                    let worst = Worst { value: -stop.distance, pose: index };
                    near[r][side] = (worst, Some((stop.joint, pose.full_cap_deviation(r, side))));
                }
            }
            friction_left[r].update(pose.friction_left(r, friction[r]), index);
        }
        for i in 0..n {
            weight[i].update(record.gravity[i].abs() - torque[i], index);
            limit[i].update(record.gravity[i].abs() - limits[i], index);
            outside[i].update((controller.params.lower[i] - q[i]).max(q[i] - controller.params.upper[i]), index);
        }
        singular.update(-rest.sigma_range()[0], index);
    }
    let mut issues = joint_issues(controller, &weight, &limit, &outside);
    for r in 0..k {
        axis_issues(controller, r, capacity_deficit[r], friction_left[r], &mut issues);
        stop_issues(controller, r, near[r], &mut issues);
        path_issues(controller, r, past[r], &mut issues);
    }
    issues.extend(host_loss_issue(controller, host_loss.0, host_loss.1, host_loss.2));
    let least = NEAR_SINGULAR * controller.params.damping.sigma_0;
    if -singular.value < least {
        issues.push(Issue {
            pose: singular.pose,
            about: "σ_min".into(),
            required: false,
            reason: format!(
                "{} is near a singular pose (below {}): some axis moves late",
                number(-singular.value),
                number(least)
            ),
            setting: None,
            value: None,
        });
    }
    let (mut issues, hints): (Vec<_>, Vec<_>) = issues.into_iter().partition(|issue| issue.required);
    issues.extend(hints);
    Ok(FeasibilityReport {
        achievable: !issues.iter().any(|issue| issue.required),
        poses: path.len(),
        issues,
        axes: controller.params.axes.iter().map(|&axis| AXIS_NAMES[axis]).collect(),
        capacity: capacity_deficit.iter().map(|sides| sides.map(|worst| -worst.value)).collect(),
        worst_pose: capacity_deficit.iter().map(|sides| sides.map(|worst| worst.pose)).collect(),
        friction_left: friction_left.iter().map(|worst| worst.value).collect(),
        stop_distance: near.iter().map(|sides| sides.map(|(worst, _)| -worst.value)).collect(),
        sigma_min: -singular.value,
        sigma_pose: singular.pose,
        path_sigma: past.iter().map(|sides| sides.map(|(worst, _)| -worst.value)).collect(),
    })
}

/// Checks the settings in a pose of the tool, whose joint positions are found by inverse kinematics from `q0`
/// [rad]. A pose out of reach is an issue, not an error.
///
/// # Errors
/// As [`Controller::step`].
pub fn check_pose(controller: &Controller, target: &ToolPose, q0: &[f64]) -> Result<FeasibilityReport> {
    controller.check_target("target", target)?;
    let task = &controller.settings().task;
    let mut axes = task.axes;
    if task.frame != Frame::Base {
        for block in axes.chunks_mut(3) {
            let on = block.iter().any(|&on| on);
            block.fill(on);
        }
    }
    let options = IkOptions { axes, position_tolerance: 1e-6, rotation_tolerance: 1e-6, ..IkOptions::default() };
    let found = controller.model().inverse_kinematics(target, q0, &options)?;
    let mut check = check_path(controller, &[found.q])?;
    if !found.converged {
        check.achievable = false;
        let issue = Issue {
            pose: 0,
            about: "target".into(),
            required: true,
            reason: format!(
                "the arm comes no closer than {:.1} mm and {:.3} rad: {}",
                1e3 * found.position_error,
                found.rotation_error,
                found.reason
            ),
            setting: None,
            value: None,
        };
        check.issues.insert(0, issue);
    }
    Ok(check)
}
