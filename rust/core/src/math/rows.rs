//! Six rows over the joints, such as a Jacobian, and their products.

use super::simd::{Arithmetic, Axes, AxisScalar, Joints, Lanes, Number, Scalar};
use crate::{MAX_AXES, MAX_JOINTS, Rows};

/// A symmetric matrix of task axes.
pub(crate) type Square<R = f64> = [[R; MAX_AXES]; MAX_AXES];

/// A matrix over the joints.
pub(crate) type JointMatrix = [[f64; MAX_JOINTS]; MAX_JOINTS];

/// Loads rows from memory.
#[inline(always)]
pub(crate) fn load_rows<J: Lanes>(rows: &Rows) -> [J; MAX_AXES] {
    let mut out = [J::splat(0.0); MAX_AXES];
    for r in 0..MAX_AXES {
        out[r] = J::load(&rows[r]);
    }
    out
}

/// Stores rows to memory, zeros in the padding.
#[inline(always)]
pub(crate) fn rows_array<J: Joints>(rows: &[J; MAX_AXES]) -> Rows {
    let mut out = [[0.0; MAX_JOINTS]; MAX_AXES];
    for r in 0..MAX_AXES {
        rows[r].store(&mut out[r]);
    }
    out
}

/// Rows and columns of the lower half of a [`Square`], in groups of four; the row after the last is zero.
const LOWER_HALF: [[(usize, usize); 4]; 6] = [
    [(0, 0), (1, 0), (1, 1), (2, 0)],
    [(2, 1), (2, 2), (3, 0), (3, 1)],
    [(3, 2), (3, 3), (4, 0), (4, 1)],
    [(4, 2), (4, 3), (4, 4), (5, 0)],
    [(5, 1), (5, 2), (5, 3), (5, 4)],
    [(5, 5), (6, 6), (6, 6), (6, 6)],
];

perhaps_called! {
    /// `J diag(d) Jᵀ`.
    fn weighted_gram<J>(rows: &[J; MAX_AXES], d: J) -> Square<Scalar<J>> as gram
}

#[inline(always)]
fn gram<J: Lanes>(rows: &[J; MAX_AXES], d: J) -> Square<Scalar<J>> {
    let (zero, nothing) = (J::splat(0.0), J::One::splat(0.0));
    let mut scaled = *rows;
    for row in &mut scaled {
        *row = *row * d;
    }
    // By reference: rows of several configurations are large.
    let right = [&rows[0], &rows[1], &rows[2], &rows[3], &rows[4], &rows[5], &zero];
    let left = [&scaled[0], &scaled[1], &scaled[2], &scaled[3], &scaled[4], &scaled[5], &zero];
    let mut out = [[nothing; MAX_AXES]; MAX_AXES];
    unrolled!(four in 0 1 2 3 4 5 => {
        let at = LOWER_HALF[four];
        let sums = J::dots(
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

/// `Jᵀ w`.
#[inline(always)]
pub(crate) fn transpose_times<J: Lanes, const K: usize>(rows: &[J; MAX_AXES], w: &[Scalar<J>; K]) -> J {
    const { assert!(K >= MAX_AXES) }
    let (mut even, mut odd) = (rows[0] * J::spread(w[0]), rows[1] * J::spread(w[1]));
    for pair in 1..MAX_AXES / 2 {
        even = J::fma(rows[2 * pair], J::spread(w[2 * pair]), even);
        odd = J::fma(rows[2 * pair + 1], J::spread(w[2 * pair + 1]), odd);
    }
    even + odd
}

/// `J v`.
#[inline(always)]
pub(crate) fn times<J: Lanes>(rows: &[J; MAX_AXES], v: J) -> [Scalar<J>; MAX_AXES] {
    let zero = J::splat(0.0);
    let [a, b, c, d] = J::dots([&rows[0], &rows[1], &rows[2], &rows[3]], [&v; 4]);
    let [e, f, ..] = J::dots([&rows[4], &rows[5], &zero, &zero], [&v, &v, &zero, &zero]);
    [a, b, c, d, e, f]
}

/// Returns the values of all task axes.
#[inline(always)]
pub(crate) fn axes<W: Axes>(values: W) -> [AxisScalar<W>; MAX_AXES] {
    values.axes()
}

/// Creates an axis vector from one value per task axis.
#[inline(always)]
pub(crate) fn wide<W: Axes>(v: &[AxisScalar<W>; MAX_AXES]) -> W {
    W::of_axes(v)
}

/// Returns the diagonal of a matrix.
#[inline(always)]
pub(crate) fn diagonal<W: Axes>(m: &Square<AxisScalar<W>>) -> W {
    wide(&[m[0][0], m[1][1], m[2][2], m[3][3], m[4][4], m[5][5]])
}

/// `M + Λ`, `Λ` diagonal.
#[inline(always)]
pub(crate) fn damped<R: Number>(mut m: Square<R>, damping: &[R; MAX_AXES]) -> Square<R> {
    for r in 0..MAX_AXES {
        m[r][r] = m[r][r] + damping[r];
    }
    m
}
