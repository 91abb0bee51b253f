//! Raises `soft` to the strength that an axis needs to track a moving target despite joint friction.

use std::sync::Arc;

use crate::analysis::axis_strength::StepAnalysis;
use crate::analysis::report::at_rest;
use crate::controller::Controller;
use crate::error::Result;
use crate::math::rounding::round_up;
use crate::model::Model;
use crate::params::{Servos, Settings, joint_space};
use crate::{AxisVec, MAX_AXES};

/// Ratio of strength to static friction with which an axis tracks a moving target. The axis must overcome static
/// friction at starts and reversals, before the feed-forward acts. Measured with sinusoidal targets: with a ratio below
/// 1 the axis does not move, with 1 it lags; 2 is enough if the friction is known exactly, 3 if it is known within 30 %
/// and measurement and command are each delayed by one step.
const TRACKING_FRICTION_RATIO: f64 = 3.0;

/// Returns the settings with `soft` of every yielding axis raised to at least three times its static friction (under
/// law `paper`: to at least that friction), because a softer axis may not track a moving target.
///
/// Uses the largest friction over the postures [rad] of `path`; for an empty path, the median over the arm's joint
/// space. Raises `firm` and `hold` where they would be smaller than `soft`.
///
/// # Errors
/// As [`Controller::new`] and [`Controller::step`].
pub fn raise_soft(
    settings: &Settings,
    model: &Arc<Model>,
    servos: Option<&Servos>,
    path: &[Vec<f64>],
) -> Result<Settings> {
    let controller = Controller::new(Arc::clone(model), settings.clone(), servos.cloned())?;
    let params = &controller.params;
    let least = if path.is_empty() {
        let n = params.n;
        let strengths: Vec<AxisVec> = joint_space::sample_configurations(model)
            .map(|q| min_tracking_strength(&controller, &q[..n]))
            .collect::<Result<_>>()?;
        let mut out = [0.0; MAX_AXES];
        for (r, slot) in out.iter_mut().enumerate().take(params.k) {
            *slot = joint_space::median(&mut strengths.iter().map(|one| one[r]).collect::<Vec<_>>());
        }
        out
    } else {
        let mut out = [0.0; MAX_AXES];
        for q in path {
            let strengths = min_tracking_strength(&controller, q)?;
            (0..params.k).for_each(|r| out[r] = strengths[r].max(out[r]));
        }
        out
    };
    let mut raised = settings.clone();
    for (row, least) in params.per_axis.iter().zip(least).take(params.k) {
        let mut soft = row.soft;
        for side in (0..2).filter(|&side| row.yields[side] > 0.0) {
            soft[side] = soft[side].max(round_up(least));
        }
        if (0..2).any(|side| row.yields[side] > 0.0 && row.soft[side] < least) {
            let axis = &mut raised.axes[row.axis];
            axis.yields = Some(axis.compliant_side());
            axis.soft = Some(soft);
            // Unset values of `firm` and `hold` are derived from `soft` when the settings are resolved.
            axis.firm = axis.firm.map(|firm| [0, 1].map(|side| firm[side].max(soft[side])));
            let max = soft[0].max(soft[1]);
            axis.hold = axis.hold.map(|hold| hold.max(max));
        }
    }
    Ok(raised)
}

/// Returns the strength that each axis needs to track a moving target from rest at `q` [N, N·m]: three times its static
/// friction; under law `paper`, whose strengths are torque budgets, the static friction.
fn min_tracking_strength(controller: &Controller, q: &[f64]) -> Result<AxisVec> {
    let resting = at_rest(controller, q)?;
    let record = resting.diagnostics();
    let pose = StepAnalysis::new(&resting.params, resting.settings(), &record);
    let times = if controller.params.law.by_force() { TRACKING_FRICTION_RATIO } else { 1.0 };
    Ok(pose.friction().map(|friction| times * friction))
}
