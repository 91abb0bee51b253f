//! Share of the friction feed-forward that the strengths of the task axes can hold.

use crate::MAX_AXES;
use crate::model::Model;
use crate::params::axis_params_simd::AxisParamsSimd;
use crate::params::{Law, ServoArrays, Settings};

/// Required ratio of the torque of the axes' strengths to the friction feed-forward.
const STRENGTH_RATIO: f64 = 2.0;

/// Torques that decide how much of the friction feed-forward is used.
///
/// A feed-forward that exceeds the true friction moves the arm, and only the strengths of the axes stop it. Without
/// them, the arm would not stop by itself.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FeedForwardBound {
    /// Torque per unit of strength of each task row: half the reach for a force, 1 for a torque [m, 1].
    levers: [f64; MAX_AXES],
    /// Torque of the strengths with which all of the feed-forward is used [N·m].
    needed: f64,
    /// True if an axis exerts no force without a spring, as under law `impedance`.
    needs_spring: bool,
}

impl FeedForwardBound {
    /// Creates the bound for a task with these `axes`.
    pub(super) fn new(model: &Model, settings: &Settings, servos: &ServoArrays, axes: &[usize]) -> Self {
        let mut levers = [0.0; MAX_AXES];
        for (lever, &axis) in levers.iter_mut().zip(axes) {
            *lever = if axis < 3 { 0.5 * model.reach() } else { 1.0 };
        }
        let friction = servos.friction.iter().fold(0.0, |most: f64, value| most.max(*value));
        let needed = STRENGTH_RATIO * settings.compensation.friction * friction;
        Self { levers, needed, needs_spring: settings.law == Law::Impedance }
    }

    /// Returns the factor, 0 to 1, on the feed-forward of friction and damping with the strengths of these `rows`.
    pub(super) fn share(&self, rows: &AxisParamsSimd) -> f64 {
        let mut torque = 0.0;
        for (r, lever) in self.levers.iter().enumerate() {
            let of_side = |side: usize| {
                let force = if rows.yields[side][r] > 0.0 { rows.far_strength[side][r] } else { rows.hold[r] };
                if self.needs_spring && rows.stiffness[side][r] <= 0.0 { 0.0 } else { force }
            };
            torque += lever * of_side(0).min(of_side(1));
        }
        if self.needed > torque { torque / self.needed } else { 1.0 }
    }
}
