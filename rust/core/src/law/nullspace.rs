//! Redundancy: the projector of (4) and the null-space cost of line 9.

use crate::law::activation::RowLengths;
use crate::math::ldlt6::{Factor, factor_of};
use crate::math::rows::{JointMatrix, load_rows, times, transpose_times};
use crate::math::simd::{Arithmetic, EveryJoint, Lanes, Scalar};
use crate::params::NullSpaceCost;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// The projector `N = I − D Jᵀ (J D Jᵀ + μ²I)⁻¹ J`, applied without forming the matrix.
///
/// Exact with μ = 0. μ = μ₁ clip(2 − σ/μ₁, 0, 1) with μ₁ = 10⁻³ σ_max fades it at singular poses, where the exact
/// projector jumps.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NullSpace<'a, J: Lanes> {
    rows: &'a [J; MAX_AXES],
    weight: J,
    factor: Factor<Scalar<J>>,
    /// Number of task rows and of joints: with more rows than joints there is no redundancy.
    task: usize,
    joints: usize,
}

/// Returns μ² of the exact projector, from the smallest and largest singular value of the rows.
#[inline(always)]
pub(crate) fn fade_squared(smallest: f64, largest: f64) -> f64 {
    let mu_1 = 1e-3 * largest;
    if mu_1 <= 0.0 {
        return 1e-12;
    }
    let mu = mu_1 * (2.0 - smallest / mu_1).clamp(0.0, 1.0);
    mu * mu
}

impl<'a, J: Lanes> NullSpace<'a, J> {
    /// Creates the projector of `task` rows over `joints`; `added` is added to the diagonal of `J D Jᵀ`.
    #[inline(always)]
    pub(crate) fn new(
        rows: &'a [J; MAX_AXES],
        weight: J,
        added: &[Scalar<J>; MAX_AXES],
        (task, joints): (usize, usize),
    ) -> Self {
        let factor = factor_of(rows, weight, added);
        Self::of(rows, weight, &factor, (task, joints))
    }

    /// Creates the projector from a matrix that is already factored.
    #[inline(always)]
    pub(crate) fn of(
        rows: &'a [J; MAX_AXES],
        weight: J,
        factor: &Factor<Scalar<J>>,
        (task, joints): (usize, usize),
    ) -> Self {
        Self { rows, weight, factor: *factor, task, joints }
    }

    /// `N v`; zero with more rows than joints (no redundancy).
    #[inline(always)]
    pub(crate) fn project(&self, v: J) -> J {
        if self.task > self.joints {
            return J::splat(0.0);
        }
        let along = self.factor.solve::<J::One>(&times(self.rows, v));
        J::fnma(self.weight, transpose_times(self.rows, &along), v)
    }

    /// `N v` from a known pseudo-inverse, `N = I − J⁺J`: no further solve.
    #[inline(always)]
    pub(crate) fn project_by(&self, pinv_transposed: &[J; MAX_AXES], v: J) -> J {
        if self.task > self.joints { J::splat(0.0) } else { v - transpose_times(pinv_transposed, &times(self.rows, v)) }
    }

    /// Returns the transposed pseudo-inverse of this projector.
    #[inline(always)]
    pub(crate) fn pseudo_inverse(&self) -> [J; MAX_AXES] {
        self.factor.weighted_rows(self.rows, self.weight)
    }
}

/// Rows of the identity. A static, because loading a row just after storing a single element of it stalls.
static IDENTITY: JointMatrix = {
    let mut rows = [[0.0; MAX_JOINTS]; MAX_JOINTS];
    let mut i = 0;
    while i < MAX_JOINTS {
        rows[i][i] = 1.0;
        i += 1;
    }
    rows
};

impl<J: Lanes> RowLengths<J> for NullSpace<'_, J> {
    #[inline(always)]
    fn row_lengths(&self) -> J {
        let (nothing, zero) = (J::splat(0.0), J::One::splat(0.0));
        if self.task > self.joints {
            return nothing;
        }
        let (mut columns, pinv_transposed) = ([[zero; MAX_JOINTS]; MAX_AXES], self.pseudo_inverse());
        for r in 0..MAX_AXES {
            columns[r] = pinv_transposed[r].array();
        }
        let (joints, mut squares) = (self.joints.min(MAX_JOINTS), [zero; MAX_JOINTS]);
        for first in (0..joints).step_by(4) {
            let mut four = [nothing; 4];
            for i in first..joints.min(first + 4) {
                let row = &mut four[i - first];
                *row = J::load(&IDENTITY[i]);
                for r in 0..MAX_AXES {
                    *row = J::fnma(J::spread(columns[r][i]), self.rows[r], *row);
                }
            }
            let [a, b, c, d] = &four;
            let sums = J::dots([a, b, c, d], [a, b, c, d]);
            squares[first..first + 4].copy_from_slice(&sums);
        }
        J::sqrt(J::of_joints(&squares))
    }
}

/// Returns the matrix N for rows in memory.
#[cold]
#[inline(never)]
pub(crate) fn projector(
    rows: &Rows,
    weight: &JointVec,
    added: &AxisVec,
    (task, joints): (usize, usize),
) -> JointMatrix {
    let rows = load_rows::<EveryJoint>(rows);
    let space = NullSpace::new(&rows, EveryJoint::load(weight), added, (task, joints));
    let mut out = [[0.0; MAX_JOINTS]; MAX_JOINTS];
    for j in 0..joints.min(MAX_JOINTS) {
        let mut unit = [0.0; MAX_JOINTS];
        unit[j] = 1.0;
        for (row, value) in out.iter_mut().zip(space.project(EveryJoint::load(&unit)).array()) {
            row[j] = value;
        }
    }
    out
}

impl NullSpaceCost {
    /// Returns the gradient of `share` times the posture cost plus the joint-limit cost at `q`.
    #[inline(always)]
    pub(crate) fn gradient<J: Lanes>(&self, q: J, rest: J, share: f64) -> J {
        let toward_middle = J::load(&self.limits) * (q - J::load(&self.middle));
        J::fma(J::splat(share) * J::load(&self.posture), q - rest, toward_middle)
    }
}

/// Gradient of `−ln √det(JJᵀ)` over the task rows.
///
/// `∂/∂q_i = −Σ_j P_j · ∂J_j/∂q_i` with `P = (JJᵀ)⁻¹ J`, both in base axes (6 × n). A column (v, ω) after joint i turns
/// with it: `ω_i × v_j`, `ω_i × ω_j`. For a column before joint i only its tool point moves: `ω_j × v_i`. `turning`
/// subtracts the rotation of the task frame, for rows in the tool's axes.
pub(crate) fn manipulability_gradient(jacobian: &Rows, p: &Rows, turning: bool, n: usize) -> JointVec {
    let n = n.min(MAX_JOINTS);
    let column = |m: &Rows, j: usize, from: usize| [m[from][j], m[from + 1][j], m[from + 2][j]];
    let mut out = [0.0; MAX_JOINTS];
    for i in 0..n {
        let (v_i, w_i) = (column(jacobian, i, 0), column(jacobian, i, 3));
        for j in 0..n {
            let (v_j, w_j) = (column(jacobian, j, 0), column(jacobian, j, 3));
            let (mut dv, mut dw) =
                if i <= j { (cross(w_i, v_j), cross(w_i, w_j)) } else { (cross(w_j, v_i), [0.0; 3]) };
            if turning {
                dv = subtract(dv, cross(w_i, v_j));
                dw = subtract(dw, cross(w_i, w_j));
            }
            out[i] -= dot(column(p, j, 0), dv) + dot(column(p, j, 3), dw);
        }
    }
    out
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn subtract(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
