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
#[inline(always)]
pub(crate) fn base_from_task(frame: &Frame, tool: &Pose) -> [[f64; 3]; 3] {
    match frame {
        Frame::Base => Pose::IDENTITY.rotation,
        Frame::Tool => tool.rotation,
        Frame::Rotation(rotation) => *rotation,
    }
}

/// Jacobian rows of the task's axes in the task frame, from the 6 × n Jacobian in base axes.
#[inline(always)]
pub(crate) fn rows(world: &Rows, base_from_task: &[[f64; 3]; 3], axes: &[usize], n: usize) -> Rows {
    let mut out = [[0.0; MAX_JOINTS]; MAX_AXES];
    rows_into(world, base_from_task, axes, n, &mut out);
    out
}

/// [`rows`] into an array whose rows behind the task's axes are 0.
#[inline(always)]
pub(crate) fn rows_into(world: &Rows, base_from_task: &[[f64; 3]; 3], axes: &[usize], n: usize, out: &mut Rows) {
    for (row, &axis) in out.iter_mut().zip(axes) {
        let (block, column) = if axis < 3 { (0, axis) } else { (3, (axis - 3) % 3) };
        let factors = [base_from_task[0][column], base_from_task[1][column], base_from_task[2][column]];
        for i in 0..n.min(MAX_JOINTS) {
            row[i] = factors[0] * world[block][i] + factors[1] * world[block + 1][i] + factors[2] * world[block + 2][i];
        }
    }
}
