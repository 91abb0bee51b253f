//! Optional parts of the control step.

use crate::MAX_AXES;
use crate::model::Model;
use crate::params::scales::tracks_sigma;
use crate::params::{Follow, Frame, Gain, GravityUse, Law, Params, Projector, Settings};

/// Optional parts of the control step that settings and model need.
///
/// The step is compiled for features that are read at run time and, for arms of at most eight joints, a second time for
/// [`Features::PLAIN`] as constants: the compiler then removes the other parts, and intermediate results stay in
/// registers.
#[expect(clippy::struct_excessive_bools, reason = "each is a part that a step has or has not")]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Features {
    pub(crate) law: Law,
    /// Chain with prismatic or mimic joints, or with joints beside the path to the tool.
    pub(crate) any_chain: bool,
    /// Task with axes other than all six of the base.
    pub(crate) any_axes: bool,
    /// Gain K_x that couples the axes of the task.
    pub(crate) coupled_gain: bool,
    /// Optional inputs other than the period, such as a joint velocity.
    pub(crate) inputs: bool,
    /// Gravity torques.
    pub(crate) gravity: bool,
    /// Singular values of the task rows, tracked from step to step.
    pub(crate) singular_values: bool,
    /// Limits on the tool's speed.
    pub(crate) tool_speed: bool,
    /// Limits on the deviation of an axis.
    pub(crate) deviation_limits: bool,
    /// Bound on the force that a hand meets if the host stops.
    pub(crate) host_loss: bool,
    /// Integration of the lead.
    pub(crate) integral: bool,
    /// Manipulability cost.
    pub(crate) manipulability: bool,
    /// Joint weights, a gain K_q per joint, the exact projector, free soft axes or budgets on the goal under law
    /// `paper`.
    pub(crate) paper_variants: bool,
}

impl Features {
    /// Law `paper` as published, for a task with all six axes of the base.
    pub(crate) const PLAIN: Self = Self {
        law: Law::Paper,
        any_chain: false,
        any_axes: false,
        coupled_gain: false,
        inputs: false,
        gravity: false,
        singular_values: false,
        tool_speed: false,
        deviation_limits: false,
        host_loss: false,
        integral: false,
        manipulability: false,
        paper_variants: false,
    };

    /// Returns the features that these settings need, without `inputs`.
    pub(super) fn new(model: &Model, settings: &Settings, params: &Params) -> Self {
        let (chain, paper) = (model.chain(), &settings.paper_options);
        Self {
            law: params.law,
            any_chain: !(chain.simple && chain.path == chain.total),
            any_axes: params.frame != Frame::Base || params.k != MAX_AXES || params.k > params.n,
            coupled_gain: (0..MAX_AXES).any(|r| (0..MAX_AXES).any(|c| r != c && params.kx[r][c] != 0.0)),
            inputs: false,
            gravity: settings.gravity_use() != GravityUse::Off
                || settings.tracking.integrate > 0.0
                || params.max_host_loss_force.is_some(),
            singular_values: tracks_sigma(settings, &params.damping),
            tool_speed: settings.max_tool_speed.iter().any(|speed| speed.is_finite()),
            deviation_limits: !params.deviation_limits.is_empty(),
            host_loss: params.max_host_loss_force.is_some(),
            integral: settings.tracking.integrate > 0.0,
            manipulability: params.cost.manipulability > 0.0,
            paper_variants: params.budget_on_goal
                || params.follow != Follow::Hold
                || params.projector != Projector::Paper
                || paper.joint_weights.is_some()
                || !matches!(paper.kq, Gain::Scalar(_)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::ModelOptions;
    use crate::params::joint_space::JointSpaceStats;
    use crate::params::{Axis, Damping, NullSpace, PaperOptions, Servos, Task, TorqueLimits, Tracking};

    /// Returns the settings of the paper as printed: fixed damping, and the projector of equation (4).
    fn printed() -> Settings {
        Settings {
            tracking: Tracking { damping: Damping::Fixed(0.02), ..Settings::paper().tracking },
            null_space: NullSpace { projector: Projector::Paper, ..Settings::paper().null_space },
            ..Settings::paper()
        }
    }

    fn coupled() -> Vec<Vec<f64>> {
        (0..6).map(|r| (0..6).map(|c| if r == c { 4.0 } else { 0.1 }).collect()).collect()
    }

    #[test]
    fn the_paper_as_printed_is_plain_and_every_option_is_a_feature() {
        let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
        let model = Model::from_urdf_str(include_str!("../../robots/arm7.urdf"), &options).unwrap();
        let is_plain = |settings: &Settings| {
            let servos = Servos { stiffness_known: true, ..Servos::new(vec![150.0], vec![10.7]) };
            let params = Params::new(&model, settings, Some(&servos), true, &mut JointSpaceStats::default()).unwrap();
            params.is_plain
        };
        assert!(is_plain(&printed()));
        let changes: [fn(&mut Settings); 16] = [
            |s| s.law = Law::Cap,
            |s| s.task = Task::parse("xyz roll pitch").unwrap(),
            |s| s.task.frame = Frame::Tool,
            |s| s.task.frame = Frame::Rotation(crate::pose::Pose::IDENTITY.rotation),
            |s| s.tracking.gain = Gain::Matrix(coupled()),
            |s| (s.gravity, s.paper_options.gravity_use) = (true, GravityUse::Limits),
            |s| s.tracking.damping = Damping::Auto,
            |s| s.max_tool_speed[1] = 1.0,
            |s| s.axes[0] = Axis { deviation_limit: Some(0.1), ..Axis::default() },
            |s| s.torque_limits = TorqueLimits { max_host_loss_force: Some(20.0), ..s.torque_limits.clone() },
            |s| s.tracking.integrate = 1.0,
            |s| s.paper_options.manipulability = 0.1,
            |s| s.null_space.projector = Projector::Exact,
            |s| s.paper_options.joint_weights = Some(vec![2.0; 7]),
            |s| s.paper_options = PaperOptions { budget_on_goal: true, ..s.paper_options.clone() },
            |s| s.paper_options.follow = Some(Follow::Free),
        ];
        for (number, change) in changes.iter().enumerate() {
            let mut settings = printed();
            change(&mut settings);
            assert!(!is_plain(&settings), "change {number}");
        }
    }
}
