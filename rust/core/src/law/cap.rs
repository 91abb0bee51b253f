//! Law `cap`: each task axis pushes back with at most a given force. Lines 7 and 8 of the control step.

use crate::command::goal::clip;
use crate::law::inverse::{Cholesky, Square, weighted_gram};
use crate::law::wrench::Wrench;
use crate::law::{Motion, Tick};
use crate::settings::Follow;
use crate::{AxisVec, MAX_AXES};

/// One tick of one task, rows of the task's axes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Demand<'a> {
    /// `C = J K_p⁻¹ Jᵀ`: how far the servos let each axis go per unit of force.
    pub(crate) compliance: &'a Square,
    /// `λ²/k̄` of each row, in its units.
    pub(crate) damping: &'a AxisVec,
    /// Step `s = h (K_x ẽ + twist)` [m, rad].
    pub(crate) step: &'a AxisVec,
    /// The step within its per-axis limits.
    pub(crate) bounded_step: &'a AxisVec,
    /// Softness w ∈ [0, 1].
    pub(crate) softness: &'a AxisVec,
    /// Cap F of the yielding axis [N, N·m].
    pub(crate) cap: &'a AxisVec,
}

impl Demand<'_> {
    /// The wrench that the servos are to exert.
    #[inline(always)]
    pub(crate) fn wrench(&self, follow: Follow, k: usize) -> Wrench {
        match follow {
            Follow::Free => Wrench { soft: self.soft_force(k), stiff: self.stiff_force(k) },
            Follow::Hold => self.all_rows(k),
        }
    }

    /// `w clip(s / C, ±F)`: what a soft axis exerts, whatever else is constrained.
    #[inline(always)]
    fn soft_force(&self, k: usize) -> AxisVec {
        let mut out = [0.0; MAX_AXES];
        for j in 0..k.min(MAX_AXES) {
            let force = self.step[j] / self.compliance[j][j].max(f64::MIN_POSITIVE);
            out[j] = self.softness[j] * clip(force, self.cap[j]);
        }
        out
    }

    /// `(C + diag(C_jj w / (1 − w)) + λ²/k̄)⁻¹ s` over the rows with w < 1.
    ///
    /// Solved in `y = W / √(1 − w)`: the added diagonal then stays finite and a row at w = 1 drops out by itself, so
    /// that softness may change over without a branch.
    #[inline(always)]
    pub(crate) fn stiff_force(&self, k: usize) -> AxisVec {
        let k = k.min(MAX_AXES);
        let mut root = [0.0; MAX_AXES];
        for r in 0..k {
            root[r] = (1.0 - self.softness[r]).max(0.0).sqrt();
        }
        let mut m = [[0.0; MAX_AXES]; MAX_AXES];
        let mut b = [0.0; MAX_AXES];
        for r in 0..k {
            for c in 0..=r {
                m[r][c] = root[r] * self.compliance[r][c] * root[c];
            }
            let own = self.compliance[r][r];
            m[r][r] += root[r] * root[r] * self.damping[r] + self.softness[r] * own.max(f64::MIN_POSITIVE);
            b[r] = root[r] * self.bounded_step[r];
        }
        let mut out = Cholesky::new(&m, k).solve(&b);
        for r in 0..k {
            out[r] *= root[r];
        }
        out
    }

    /// `(C + λ²/k̄)⁻¹ s` over all rows, soft steps clamped to ±F C_jj.
    #[inline(always)]
    fn all_rows(&self, k: usize) -> Wrench {
        let k = k.min(MAX_AXES);
        let mut m = *self.compliance;
        let mut b = [0.0; MAX_AXES];
        for r in 0..k {
            m[r][r] += self.damping[r];
            let most = self.cap[r] * self.compliance[r][r];
            let w = self.softness[r];
            b[r] = (1.0 - w) * self.bounded_step[r] + w * clip(self.bounded_step[r], most);
        }
        let all = Cholesky::new(&m, k).solve(&b);
        let mut out = Wrench::default();
        for r in 0..k {
            out.soft[r] = self.softness[r] * all[r];
            out.stiff[r] = (1.0 - self.softness[r]) * all[r];
        }
        out
    }
}

/// Goals' lead of law `cap`: the wrench through the joints, scaled to torque ceilings and speed limits.
#[inline(always)]
pub(crate) fn motion(tick: &Tick<'_>) -> Motion {
    let plan = tick.plan;
    let compliance = weighted_gram(tick.rows, &plan.servos.compliance, tick.k, tick.n);
    let damping = plan.per_stiffness(tick.damping);
    let demand = Demand {
        compliance: &compliance,
        damping: &damping,
        step: tick.step,
        bounded_step: tick.bounded_step,
        softness: tick.softness,
        cap: tick.strength,
    };
    tick.exert(demand.wrench(plan.follow, tick.k), tick.null_motion())
}

#[cfg(test)]
mod tests {
    use super::*;

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
    fn partly_soft_rows_follow_the_formula_and_fully_soft_ones_leave() {
        let (c, s) = case();
        let softness = [0.5, 1.0, 0.0, 0.0, 0.25, 0.0];
        let demand = Demand {
            compliance: &c,
            damping: &[1e-3; 6],
            step: &s,
            bounded_step: &s,
            softness: &softness,
            cap: &[5.0; 6],
        };
        let stiff = demand.stiff_force(6);
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
        assert!((demand.wrench(Follow::Free, 6).soft[1] + 0.1).abs() < 1e-15);
    }

    #[test]
    fn a_soft_axis_never_exceeds_its_cap() {
        let (c, _) = case();
        let demand = Demand {
            compliance: &c,
            damping: &[0.0; 6],
            step: &[100.0; 6],
            bounded_step: &[0.1; 6],
            softness: &[1.0; 6],
            cap: &[5.0; 6],
        };
        assert!(demand.wrench(Follow::Free, 6).soft.iter().all(|f| (f - 5.0).abs() < 1e-15));
    }
}
