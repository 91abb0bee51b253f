//! Redundancy: the projector of (4) and the cost that is descended in it, line 9.

use crate::law::inverse::{Cholesky, times, transpose_times, weighted_gram};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// An n × n matrix over the joints.
pub(crate) type JointSquare = [[f64; MAX_JOINTS]; MAX_JOINTS];

/// The projector `N = I − D Jᵀ (J D Jᵀ + μ²I)⁻¹ J`, applied without ever being formed.
///
/// With μ = 0 it is exact. μ = μ₁ clip(2 − σ/μ₁, 0, 1) with μ₁ = 10⁻³ σ_max fades it at singular poses, where the exact
/// one jumps.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NullSpace<'a> {
    rows: &'a Rows,
    weight: &'a JointVec,
    factor: Cholesky,
    k: usize,
    n: usize,
    /// Whether there are more rows than joints.
    empty: bool,
}

/// μ² of the exact projector, from the largest and smallest singular value of the rows.
#[inline(always)]
pub(crate) fn fade_squared(smallest: f64, largest: f64) -> f64 {
    let mu_1 = 1e-3 * largest;
    if mu_1 <= 0.0 {
        return 1e-12;
    }
    let mu = mu_1 * (2.0 - smallest / mu_1).clamp(0.0, 1.0);
    mu * mu
}

impl<'a> NullSpace<'a> {
    /// Of `k` rows over `n` joints; `added` holds what is added to the diagonal of `J D Jᵀ`.
    #[inline(always)]
    pub(crate) fn new(rows: &'a Rows, weight: &'a JointVec, added: &AxisVec, k: usize, n: usize) -> Self {
        let mut gram = weighted_gram(rows, weight, k, n);
        for r in 0..k.min(MAX_AXES) {
            gram[r][r] += added[r];
        }
        Self::of(rows, weight, &Cholesky::new(&gram, k), k, n)
    }

    /// The same of a matrix that is factored already.
    #[inline(always)]
    pub(crate) fn of(rows: &'a Rows, weight: &'a JointVec, factor: &Cholesky, k: usize, n: usize) -> Self {
        Self { rows, weight, factor: *factor, k, n, empty: k > n }
    }

    /// The same, if `k` and `n` are larger than the task and the arm.
    #[inline(always)]
    pub(crate) fn padded(self, task: usize, joints: usize) -> Self {
        Self { empty: task > joints, ..self }
    }

    /// `N v`; zero where there are more rows than joints, as there is no redundancy then.
    #[inline(always)]
    pub(crate) fn project(&self, v: &JointVec) -> JointVec {
        if self.empty {
            return [0.0; MAX_JOINTS];
        }
        let along = self.factor.solve(&times(self.rows, v, self.k, self.n));
        let back = transpose_times(self.rows, &along, self.k, self.n);
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..self.n.min(MAX_JOINTS) {
            out[i] = v[i] - self.weight[i] * back[i];
        }
        out
    }

    /// N itself.
    #[cold]
    pub(crate) fn matrix(&self) -> JointSquare {
        let mut out = [[0.0; MAX_JOINTS]; MAX_JOINTS];
        for j in 0..self.n.min(MAX_JOINTS) {
            let mut unit = [0.0; MAX_JOINTS];
            unit[j] = 1.0;
            for (row, value) in out.iter_mut().zip(self.project(&unit)) {
                row[j] = value;
            }
        }
        out
    }

    /// Transposed pseudo-inverse that belongs to this projector.
    #[inline(always)]
    pub(crate) fn pseudo_inverse(&self) -> Rows {
        self.factor.weighted_rows(self.rows, self.weight, self.n)
    }
}

/// The parts of the null-space cost that depend on the arm alone.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cost {
    /// Weight of each joint in `½ Σ w (q − q_rest)²`.
    pub(crate) posture: JointVec,
    /// Middle of each joint's range [rad].
    pub(crate) middle: JointVec,
    /// `weight / (half range)²`; 0 for continuous joints.
    pub(crate) limits: JointVec,
    /// Weight of `−ln √det(JJᵀ)`.
    pub(crate) manipulability: f64,
}

impl Cost {
    /// Gradient of posture and joint-limit cost at `q`.
    #[inline(always)]
    pub(crate) fn gradient(&self, q: &JointVec, rest: &JointVec, n: usize) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..n.min(MAX_JOINTS) {
            out[i] = self.posture[i] * (q[i] - rest[i]) + self.limits[i] * (q[i] - self.middle[i]);
        }
        out
    }
}

/// Gradient of `−ln √det(JJᵀ)` over the task rows.
///
/// `∂/∂q_i = −Σ_j P_j · ∂J_j/∂q_i` with `P = (JJᵀ)⁻¹ J`, both in base axes (6 × n). A column (v, ω) behind joint i turns
/// with it, `ω_i × v_j`, `ω_i × ω_j`; one before it sees its tool point move, `ω_j × v_i`. `turning` subtracts the turn of
/// the task frame itself, for rows taken in the tool's axes.
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
