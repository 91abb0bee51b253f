//! Diagnostics: all intermediates of the last step.

use nalgebra::{DMatrix, DVector};

use crate::law::activation::{Activation, product, responsibility};
use crate::law::nullspace::{step_projector, step_pseudo_inverse};
use crate::math::simd::JointVec16;
use crate::params::Params;
use crate::pose::Pose;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Intermediates of the last step; 6-vectors hold one entry per task axis, in the order of the task's axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Diagnostics {
    /// Predicted positions q̂ [rad].
    pub q: JointVec,
    /// Filtered velocity v [rad/s].
    pub velocity: JointVec,
    /// Deviation e from the reference, in the task frame [m, rad].
    pub deviation: AxisVec,
    /// Adapted deviation ẽ [m, rad].
    pub adapted_deviation: AxisVec,
    /// Δx = K_x ẽ + twist within its per-axis limits [m/s, rad/s].
    pub task_velocity: AxisVec,
    /// Softness w ∈ [0, 1] for the side the axis is pushed from.
    pub softness: AxisVec,
    /// Compliance c ∈ [0, 1] of (8).
    pub compliance: AxisVec,
    /// Current strength, `w F + (1 − w) hold`: holding torque τ^x of (9) under law `paper`, else cap [N, N·m].
    pub axis_strength: AxisVec,
    /// Wrench W on the target [N, N·m] (not under law `paper`).
    pub wrench: AxisVec,
    /// Gravity torques at q̂ [N·m]; computed on request if the step does not use them.
    pub gravity: JointVec,
    /// Feed-forward of friction and damping [N·m].
    pub feed_forward: JointVec,
    /// Gradient of the null-space cost.
    pub gradient: JointVec,
    /// Task rows (k × n) in the task frame.
    pub rows: Rows,
    /// Smallest and largest singular value of the task rows, with translations divided by the arm's length; `None` if
    /// the step uses neither: then [`Controller::sigma`](crate::Controller::sigma) computes them.
    pub(crate) followed_sigma: Option<[f64; 2]>,
    /// Damping λ.
    pub damping: f64,
    /// γ: factor on feed-forward and prediction.
    pub gamma: f64,
    /// Factors by which null-space, soft and stiff part were scaled to satisfy torque ceilings and speed limits.
    pub factors: [f64; 3],
    /// Factor ≤ 1 on the gain of the stiff axes: on K_x, required by the delay; under law `impedance` on the stiffness,
    /// required by delay and pose.
    pub gain_factor: f64,
    /// Joints whose torque limit is at the ceiling, computed on request. `factors` give the scaling of the motion that
    /// this required.
    pub saturated: [bool; MAX_JOINTS],
    /// Joints at a position limit, removed from the inverse kinematics.
    pub locked: [bool; MAX_JOINTS],
    /// Task axes at their deviation limit.
    pub deviation_limited: [bool; MAX_AXES],
    /// The reference pose: the target after the tool's speed limit and the deviation limits. The deviation is taken
    /// from it.
    pub reference: Pose,
}

impl Diagnostics {
    pub(crate) fn empty() -> Self {
        Self {
            q: [0.0; MAX_JOINTS],
            velocity: [0.0; MAX_JOINTS],
            deviation: [0.0; MAX_AXES],
            adapted_deviation: [0.0; MAX_AXES],
            task_velocity: [0.0; MAX_AXES],
            softness: [0.0; MAX_AXES],
            compliance: [0.0; MAX_AXES],
            axis_strength: [0.0; MAX_AXES],
            wrench: [0.0; MAX_AXES],
            gravity: [0.0; MAX_JOINTS],
            feed_forward: [0.0; MAX_JOINTS],
            gradient: [0.0; MAX_JOINTS],
            rows: [[0.0; MAX_JOINTS]; MAX_AXES],
            followed_sigma: Some([0.0; 2]),
            damping: 0.0,
            gamma: 1.0,
            factors: [1.0; 3],
            gain_factor: 1.0,
            saturated: [false; MAX_JOINTS],
            locked: [false; MAX_JOINTS],
            deviation_limited: [false; MAX_AXES],
            reference: Pose::IDENTITY,
        }
    }

    /// Returns the smallest and largest singular value of the scaled task rows.
    pub(crate) fn sigma(&self, params: &Params) -> [f64; 2] {
        self.followed_sigma.unwrap_or_else(|| {
            let all = self.singular_values(params);
            [all.min(), all.max()]
        })
    }

    fn pseudo_inverse(&self, params: &Params) -> Rows {
        step_pseudo_inverse(params, &self.rows, self.damping)
    }

    /// Returns A of (10) over all joints, including locked ones.
    pub(crate) fn shares(&self, params: &Params) -> Activation<JointVec16> {
        Activation::of_step(params, &self.rows, &self.gradient, self.damping, || self.sigma(params))
    }

    /// Activation matrix A of (10), n × (k + 1), the null-space column last.
    pub(crate) fn activation(&self, params: &Params) -> DMatrix<f64> {
        self.shares(params).matrix(params.k, params.n)
    }

    /// Responsibility R of (6), (7), n × (k + 1): `|J⁺ diag(Δx)|` and `|α N∇g|`.
    pub(crate) fn responsibility(&self, params: &Params) -> DMatrix<f64> {
        let projector = step_projector(params, &self.rows, self.damping, || self.sigma(params));
        let null = product(&projector, &self.gradient);
        responsibility(&self.pseudo_inverse(params), &self.task_velocity, &null, params.alpha, (params.k, params.n))
    }

    /// The task rows, k × n.
    pub(crate) fn task_jacobian(&self, params: &Params) -> DMatrix<f64> {
        DMatrix::from_fn(params.k, params.n, |r, i| self.rows[r][i])
    }

    /// All singular values of the scaled task rows, largest first (an SVD: off the hot path).
    pub(crate) fn singular_values(&self, params: &Params) -> DVector<f64> {
        let scaled = |r: usize, i: usize| params.row_scale[r] * self.rows[r][i];
        crate::math::svd::singular_values(&DMatrix::from_fn(params.k, params.n, scaled))
    }
}
