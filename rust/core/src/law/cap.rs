//! Law `cap`: each yielding task axis opposes a push with at most its force cap.

use crate::law::wrench::{Wrench, WrenchDemand, WrenchLaw};
use crate::law::{AxisPush, ControlLaw, LawInput};
use crate::math::ldlt6::Ldlt6;
use crate::math::rows::{Mat6, damped, diagonal};
use crate::math::simd::{F64x8, JointVector};
use crate::params::Follow;

/// Compliance, step and bounds of each task axis, from which one control step computes the wrench.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CapProblem<'a, W: F64x8> {
    /// `C = J K_p⁻¹ Jᵀ` [m/N, rad/(N·m)]: compliance of the task axes that results from the servos' stiffness.
    pub(crate) compliance: &'a Mat6,
    /// Damping `λ²/k̄` of each row, in the units of `C`, with the servos' mean stiffness k̄.
    pub(crate) damping: W,
    /// Step `s = h K_x ẽ` [m, rad], within the step limits of soft axes.
    pub(crate) step: W,
    /// Step s [m, rad], within the step limits of soft and of stiff axes.
    pub(crate) bounded_step: W,
    /// Softness w of each axis: 0 if it does not yield, 1 if it yields, between while it changes sides.
    pub(crate) softness: W,
    /// Force cap F of each yielding axis [N, N·m].
    pub(crate) cap: W,
}

impl<W: F64x8> CapProblem<'_, W> {
    /// Returns the wrench that the servos are to exert on the tool.
    #[inline(always)]
    pub(crate) fn wrench(&self, follow: Follow) -> Wrench<W> {
        match follow {
            Follow::Free => Wrench { soft: self.soft_force(), stiff: self.stiff_force() },
            Follow::Hold => self.all_rows(),
        }
    }

    /// Returns `w clip(s_j / C_jj, ±F)`: the force of each soft axis, independent of all other axes.
    #[inline(always)]
    fn soft_force(&self) -> W {
        let c_diagonal = W::max(diagonal(self.compliance), W::splat(f64::MIN_POSITIVE));
        self.softness * W::clamp_abs(self.step / c_diagonal, self.cap)
    }

    /// Returns `(C + diag(C_jj w / (1 − w)) + λ²/k̄)⁻¹ s` over the rows with w < 1, 0 for the others.
    ///
    /// Solved for `y = W / √(1 − w)` with the wrench W: the added diagonal then stays finite, and a row with w = 1 has
    /// no effect, so no branch on the softness is needed.
    #[inline(always)]
    pub(crate) fn stiff_force(&self) -> W {
        let root = W::sqrt(W::max(W::splat(1.0) - self.softness, W::splat(0.0)));
        let c_diagonal = W::max(diagonal(self.compliance), W::splat(f64::MIN_POSITIVE));
        let added = W::fma(root * root, self.damping, self.softness * c_diagonal);
        let (roots, mut m) = (root.to_axes(), *self.compliance);
        for (r, row) in m.iter_mut().enumerate() {
            for c in 0..=r {
                row[c] *= roots[r] * roots[c];
            }
        }
        let factor = Ldlt6::new::<W::Elem>(&damped(m, &added.to_axes()));
        root * W::from_axes(&factor.solve::<W::Elem>(&(root * self.bounded_step).to_axes()))
    }

    /// Returns the wrench `(C + λ²/k̄)⁻¹ s` over all rows, with the steps of soft rows clamped to ±F C_jj.
    #[inline(always)]
    fn all_rows(&self) -> Wrench<W> {
        let (w, stiff) = (self.softness, W::splat(1.0) - self.softness);
        let max = self.cap * diagonal::<W>(self.compliance);
        let b = W::fma(w, W::clamp_abs(self.bounded_step, max), stiff * self.bounded_step);
        let factor = Ldlt6::new::<W::Elem>(&damped(*self.compliance, &self.damping.to_axes()));
        let all = W::from_axes(&factor.solve::<W::Elem>(&b.to_axes()));
        Wrench { soft: w * all, stiff: stiff * all }
    }
}

/// The law `cap`.
pub(crate) struct Cap;

