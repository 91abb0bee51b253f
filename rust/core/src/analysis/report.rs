//! Report on the capabilities of the present pose and settings, in numbers and in sentences.
//!
//! Not for the control step, but fast enough to run beside the loop. Sides are named by the push: the first number of a
//! pair is for a push toward −, the second for a push toward +.

use crate::command::host_loss::HostLoss;
use crate::controller::{Controller, StepInput};
use crate::error::{Error, Result};
use crate::kinematics::JointFrames;
use crate::kinematics::statics::static_force;
use crate::math::rows::pad;
use crate::params::{AXIS_NAMES, Law, OnDeviationLimit};
use crate::pose::COORDINATE_BOUND;
use crate::{JointVec, MAX_JOINTS};

use crate::analysis::axis_strength::StepAnalysis;
use crate::analysis::push_path::{JointStop, PushPath};

/// Capabilities of one pose with the current settings.
///
/// Vectors have one entry per joint.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseReport {
    /// One entry per task axis, in the order of the task.
    pub axes: Vec<AxisReport>,
    /// Names of the joints.
    pub joints: Vec<String>,
    /// Control law.
    pub law: Law,
    /// Joint positions of the report [rad].
    pub q: Vec<f64>,
    /// Torque limits in this pose [N·m].
    pub torque_limit: Vec<f64>,
    /// Torque limit beyond gravity, for a joint pushed toward (−, +): `L − g`, `L + g` [N·m].
    pub gravity_margin: Vec<[f64; 2]>,
    /// Smallest singular value of the task rows, with translations divided by the arm's length.
    pub sigma_min: f64,
    /// Condition number: largest over smallest singular value.
    pub condition: f64,
    /// σ₀ of the damping: poses with a much smaller σ_min are near singular.
    pub sigma_0: f64,
    /// Joints whose limit is at the servo's ceiling.
    pub saturated: Vec<bool>,
    /// Joints at a position limit, removed from the inverse kinematics.
    pub locked: Vec<bool>,
    /// Prismatic joints: their units are metres.
    pub prismatic: Vec<bool>,
    /// Allowed value of [`AxisReport::host_loss_force`] along translations [N].
    pub max_host_loss_force: Option<f64>,
    /// Factor ≤ 1 on K_x, under law `impedance` on the stiffness, required by delay and pose.
    pub gain_factor: f64,
    /// Factor ≤ 1 on the damping of law `impedance`.
    pub damping_factor: f64,
}

/// Capabilities along one task axis. Forces in N, for rotations N·m; displacements in m or rad.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisReport {
    /// Name of the axis.
    pub name: &'static str,
    /// The largest static force that the present limits hold: `min_i (L_i + s_i g_i) / |a_i|`, `a = Jᵀd`. Negative if
    /// the arm cannot hold itself.
    pub static_force: [f64; 2],
    /// The largest static force at the servos' full torque.
    pub capacity: [f64; 2],
    /// Compliance of the axis toward (−, +).
    pub yields: [bool; 2],
    /// Force at which the axis yields under the law, without friction, per side: at a small and at a large deviation,
    /// d⁻/(1 − η) and d⁺/(1 − η), at most 0.15 m or 0.4 rad.
    pub yield_force: [[f64; 2]; 2],
    /// Deviations d⁻/(1 − η), d⁺/(1 − η) between which the strength changes.
    pub thresholds: [f64; 2],
    /// Dry friction of the joints along the axis, `Σ_i |J⁺_ij| τ_f,i`: added to the force of a push from rest.
    pub friction: f64,
    /// Friction that the feed-forward leaves in steady motion. An axis with a smaller strength cannot keep moving.
    pub friction_left: f64,
    /// Strength of the axis if its own were 0, caused by the torque limits that the other axes require of the same
    /// joints.
    pub coupling: [f64; 2],
    /// The other axis with the largest share of it.
    pub coupled_to: [Option<&'static str>; 2],
    /// Strength of the axis toward sides that do not yield.
    pub hold: f64,
    /// The default of `hold`, if soft or firm raised it.
    pub default_hold: Option<f64>,
    /// The largest force on a hand that pushes along the axis by 0.15 m or 0.4 rad at 25 mm/s or 0.067 rad/s if the
    /// host dies now, beginning at the arm's equilibrium, gear friction and damping included; ∞ if the arm cannot be
    /// moved so far because it is stretched out or at stops.
    pub host_loss_force: [f64; 2],
    /// The first position limit on the path of a push along the axis, the others fixed; `None` if no joint meets one
    /// within 0.15 m or 0.4 rad.
    pub stop: [Option<JointStop>; 2],
    /// Largest friction of the joints along the axis on that path, up to the stop; many times `friction` if the path
    /// passes a singular pose.
    pub path_friction: [f64; 2],
    /// σ_min at the point of `path_friction`.
    pub path_sigma: [f64; 2],
    /// Displacement of the axis at that point.
    pub path_distance: [f64; 2],
    /// Deviation beyond which the target stops or follows the tool; ∞ without such a limit and toward sides that
    /// yield.
    pub deviation_limit: [f64; 2],
    /// Behaviour of the target beyond the deviation limit.
    pub on_deviation_limit: OnDeviationLimit,
}

