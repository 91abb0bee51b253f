//! Redundancy: the null-space projector, equation (4) of the paper, and the gradient of the null-space cost.

use crate::law::activation::RowNorms;
use crate::law::posture_fade::posture_gain;
use crate::math::cold;
use crate::math::ldlt6::{Ldlt6, factor_gram, pseudo_inverse};
use crate::math::rows::{JointMatrix, load_rows, mul, store_rows, tr_mul};
use crate::math::simd::{BaselineF64, JointVec16, JointVector};
use crate::math::spatial::{cross, dot, sub};
use crate::params::{Features, Frame, NullSpaceCost, Params, Projector};
use crate::task::ArmState;
use crate::task::demand::AxisDemand;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// The null-space projector `N = I − D Jᵀ (J D Jᵀ + μ²I)⁻¹ J`, applied without forming the matrix, with the task rows J
/// and the diagonal matrix D of joint weights.
///
/// Exact with μ = 0. Near singular poses, where the exact projector jumps, it is faded by `μ = μ₁ clip(2 − σ/μ₁, 0,
/// 1)`, `μ₁ = 10⁻³ σ_max`, with the smallest and the largest singular value σ and σ_max of the rows.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NullSpace<'a, J: JointVector> {
    rows: &'a [J; MAX_AXES],
    /// Joint weights, the diagonal of D.
    weight: J,
    /// Factor of `J D Jᵀ + μ²I`.
    factor: Ldlt6,
    /// Number of task rows; if there are more rows than joints, N is 0.
    task: usize,
    /// Number of joints.
    joints: usize,
}

/// Returns the squared damping μ² of the exact null-space projector, from the smallest and the largest singular value
/// of the rows.
#[inline(always)]
pub(crate) fn projector_damping_sq(smallest: f64, largest: f64) -> f64 {
    let mu_1 = 1e-3 * largest;
    if mu_1 <= 0.0 {
        return 1e-12;
    }
    if smallest < 2.0 * mu_1 {
        cold();
        let mu = mu_1 * (2.0 - smallest / mu_1).clamp(0.0, 1.0);
        return mu * mu;
    }
    0.0
}

impl<'a, J: JointVector> NullSpace<'a, J> {
    /// Creates the projector for `task` rows and `joints` joints. `weight` is the diagonal of D; `added` is the
    /// diagonal added to `J D Jᵀ`.
    #[inline(always)]
    pub(crate) fn new(rows: &'a [J; MAX_AXES], weight: J, added: &AxisVec, (task, joints): (usize, usize)) -> Self {
        let factor = factor_gram(rows, weight, added);
        Self::of(rows, weight, &factor, (task, joints))
    }

    /// Creates the projector from the factor of the damped `J D Jᵀ`; `weight` is the diagonal of D.
    #[inline(always)]
    pub(crate) fn of(rows: &'a [J; MAX_AXES], weight: J, factor: &Ldlt6, (task, joints): (usize, usize)) -> Self {
        Self { rows, weight, factor: *factor, task, joints }
    }

    /// Returns the null-space part `N v` of v; zero with more task rows than joints.
    #[inline(always)]
    pub(crate) fn project(&self, v: J) -> J {
        if self.task > self.joints {
            return J::splat(0.0);
        }
        let along = self.factor.solve::<J::Elem>(&mul(self.rows, v));
        J::fnma(self.weight, tr_mul(self.rows, &along), v)
    }

    /// Returns the null-space part `N v = v − J⁺J v` of v, from a given pseudo-inverse; zero with more task rows than
    /// joints.
    #[inline(always)]
    pub(crate) fn project_by(&self, pinv_transposed: &[J; MAX_AXES], v: J) -> J {
        if self.task > self.joints { J::splat(0.0) } else { v - tr_mul(pinv_transposed, &mul(self.rows, v)) }
    }

    /// Returns the transposed damped pseudo-inverse `(J D Jᵀ + μ²I)⁻¹ J D`.
    #[inline(always)]
    pub(crate) fn pseudo_inverse(&self) -> [J; MAX_AXES] {
        self.factor.weighted_rows(self.rows, self.weight)
    }
}

