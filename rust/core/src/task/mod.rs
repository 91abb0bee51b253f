//! From pose to deviation, softness, compliance and strength: lines 3–6 of the control step.

pub mod adapt;
pub mod axes;
pub mod compliance;
pub mod deviation;

pub(crate) mod deviation_limit;
pub(crate) mod governor;
pub(crate) mod wish;

use crate::pose::Pose;
use crate::task::axes::Frame;
use crate::{MAX_AXES, MAX_JOINTS, Rows};

/// `base_from_task` of a task frame, given the pose of the tool.
#[inline]
pub(crate) fn base_from_task(frame: &Frame, tool: &Pose) -> [[f64; 3]; 3] {
    match frame {
        Frame::Base => Pose::IDENTITY.rotation,
        Frame::Tool => tool.rotation,
        Frame::Rotation(rotation) => *rotation,
    }
}

/// Jacobian rows of the task's axes in the task frame, from the 6 × n Jacobian in base axes.
#[inline]
pub(crate) fn rows(world: &Rows, base_from_task: &[[f64; 3]; 3], axes: &[usize]) -> Rows {
    let mut out = [[0.0; MAX_JOINTS]; MAX_AXES];
    for (row, &axis) in out.iter_mut().zip(axes) {
        let (block, column) = if axis < 3 { (0, axis) } else { (3, axis - 3) };
        for (k, factors) in base_from_task.iter().enumerate() {
            let factor = factors[column % 3];
            for i in 0..MAX_JOINTS {
                row[i] += factor * world[block + k][i];
            }
        }
    }
    out
}
