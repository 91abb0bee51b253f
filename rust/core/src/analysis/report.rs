//! Report on the capabilities of an arm with its settings in one pose.
//!
//! Pairs have one number per direction of a push: toward −, then toward +.

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

/// Capabilities of the arm in one pose with the current settings.
///
/// All vectors but `axes` have one entry per joint.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseReport {
    /// Capabilities along each task axis, in the order of the task.
    pub axes: Vec<AxisReport>,
    /// Names of the joints.
    pub joints: Vec<String>,
    /// Control law of the settings.
    pub law: Law,
    /// Joint positions in this pose [rad; m if prismatic].
    pub q: Vec<f64>,
    /// Torque limit of each joint in this pose [N·m].
    pub torque_limit: Vec<f64>,
    /// Torque with which each joint can resist a push toward (−, +) [N·m]: torque limit L beyond gravity torque g, `L −
    /// g` and `L + g`. Negative if the joint cannot hold its load.
    pub gravity_margin: Vec<[f64; 2]>,
    /// Smallest singular value of the task rows, with translations divided by the arm's length.
    pub sigma_min: f64,
    /// Condition number of the scaled task rows: ratio of largest to smallest singular value.
    pub condition: f64,
    /// Singular value σ₀ below which the adaptive damping grows. A pose with σ_min below σ₀ / 10 is reported as near
    /// singular.
    pub sigma_0: f64,
    /// True for joints whose torque limit is at the servo's usable torque.
    pub saturated: Vec<bool>,
    /// True for joints that the control step leaves out of the inverse kinematics because they are at a position
    /// limit.
    pub locked: Vec<bool>,
    /// True for prismatic joints, whose positions are in metres.
    pub prismatic: Vec<bool>,
    /// Bound on [`AxisReport::host_loss_force`] along translations [N]; `None` if the settings have none.
    pub max_host_loss_force: Option<f64>,
    /// Factor ≤ 1 on the gain K_x, required by the loop delay; under law `impedance` on the stiffness, required by
    /// delay and pose.
    pub gain_factor: f64,
    /// Factor ≤ 1 on the damping of law `impedance`, required by delay and pose; 1 under the other laws.
    pub damping_factor: f64,
}

/// Capabilities along one task axis. Forces in N, for rotations N·m; displacements in m or rad.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisReport {
    /// Name of the axis, e.g. `y` or `roll`.
    pub name: &'static str,
    /// Largest static force that the present torque limits L hold against a push toward (−, +):
    /// `min_i (L_i + s_i g_i) / |a_i|` with the gravity torques g, the levers `a = Jᵀd` of the push direction d, and
    /// `s_i = sign(a_i)`. Negative if the arm cannot hold its own weight.
    pub static_force: [f64; 2],
    /// Largest static force that the servos' full usable torque holds against a push toward (−, +).
    pub capacity: [f64; 2],
    /// True if the axis yields to a push toward (−, +).
    pub yields: [bool; 2],
    /// Forces at which the axis yields to a push toward (−, +), without joint friction: for each side, at the two
    /// deviations `thresholds`, which are bounded here to 0.15 m or 0.4 rad.
    pub yield_force: [[f64; 2]; 2],
    /// Deviations between which the strength changes, d⁻/(1 − η) and d⁺/(1 − η), with the settings `soft_until` d⁻,
    /// `firm_from` d⁺ and `adaptation` η.
    pub thresholds: [f64; 2],
    /// Static friction of the joints along the axis, `Σ_i |J⁺_ij| τ_f,i`. A push from rest must overcome it in addition
    /// to `yield_force`.
    pub friction: f64,
    /// Friction along the axis in steady motion that the feed-forward does not compensate. The axis keeps moving only
    /// if its strength exceeds it. Without `stiffness_known`, more than half of the friction is compensated only up to
    /// the strength of the axis.
    pub friction_left: f64,
    /// Force against a push toward (−, +) that remains if the strength of the axis is 0, because the other axes raise
    /// the torque limits of the same joints.
    pub coupling: [f64; 2],
    /// Name of the other axis that contributes most to `coupling`; `None` if no other axis contributes.
    pub coupled_to: [Option<&'static str>; 2],
    /// Largest force with which the axis resists pushes to which it does not yield.
    pub hold: f64,
    /// Default of `hold` before a larger `soft` or `firm` raised it; `None` if they did not.
    pub default_hold: Option<f64>,
    /// Largest force on a hand that pushes the tool toward (−, +) after a host loss in this state, with gear friction
    /// and damping. The push starts at the arm's equilibrium and moves 0.15 m at 25 mm/s, or 0.4 rad at 0.067 rad/s. ∞
    /// if the arm cannot move so far because it is stretched out or at stops.
    pub host_loss_force: [f64; 2],
    /// First position limit that a joint reaches when the axis is pushed toward (−, +) and the other task axes keep
    /// their positions; `None` if no joint reaches one within 0.15 m or 0.4 rad.
    pub stop: [Option<JointStop>; 2],
    /// Largest friction of the joints along the axis during a push toward (−, +) by 0.15 m or 0.4 rad, or up to the
    /// first stop; many times `friction` if the push passes near a singular pose.
    pub path_friction: [f64; 2],
    /// Smallest singular value of the scaled task rows at the point where `path_friction` occurs.
    pub path_sigma: [f64; 2],
    /// Displacement of the axis at the point where `path_friction` occurs.
    pub path_distance: [f64; 2],
    /// Deviation, pushed toward (−, +), beyond which the target waits or follows the tool; ∞ without a limit and for
    /// sides that yield.
    pub deviation_limit: [f64; 2],
    /// Behaviour of the target beyond the deviation limit.
    pub on_deviation_limit: OnDeviationLimit,
}