/// Rows of the identity matrix. Static, because a vector load right after the store of one of its elements stalls.
static IDENTITY: JointMatrix = {
    let mut rows = [[0.0; MAX_JOINTS]; MAX_JOINTS];
    let mut i = 0;
    while i < MAX_JOINTS {
        rows[i][i] = 1.0;
        i += 1;
    }
    rows
};

impl<J: JointVector> RowNorms<J> for NullSpace<'_, J> {
    #[inline(always)]
    fn row_norms(&self) -> J {
        let none = J::splat(0.0);
        if self.task > self.joints {
            return none;
        }
        let (mut columns, pinv_transposed) = ([[0.0; MAX_JOINTS]; MAX_AXES], self.pseudo_inverse());
        for r in 0..MAX_AXES {
            columns[r] = pinv_transposed[r].to_joints();
        }
        let (joints, mut squares) = (self.joints.min(MAX_JOINTS), [0.0; MAX_JOINTS]);
        for first in (0..joints).step_by(4) {
            let mut four = [none; 4];
            for i in first..joints.min(first + 4) {
                let row = &mut four[i - first];
                *row = J::load(&IDENTITY[i]);
                for r in 0..MAX_AXES {
                    *row = J::fnma(J::splat(columns[r][i]), self.rows[r], *row);
                }
            }
            let [a, b, c, d] = &four;
            let sums = J::dot4([a, b, c, d], [a, b, c, d]);
            squares[first..first + 4].copy_from_slice(&sums);
        }
        J::sqrt(J::load(&squares))
    }
}

/// Returns the null-space projector N as a matrix; arguments as [`NullSpace::new`].
#[cold]
#[inline(never)]
pub(crate) fn projector(
    rows: &Rows,
    weight: &JointVec,
    added: &AxisVec,
    (task, joints): (usize, usize),
) -> JointMatrix {
    let rows = load_rows::<JointVec16>(rows);
    let space = NullSpace::new(&rows, JointVec16::load(weight), added, (task, joints));
    let mut out = [[0.0; MAX_JOINTS]; MAX_JOINTS];
    for j in 0..joints.min(MAX_JOINTS) {
        let mut unit = [0.0; MAX_JOINTS];
        unit[j] = 1.0;
        for (row, value) in out.iter_mut().zip(space.project(JointVec16::load(&unit)).to_joints()) {
            row[j] = value;
        }
    }
    out
}

impl NullSpaceCost {
    /// Returns the gradient, at `q`, of `share` times the cost of leaving the posture `rest`, plus the joint-limit
    /// cost.
    #[inline(always)]
    pub(crate) fn gradient<J: JointVector>(&self, q: J, rest: J, share: f64) -> J {
        let toward_middle = J::load(&self.limits) * (q - J::load(&self.middle));
        J::fma(J::splat(share) * J::load(&self.posture), q - rest, toward_middle)
    }
}

/// Returns the gradient of the whole null-space cost. `rest` is the rest posture, `added` the gradient of the user's
/// cost, `scaled` the scaled task rows, `mu_squared` the damping μ² of the projector.
#[expect(clippy::too_many_arguments, reason = "a struct of them would be kept in memory")]
#[inline(always)]
pub(crate) fn cost_gradient<J: JointVector>(
    params: &Params,
    features: Features,
    rest: &JointVec,
    added: Option<&JointVec>,
    arm: &ArmState<'_, J>,
    demand: &AxisDemand<J::Axes>,
    scaled: &[J; MAX_AXES],
    mu_squared: f64,
) -> J {
    let rest = J::load(rest);
    // Law `paper` never fades the posture task, see `Params::clearance`.
    let share = if features.law.by_force() { posture_gain(params, arm.q, rest, demand) } else { 1.0 };
    let mut gradient = params.cost.gradient(arm.q, rest, share);
    if features.manipulability {
        let (j_base, scaled) = (store_rows(&arm.view.j_base), store_rows(scaled));
        let more = weighted_manipulability(params, &j_base, &scaled, &arm.base_from_task, mu_squared);
        gradient = gradient + J::load(&more);
    }
    match added {
        Some(added) if features.inputs => gradient + J::load(added),
        _ => gradient,
    }
}

