//! What each axis wants at one tick: lines 3 to 6 of the control step.

use crate::plan::Plan;
use crate::settings::Settings;
use crate::task::{adapt, compliance};
use crate::{AxisVec, MAX_AXES};

/// Deviation and what softness, compliance and gains make of it; one entry per task row.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wish {
    /// e [m, rad].
    pub(crate) deviation: AxisVec,
    /// ẽ = (1 − η w) e.
    pub(crate) adapted: AxisVec,
    /// w ∈ [0, 1].
    pub(crate) softness: AxisVec,
    /// c ∈ [0, 1].
    pub(crate) compliance: AxisVec,
    /// F: strength where the axis yields.
    pub(crate) strength: AxisVec,
    /// w F + (1 − w) hold.
    pub(crate) most: AxisVec,
    /// K [N/m, N·m/rad] for the side it is pushed from.
    pub(crate) stiffness: AxisVec,
    /// D [N·s/m, N·m·s/rad] for that side.
    pub(crate) viscosity: AxisVec,
    /// Velocity of the target [m/s, rad/s].
    pub(crate) twist: AxisVec,
    /// s = h (K_x ẽ + twist), within the limit of soft axes.
    pub(crate) step: AxisVec,
    /// The same within the limits of stiff axes too.
    pub(crate) bounded: AxisVec,
}

impl Wish {
    /// From the deviation and the target's velocity (6,), both in the task frame.
    #[inline(always)]
    pub(crate) fn new(plan: &Plan, settings: &Settings, error: &AxisVec, twist: &AxisVec) -> Self {
        let zero = [0.0; MAX_AXES];
        let mut wish = Self {
            deviation: zero,
            adapted: zero,
            softness: zero,
            compliance: zero,
            strength: zero,
            most: zero,
            stiffness: zero,
            viscosity: zero,
            twist: zero,
            step: zero,
            bounded: zero,
        };
        for (r, row) in plan.rows.iter().enumerate().take(plan.k) {
            let e = error[row.axis];
            let plus = adapt::plus_share(e, row.band);
            let between = |pair: [f64; 2]| (1.0 - plus) * pair[0] + plus * pair[1];
            let w = between(row.yields);
            let adapted = adapt::adapt_deviation(e, row.eta, w);
            let seen = if settings.raw_deviation { e } else { adapted };
            let c = compliance::compliance(seen, row.d_minus, row.d_plus);
            let strength = compliance::strength(c, between(row.soft), between(row.firm), row.profile);
            wish.deviation[r] = e;
            wish.adapted[r] = adapted;
            wish.softness[r] = w;
            wish.compliance[r] = c;
            wish.strength[r] = strength;
            wish.most[r] = w * strength + (1.0 - w) * row.hold;
            wish.stiffness[r] = between(row.stiffness);
            wish.viscosity[r] = between(row.viscosity);
            wish.twist[r] = twist[row.axis];
        }
        wish.take_steps(plan, settings.horizon, twist);
        wish
    }

    /// Line 6: the step and its per-axis limits. Whole vectors are never scaled by their norm, which would spend the
    /// stiff axes' share on the soft ones.
    #[inline(always)]
    fn take_steps(&mut self, plan: &Plan, h: f64, twist: &AxisVec) {
        for (r, row) in plan.rows.iter().enumerate().take(plan.k) {
            let pull: f64 = (0..plan.k).map(|c| plan.kx[r][c] * self.adapted[c]).sum();
            let step = h * (plan.kx_derating * pull + twist[row.axis]);
            let (w, soft_most) = (self.softness[r], h * row.soft_step_limit);
            let most = if w <= 0.0 {
                h * row.step_limit
            } else if w >= 1.0 {
                soft_most
            } else if soft_most.is_finite() && row.step_limit.is_finite() {
                (1.0 - w) * h * row.step_limit + w * soft_most
            } else {
                // Between the two the stiff part of the axis keeps its own limit.
                h * row.step_limit
            };
            self.step[r] = step.clamp(-soft_most, soft_most);
            self.bounded[r] = step.clamp(-most, most);
        }
    }
}
