//! Diagnostics: intermediate results of the last control step.

use nalgebra::{DMatrix, DVector};

use crate::law::activation::{Activation, product, responsibility};
use crate::law::nullspace::{step_projector, step_pseudo_inverse};
use crate::math::simd::JointVec16;
use crate::params::Params;
use crate::pose::Pose;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Intermediate results of the last control step. Of a 6-vector, the first k entries are those of the task axes, in the
/// order of the task; the rest is unused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Diagnostics {
    /// Predicted joint positions q̂ [rad].
    pub q: JointVec,
    /// Joint velocity v, filtered or given [rad/s].
    pub velocity: JointVec,
    /// Deviation e of the tool from the reference along the task axes [m, rad]; with a twist, when the goal arrives.
    pub deviation: AxisVec,
    /// Deviation ẽ from the adapted target along the task axes, `(1 − η w) e` [m, rad].
    pub adapted_deviation: AxisVec,
    /// Commanded velocity of the task axes, `Δx = K_x ẽ`, within its limits; law `paper` adds the twist [m/s, rad/s].
    pub task_velocity: AxisVec,
    /// Softness w of each axis for the side from which it is pushed, 0 (stiff) to 1 (soft).
    pub softness: AxisVec,
    /// Compliance c of each axis, equation (8) of the paper: 1 at a small deviation, 0 at a large one.
    pub compliance: AxisVec,
    /// Present strength of each axis, `w F + (1 − w) hold`: under law `paper` the holding torque τ^x [N·m] of equation
    /// (9) of the paper, under the other laws the force cap [N, N·m].
    pub axis_strength: AxisVec,
    /// Wrench W that the law exerts on the tool along the task axes [N, N·m]; 0 under law `paper`.
    pub wrench: AxisVec,
    /// Gravity torques at q̂ [N·m]; computed on request if the step does not use them.
    pub gravity: JointVec,
    /// Feed-forward of friction and damping [N·m].
    pub feed_forward: JointVec,
    /// Gradient of the null-space cost.
    pub gradient: JointVec,
    /// Rows of the Jacobian for the task axes (k × n), in the task frame.
    pub rows: Rows,
    /// Smallest and largest singular value of the scaled task rows; `None` if the step did not need them.
    /// [`Diagnostics::sigma`] then computes them.
    pub(crate) followed_sigma: Option<[f64; 2]>,
    /// Damping λ of the inverse.
    pub damping: f64,
    /// Factor γ on feed-forward and prediction, smaller near singular poses.
    pub gamma: f64,
    /// Scale factors (0 to 1) of the null-space, soft and stiff parts of the motion, which keep it within the torque
    /// and speed limits.
    pub factors: [f64; 3],
    /// Factor ≤ 1 on the gain K_x, required by the delay; under law `impedance` on the stiffness, required by delay and
    /// pose.
    pub gain_factor: f64,
    /// True for joints whose torque limit is at the servo's usable torque. Computed by
    /// [`Controller::diagnostics`](crate::Controller::diagnostics).
    pub saturated: [bool; MAX_JOINTS],
    /// True for joints that the step left out of the inverse kinematics because they are at a position limit.
    pub locked: [bool; MAX_JOINTS],
    /// True for task axes at their deviation limit.
    pub deviation_limited: [bool; MAX_AXES],
    /// Reference pose that the arm tracks: the target within the limits on speed, acceleration and deviation.
    pub reference: Pose,
    /// True if [`Diagnostics::complete`] has yet to store a part of the results.
    pub(super) is_partial: bool,
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
            is_partial: false,
        }
    }

    /// Completes the record of a plain step from that of a full step at the same positions and reference, `whole`.
    /// Keeps the values that also depend on the state before the step.
    pub(super) fn complete(&mut self, whole: &Self) {
        let Self { velocity, gradient, factors, locked, .. } = *self;
        *self = Self { velocity, gradient, factors, locked, ..*whole };
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

    /// Returns the activation matrix A, equation (10) of the paper, of all joints including locked ones.
    pub(crate) fn shares(&self, params: &Params) -> Activation<JointVec16> {
        Activation::of_step(params, &self.rows, &self.gradient, self.damping, || self.sigma(params))
    }

    /// Returns the activation matrix A, equation (10) of the paper, n × (k + 1), the null-space column last.
    pub(crate) fn activation(&self, params: &Params) -> DMatrix<f64> {
        self.shares(params).matrix(params.k, params.n)
    }

    /// Returns the responsibility R, equations (6), (7) of the paper, n × (k + 1): `|J⁺ diag(Δx)|`, then `|α N∇g|`.
    pub(crate) fn responsibility(&self, params: &Params) -> DMatrix<f64> {
        let projector = step_projector(params, &self.rows, self.damping, || self.sigma(params));
        let null = product(&projector, &self.gradient);
        responsibility(&self.pseudo_inverse(params), &self.task_velocity, &null, params.alpha, (params.k, params.n))
    }

    /// Returns the task rows, k × n.
    pub(crate) fn task_jacobian(&self, params: &Params) -> DMatrix<f64> {
        DMatrix::from_fn(params.k, params.n, |r, i| self.rows[r][i])
    }

    /// Returns all singular values of the scaled task rows, largest first. Computes an SVD, so a step must not call it.
    pub(crate) fn singular_values(&self, params: &Params) -> DVector<f64> {
        let scaled = |r: usize, i: usize| params.row_scale[r] * self.rows[r][i];
        crate::math::svd::singular_values(&DMatrix::from_fn(params.k, params.n, scaled))
    }
}
