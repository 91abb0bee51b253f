//! State of the arm at the predicted positions: line 2 of the control step.

use crate::MAX_AXES;
use crate::kinematics::KinematicState;
use crate::math::simd::{JointVector, Scalar};
use crate::params::{Params, Settings};
use crate::task::rows_in;

/// Line 2: state of the arm at the predicted positions.
#[derive(Clone, Copy)]
pub(crate) struct ArmState<'a, J: JointVector> {
    /// q̂ [rad].
    pub(crate) q: J,
    /// Pose of the tool, Jacobian, gravity torques.
    pub(crate) view: &'a KinematicState<J>,
    pub(crate) base_from_task: [[Scalar<J>; 3]; 3],
    /// Jacobian rows of the task's axes, in the task frame (k × n).
    pub(crate) rows: &'a [J; MAX_AXES],
    pub(crate) gravity_in_goal: J,
    pub(crate) gravity_in_limit: J,
}

impl<'a, J: JointVector> ArmState<'a, J> {
    #[inline(always)]
    pub(crate) fn new(
        params: &Params,
        settings: &Settings,
        q: J,
        view: &'a KinematicState<J>,
        room: &'a mut Option<[J; MAX_AXES]>,
    ) -> Self {
        let base_from_task = params.base_from_task::<J::Elem>(&view.tool);
        let rows = rows_in(&params.frame, &view.j_base, &base_from_task, &params.axes, room);
        let gravity = settings.gravity_use();
        let in_goal = J::splat(f64::from(u8::from(gravity.in_goal())));
        let in_limit = J::splat(f64::from(u8::from(gravity.in_limits())));
        let (gravity_in_goal, gravity_in_limit) = (in_goal * view.holding, in_limit * view.holding);
        Self { q, view, base_from_task, rows, gravity_in_goal, gravity_in_limit }
    }
}
