//! Reference tracking of the stiff axes: damping and inertia of each task axis.

use crate::math::simd::LANES;
use crate::model::Model;
use crate::params::workspace::WorkspaceStats;
use crate::params::{AxisArray, ServoArrays, Settings};
use crate::{AxisVec, MAX_AXES, MAX_JOINTS};

/// Decay rate [1/s] of the velocity error between tool and reference.
const DECAY: f64 = 20.0;

/// Largest product of `DECAY` and the age [s] of the velocity at which the damper does not oscillate.
const DECAY_DELAY_BOUND: f64 = 0.5;

/// Share of the servo damping cancelled by the feed-forward that the damper restores. Less than one: axes that share
/// joints would count it twice.
const RESTORED: f64 = 0.5;

/// Bound on the acceleration feed-forward [m/s², rad/s²]: the arm is not accelerated after a target that stops
/// abruptly.
const DRIVEN: [f64; 2] = [3.0, 12.0];

/// Per task row, in units of the servos' stiffness along it; zero if a reference has no velocity of its own.
#[derive(Debug, Clone)]
pub(crate) struct PacingParams {
    /// True if any row is nonzero.
    pub(crate) on: bool,
    /// Squared time constant `Λ_j C_jj` [s²] of each axis on its servos.
    pub(crate) inertia: AxisArray,
    /// Bound on the acceleration [m/s², rad/s²].
    pub(crate) driven: AxisArray,
    /// Time constant [s] of the damper at the present delay.
    pub(crate) damping: AxisArray,
    /// Part of it that restores the damping cancelled by the feed-forward [s].
    restored: f64,
}

impl PacingParams {
    pub(super) fn new(
        model: &Model,
        settings: &Settings,
        servos: &ServoArrays,
        axes: &[usize],
        workspace_stats: &mut WorkspaceStats,
    ) -> Self {
        let governed = |axis: usize| settings.max_tool_speed[usize::from(axis >= 3)].is_finite();
        let (mut inertia, mut driven) = ([0.0; LANES], [0.0; LANES]);
        if servos.has_kp && axes.iter().any(|&axis| governed(axis)) {
            let found: AxisVec = workspace_stats.squared_periods(model, servos, axes, &settings.task.frame);
            for (r, &axis) in axes.iter().enumerate().take(MAX_AXES) {
                inertia[r] = if governed(axis) { found[r] } else { 0.0 };
                driven[r] = DRIVEN[usize::from(axis >= 3)];
            }
        }
        let n = model.n().min(MAX_JOINTS);
        let resisted: f64 = (0..n).map(|i| servos.damping[i] * servos.compliance[i]).sum();
        let taken =
            if settings.law.by_force() { settings.compensation.damping * resisted / n.max(1) as f64 } else { 0.0 };
        let on = inertia.iter().any(|&t| t > 0.0);
        let mut pace = Self { on, inertia, driven, damping: [0.0; LANES], restored: RESTORED * taken };
        pace.update_gain_scale(settings, settings.delay);
        pace
    }

    /// Sets the damper for a measured delay [s].
    pub(super) fn update_gain_scale(&mut self, settings: &Settings, delay: f64) {
        let late = delay + 0.5 / settings.rate + settings.tracking.velocity_filter;
        let rate = DECAY.min(DECAY_DELAY_BOUND / late);
        let restored = self.restored;
        self.damping = self.inertia.map(|squared| if squared > 0.0 { rate * squared + restored } else { 0.0 });
    }
}