/// Returns the gradient of the manipulability cost at the present configuration, times its weight.
///
/// `j_base` is the 6 × n Jacobian in base axes. The local `p` is its P in [`manipulability_gradient`].
#[cold]
#[inline(never)]
fn weighted_manipulability(
    params: &Params,
    j_base: &Rows,
    scaled_rows: &Rows,
    base_from_task: &[[f64; 3]; 3],
    mu_squared: f64,
) -> JointVec {
    let pinv = pseudo_inverse(scaled_rows, &[1.0; MAX_JOINTS], &[mu_squared; MAX_AXES]);
    let mut p = [[0.0; MAX_JOINTS]; MAX_AXES];
    for (r, &axis) in params.axes.iter().enumerate().take(MAX_AXES) {
        let (block, column) = if axis < 3 { (0, axis) } else { (3, axis - 3) };
        for (i, factors) in base_from_task.iter().enumerate() {
            let factor = factors[column % 3] * params.row_scale[r];
            for j in 0..MAX_JOINTS {
                p[block + i][j] += factor * pinv[r][j];
            }
        }
    }
    let turning = matches!(params.frame, Frame::Tool);
    manipulability_gradient(j_base, &p, turning, params.n).map(|g| params.cost.manipulability * g)
}

/// Returns the transposed damped pseudo-inverse, equation (3) of the paper, of the task rows of a step for λ =
/// `damping`.
pub(crate) fn step_pseudo_inverse(params: &Params, rows: &Rows, damping: f64) -> Rows {
    pseudo_inverse(rows, &params.joint_weight_inv, &params.damping_scale.map(|scale| scale * damping * damping))
}

/// Returns the null-space projector N that the settings select, for the task rows of a step and λ = `damping`. `sigma`
/// returns the smallest and the largest singular value of the scaled rows; only the exact projector calls it.
pub(crate) fn step_projector(
    params: &Params,
    rows: &Rows,
    damping: f64,
    sigma: impl FnOnce() -> [f64; 2],
) -> JointMatrix {
    let size = (params.k, params.n);
    match params.projector {
        Projector::Paper => {
            let squared = params.damping_scale.map(|scale| scale * damping * damping);
            projector(rows, &params.joint_weight_inv, &squared, size)
        }
        Projector::Exact => {
            let scaled = store_rows(&params.scale_rows(&load_rows::<JointVec16>(rows)));
            let [smallest, largest] = sigma();
            let mu_squared = projector_damping_sq(smallest, largest);
            projector(&scaled, &params.joint_weight_inv, &[mu_squared; MAX_AXES], size)
        }
    }
}

/// Returns the gradient of `−ln √det(JJᵀ)` over the task rows.
///
/// `∂/∂q_i = −Σ_j P_j · ∂J_j/∂q_i` with `P = (JJᵀ)⁻¹ J`, both in base axes (6 × n). For j ≥ i the column (v_j, ω_j) of
/// J rotates with joint i: its derivative is `(ω_i × v_j, ω_i × ω_j)`. For j < i only the tool point moves: `(ω_j ×
/// v_i, 0)`. `turning` subtracts the rotation of task axes that turn with the tool.
fn manipulability_gradient(jacobian: &Rows, p: &Rows, turning: bool, n: usize) -> JointVec {
    let n = n.min(MAX_JOINTS);
    let column = |m: &Rows, j: usize, from: usize| [m[from][j], m[from + 1][j], m[from + 2][j]];
    let mut out = [0.0; MAX_JOINTS];
    for i in 0..n {
        let (v_i, w_i) = (column(jacobian, i, 0), column(jacobian, i, 3));
        for j in 0..n {
            let (v_j, w_j) = (column(jacobian, j, 0), column(jacobian, j, 3));
            let (mut dv, mut dw) = if i <= j {
                (cross::<BaselineF64>(&w_i, &v_j), cross::<BaselineF64>(&w_i, &w_j))
            } else {
                (cross::<BaselineF64>(&w_j, &v_i), [0.0; 3])
            };
            if turning {
                dv = sub::<BaselineF64>(&dv, &cross::<BaselineF64>(&w_i, &v_j));
                dw = sub::<BaselineF64>(&dw, &cross::<BaselineF64>(&w_i, &w_j));
            }
            out[i] -= dot::<BaselineF64>(&column(p, j, 0), &dv) + dot::<BaselineF64>(&column(p, j, 3), &dw);
        }
    }
    out
}