/// Reports on the pose and the limits of the last step.
///
/// # Errors
/// [`Error::Config`] before the first step.
pub fn report(controller: &Controller) -> Result<PoseReport> {
    if controller.state.limit.is_none() {
        return Err(Error::config("report", "no step has been made yet: make one, or report on a given q"));
    }
    Ok(build_report(controller))
}

/// Reports on the arm at rest on its target in `q` (n) [rad]. Does not change the controller.
///
/// # Errors
/// As [`Controller::step`].
///
/// ```
/// # use pliant_core::analysis::report_at;
/// # use pliant_core::{Controller, Model, ModelOptions, Servos, Settings};
/// # fn main() -> pliant_core::Result<()> {
/// # let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
/// # let model = std::sync::Arc::new(Model::from_urdf_str(include_str!("../../robots/arm7.urdf"), &options)?);
/// # let servos = Servos::new(vec![150.0], vec![10.7]);
/// # let controller = Controller::new(model.clone(), Settings::default(), Some(servos))?;
/// let report = report_at(&controller, &[-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17])?; // [rad]
/// let y = &report.axes[1];
/// assert_eq!(y.name, "y");
/// assert!(y.capacity[0] > 0.0); // [N], all that the servos can answer to a push toward −y
/// assert!(report.to_string().contains("gives way"));
/// # Ok(())
/// # }
/// ```
pub fn report_at(controller: &Controller, q: &[f64]) -> Result<PoseReport> {
    Ok(build_report(&at_rest(controller, q)?))
}

/// Returns a copy of this controller after its first step, on its target in `q`.
pub(super) fn at_rest(controller: &Controller, q: &[f64]) -> Result<Controller> {
    let at = controller.model().joints_within("q", q, COORDINATE_BOUND)?;
    let mut copy = controller.clone();
    // At rest the goals have reached their final values.
    copy.settings.tracking.goal_slew = f64::INFINITY;
    copy.reset(q)?;
    let mut frames = JointFrames::default();
    copy.model().chain().forward(&at, &mut frames);
    copy.step(q, &frames.tool, &StepInput::default())?;
    Ok(copy)
}

