//! LDLᵀ factor of a 6 × 6 matrix, and the damped pseudo-inverse of six rows.

use super::rows::{Mat6, damped, load_rows, store_rows, weighted_gram};
use super::simd::{JointVec16, JointVector, RealOps};
use crate::{AxisVec, JointVec, MAX_AXES, Rows};

outlined_formula! {
    /// Factors `J diag(d) Jᵀ` plus the diagonal matrix of `added`.
    fn factor_gram<J>(rows: &[J; MAX_AXES], d: J, added: &AxisVec) -> Ldlt6 as factored
}

#[inline(always)]
fn factored<J: JointVector>(rows: &[J; MAX_AXES], d: J, added: &AxisVec) -> Ldlt6 {
    Ldlt6::new::<J::Elem>(&damped(weighted_gram(rows, d), added))
}

/// Lower bound on a pivot, as a share of its diagonal entry.
const PIVOT_SHARE: f64 = 1e-15;

/// Lower bound on a pivot. Its square and inverse square are finite and nonzero.
const MIN_PIVOT: f64 = 1e-100;

/// Factor `L D Lᵀ` of a symmetric, positive definite matrix; only its lower half is read.
///
/// `D` has blocks of 2 × 2, so that the dependency chain has three divisions instead of six. A pivot lost to rounding
/// is replaced by a tiny positive number, so a singular matrix gives large but finite results. A row of zeros gives a
/// zero result if the right-hand side is zero there, so a task with fewer axes needs no separate code.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ldlt6 {
    /// `L` below its diagonal; the 2 × 2 blocks on the diagonal are the identity.
    l: Mat6,
    /// Inverse `[[a, b], [b, c]]` of each 2 × 2 block of `D`, as `[a, b, c]`.
    inverse: [[f64; 3]; MAX_AXES / 2],
}

impl Ldlt6 {
    /// Factors `m` with the scalar operations of an instruction set.
    #[inline(always)]
    pub(crate) fn new<A: RealOps<Real = f64>>(m: &Mat6) -> Self {
        let (mut s, mut l) = (*m, [[0.0; MAX_AXES]; MAX_AXES]);
        let mut inverse = [[0.0; 3]; MAX_AXES / 2];
        unrolled!(block in 0 1 2 => {
            let (i, j) = (2 * block, 2 * block + 1);
            let least = [A::max(PIVOT_SHARE * m[i][i], MIN_PIVOT), A::max(PIVOT_SHARE * m[j][j], MIN_PIVOT)];
            let (a, b, c) = (A::max(s[i][i], least[0]), s[j][i], A::max(s[j][j], least[1]));
            let determinant = A::max(A::fnma(b, b, a * c), a * least[1]);
            // The products do not depend on this division, so they are computed during its latency.
            let scale = 1.0 / determinant;
            let mut products = [[0.0; 2]; MAX_AXES];
            for r in j + 1..MAX_AXES {
                let (u, v) = (s[r][i], s[r][j]);
                products[r] = [A::fnma(b, v, c * u), A::fnma(b, u, a * v)];
            }
            for r in j + 1..MAX_AXES {
                for k in j + 1..=r {
                    s[r][k] = A::fnma(scale, A::fma(products[r][0], s[k][i], products[r][1] * s[k][j]), s[r][k]);
                }
            }
            inverse[block] = [c * scale, -b * scale, a * scale];
            for r in j + 1..MAX_AXES {
                (l[r][i], l[r][j]) = (products[r][0] * scale, products[r][1] * scale);
            }
        });
        Self { l, inverse }
    }

    /// Solves `M X = B`; each row of B is one value, or one value per joint.
    #[inline(always)]
    pub(crate) fn solve<A: RealOps>(&self, b: &[A::Real; MAX_AXES]) -> [A::Real; MAX_AXES] {
        let mut x = *b;
        unrolled!(block in 0 1 => {
            let (i, j) = (2 * block, 2 * block + 1);
            for r in j + 1..MAX_AXES {
                x[r] = A::fnma(A::splat(self.l[r][j]), x[j], A::fnma(A::splat(self.l[r][i]), x[i], x[r]));
            }
        });
        unrolled!(block in 0 1 2 => {
            let ((i, j), [a, b, c]) = ((2 * block, 2 * block + 1), self.inverse[block]);
            let (u, v) = (x[i], x[j]);
            x[i] = A::fma(A::splat(a), u, A::splat(b) * v);
            x[j] = A::fma(A::splat(b), u, A::splat(c) * v);
        });
        unrolled!(block in 1 0 => {
            let (i, j) = (2 * block, 2 * block + 1);
            for r in j + 1..MAX_AXES {
                x[i] = A::fnma(A::splat(self.l[r][i]), x[r], x[i]);
                x[j] = A::fnma(A::splat(self.l[r][j]), x[r], x[j]);
            }
        });
        x
    }

    /// Returns `M⁻¹ J D`, the transposed pseudo-inverse. `self` is the factor of `M = J D Jᵀ` plus damping,
    /// `joint_weight` the diagonal of D.
    #[inline(always)]
    pub(crate) fn weighted_rows<J: JointVector>(&self, rows: &[J; MAX_AXES], joint_weight: J) -> [J; MAX_AXES] {
        if J::OUTLINED { self.outlined_rows(rows, joint_weight) } else { self.inlined_rows(rows, joint_weight) }
    }

