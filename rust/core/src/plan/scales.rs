//! What the cycle scales and bounds by constants of the plan.

use crate::model::Model;
use crate::plan::Plan;
use crate::pose::COORDINATE_BOUND;
use crate::settings::{Law, Projector};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// How far a reading may lie beyond a joint's position limits [rad]: half a turn. Farther off it is in degrees, or of
/// another robot.
const BEYOND_LIMITS: f64 = std::f64::consts::PI;

/// Smallest and largest position of each joint that is taken for a real one; a prismatic joint may be off by its travel.
pub(super) fn readable(model: &Model) -> [JointVec; 2] {
    let mut out = [[0.0; MAX_JOINTS]; 2];
    for (i, (&lower, &upper)) in model.lower().iter().zip(model.upper()).enumerate().take(MAX_JOINTS) {
        let prismatic = model.prismatic().get(i).copied().unwrap_or(false);
        let beyond = if prismatic { upper - lower } else { BEYOND_LIMITS };
        out[0][i] = (lower - beyond).max(-COORDINATE_BOUND);
        out[1][i] = (upper + beyond).min(COORDINATE_BOUND);
    }
    out
}

impl Plan {
    /// Task rows with translations divided by the arm's length.
    #[inline(always)]
    pub(crate) fn scale_rows(&self, rows: &Rows, n: usize) -> Rows {
        let mut out = [[0.0; MAX_JOINTS]; MAX_AXES];
        for r in 0..MAX_AXES {
            for i in 0..n.min(MAX_JOINTS) {
                out[r][i] = self.row_scale[r] * rows[r][i];
            }
        }
        out
    }

    /// λ² of each row per mean stiffness, `λ²/k̄`.
    #[inline(always)]
    pub(crate) fn per_stiffness(&self, squared: &AxisVec) -> AxisVec {
        let mut out = [0.0; MAX_AXES];
        for r in 0..MAX_AXES {
            out[r] = squared[r] / self.servos.kp_mean;
        }
        out
    }

    /// How far each joint may move within a horizon [rad].
    #[inline(always)]
    pub(crate) fn reach(&self, horizon: f64, n: usize) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..n.min(MAX_JOINTS) {
            out[i] = self.joint_speed[i] * horizon;
        }
        out
    }

    /// Whether anything of a step depends on the singular values of its rows.
    pub(crate) fn follows_sigma(&self) -> bool {
        self.law != Law::Paper
            || self.damping.sigma_0 > 0.0
            || self.cost.manipulability > 0.0
            || self.projector == Projector::Exact
    }

    /// Scales a null-space motion [rad] to its speed limit.
    #[inline(always)]
    pub(crate) fn bound_null_speed(&self, null: &mut JointVec, horizon: f64, n: usize) {
        let (most, null) = (self.null_speed * horizon, &mut null[..n.min(MAX_JOINTS)]);
        let mut fastest = 0.0;
        for value in &*null {
            let speed = value.abs();
            fastest = if speed > fastest { speed } else { fastest };
        }
        if fastest > most {
            for value in null {
                *value *= most / fastest;
            }
        }
    }
}
