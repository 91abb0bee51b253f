//! Smooth upper bound on the largest eigenvalue of a symmetric 6 × 6 matrix.

use super::rows::Mat6;
use super::simd::{F64x8, RealOps};
use crate::MAX_AXES;

/// Number of squarings, which raise the matrix to the power 2⁶ = 64 so that the largest eigenvalue dominates.
const SQUARINGS: usize = 6;

/// Returns `ρ = (Σ λ_i⁶⁴)^(1/64)` over the eigenvalues λ_i of `K_p⁻¹ Jᵀ K J`: the stiffness K of the axes relative to
/// that of the servos, whose compliance at the axes is `c = J K_p⁻¹ Jᵀ`.
///
/// ρ is at least the largest eigenvalue and at most 3 % above it (for six equal eigenvalues). It is smooth where
/// eigenvalues cross and needs no state.
#[inline(always)]
pub(crate) fn rho<W: F64x8>(c: &Mat6, stiffness: W) -> f64 {
    // √K C √K has the same eigenvalues, and is symmetric.
    let root = W::sqrt(stiffness);
    let roots = root.to_axes();
    let mut m = [root; MAX_AXES];
    for r in 0..MAX_AXES {
        m[r] = W::from_axes(&c[r]) * root * W::splat(roots[r]);
    }
    // Divide by the trace before each squaring, to prevent overflow.
    let mut traces = [0.0; SQUARINGS];
    for trace in &mut traces {
        *trace = trace_of(&m);
        m = squared(&m, 1.0 / W::Elem::max(*trace, f64::MIN_POSITIVE));
    }
    let mut power = trace_of(&m);
    for trace in traces.iter().rev() {
        power = *trace * W::Elem::sqrt(power);
    }
    power
}

#[inline(always)]
fn trace_of<W: F64x8>(m: &[W; MAX_AXES]) -> f64 {
    let mut sum = 0.0;
    for r in 0..MAX_AXES {
        sum += m[r].to_axes()[r];
    }
    sum
}

/// Returns `(f M)²` for a symmetric matrix M.
#[inline(always)]
fn squared<W: F64x8>(m: &[W; MAX_AXES], factor: f64) -> [W; MAX_AXES] {
    let (factor, mut out) = (W::splat(factor), [W::splat(0.0); MAX_AXES]);
    for r in 0..MAX_AXES {
        let row = (m[r] * factor * factor).to_axes();
        for c in 0..MAX_AXES {
            out[r] = W::fma(W::splat(row[c]), m[c], out[r]);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::rows::{load_rows, weighted_gram};
    use crate::math::simd::{JointVec16, JointVector};
    use crate::{JointVec, MAX_JOINTS};

    #[test]
    fn rho_is_just_above_the_largest_eigenvalue() {
        let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
        for (r, row) in rows.iter_mut().enumerate() {
            for (i, value) in row.iter_mut().enumerate().take(7) {
                *value = ((3 * r + 5 * i) as f64).sin();
            }
        }
        let mut compliance: JointVec = [1.0; MAX_JOINTS];
        compliance[..7].copy_from_slice(&[1.0 / 150.0, 1.0 / 150.0, 1e-2, 1e-2, 1.0 / 60.0, 1.0 / 60.0, 1.0 / 60.0]);
        let of = |stiffness: &[f64; 6]| {
            rho(
                &weighted_gram(&load_rows(&rows), JointVec16::load(&compliance)),
                <JointVec16 as JointVector>::Axes::from_axes(stiffness),
            )
        };
        for stiffness in [[800.0_f64, 800.0, 800.0, 20.0, 20.0, 20.0], [0.0, 1e9, 1e-3, 5.0, 0.0, 0.0], [1.0; 6]] {
            let j = nalgebra::DMatrix::from_fn(6, 7, |r, i| rows[r][i] * stiffness[r].sqrt());
            let c = nalgebra::DVector::from_column_slice(&compliance[..7]);
            let largest = (&j * nalgebra::DMatrix::from_diagonal(&c) * j.transpose()).symmetric_eigenvalues().max();
            let got = of(&stiffness);
            assert!(got >= largest * (1.0 - 1e-12) && got <= 1.0285 * largest, "{got} {largest}");
        }
        assert!(of(&[0.0; 6]) < f64::MIN_POSITIVE);
    }
}
