//! Deviation limits of stiff axes.
//!
//! The limiter moves the reference instead of clipping the deviation. The speed of the reference is bounded, so that
//! after a release the tool returns at that speed and does not jump.

use crate::math::rotation::{base_to_task, rotation_matrix, rotation_vector, task_to_base};
use crate::math::simd::BaselineF64;
use crate::math::spatial::multiply;
use crate::params::{DeviationLimit, OnDeviationLimit, Params};
use crate::pose::Pose;
use crate::task::pose_error;
use crate::task::reference_governor::ReferenceGovernor;
use crate::{AxisVec, MAX_AXES};

/// Change of a deviation [m or rad] that counts as none, so that rounding errors do not release a stopped target.
const MIN_CHANGE: f64 = 1e-9;

impl DeviationLimit {
    /// Clamps the deviation `e` [m or rad] to the limit; e > 0 if the axis is pushed toward −.
    fn limited(&self, e: f64) -> f64 {
        e.clamp(-self.max[1], self.max[0])
    }
}

/// Poses that the deviation limits of one step use.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DeviationLimiter<'a> {
    /// Pose of the tool at the predicted positions, `base_from_tool`.
    pub(crate) tool: &'a Pose,
    /// Task axes as columns, in the base.
    pub(crate) base_from_task: &'a [[f64; 3]; 3],
    /// Reference of the last step, `base_from_tool`.
    pub(crate) before: &'a Pose,
}

/// Reference after the deviation limits were applied.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LimitedReference {
    /// The moved reference, `base_from_tool`.
    pub(crate) reference: Pose,
    /// Deviation (6,) of the moved reference from the tool [m, rad], in the task frame.
    pub(crate) error: AxisVec,
    /// Share of the reference's motion in this step, 0 to 1, that the axes with [`OnDeviationLimit::Wait`] allow.
    pub(crate) progress: f64,
    /// True for each of x, y, z, roll, pitch, yaw that is at its limit.
    pub(crate) active: [bool; MAX_AXES],
}

impl DeviationLimiter<'_> {
    /// Returns the deviation (6,) of `reference` from the tool [m, rad], in the task frame.
    fn error(&self, reference: &Pose) -> AxisVec {
        base_to_task::<BaselineF64>(self.base_from_task, &pose_error(self.tool, reference))
    }

    /// Bounds the deviation of `reference` from the tool; `None` if no axis exceeds its limit.
    ///
    /// First shortens the motion of the reference so that it does not take a `Wait` axis farther beyond its limit. Then
    /// moves the reference along each `Yield` axis until the deviation is at its limit.
    pub(crate) fn limit(&self, limits: &[DeviationLimit], reference: &Pose) -> Option<LimitedReference> {
        let (mut active, mut progress) = ([false; MAX_AXES], 1.0_f64);
        let (from, to) = (self.error(self.before), self.error(reference));
        for limit in limits {
            let (e0, e1) = (from[limit.axis], to[limit.axis]);
            if (limit.limited(e1) - e1).abs() > 0.0 {
                active[limit.axis] = true;
                if limit.reaction == OnDeviationLimit::Wait {
                    // A push can cause a deviation beyond the limit. The reference must not increase it.
                    let allowed = e1.clamp(e0.min(-limit.max[1]), e0.max(limit.max[0]));
                    let share = if (e1 - e0).abs() > MIN_CHANGE { (allowed - e0) / (e1 - e0) } else { 0.0 };
                    progress = progress.min(share.clamp(0.0, 1.0));
                }
            }
        }
        if !active.contains(&true) {
            return None;
        }
        let mut reference = if progress < 1.0 { interpolate(self.before, reference, progress) } else { *reference };
        let mut error = self.error(&reference);
        let mut follows = false;
        for limit in limits.iter().filter(|limit| limit.reaction == OnDeviationLimit::Yield) {
            let limited = limit.limited(error[limit.axis]);
            follows |= (limited - error[limit.axis]).abs() > 0.0;
            error[limit.axis] = limited;
        }
        if follows {
            reference = self.beside_tool(&error);
        }
        Some(LimitedReference { reference, error, progress, active })
    }

    /// Returns the pose that deviates from the tool by `error` (6,) [m, rad], in the task frame.
    fn beside_tool(&self, error: &AxisVec) -> Pose {
        let e = task_to_base(self.base_from_task, error);
        let mut pose = *self.tool;
        for (value, shift) in pose.position.iter_mut().zip(e) {
            *value += shift;
        }
        pose.rotation = multiply::<BaselineF64>(&rotation_matrix([e[3], e[4], e[5]]), &self.tool.rotation);
        pose
    }
}

/// Bounds the deviation of stiff axes by moving the reference of `governor`. Its velocity becomes zero along axes at
/// their limit; along the others it is scaled like its motion. Returns `None` if no axis exceeds its limit.
#[cold]
#[inline(never)]
pub(crate) fn limit_deviation(
    params: &Params,
    limiter: &DeviationLimiter<'_>,
    governor: &mut ReferenceGovernor,
) -> Option<LimitedReference> {
    let limited = limiter.limit(&params.deviation_limits, &governor.pose())?;
    let mut velocity = base_to_task::<BaselineF64>(limiter.base_from_task, &governor.reference_velocity());
    for (value, active) in velocity.iter_mut().zip(limited.active) {
        *value *= if active { 0.0 } else { limited.progress };
    }
    governor.set(limited.reference, task_to_base(limiter.base_from_task, &velocity));
    Some(limited)
}

