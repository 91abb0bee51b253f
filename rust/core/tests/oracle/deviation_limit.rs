//! Deviation limits of the oracle: first axes with `Wait` stop the target, then it follows the tool along axes with
//! `Yield`.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use pliant_core::Pose;
use pliant_core::params::{CompliantSide, OnDeviationLimit};

use super::{Oracle, Vector};

fn rotation(pose: &Pose) -> Rotation3<f64> {
    Rotation3::from_matrix_unchecked(Matrix3::from_fn(|i, j| pose.rotation[i][j]))
}

/// Returns the rotation vector, computed from the quaternion, because the trace of a tiny rotation has no significant
/// digits.
fn scaled_axis(rotation: &Rotation3<f64>) -> Vector3<f64> {
    UnitQuaternion::from_rotation_matrix(rotation).scaled_axis()
}

fn pose(position: Vector3<f64>, rotation: Rotation3<f64>) -> Pose {
    let m = rotation.matrix();
    Pose { position: position.into(), rotation: std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)])) }
}

impl Oracle {
    /// Returns the lowest and the highest deviation [m or rad] that the limit of an axis allows.
    fn allowed(&self, axis: usize) -> (f64, f64) {
        let axis_settings = &self.settings.axes[axis];
        let max = axis_settings.deviation_limit.unwrap_or(f64::INFINITY);
        match axis_settings.compliant_side() {
            CompliantSide::None => (-max, max),
            CompliantSide::Plus => (f64::NEG_INFINITY, max),
            CompliantSide::Minus => (-max, f64::INFINITY),
            CompliantSide::Both => (f64::NEG_INFINITY, f64::INFINITY),
        }
    }

    /// Returns the target after the deviation limits, and true for each row at its limit.
    pub(super) fn reference(&self, tool: &Pose, target: &Pose) -> (Pose, Vec<bool>) {
        let axes = self.axes();
        let before = self.state.reference;
        let (was, wanted) = (self.deviation(tool, &before), self.deviation(tool, target));
        let beyond = |r: usize, e: f64| {
            let (low, high) = self.allowed(axes[r]);
            e < low || e > high
        };
        let at_limit: Vec<bool> = (0..axes.len()).map(|r| beyond(r, wanted[r])).collect();
        let mut share: f64 = 1.0;
        for r in 0..axes.len() {
            if at_limit[r] && self.settings.axes[axes[r]].on_deviation_limit == OnDeviationLimit::Wait {
                let (low, high) = self.allowed(axes[r]);
                let nearest = wanted[r].max(low.min(was[r])).min(high.max(was[r]));
                let way = wanted[r] - was[r];
                share = share.min(if way.abs() <= 1e-9 { 0.0 } else { ((nearest - was[r]) / way).clamp(0.0, 1.0) });
            }
        }
        let mut reference = *target;
        if share < 1.0 {
            let (from, to) = (Vector3::from(before.position), Vector3::from(target.position));
            let turn = scaled_axis(&(rotation(target) * rotation(&before).inverse())) * share;
            reference = pose(from + (to - from) * share, Rotation3::new(turn) * rotation(&before));
        }
        // The deviation along all six axes, including those outside the task.
        let turn = self.base_from_task(tool);
        let linear = turn.transpose() * (Vector3::from(reference.position) - Vector3::from(tool.position));
        let angular = turn.transpose() * scaled_axis(&(rotation(&reference) * rotation(tool).inverse()));
        let e = Vector::from_iterator(6, linear.iter().chain(angular.iter()).copied());
        let mut kept = e.clone();
        for &axis in axes.iter().filter(|&&axis| self.settings.axes[axis].on_deviation_limit == OnDeviationLimit::Yield)
        {
            let (low, high) = self.allowed(axis);
            kept[axis] = e[axis].max(low).min(high);
        }
        if kept != e {
            let shift = turn * Vector3::new(kept[0], kept[1], kept[2]);
            let spin = Rotation3::new(turn * Vector3::new(kept[3], kept[4], kept[5]));
            reference = pose(Vector3::from(tool.position) + shift, spin * rotation(tool));
        }
        (reference, at_limit)
    }
}
