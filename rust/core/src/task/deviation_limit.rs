//! Deviation limits of stiff axes.
//!
//! The limiter moves the reference instead of clipping the deviation. The reference has a bounded speed and a state, so
//! that after a release the tool moves at its own speed and does not jump.

use crate::math::rotation::{into_frame, out_of_frame, rotation_matrix, rotation_vector};
use crate::math::simd::Plain;
use crate::params::{DeviationLimit, OnDeviationLimit, Plan};
use crate::pose::Pose;
use crate::task::pose_error;
use crate::task::reference_governor::Governor;
use crate::{AxisVec, MAX_AXES};

/// Change of a deviation [m or rad] that counts as no change: rounding must not release a stopped target.
const STILL: f64 = 1e-9;

impl DeviationLimit {
    /// Clamps the deviation `e` to the limit: e > 0 if the axis is pushed toward −.
    fn kept(&self, e: f64) -> f64 {
        e.clamp(-self.most[1], self.most[0])
    }
}

/// Tool and reference poses of one step.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pushed<'a> {
    pub(crate) tool: &'a Pose,
    pub(crate) base_from_task: &'a [[f64; 3]; 3],
    /// Reference of the last step.
    pub(crate) before: &'a Pose,
}

/// Reference after the deviation limits.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Kept {
    pub(crate) reference: Pose,
    /// Deviation (6,) from this reference, in the task frame.
    pub(crate) error: AxisVec,
    /// Share of the reference's motion that the axes with [`OnDeviationLimit::Wait`] allow.
    pub(crate) advance: f64,
    /// Which of x, y, z, roll, pitch, yaw is at its limit.
    pub(crate) met: [bool; MAX_AXES],
}

impl Pushed<'_> {
    /// Returns the deviation (6,) from a reference, in the task frame.
    fn error(&self, reference: &Pose) -> AxisVec {
        into_frame::<Plain>(self.base_from_task, &pose_error(self.tool, reference))
    }

    /// Bounds the deviation from `reference`; `None` if no axis exceeds its limit.
    ///
    /// First stops the whole reference if its motion would increase the excess of a `Wait` axis. Then moves the
    /// reference along the `Yield` axes to within their limit of the tool.
    pub(crate) fn keep(&self, limits: &[DeviationLimit], reference: &Pose) -> Option<Kept> {
        let (mut met, mut advance) = ([false; MAX_AXES], 1.0_f64);
        let (from, to) = (self.error(self.before), self.error(reference));
        for limit in limits {
            let (e0, e1) = (from[limit.axis], to[limit.axis]);
            if (limit.kept(e1) - e1).abs() > 0.0 {
                met[limit.axis] = true;
                if limit.reaction == OnDeviationLimit::Wait {
                    // A deviation that a push has made need not decrease; it must only not grow.
                    let allowed = e1.clamp(e0.min(-limit.most[1]), e0.max(limit.most[0]));
                    let share = if (e1 - e0).abs() > STILL { (allowed - e0) / (e1 - e0) } else { 0.0 };
                    advance = advance.min(share.clamp(0.0, 1.0));
                }
            }
        }
        if !met.contains(&true) {
            return None;
        }
        let mut reference = if advance < 1.0 { between(self.before, reference, advance) } else { *reference };
        let mut error = self.error(&reference);
        let mut follows = false;
        for limit in limits.iter().filter(|limit| limit.reaction == OnDeviationLimit::Yield) {
            let kept = limit.kept(error[limit.axis]);
            follows |= (kept - error[limit.axis]).abs() > 0.0;
            error[limit.axis] = kept;
        }
        if follows {
            reference = self.beside_tool(&error);
        }
        Some(Kept { reference, error, advance, met })
    }

    /// Returns the pose whose deviation is `error` (6,), in the task frame.
    fn beside_tool(&self, error: &AxisVec) -> Pose {
        let e = out_of_frame(self.base_from_task, error);
        let mut pose = *self.tool;
        for (value, shift) in pose.position.iter_mut().zip(e) {
            *value += shift;
        }
        pose.rotation = product(&rotation_matrix([e[3], e[4], e[5]]), &self.tool.rotation);
        pose
    }
}

/// Bounds the deviation of stiff axes by moving the reference, and sets its velocity along these axes to zero.
#[cold]
#[inline(never)]
pub(crate) fn limit_deviation(plan: &Plan, pushed: &Pushed<'_>, governor: &mut Governor) -> Option<Kept> {
    let kept = pushed.keep(&plan.deviation_limits, &governor.pose())?;
    let mut velocity = into_frame::<Plain>(pushed.base_from_task, &governor.own_velocity());
    for (value, met) in velocity.iter_mut().zip(kept.met) {
        *value *= if met { 0.0 } else { kept.advance };
    }
    governor.put(kept.reference, out_of_frame(pushed.base_from_task, &velocity));
    Some(kept)
}

