//! Damping and inertia per task axis, with which the stiff axes track the velocity of their reference.

use crate::math::simd::LANES;
use crate::model::Model;
use crate::params::joint_space::JointSpaceStats;
use crate::params::overspeed::OverspeedParams;
use crate::params::{AxisArray, ServoArrays, Settings};
use crate::{AxisVec, MAX_AXES, MAX_JOINTS};

/// Decay rate [1/s] of the velocity error between tool and reference; less at a long delay.
const DECAY: f64 = 20.0;

/// Largest product of decay rate [1/s] and age of the velocity [s] at which the damper does not make the arm oscillate.
const DECAY_DELAY_BOUND: f64 = 0.5;

/// Share of the servo damping cancelled by the feed-forward that the damper restores. It is below 1, because axes that
/// share joints would restore the damping twice.
const RESTORED_SHARE: f64 = 0.5;

/// Bound on the acceleration feed-forward, linear and angular [m/s², rad/s²], so that a target that stops abruptly does
/// not jolt the arm.
const MAX_FEEDFORWARD_ACCELERATION: [f64; 2] = [3.0, 12.0];

/// Inertia and damping of each task axis, divided by the servos' stiffness along it; zero for an axis whose reference
/// has no velocity.
#[derive(Debug, Clone)]
pub(crate) struct PacingParams {
    /// True if an axis has an inertia, so that its reference has a velocity.
    pub(crate) on: bool,
    /// Squared time constant `Λ_j C_jj` [s²] of each axis on the servos' springs: inertia divided by stiffness.
    pub(crate) inertia: AxisArray,
    /// Bound on the acceleration feed-forward [m/s², rad/s²].
    pub(crate) max_acceleration: AxisArray,
    /// Time constant [s] of the damper of each axis (damping divided by stiffness) at the present delay.
    pub(crate) damping: AxisArray,
    /// Speeds of the tool above which forces are reduced.
    pub(crate) overspeed: OverspeedParams,
    /// Part of `damping` that restores the servo damping cancelled by the feed-forward [s].
    restored: f64,
}

impl PacingParams {
    pub(super) fn new(
        model: &Model,
        settings: &Settings,
        servos: &ServoArrays,
        axes: &[usize],
        joint_space_stats: &mut JointSpaceStats,
    ) -> Self {
        let governed = |axis: usize| settings.max_tool_speed[usize::from(axis >= 3)].is_finite();
        let (mut inertia, mut max_acceleration) = ([0.0; LANES], [0.0; LANES]);
        if servos.has_kp && axes.iter().any(|&axis| governed(axis)) {
            let found: AxisVec = joint_space_stats.squared_time_constants(model, servos, axes, &settings.task.frame);
            for (r, &axis) in axes.iter().enumerate().take(MAX_AXES) {
                inertia[r] = if governed(axis) { found[r] } else { 0.0 };
                max_acceleration[r] = MAX_FEEDFORWARD_ACCELERATION[usize::from(axis >= 3)];
            }
        }
        let n = model.n().min(MAX_JOINTS);
        let resisted: f64 = (0..n).map(|i| servos.damping[i] * servos.compliance[i]).sum();
        let taken =
            if settings.law.by_force() { settings.compensation.damping * resisted / n.max(1) as f64 } else { 0.0 };
        let on = inertia.iter().any(|&t| t > 0.0);
        let overspeed = OverspeedParams::new(axes, settings.max_tool_speed);
        let restored = RESTORED_SHARE * taken;
        let mut pace = Self { on, inertia, max_acceleration, damping: [0.0; LANES], overspeed, restored };
        pace.set_delay(settings.delay, settings);
        pace
    }

    /// Updates the damper for a measured delay [s].
    pub(super) fn set_delay(&mut self, delay: f64, settings: &Settings) {
        let late = delay + 0.5 / settings.rate + settings.tracking.velocity_filter;
        let rate = DECAY.min(DECAY_DELAY_BOUND / late);
        let restored = self.restored;
        self.damping = self.inertia.map(|squared| if squared > 0.0 { rate * squared + restored } else { 0.0 });
    }
}