fn build_report(controller: &Controller) -> PoseReport {
    let (params, record) = (&controller.params, &controller.diagnostics());
    let n = params.n;
    let limit = current_limits(controller);
    let pose = StepAnalysis::new(params, controller.settings(), record);
    let singular = record.singular_values(params);
    let sigma_min = singular.iter().copied().fold(f64::INFINITY, f64::min);
    let mut static_friction = [0.0; MAX_JOINTS];
    (0..n).for_each(|i| static_friction[i] = params.servos.friction_at_rest(i, record.gravity[i]));
    let mut frames = JointFrames::default();
    controller.model().chain().forward(&record.q, &mut frames);
    let path = push_path(controller, &frames, &static_friction);
    let goal = pad(controller.command.goal(), 0.0);
    let host_loss = host_loss_now(controller, &frames, &goal, &limit, &static_friction);
    let rest = host_loss.equilibrium();
    let friction = pose.friction();
    let axis_report = |row: usize| {
        let (axis, axis_params) = (params.axes[row], &params.per_axis[row]);
        let static_force =
            |limit: &JointVec| [-1.0, 1.0].map(|sign| static_force(&record.rows[row], sign, limit, &record.gravity, n));
        let coupling = [0, 1].map(|side| pose.coupling(row, side));
        let pushes = [-1.0, 1.0].map(|sign| path.simulate(row, sign));
        let deviation_limit = params.deviation_limits.iter().find(|limit| limit.axis == axis);
        AxisReport {
            name: AXIS_NAMES[axis],
            static_force: static_force(&limit),
            capacity: static_force(&params.servos.torque),
            yields: axis_params.yields.map(|weight| weight > 0.0),
            yield_force: [0, 1].map(|side| pose.yield_forces_at(row, side)),
            thresholds: [axis_params.soft_until, axis_params.firm_from].map(|d| d / (1.0 - axis_params.eta)),
            friction: friction[row],
            friction_left: friction[row] * pose.friction_share_left(),
            coupling: coupling.map(|(force, _)| force),
            coupled_to: coupling.map(|(_, with)| with.map(|other| AXIS_NAMES[params.axes[other]])),
            hold: axis_params.hold,
            default_hold: axis_params.default_hold,
            host_loss_force: [-1.0, 1.0].map(|sign| {
                let result = host_loss.max_push_force(&rest, row, sign);
                if result.blocked { f64::INFINITY } else { result.force }
            }),
            stop: pushes.map(|push| push.stop),
            path_friction: pushes.map(|push| push.friction),
            path_sigma: pushes.map(|push| push.sigma),
            path_distance: pushes.map(|push| push.at),
            deviation_limit: deviation_limit.map_or([f64::INFINITY; 2], |limit| limit.max),
            on_deviation_limit: controller.settings().axes[axis].on_deviation_limit,
        }
    };
    PoseReport {
        axes: (0..params.k).map(axis_report).collect(),
        joints: controller.model().joint_names().to_vec(),
        law: params.law,
        q: record.q[..n].to_vec(),
        torque_limit: limit[..n].to_vec(),
        gravity_margin: (0..n).map(|i| [limit[i] - record.gravity[i], limit[i] + record.gravity[i]]).collect(),
        sigma_min,
        condition: singular.max() / sigma_min,
        sigma_0: params.damping.sigma_0,
        saturated: record.saturated[..n].to_vec(),
        locked: record.locked[..n].to_vec(),
        prismatic: controller.model().prismatic().to_vec(),
        max_host_loss_force: params.max_host_loss_force,
        gain_factor: controller.gain_factor(),
        damping_factor: controller.damping_factor(),
    }
}

/// Returns the push paths from the last step's pose; `friction` at rest [N·m].
pub(super) fn push_path<'a>(controller: &'a Controller, frames: &JointFrames, friction: &'a JointVec) -> PushPath<'a> {
    let base_from_task = controller.params.base_from_task::<crate::math::simd::BaselineF64>(&frames.tool);
    PushPath {
        model: controller.model(),
        params: &controller.params,
        base_from_task,
        q: &controller.diagnostics.q,
        friction,
    }
}

/// Returns the arm with its last command, for a host loss now.
pub(super) fn host_loss_now<'a>(
    controller: &'a Controller,
    frames: &JointFrames,
    goal: &'a JointVec,
    limit: &'a JointVec,
    friction: &'a JointVec,
) -> HostLoss<'a> {
    HostLoss {
        chain: controller.model().chain(),
        params: &controller.params,
        masses: &controller.masses,
        gravity: controller.gravity,
        base_from_task: controller.params.base_from_task::<crate::math::simd::BaselineF64>(&frames.tool),
        q: &controller.diagnostics.q,
        goal,
        limit,
        friction,
    }
}

/// Returns the limits of the last command.
pub(super) fn current_limits(controller: &Controller) -> JointVec {
    pad(controller.command.torque_limit(), 0.0)
}
