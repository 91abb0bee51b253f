//! Deviation of each task axis in one control step, and the quantities computed from it.

use crate::MAX_AXES;
use crate::math::simd::F64x8;
use crate::params::{AxisArray, Features, Params, Settings};
use crate::task::adapt::{adapt_deviation, push_side_blend};
use crate::task::compliance::{compliance_by, lerp};

/// Deviation of each task axis and the quantities computed from it; one lane per task axis, zeros in unused lanes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AxisDemand<W> {
    /// Deviation e = target − tool [m, rad]; under laws that compute a wrench, from the target when the goal arrives.
    pub(crate) deviation: W,
    /// Adapted deviation ẽ = (1 − η w) e [m, rad].
    pub(crate) adapted: W,
    /// Softness w ∈ [0, 1]: 1 if the axis yields to the push, 0 if not; blended at small deviations.
    pub(crate) softness: W,
    /// Compliance c, equation (8) of the paper: 1 at a small deviation, 0 at a large one.
    pub(crate) compliance: W,
    /// Strength F of a yielding axis [N, N·m; N·m under law `paper`].
    pub(crate) strength: W,
    /// Strength blended by softness, w F + (1 − w) hold, in the unit of F.
    pub(crate) max_strength: W,
    /// Stiffness K per axis [N/m, N·m/rad], for the side on which the deviation lies.
    pub(crate) stiffness: W,
    /// Damping D per axis [N·s/m, N·m·s/rad], for the side on which the deviation lies.
    pub(crate) damping: W,
    /// Velocity of the target [m/s, rad/s].
    pub(crate) twist: W,
    /// Step s = h K_x ẽ [m, rad] over the horizon h, under law `paper` h (K_x ẽ + twist); clamped to the step limit of a
    /// soft axis.
    pub(crate) displacement: W,
    /// Step s [m, rad], clamped to the step limit of a soft or a stiff axis according to its softness.
    pub(crate) clamped_displacement: W,
}

impl<W: F64x8> AxisDemand<W> {
    /// Computes the demand from the deviation `e` [m, rad] and the target's velocity `twist` [m/s, rad/s] of each task
    /// row.
    ///
    /// Laws that compute a wrench use the deviation from the target after the time `ahead` [s], for which the positions
    /// are predicted. They do not add the twist to the step, as law `paper` does: they compensate the damping of the
    /// servos, so the tool would run ahead of the target by twist/K_x.
    #[inline(always)]
    pub(crate) fn new(params: &Params, settings: &Settings, features: Features, e: W, twist: W, ahead: f64) -> Self {
        let rows = &params.axis_simd;
        let by_force = features.law.by_force();
        let e = if features.inputs && by_force { W::fma(W::splat(ahead), twist, e) } else { e };
        let plus = push_side_blend::<W>(e, W::from_array(&rows.band), W::from_array(&rows.band_slope));
        let w = blend_sides(plus, &rows.yields);
        let adapted = adapt_deviation::<W>(e, W::from_array(&rows.eta), w);
        let deviation_of_compliance = if settings.paper_options.raw_deviation { e } else { adapted };
        let c = compliance_by::<W>(
            deviation_of_compliance,
            W::from_array(&rows.firm_from),
            W::from_array(&rows.compliance_slope),
        );
        let strength = lerp::<W>(c, blend_sides(plus, &rows.far_strength), blend_sides(plus, &rows.near_strength));
        let horizon = W::splat(settings.paper_options.horizon);
        let velocity = if by_force { W::splat(0.0) } else { twist };
        let displacement = horizon * W::fma(W::splat(params.gain_scale), apply_kx(params, features, adapted), velocity);
        let (mut bounded, mut clamped) = (displacement, displacement);
        if rows.limits_steps {
            let stiff_max = horizon * W::from_array(&rows.step_limit);
            let soft_max = horizon * W::from_array(&rows.soft_step_limit);
            bounded = W::clamp_abs(displacement, soft_max);
            clamped = W::clamp_abs(displacement, max_displacement(w, stiff_max, soft_max));
        }
        Self {
            deviation: e,
            adapted,
            softness: w,
            compliance: c,
            strength,
            max_strength: lerp::<W>(w, W::from_array(&rows.hold), strength),
            stiffness: blend_sides(plus, &rows.stiffness),
            damping: blend_sides(plus, &rows.damping),
            twist,
            displacement: bounded,
            clamped_displacement: clamped,
        }
    }
}

/// Returns the value for the side from which each axis is pushed: `pair[0]` toward −, `pair[1]` toward +, blended by
/// the weight `plus`.
#[inline(always)]
fn blend_sides<W: F64x8>(plus: W, pair: &[AxisArray; 2]) -> W {
    lerp::<W>(plus, W::from_array(&pair[0]), W::from_array(&pair[1]))
}

/// Returns the task velocity `K_x ẽ` that the gain requests.
#[inline(always)]
fn apply_kx<W: F64x8>(params: &Params, features: Features, adapted: W) -> W {
    if !features.coupled_gain {
        return W::from_array(&params.axis_simd.kx_diagonal) * adapted;
    }
    let (adapted, mut pull) = (adapted.to_axes(), W::splat(0.0));
    for c in 0..MAX_AXES {
        pull = W::fma(W::from_array(&params.axis_simd.kx[c]), W::splat(adapted[c]), pull);
    }
    pull
}

/// Returns the step limit [m, rad] of each axis by its softness `w`. The limits are per axis: with a limit on the norm
/// of all steps, a large step of a soft axis would reduce those of the stiff axes.
#[inline(always)]
fn max_displacement<W: F64x8>(w: W, stiff: W, soft: W) -> W {
    let (zero, one, endless) = (W::splat(0.0), W::splat(1.0), W::splat(f64::INFINITY));
    // If one of the two limits is infinite, a partly stiff axis keeps the limit of its stiff part.
    let mixed = W::select_lt(W::max(stiff, soft), endless, lerp::<W>(w, stiff, soft), stiff);
    W::select_lt(zero, w, W::select_lt(w, one, mixed, soft), stiff)
}