/// Returns the capabilities of the arm in the pose and with the torque limits of the controller's last step.
///
/// # Errors
/// [`Error::Config`] before the first step.
pub fn report(controller: &Controller) -> Result<PoseReport> {
    if controller.state.limit.is_none() {
        return Err(Error::config("report", "no step has been made yet: make one, or report on a given q"));
    }
    Ok(build_report(controller))
}

/// Returns the capabilities of the arm at rest on its target at the joint positions `q` [rad]. Does not change the
/// controller.
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
/// assert!(y.capacity[0] > 0.0); // [N], largest push toward −y that the servos can hold
/// assert!(report.to_string().contains("gives way"));
/// # Ok(())
/// # }
/// ```
pub fn report_at(controller: &Controller, q: &[f64]) -> Result<PoseReport> {
    Ok(build_report(&at_rest(controller, q)?))
}

/// Returns a copy of the controller after a first step at rest at the joint positions `q` [rad], with the target at the
/// tool.
pub(super) fn at_rest(controller: &Controller, q: &[f64]) -> Result<Controller> {
    let at = controller.model().joints_within("q", q, COORDINATE_BOUND)?;
    let mut copy = controller.clone();
    // Without a speed limit of the goals, one step moves them to the values that they have at rest.
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
            friction_left: pose.friction_left(row, friction[row]),
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

/// Returns the simulation of pushes from the pose of the last step; `friction` is the static friction of the joints
/// [N·m].
pub(super) fn push_path<'a>(controller: &'a Controller, frames: &JointFrames, friction: &'a JointVec) -> PushPath<'a> {
    let base_from_task = controller.params.base_from_task(&frames.tool);
    PushPath {
        simd_level: controller.simd_level,
        model: controller.model(),
        params: &controller.params,
        base_from_task,
        q: &controller.diagnostics.q,
        friction,
    }
}

/// Returns the simulation of a host loss after the last step, with the last goals [rad] and torque limits [N·m].
pub(super) fn host_loss_now<'a>(
    controller: &'a Controller,
    frames: &JointFrames,
    goal: &'a JointVec,
    limit: &'a JointVec,
    friction: &'a JointVec,
) -> HostLoss<'a> {
    HostLoss {
        simd_level: controller.simd_level,
        chain: controller.model().chain(),
        params: &controller.params,
        masses: &controller.masses,
        gravity: controller.gravity,
        base_from_task: controller.params.base_from_task(&frames.tool),
        q: &controller.diagnostics.q,
        goal,
        limit,
        friction,
    }
}

/// Returns the torque limits of the last command [N·m].
pub(super) fn current_limits(controller: &Controller) -> JointVec {
    pad(controller.command.torque_limit(), 0.0)
}
