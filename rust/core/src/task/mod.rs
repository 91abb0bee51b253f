//! From pose to deviation, softness, compliance and strength: lines 3–6 of the control step.

pub mod adapt;
pub mod axes;
pub mod compliance;
pub mod deviation;

pub(crate) mod deviation_limit;
pub(crate) mod governor;
pub(crate) mod wish;

use crate::kinematics::spatial::Mat3;
use crate::law::inverse::{load_rows, rows_array};
use crate::number::{EveryJoint, Lanes, Scalar};
use crate::task::axes::Frame;
use crate::{MAX_AXES, Rows};

/// Jacobian rows of the task's axes in the task frame, from the 6 × n Jacobian in base axes; zeros after them.
pub(crate) fn rows(world: &Rows, base_from_task: &[[f64; 3]; 3], axes: &[usize]) -> Rows {
    rows_array(&turned_rows::<EveryJoint>(&load_rows(world), base_from_task, axes))
}

/// [`rows`] of a task in `frame`; written to `room` unless they equal those of `world`.
#[inline(always)]
pub(crate) fn rows_in<'a, J: Lanes>(
    frame: &Frame,
    world: &'a [J; MAX_AXES],
    base_from_task: &Mat3<Scalar<J>>,
    axes: &[usize],
    room: &'a mut Option<[J; MAX_AXES]>,
) -> &'a [J; MAX_AXES] {
    match frame {
        // All six base axes: the rows are those of `world`.
        Frame::Base if axes.len() == MAX_AXES => world,
        Frame::Base => {
            let mut out = [J::splat(0.0); MAX_AXES];
            for r in 0..axes.len().min(MAX_AXES) {
                out[r] = world[axes[r] % MAX_AXES];
            }
            room.insert(out)
        }
        _ => room.insert(turned_rows(world, base_from_task, axes)),
    }
}

#[inline(always)]
fn turned_rows<J: Lanes>(world: &[J; MAX_AXES], base_from_task: &Mat3<Scalar<J>>, axes: &[usize]) -> [J; MAX_AXES] {
    let mut out = [J::splat(0.0); MAX_AXES];
    for r in 0..axes.len().min(MAX_AXES) {
        let axis = axes[r];
        let (block, column) = if axis < 3 { (0, axis) } else { (3, (axis - 3) % 3) };
        let [x, y, z] = [
            J::spread(base_from_task[0][column]),
            J::spread(base_from_task[1][column]),
            J::spread(base_from_task[2][column]),
        ];
        out[r] = J::fma(z, world[block + 2], J::fma(y, world[block + 1], x * world[block]));
    }
    out
}