/// Interpolates between two poses, on a straight line and about one fixed axis; `share` is 0 at `from`, 1 at `to`.
fn interpolate(from: &Pose, to: &Pose, share: f64) -> Pose {
    let mut pose = *from;
    for (value, end) in pose.position.iter_mut().zip(to.position) {
        *value += share * (end - *value);
    }
    let transposed = std::array::from_fn(|i| std::array::from_fn(|j| from.rotation[j][i]));
    let turn = rotation_vector(&multiply::<BaselineF64>(&to.rotation, &transposed)).map(|angle| share * angle);
    pose.rotation = multiply::<BaselineF64>(&rotation_matrix(turn), &from.rotation);
    pose
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: [[f64; 3]; 3] = Pose::IDENTITY.rotation;

    fn at(x: f64, y: f64, yaw: f64) -> Pose {
        Pose { position: [x, y, 0.0], rotation: rotation_matrix([0.0, 0.0, yaw]) }
    }

    fn limit(axis: usize, max: f64, reaction: OnDeviationLimit) -> DeviationLimit {
        DeviationLimit { axis, max: [max; 2], reaction }
    }

    #[test]
    fn a_deviation_within_its_limits_changes_nothing() {
        let limiter = DeviationLimiter { tool: &Pose::IDENTITY, base_from_task: &FRAME, before: &Pose::IDENTITY };
        assert!(limiter.limit(&[limit(0, 0.02, OnDeviationLimit::Wait)], &at(0.0199, 5.0, 1.0)).is_none());
    }

    #[test]
    fn following_axes_keep_the_limit_and_the_others_their_target() {
        let tool = at(0.1, 0.2, 0.3);
        let limiter = DeviationLimiter { tool: &tool, base_from_task: &FRAME, before: &tool };
        let limits = [limit(0, 0.02, OnDeviationLimit::Yield), limit(5, 0.1, OnDeviationLimit::Yield)];
        let limited = limiter.limit(&limits, &at(-0.4, 0.7, 1.3)).unwrap();
        let expected = at(0.08, 0.7, 0.4);
        for i in 0..3 {
            assert!((limited.reference.position[i] - expected.position[i]).abs() < 1e-15);
            for j in 0..3 {
                assert!((limited.reference.rotation[i][j] - expected.rotation[i][j]).abs() < 1e-15);
            }
        }
        assert_eq!(limited.active, [true, false, false, false, false, true]);
    }

    #[test]
    fn a_waiting_axis_stops_the_whole_target_but_lets_it_retreat() {
        let tool = Pose::IDENTITY;
        let limits = [limit(0, 0.02, OnDeviationLimit::Wait)];
        let limiter = DeviationLimiter { tool: &tool, base_from_task: &FRAME, before: &at(0.01, 0.0, 0.0) };
        let limited = limiter.limit(&limits, &at(0.05, 0.4, 0.4)).unwrap();
        assert!((limited.progress - 0.25).abs() < 1e-12);
        assert!((limited.error[0] - 0.02).abs() < 1e-15 && (limited.error[1] - 0.1).abs() < 1e-12);
        assert!((limited.error[5] - 0.1).abs() < 1e-12);
        // A push has moved the tool beyond the limit: the reference may only move toward the tool.
        let outside = DeviationLimiter { before: &at(0.05, 0.0, 0.0), ..limiter };
        assert!(outside.limit(&limits, &at(0.06, 0.1, 0.0)).unwrap().progress.abs() < 1e-15);
        assert!((outside.limit(&limits, &at(0.04, 0.1, 0.0)).unwrap().progress - 1.0).abs() < 1e-15);
    }

    #[test]
    fn a_reference_that_the_limits_do_not_move_keeps_its_bits() {
        let limits = [limit(0, 0.02, OnDeviationLimit::Wait), limit(1, 0.02, OnDeviationLimit::Yield)];
        for i in 0..20 {
            let (tool, before) = (at(0.1, 0.2, 0.3), at(0.27, 0.2, 0.3));
            let limiter = DeviationLimiter { tool: &tool, base_from_task: &FRAME, before: &before };
            let retreating = at(0.13 + 0.003 * f64::from(i), 0.21, 0.37 * f64::from(i));
            let limited = limiter.limit(&limits, &retreating).unwrap();
            assert_eq!((limited.reference, limited.progress.to_bits()), (retreating, 1.0_f64.to_bits()));
            assert_eq!(limited.active, [true, false, false, false, false, false]);
        }
    }

    #[test]
    fn a_side_that_yields_has_no_limit() {
        let tool = Pose::IDENTITY;
        let limiter = DeviationLimiter { tool: &tool, base_from_task: &FRAME, before: &tool };
        let limits = [DeviationLimit { axis: 1, max: [0.02, f64::INFINITY], reaction: OnDeviationLimit::Yield }];
        assert!(limiter.limit(&limits, &at(0.0, -0.5, 0.0)).is_none());
        assert!((limiter.limit(&limits, &at(0.0, 0.5, 0.0)).unwrap().error[1] - 0.02).abs() < 1e-15);
    }
}
