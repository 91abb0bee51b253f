//! State of the arm at the predicted joint positions, with the Jacobian rows of the task.

use crate::MAX_AXES;
use crate::kinematics::KinematicState;
use crate::math::simd::JointVector;
use crate::math::spatial::Mat3;
use crate::params::{Features, Params, Settings};
use crate::task::rows_in;

/// State of the arm at the predicted positions q̂.
#[derive(Clone, Copy)]
pub(crate) struct ArmState<'a, J: JointVector> {
    /// Predicted joint positions q̂ at the arrival of the goal [rad].
    pub(crate) q: J,
    /// Tool pose, Jacobian and gravity torques at q̂.
    pub(crate) view: &'a KinematicState<J>,
    /// Task axes as columns, in the base.
    pub(crate) base_from_task: Mat3,
    /// Jacobian rows of the task's axes, in the task frame (k × n); zeros after the last row.
    pub(crate) rows: &'a [J; MAX_AXES],
    /// Gravity torques that the goals compensate [N·m]; 0 if the settings exclude it.
    pub(crate) gravity_in_goal: J,
    /// Gravity torques that the torque limits include [N·m]; 0 if the settings exclude it.
    pub(crate) gravity_in_limit: J,
}

impl<'a, J: JointVector> ArmState<'a, J> {
    /// Computes task rows and gravity torques from the kinematics `view`; stores the rows in `row_storage`.
    #[inline(always)]
    pub(crate) fn new(
        params: &Params,
        settings: &Settings,
        features: Features,
        q: J,
        view: &'a KinematicState<J>,
        row_storage: &'a mut Option<[J; MAX_AXES]>,
    ) -> Self {
        let base_from_task = params.base_from_task(&view.tool);
        let rows = if features.any_axes {
            rows_in(&params.frame, &view.j_base, &base_from_task, &params.axes, row_storage)
        } else {
            &view.j_base
        };
        if !features.gravity {
            let zero = J::splat(0.0);
            return Self { q, view, base_from_task, rows, gravity_in_goal: zero, gravity_in_limit: zero };
        }
        let gravity = settings.gravity_use();
        let in_goal = J::splat(f64::from(u8::from(gravity.in_goal())));
        let in_limit = J::splat(f64::from(u8::from(gravity.in_limits())));
        let (gravity_in_goal, gravity_in_limit) = (in_goal * view.holding, in_limit * view.holding);
        Self { q, view, base_from_task, rows, gravity_in_goal, gravity_in_limit }
    }
}