    #[inline(never)]
    fn outlined_rows<J: JointVector>(&self, rows: &[J; MAX_AXES], joint_weight: J) -> [J; MAX_AXES] {
        self.inlined_rows(rows, joint_weight)
    }

    #[inline(always)]
    fn inlined_rows<J: JointVector>(&self, rows: &[J; MAX_AXES], joint_weight: J) -> [J; MAX_AXES] {
        // Weight the right-hand side, not the result: the compiler then shares the products of [`weighted_gram`].
        let mut weighted = *rows;
        for row in &mut weighted {
            *row = *row * joint_weight;
        }
        // One register at a time, because the six rows of all registers do not fit into the registers.
        let mut out = weighted;
        unrolled!(index in 0 1 2 3 => {
            if index < J::REGISTERS {
                let mut part = [weighted[0].register(index); MAX_AXES];
                for r in 1..MAX_AXES {
                    part[r] = weighted[r].register(index);
                }
                part = self.solve::<J::Register>(&part);
                for r in 0..MAX_AXES {
                    out[r].set_register(index, part[r]);
                }
            }
        });
        out
    }

    /// Returns the diagonal of `M⁻¹`.
    #[inline(always)]
    pub(crate) fn inverse_diagonal<A: RealOps<Real = f64>>(&self) -> AxisVec {
        let mut out = [0.0; MAX_AXES];
        for i in 0..MAX_AXES {
            let mut unit = [0.0; MAX_AXES];
            unit[i] = 1.0;
            out[i] = self.solve::<A>(&unit)[i];
        }
        out
    }
}

/// Returns the transposed damped pseudo-inverse, equation (3) of the paper: row r is column r of `J⁺ = D Jᵀ (J D Jᵀ +
/// Λ)⁻¹`.
///
/// `joint_weight` is the diagonal of `D` (1 for equal weights), `damping` the diagonal of `Λ` (λ², in the squared unit
/// of each row).
pub(crate) fn pseudo_inverse(rows: &Rows, joint_weight: &JointVec, damping: &AxisVec) -> Rows {
    let (rows, weight) = (load_rows::<JointVec16>(rows), JointVec16::load(joint_weight));
    let factor = factor_gram(&rows, weight, damping);
    store_rows(&factor.weighted_rows(&rows, weight))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MAX_JOINTS;
    use crate::math::simd::BaselineF64;

    fn rows() -> [JointVec16; MAX_AXES] {
        let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
        for (r, row) in rows.iter_mut().enumerate() {
            for (i, value) in row.iter_mut().enumerate().take(7) {
                *value = ((r * 7 + i) as f64 * 0.7).sin();
            }
        }
        load_rows(&rows)
    }

    fn x_times(m: &Mat6, x: &AxisVec) -> AxisVec {
        m.map(|row| row.iter().zip(x).map(|(a, b)| a * b).sum())
    }

    #[test]
    fn solve_inverts_the_product_for_values_and_rows() {
        let m = damped(weighted_gram(&rows(), JointVec16::splat(1.0)), &[0.1; MAX_AXES]);
        let factor = Ldlt6::new::<BaselineF64>(&m);
        let x = [1.0, -2.0, 3.0, 0.5, 0.0, 1.5];
        let back = factor.solve::<BaselineF64>(&x_times(&m, &x));
        assert!(x.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-12));
        let mut identity = [[0.0; MAX_JOINTS]; MAX_AXES];
        (0..6).for_each(|i| identity[i][i] = 1.0);
        let inverse = store_rows(&factor.solve::<JointVec16>(&load_rows(&identity)));
        for (i, value) in factor.inverse_diagonal::<BaselineF64>().iter().enumerate() {
            assert!((value - inverse[i][i]).abs() < 1e-12);
        }
    }

    #[test]
    fn a_singular_matrix_gives_finite_results() {
        let factor = Ldlt6::new::<BaselineF64>(&[[0.0; MAX_AXES]; MAX_AXES]);
        assert!(factor.solve::<BaselineF64>(&[1.0; MAX_AXES]).iter().all(|x| x.is_finite()));
        let factor = Ldlt6::new::<BaselineF64>(&[[1.0; MAX_AXES]; MAX_AXES]);
        assert!(factor.solve::<BaselineF64>(&[1.0, -1.0, 1.0, 0.0, 0.0, 2.0]).iter().all(|x| x.is_finite()));
    }

    #[test]
    fn a_row_of_zeros_does_not_change_the_other_rows() {
        for zero in 0..MAX_AXES {
            let mut m = damped(weighted_gram(&rows(), JointVec16::splat(1.0)), &[0.1; MAX_AXES]);
            (0..MAX_AXES).for_each(|i| (m[i][zero], m[zero][i]) = (0.0, 0.0));
            let mut x = [1.0, -2.0, 3.0, 0.5, 0.3, 1.5];
            x[zero] = 0.0;
            let back = Ldlt6::new::<BaselineF64>(&m).solve::<BaselineF64>(&x_times(&m, &x));
            assert!(x.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-11), "{zero}: {back:?}");
        }
    }
}
