//! Six rows over the joints, such as a Jacobian, and their products.

use super::simd::{F64x8, JointVector};
use crate::{AxisVec, MAX_AXES, MAX_JOINTS, Rows};

/// A 6 × 6 matrix over the task axes, usually symmetric.
pub(crate) type Mat6 = [[f64; MAX_AXES]; MAX_AXES];

/// A joint-space matrix, `m[row][column]`.
pub(crate) type JointMatrix = [[f64; MAX_JOINTS]; MAX_JOINTS];

/// Copies a slice into an array and fills the remaining entries with `rest`.
pub(crate) fn pad<const N: usize>(values: &[f64], rest: f64) -> [f64; N] {
    let mut out = [rest; N];
    out.iter_mut().zip(values).for_each(|(slot, value)| *slot = *value);
    out
}

/// Loads six rows over the joints from memory.
#[inline(always)]
pub(crate) fn load_rows<J: JointVector>(rows: &Rows) -> [J; MAX_AXES] {
    let mut out = [J::splat(0.0); MAX_AXES];
    for r in 0..MAX_AXES {
        out[r] = J::load(&rows[r]);
    }
    out
}

/// Stores six rows over the joints to memory, zeros in the padding.
#[inline(always)]
pub(crate) fn store_rows<J: JointVector>(rows: &[J; MAX_AXES]) -> Rows {
    let mut out = [[0.0; MAX_JOINTS]; MAX_AXES];
    for r in 0..MAX_AXES {
        rows[r].store(&mut out[r]);
    }
    out
}

/// Row and column of each entry in the lower half of a [`Mat6`], in groups of four; index 6 stands for a row of zeros.
const LOWER_HALF: [[(usize, usize); 4]; 6] = [
    [(0, 0), (1, 0), (1, 1), (2, 0)],
    [(2, 1), (2, 2), (3, 0), (3, 1)],
    [(3, 2), (3, 3), (4, 0), (4, 1)],
    [(4, 2), (4, 3), (4, 4), (5, 0)],
    [(5, 1), (5, 2), (5, 3), (5, 4)],
    [(5, 5), (6, 6), (6, 6), (6, 6)],
];

outlined_formula! {
    /// Returns `J diag(d) Jᵀ`.
    fn weighted_gram<J>(rows: &[J; MAX_AXES], d: J) -> Mat6 as gram
}

#[inline(always)]
fn gram<J: JointVector>(rows: &[J; MAX_AXES], d: J) -> Mat6 {
    let zero = J::splat(0.0);
    let mut scaled = *rows;
    for row in &mut scaled {
        *row = *row * d;
    }
    // References, because a copy of a `JointVec16` is a call.
    let right = [&rows[0], &rows[1], &rows[2], &rows[3], &rows[4], &rows[5], &zero];
    let left = [&scaled[0], &scaled[1], &scaled[2], &scaled[3], &scaled[4], &scaled[5], &zero];
    let mut out = [[0.0; MAX_AXES]; MAX_AXES];
    unrolled!(four in 0 1 2 3 4 5 => {
        let at = LOWER_HALF[four];
        let sums = J::dot4(
            [left[at[0].0], left[at[1].0], left[at[2].0], left[at[3].0]],
            [right[at[0].1], right[at[1].1], right[at[2].1], right[at[3].1]],
        );
        for i in 0..4 {
            let (r, c) = at[i];
            if r < MAX_AXES {
                (out[r][c], out[c][r]) = (sums[i], sums[i]);
            }
        }
    });
    out
}

outlined_formula! {
    /// Returns `Jᵀ w`.
    fn tr_mul<J>(rows: &[J; MAX_AXES], w: &AxisVec) -> J as sum_of_rows
}

#[inline(always)]
fn sum_of_rows<J: JointVector>(rows: &[J; MAX_AXES], w: &AxisVec) -> J {
    let (mut even, mut odd) = (rows[0] * J::splat(w[0]), rows[1] * J::splat(w[1]));
    for pair in 1..MAX_AXES / 2 {
        even = J::fma(rows[2 * pair], J::splat(w[2 * pair]), even);
        odd = J::fma(rows[2 * pair + 1], J::splat(w[2 * pair + 1]), odd);
    }
    even + odd
}

/// Returns `J v`.
#[inline(always)]
pub(crate) fn mul<J: JointVector>(rows: &[J; MAX_AXES], v: J) -> AxisVec {
    let zero = J::splat(0.0);
    let [a, b, c, d] = J::dot4([&rows[0], &rows[1], &rows[2], &rows[3]], [&v; 4]);
    let [e, f, ..] = J::dot4([&rows[4], &rows[5], &zero, &zero], [&v, &v, &zero, &zero]);
    [a, b, c, d, e, f]
}

/// Returns the diagonal of a matrix as a task vector.
#[inline(always)]
pub(crate) fn diagonal<W: F64x8>(m: &Mat6) -> W {
    W::from_axes(&[m[0][0], m[1][1], m[2][2], m[3][3], m[4][4], m[5][5]])
}

/// Returns `M + Λ`, where `damping` is the diagonal of Λ.
#[inline(always)]
pub(crate) fn damped(mut m: Mat6, damping: &AxisVec) -> Mat6 {
    for r in 0..MAX_AXES {
        m[r][r] += damping[r];
    }
    m
}
