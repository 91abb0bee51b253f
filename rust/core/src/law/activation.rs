//! Responsibility, activation and joint torque limits: equations (6), (7), (10), (11) of the paper.

use nalgebra::DMatrix;

use crate::law::nullspace::{step_projector, step_pseudo_inverse};
use crate::math::rows::{JointMatrix, load_rows, tr_mul};
use crate::math::simd::{F64x8, JointVec16, JointVector, RealOps};
use crate::params::Params;
use crate::task::compliance::clamp01;
use crate::{AxisVec, JointVec, MAX_AXES, Rows};

/// Lower bound on the sum by which the shares of an axis are divided, so that the quotient times any strength is
/// finite. With a smaller sum, the axis gets less than its strength, down to zero.
const MIN_SUM: f64 = 1e-100;

/// Sum of `|N∇g|` over the joints [rad] up to which the null-space shares are the row norms of N, because the direction
/// of so small a gradient is meaningless. Up to twice this sum they blend into `|N∇g|`; above, they are `|N∇g|`.
const GRADIENT_THRESHOLD: f64 = 1e-3;

/// Transposed activation matrix: one row per task axis with the shares of the joints in that axis, and a last row with
/// their shares in the null-space motion.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Activation<J: JointVector> {
    /// `|J⁺|` transposed: the shares in each task axis, before each row is divided by its sum.
    magnitudes: [J; MAX_AXES],
    /// Reciprocal of the sum of each row of `magnitudes`.
    per_sum: J::Axes,
    /// Share of each joint in the null-space motion, 0 to 1.
    null: J,
}

impl<J: JointVector> Activation<J> {
    /// Computes A of equation (10) of the paper: the columns of `|J⁺|`, each divided by its sum, and the null-space
    /// column `null`.
    ///
    /// The paper's factor Δx, equation (6), cancels. Without it, an axis without deviation does not give 0/0.
    #[inline(always)]
    pub(crate) fn new(pinv_transposed: &[J; MAX_AXES], null: J) -> Self {
        let zero = J::splat(0.0);
        let mut magnitudes = [zero; MAX_AXES];
        for r in 0..MAX_AXES {
            magnitudes[r] = J::abs(pinv_transposed[r]);
        }
        let [a, b, c, d] = J::sum4([magnitudes[0], magnitudes[1], magnitudes[2], magnitudes[3]]);
        let [e, f, ..] = J::sum4([magnitudes[4], magnitudes[5], zero, zero]);
        let sums = J::Axes::max(J::Axes::from_axes(&[a, b, c, d, e, f]), J::Axes::splat(MIN_SUM));
        let per_sum = J::Axes::splat(1.0) / sums;
        Self { magnitudes, per_sum, null }
    }

    /// Returns the joint torque limits `τ^q = A τ^x` [N·m], equation (11) of the paper; τ^x is `strength` on the task
    /// axes and `null_torque` in the null space.
    #[inline(always)]
    pub(crate) fn distribute(&self, strength: J::Axes, null_torque: f64) -> J {
        let per_size = (self.per_sum * strength).to_axes();
        J::fma(self.null, J::splat(null_torque), tr_mul(&self.magnitudes, &per_size))
    }
}

impl Activation<JointVec16> {
    /// Creates the matrix from shares that are already normalized.
    pub(crate) fn of(task: &Rows, null: &JointVec) -> Self {
        Self {
            magnitudes: load_rows(task),
            per_sum: <JointVec16 as JointVector>::Axes::splat(1.0),
            null: JointVec16::load(null),
        }
    }

    /// Returns A of equation (10) of the paper for one control step, computed from its task rows, the `gradient` of its
    /// null-space cost and the damping λ of the inverse. `sigma` returns the smallest and largest singular value of the
    /// scaled rows.
    pub(crate) fn of_step(
        params: &Params,
        rows: &Rows,
        gradient: &JointVec,
        damping: f64,
        sigma: impl FnOnce() -> [f64; 2],
    ) -> Self {
        let null = if params.k < params.n {
            let projector = step_projector(params, rows, damping, sigma);
            null_column(JointVec16::load(&product(&projector, gradient)), &projector)
        } else {
            JointVec16::splat(0.0)
        };
        Self::new(&load_rows(&step_pseudo_inverse(params, rows, damping)), null)
    }

    /// Returns the shares of the joints in one task axis.
    pub(crate) fn row(&self, axis: usize) -> JointVec {
        (self.magnitudes[axis] * JointVec16::splat(self.per_sum.to_axes()[axis])).to_joints()
    }

    /// Returns the shares of the joints in the null-space motion.
    pub(crate) fn null(&self) -> JointVec {
        self.null.to_joints()
    }

    /// Returns the activation matrix A, n × (k + 1), the null-space column last.
    pub(crate) fn matrix(&self, k: usize, n: usize) -> DMatrix<f64> {
        let columns: Vec<JointVec> = (0..k).map(|axis| self.row(axis)).chain([self.null()]).collect();
        DMatrix::from_fn(n, k + 1, |i, r| columns[r][i])
    }
}

/// Returns the responsibility R, n × (k + 1), equations (6), (7) of the paper: the columns of `|J⁺ diag(Δx)|`, then
/// `|α N∇g|`. Divided by their sums, they are the columns of [`Activation`].
pub(crate) fn responsibility(
    pinv_transposed: &Rows,
    dx: &AxisVec,
    null_motion: &JointVec,
    alpha: f64,
    (k, n): (usize, usize),
) -> DMatrix<f64> {
    DMatrix::from_fn(n, k + 1, |i, r| {
        if r < k { (pinv_transposed[r][i] * dx[r]).abs() } else { (alpha * null_motion[i]).abs() }
    })
}

/// Returns the shares of the joints in the null-space motion `N∇g`: its absolute values divided by their sum. Where the
/// motion vanishes, they blend into the row norms of N, which are computed only then.
#[inline(always)]
pub(crate) fn null_column<J: JointVector>(motion: J, projector: &impl RowNorms<J>) -> J {
    let magnitudes = J::abs(motion);
    let sum = magnitudes.sum();
    let blend = sum * (1.0 / GRADIENT_THRESHOLD) - 1.0;
    if !(blend < 1.0) {
        return magnitudes * J::splat(1.0 / sum);
    }
    let (blend, lengths) = (clamp01::<J::Elem>(blend), projector.row_norms());
    let (moved, still) = (J::Elem::max(sum, MIN_SUM), J::Elem::max(lengths.sum(), MIN_SUM));
    magnitudes * J::splat(blend / moved) + lengths * J::splat((1.0 - blend) / still)
}

/// A joint-space matrix whose row norms can be computed. A trait, because a closure would be compiled for the baseline
/// instruction set.
pub(crate) trait RowNorms<J> {
    /// Returns the Euclidean norm of each row.
    fn row_norms(&self) -> J;
}

impl RowNorms<JointVec16> for JointMatrix {
    fn row_norms(&self) -> JointVec16 {
        JointVec16::load(&self.map(|row| row.iter().map(|x| x * x).sum::<f64>().sqrt()))
    }
}

/// Returns `M v` for a joint-space matrix M.
pub(crate) fn product(m: &JointMatrix, v: &JointVec) -> JointVec {
    m.map(|row| row.iter().zip(v).map(|(a, b)| a * b).sum())
}
