//! Law `cap`: each task axis pushes back with at most a given force. Lines 7 and 8 of the control step.

use crate::law::wrench::Wrench;
use crate::law::{Motion, Tick};
use crate::math::ldlt6::Factor;
use crate::math::rows::{Square, axes, damped, diagonal, weighted_gram, wide};
use crate::math::simd::{Axes, AxisScalar, Lanes};
use crate::params::Follow;

/// Input of the law for one step, with the rows of the task's axes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Demand<'a, W: Axes> {
    /// `C = J K_p⁻¹ Jᵀ`: compliance of each axis on the servos' stiffness.
    pub(crate) compliance: &'a Square<AxisScalar<W>>,
    /// `λ²/k̄` of each row, in its units.
    pub(crate) damping: W,
    /// Step `s = h (K_x ẽ + twist)` [m, rad].
    pub(crate) step: W,
    /// The step within its per-axis limits.
    pub(crate) bounded_step: W,
    /// Softness w ∈ [0, 1].
    pub(crate) softness: W,
    /// Cap F of the yielding axis [N, N·m].
    pub(crate) cap: W,
}

impl<W: Axes> Demand<'_, W> {
    /// Returns the wrench that the servos shall exert.
    #[inline(always)]
    pub(crate) fn wrench(&self, follow: Follow) -> Wrench<W> {
        match follow {
            Follow::Free => Wrench { soft: self.soft_force(), stiff: self.stiff_force() },
            Follow::Hold => self.all_rows(),
        }
    }

    /// `w clip(s / C, ±F)`: force of a soft axis, independent of all other constraints.
    #[inline(always)]
    fn soft_force(&self) -> W {
        let own = W::at_least(diagonal(self.compliance), W::splat(f64::MIN_POSITIVE));
        self.softness * W::clip(self.step / own, self.cap)
    }

    /// `(C + diag(C_jj w / (1 − w)) + λ²/k̄)⁻¹ s` over the rows with w < 1.
    ///
    /// Solved in `y = W / √(1 − w)`: the added diagonal then stays finite and a row at w = 1 drops out, so that
    /// softness changes without a branch.
    #[inline(always)]
    pub(crate) fn stiff_force(&self) -> W {
        let root = W::sqrt(W::at_least(W::splat(1.0) - self.softness, W::splat(0.0)));
        let own = W::at_least(diagonal(self.compliance), W::splat(f64::MIN_POSITIVE));
        let added = W::fma(root * root, self.damping, self.softness * own);
        let (roots, mut m) = (axes(root), *self.compliance);
        for (r, row) in m.iter_mut().enumerate() {
            for c in 0..=r {
                row[c] = row[c] * (roots[r] * roots[c]);
            }
        }
        let y = Factor::new::<W::One>(&damped(m, &axes(added))).solve::<W::One>(&axes(root * self.bounded_step));
        root * wide(&y)
    }

    /// `(C + λ²/k̄)⁻¹ s` over all rows, soft steps clamped to ±F C_jj.
    #[inline(always)]
    fn all_rows(&self) -> Wrench<W> {
        let (w, stiff) = (self.softness, W::splat(1.0) - self.softness);
        let most = self.cap * diagonal::<W>(self.compliance);
        let b = W::fma(w, W::clip(self.bounded_step, most), stiff * self.bounded_step);
        let factor = Factor::new::<W::One>(&damped(*self.compliance, &axes(self.damping)));
        let all: W = wide(&factor.solve::<W::One>(&axes(b)));
        Wrench { soft: w * all, stiff: stiff * all }
    }
}

/// Lead of the goals under law `cap`: the wrench mapped to the joints, scaled to torque ceilings and speed limits.
#[inline(always)]
pub(crate) fn motion<J: Lanes>(tick: &Tick<'_, J>) -> Motion<J> {
    let plan = tick.plan;
    let demand = Demand {
        compliance: &weighted_gram(tick.rows, J::load(&plan.servos.compliance)),
        damping: plan.per_stiffness(tick.damping),
        step: tick.wish.step,
        bounded_step: tick.wish.bounded,
        softness: tick.wish.softness,
        cap: tick.wish.strength,
    };
    let mut wrench = demand.wrench(plan.follow);
    let mut ahead = J::splat(0.0);
    if plan.pace.on {
        let (force, speed) = tick.paced(diagonal(demand.compliance));
        (wrench.stiff, ahead) = (wrench.stiff + force, speed);
    }
    tick.exert(wrench, tick.null_motion(), tick.resistance(ahead))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::simd::{Arithmetic, EveryJoint};
    use crate::{AxisVec, MAX_AXES};

    type Axes = <EveryJoint as Lanes>::Axes;

    fn case() -> (Square, AxisVec) {
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
        let demand = Demand {
            compliance: &c,
            damping: Axes::splat(1e-3),
            step: wide(&s),
            bounded_step: wide(&s),
            softness: wide(&softness),
            cap: Axes::splat(5.0),
        };
        let stiff = axes(demand.stiff_force());
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
        assert!((axes(demand.wrench(Follow::Free).soft)[1] + 0.1).abs() < 1e-15);
    }

    #[test]
    fn a_soft_axis_never_exceeds_its_cap() {
        let (c, _) = case();
        let demand = Demand {
            compliance: &c,
            damping: Axes::splat(0.0),
            step: Axes::splat(100.0),
            bounded_step: Axes::splat(0.1),
            softness: Axes::splat(1.0),
            cap: Axes::splat(5.0),
        };
        assert!(axes(demand.wrench(Follow::Free).soft).iter().all(|f| (f - 5.0).abs() < 1e-15));
    }
}
