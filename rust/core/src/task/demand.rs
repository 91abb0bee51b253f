//! Demand of each axis in one step: lines 3 to 6 of the control step.

use crate::MAX_AXES;
use crate::math::simd::Axes;
use crate::params::{AxisLanes, Plan, Settings};
use crate::task::adapt::{adapt_deviation, plus_share};
use crate::task::compliance::{between, compliance_by};

/// Deviation and its products with softness, compliance and gains; one lane per task row, zeros after the last.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Wish<W> {
    /// e [m, rad].
    pub(crate) deviation: W,
    /// ẽ = (1 − η w) e.
    pub(crate) adapted: W,
    /// w ∈ [0, 1].
    pub(crate) softness: W,
    /// c ∈ [0, 1].
    pub(crate) compliance: W,
    /// F: strength of the yielding axis.
    pub(crate) strength: W,
    /// w F + (1 − w) hold.
    pub(crate) most: W,
    /// K [N/m, N·m/rad] for the side from which it is pushed.
    pub(crate) stiffness: W,
    /// D [N·s/m, N·m·s/rad] for that side.
    pub(crate) viscosity: W,
    /// Velocity of the target [m/s, rad/s].
    pub(crate) twist: W,
    /// s = h (K_x ẽ + twist), within the limit of soft axes.
    pub(crate) step: W,
    /// s, also within the limits of stiff axes.
    pub(crate) bounded: W,
}

impl<W: Axes> Wish<W> {
    /// Computes the demand from the deviation `e` and the target's velocity, per task row.
    #[inline(always)]
    pub(crate) fn new(plan: &Plan, settings: &Settings, e: W, twist: W) -> Self {
        let rows = &plan.lanes;
        let plus = plus_share::<W>(e, W::constant(&rows.band), W::constant(&rows.band_slope));
        let w = side(plus, &rows.yields);
        let adapted = adapt_deviation::<W>(e, W::constant(&rows.eta), w);
        let seen = if settings.paper_options.raw_deviation { e } else { adapted };
        let c = compliance_by::<W>(seen, W::constant(&rows.firm_from), W::constant(&rows.d_slope));
        let strength = between::<W>(c, side(plus, &rows.far), side(plus, &rows.near));
        let step =
            W::splat(settings.paper_options.horizon) * W::fma(W::splat(plan.kx_derating), pulled(plan, adapted), twist);
        let soft_most = W::splat(settings.paper_options.horizon) * W::constant(&rows.soft_step_limit);
        Self {
            deviation: e,
            adapted,
            softness: w,
            compliance: c,
            strength,
            most: between::<W>(w, W::constant(&rows.hold), strength),
            stiffness: side(plus, &rows.stiffness),
            viscosity: side(plus, &rows.viscosity),
            twist,
            step: W::clip(step, soft_most),
            bounded: W::clip(
                step,
                largest_step(w, W::splat(settings.paper_options.horizon) * W::constant(&rows.step_limit), soft_most),
            ),
        }
    }
}

/// Blends a pair of values by the side from which an axis is pushed.
#[inline(always)]
fn side<W: Axes>(plus: W, pair: &[AxisLanes; 2]) -> W {
    between::<W>(plus, W::constant(&pair[0]), W::constant(&pair[1]))
}

/// `K_x ẽ`.
#[inline(always)]
fn pulled<W: Axes>(plan: &Plan, adapted: W) -> W {
    let (adapted, mut pull) = (adapted.axes(), W::splat(0.0));
    for c in 0..MAX_AXES {
        pull = W::fma(W::constant(&plan.lanes.kx[c]), W::spread(adapted[c]), pull);
    }
    pull
}

/// Per-axis limits of the step of line 6. A vector is never scaled by its norm: a large soft step would reduce the
/// stiff axes' step.
#[inline(always)]
fn largest_step<W: Axes>(w: W, stiff: W, soft: W) -> W {
    let (zero, one, endless) = (W::splat(0.0), W::splat(1.0), W::splat(f64::INFINITY));
    // If one of the two limits is infinite, a partly stiff axis keeps the limit of its stiff part.
    let mixed = W::if_less(W::at_least(stiff, soft), endless, between::<W>(w, stiff, soft), stiff);
    W::if_less(zero, w, W::if_less(w, one, mixed, soft), stiff)
}
