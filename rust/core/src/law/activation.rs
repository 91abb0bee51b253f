//! Responsibility (6), (7), activation (10) and the joint torque limits of (11).

use nalgebra::DMatrix;

use crate::law::nullspace::{step_projector, step_pseudo_inverse};
use crate::math::rows::{JointMatrix, load_rows, tr_mul};
use crate::math::simd::{JointVec16, JointVector, RealOps, TaskVector};
use crate::params::Params;
use crate::{AxisVec, JointVec, MAX_AXES, Rows};

/// Smallest sum that shares are divided by. Its inverse times any strength is finite. An axis whose joints move the
/// tool by less gets no torque.
const MIN_SUM: f64 = 1e-100;

/// Size of `N∇g` [rad] below which the null column turns into the row norms of `N`.
const GRADIENT_THRESHOLD: f64 = 1e-3;

/// Activation matrix, transposed: row r holds the shares of task axis r, the last row those of the null-space motion.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Activation<J: JointVector> {
    /// Shares before they are divided by their sums.
    sizes: [J; MAX_AXES],
    /// Inverse of the sum of each row.
    per_sum: J::Axes,
    null: J,
}

impl<J: JointVector> Activation<J> {
    /// (10): the columns of `|J⁺|`, each divided by its sum, and the null-space column.
    ///
    /// The size of Δx in (6) cancels, which also settles the 0/0 of an axis at rest.
    #[inline(always)]
    pub(crate) fn new(pinv_transposed: &[J; MAX_AXES], null: J) -> Self {
        let zero = J::splat(0.0);
        let mut sizes = [zero; MAX_AXES];
        for r in 0..MAX_AXES {
            sizes[r] = J::abs(pinv_transposed[r]);
        }
        let [a, b, c, d] = J::sum4([sizes[0], sizes[1], sizes[2], sizes[3]]);
        let [e, f, ..] = J::sum4([sizes[4], sizes[5], zero, zero]);
        let sums = J::Axes::max(J::Axes::from_axes(&[a, b, c, d, e, f]), J::Axes::splat(MIN_SUM));
        let per_sum = J::Axes::splat(1.0) / sums;
        Self { sizes, per_sum, null }
    }

    /// (11): `τ^q = A τ^x` [N·m], the null-space torque last.
    #[inline(always)]
    pub(crate) fn distribute(&self, strength: J::Axes, null_torque: f64) -> J {
        let per_size = (self.per_sum * strength).to_axes();
        J::fma(self.null, J::splat(null_torque), tr_mul(&self.sizes, &per_size))
    }
}

impl Activation<JointVec16> {
    /// Creates the matrix from shares in memory.
    pub(crate) fn of(task: &Rows, null: &JointVec) -> Self {
        Self {
            sizes: load_rows(task),
            per_sum: <JointVec16 as JointVector>::Axes::splat(1.0),
            null: JointVec16::load(null),
        }
    }

    /// Returns A of (10) over all joints for the task rows of a step, the gradient of its null-space cost and λ; `sigma`
    /// gives the smallest and largest singular value of the scaled rows.
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

    /// Returns the shares of one task axis.
    pub(crate) fn row(&self, axis: usize) -> JointVec {
        (self.sizes[axis] * JointVec16::splat(self.per_sum.to_axes()[axis])).to_joints()
    }

    /// Returns the shares in the null-space motion.
    pub(crate) fn null(&self) -> JointVec {
        self.null.to_joints()
    }

    /// Returns the n × (k + 1) matrix, the null-space column last.
    pub(crate) fn matrix(&self, k: usize, n: usize) -> DMatrix<f64> {
        let columns: Vec<JointVec> = (0..k).map(|axis| self.row(axis)).chain([self.null()]).collect();
        DMatrix::from_fn(n, k + 1, |i, r| columns[r][i])
    }
}

/// (6), (7): `|J⁺ diag(Δx)|` and `|α N∇g|`, n × (k + 1): the shares of [`Activation`] before normalization.
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

/// Shares of the joints in the null-space motion `N∇g`: absolute values, blended into the row lengths of `N` where the
/// motion vanishes.
///
/// `projector` is evaluated only there.
#[inline(always)]
pub(crate) fn null_column<J: JointVector>(motion: J, projector: &impl RowLengths<J>) -> J {
    let sizes = J::abs(motion);
    let sum = sizes.sum();
    let (zero, one) = (J::Elem::splat(0.0), J::Elem::splat(1.0));
    let blend = sum * J::Elem::splat(1.0 / GRADIENT_THRESHOLD) - one;
    if !J::Elem::any_lt(blend, one) {
        return sizes * J::broadcast(one / sum);
    }
    let (blend, lengths) = (J::Elem::min(J::Elem::max(blend, zero), one), projector.row_lengths());
    let least = J::Elem::splat(MIN_SUM);
    let (moved, still) = (J::Elem::max(sum, least), J::Elem::max(lengths.sum(), least));
    sizes * J::broadcast(blend / moved) + lengths * J::broadcast((one - blend) / still)
}

/// A matrix over the joints with row lengths. A trait, because a closure would be compiled for the baseline instruction
/// set.
pub(crate) trait RowLengths<J> {
    /// Length of each row.
    fn row_lengths(&self) -> J;
}

impl RowLengths<JointVec16> for JointMatrix {
    fn row_lengths(&self) -> JointVec16 {
        JointVec16::load(&self.map(|row| row.iter().map(|x| x * x).sum::<f64>().sqrt()))
    }
}

/// `M v` of an n × n matrix.
pub(crate) fn product(m: &JointMatrix, v: &JointVec) -> JointVec {
    m.map(|row| row.iter().zip(v).map(|(a, b)| a * b).sum())
}
