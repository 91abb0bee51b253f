//! Speeds of the tool above which the laws reduce forces that would accelerate it.

use crate::MAX_AXES;
use crate::math::simd::LANES;
use crate::params::AxisArray;

/// Speed above `max_tool_speed`, linear and angular [m/s, rad/s], at which forces begin to be reduced. They are zero at
/// twice this margin.
const MARGIN: [f64; 2] = [0.08, 0.3];

/// Speeds of the tool above which forces are reduced.
#[derive(Debug, Clone, Copy)]
pub(crate) struct OverspeedParams {
    /// Linear and angular speed [m/s, rad/s] above which forces are reduced, and the further speed over which they
    /// decrease to zero. The first is ∞ if no axis of the task is of that kind.
    pub(crate) ramps: [[f64; 2]; 2],
    /// Reciprocal of the first of these speeds for each task row.
    pub(crate) per_start: AxisArray,
}

impl OverspeedParams {
    /// Creates the parameters for a task with these `axes` and the bounds `max_tool_speed` [m/s, rad/s].
    pub(crate) fn new(axes: &[usize], max_tool_speed: [f64; 2]) -> Self {
        let (mut ramps, mut per_start) = (MARGIN.map(|width| [f64::INFINITY, width]), [0.0; LANES]);
        for (r, &axis) in axes.iter().enumerate().take(MAX_AXES) {
            let block = usize::from(axis >= 3);
            let start = max_tool_speed[block] + MARGIN[block];
            ramps[block][0] = start;
            per_start[r] = 1.0 / start;
        }
        Self { ramps, per_start }
    }
}