impl WrenchLaw for Cap {
    #[inline(always)]
    fn wrench<J: JointVector>(input: &LawInput<'_, J>, compliance: &Mat6) -> WrenchDemand<J> {
        let params = input.params;
        let problem = CapProblem {
            compliance,
            damping: params.per_stiffness(input.damping),
            step: input.demand.displacement,
            bounded_step: input.demand.clamped_displacement,
            softness: input.demand.softness,
            cap: input.demand.strength,
        };
        let mut wrench = problem.wrench(params.follow);
        let mut ahead = J::splat(0.0);
        if params.pace.on {
            let (force, speed) = input.pacing_force(diagonal(problem.compliance));
            (wrench.stiff, ahead) = (wrench.stiff + force, speed);
        }
        WrenchDemand { wrench, ahead, null_stiffness: None, gain_factor: params.gain_scale }
    }
}

impl ControlLaw for Cap {
    /// Returns the force [N, N·m] that opposes the push without a force cap: `s / (C_jj + (1 − w) λ²/k̄)`, where the
    /// step `s = h K_x ẽ` [m, rad] is within the step limit of the axis.
    fn force_at(push: &AxisPush<'_>) -> f64 {
        let (params, h) = (push.params, push.horizon);
        let axis = &params.per_axis[push.row];
        let w = axis.yields[push.side];
        let c_diagonal: f64 = (0..params.n).map(|i| push.j_row[i].powi(2) * params.servos.compliance[i]).sum();
        let bound = h * if w > 0.0 { axis.soft_step_limit } else { axis.step_limit };
        let step = (h * params.gain_scale * params.kx[push.row][push.row] * push.share * push.deviation).min(bound);
        step / (c_diagonal + (1.0 - w) * push.damping)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::simd::{JointVec16, RealOps};
    use crate::{AxisVec, MAX_AXES};

    type Axes = <JointVec16 as JointVector>::Axes;

    fn case() -> (Mat6, AxisVec) {
        let mut c = [[0.0; MAX_AXES]; MAX_AXES];
        for (r, row) in c.iter_mut().enumerate() {
            for (k, value) in row.iter_mut().enumerate() {
                *value = if r == k { 2.0 } else { 0.3 / (1.0 + r.abs_diff(k) as f64) };
            }
        }
        (c, [0.1, -0.2, 0.3, 0.05, 0.0, -0.1])
    }

    #[test]
    fn partly_soft_rows_follow_the_formula_and_fully_soft_rows_drop_out() {
        let (c, s) = case();
        let softness = [0.5, 1.0, 0.0, 0.0, 0.25, 0.0];
        let problem = CapProblem {
            compliance: &c,
            damping: Axes::splat(1e-3),
            step: Axes::from_axes(&s),
            bounded_step: Axes::from_axes(&s),
            softness: Axes::from_axes(&softness),
            cap: Axes::splat(5.0),
        };
        let stiff = problem.stiff_force().to_axes();
        let rows = [0, 2, 3, 4, 5];
        let matrix = nalgebra::DMatrix::from_fn(5, 5, |i, j| {
            let (r, k) = (rows[i], rows[j]);
            c[r][k] + if r == k { 1e-3 + c[r][r] * softness[r] / (1.0 - softness[r]) } else { 0.0 }
        });
        let b = nalgebra::DVector::from_fn(5, |i, _| s[rows[i]]);
        let expected = matrix.lu().solve(&b).unwrap();
        for (i, &r) in rows.iter().enumerate() {
            assert!((stiff[r] - expected[i]).abs() < 1e-14);
        }
        assert!(stiff[1].abs() < f64::MIN_POSITIVE);
        assert!((problem.wrench(Follow::Free).soft.to_axes()[1] + 0.1).abs() < 1e-15);
    }

    #[test]
    fn a_soft_axis_never_exceeds_its_cap() {
        let (c, _) = case();
        let problem = CapProblem {
            compliance: &c,
            damping: Axes::splat(0.0),
            step: Axes::splat(100.0),
            bounded_step: Axes::splat(0.1),
            softness: Axes::splat(1.0),
            cap: Axes::splat(5.0),
        };
        assert!(problem.wrench(Follow::Free).soft.to_axes().iter().all(|f| (f - 5.0).abs() < 1e-15));
    }
}