/// Interpolates two poses: straight line, and rotation about one axis.
fn between(from: &Pose, to: &Pose, share: f64) -> Pose {
    let mut pose = *from;
    for (value, end) in pose.position.iter_mut().zip(to.position) {
        *value += share * (end - *value);
    }
    let transposed = std::array::from_fn(|i| std::array::from_fn(|j| from.rotation[j][i]));
    let turn = rotation_vector(&product(&to.rotation, &transposed)).map(|angle| share * angle);
    pose.rotation = product(&rotation_matrix(turn), &from.rotation);
    pose
}

fn product(a: &[[f64; 3]; 3], b: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..3).map(|k| a[i][k] * b[k][j]).sum()))
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: [[f64; 3]; 3] = Pose::IDENTITY.rotation;

    fn at(x: f64, y: f64, yaw: f64) -> Pose {
        Pose { position: [x, y, 0.0], rotation: rotation_matrix([0.0, 0.0, yaw]) }
    }

    fn limit(axis: usize, most: f64, reaction: OnDeviationLimit) -> DeviationLimit {
        DeviationLimit { axis, most: [most; 2], reaction }
    }

    #[test]
    fn a_deviation_within_its_limits_changes_nothing() {
        let pushed = Pushed { tool: &Pose::IDENTITY, base_from_task: &FRAME, before: &Pose::IDENTITY };
        assert!(pushed.keep(&[limit(0, 0.02, OnDeviationLimit::Wait)], &at(0.0199, 5.0, 1.0)).is_none());
    }

    #[test]
    fn following_axes_keep_the_limit_and_the_others_their_target() {
        let tool = at(0.1, 0.2, 0.3);
        let pushed = Pushed { tool: &tool, base_from_task: &FRAME, before: &tool };
        let limits = [limit(0, 0.02, OnDeviationLimit::Yield), limit(5, 0.1, OnDeviationLimit::Yield)];
        let kept = pushed.keep(&limits, &at(-0.4, 0.7, 1.3)).unwrap();
        let expected = at(0.08, 0.7, 0.4);
        for i in 0..3 {
            assert!((kept.reference.position[i] - expected.position[i]).abs() < 1e-15);
            for j in 0..3 {
                assert!((kept.reference.rotation[i][j] - expected.rotation[i][j]).abs() < 1e-15);
            }
        }
        assert_eq!(kept.met, [true, false, false, false, false, true]);
    }

    #[test]
    fn a_waiting_axis_stops_the_whole_target_but_lets_it_retreat() {
        let tool = Pose::IDENTITY;
        let limits = [limit(0, 0.02, OnDeviationLimit::Wait)];
        let pushed = Pushed { tool: &tool, base_from_task: &FRAME, before: &at(0.01, 0.0, 0.0) };
        let kept = pushed.keep(&limits, &at(0.05, 0.4, 0.4)).unwrap();
        assert!((kept.advance - 0.25).abs() < 1e-12);
        assert!((kept.error[0] - 0.02).abs() < 1e-15 && (kept.error[1] - 0.1).abs() < 1e-12);
        assert!((kept.error[5] - 0.1).abs() < 1e-12);
        // A push moved the tool beyond the limit: the reference may only move back.
        let beyond = Pushed { before: &at(0.05, 0.0, 0.0), ..pushed };
        assert!(beyond.keep(&limits, &at(0.06, 0.1, 0.0)).unwrap().advance.abs() < 1e-15);
        assert!((beyond.keep(&limits, &at(0.04, 0.1, 0.0)).unwrap().advance - 1.0).abs() < 1e-15);
    }

    #[test]
    fn a_side_that_yields_has_no_limit() {
        let tool = Pose::IDENTITY;
        let pushed = Pushed { tool: &tool, base_from_task: &FRAME, before: &tool };
        let limits = [DeviationLimit { axis: 1, most: [0.02, f64::INFINITY], reaction: OnDeviationLimit::Yield }];
        assert!(pushed.keep(&limits, &at(0.0, -0.5, 0.0)).is_none());
        assert!((pushed.keep(&limits, &at(0.0, 0.5, 0.0)).unwrap().error[1] - 0.02).abs() < 1e-15);
    }
}
