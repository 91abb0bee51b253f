//! Deviation, softness, compliance and strength of each task axis, computed from the poses of tool and target.

pub mod adapt;
mod arm_state;
pub mod compliance;
mod pose_error;

pub(crate) mod demand;
pub(crate) mod deviation_limit;
pub(crate) mod reference_governor;

pub(crate) use arm_state::ArmState;
pub use pose_error::pose_error;
pub(crate) use pose_error::{frame_error, pose_error_by};

use crate::MAX_AXES;
use crate::kinematics::rotated_rows;
use crate::math::simd::JointVector;
use crate::math::spatial::Mat3;
use crate::params::Frame;

/// Returns the Jacobian rows of a task in `frame`, stored in `storage`: [`task_rows`](crate::kinematics::task_rows), or
/// `j_base` itself if the task has all six base axes.
#[inline(always)]
pub(crate) fn rows_in<'a, J: JointVector>(
    frame: &Frame,
    j_base: &'a [J; MAX_AXES],
    base_from_task: &Mat3,
    axes: &[usize],
    storage: &'a mut Option<[J; MAX_AXES]>,
) -> &'a [J; MAX_AXES] {
    match frame {
        Frame::Base if axes.len() == MAX_AXES => j_base,
        Frame::Base => {
            let mut out = [J::splat(0.0); MAX_AXES];
            for r in 0..axes.len().min(MAX_AXES) {
                out[r] = j_base[axes[r] % MAX_AXES];
            }
            storage.insert(out)
        }
        _ => storage.insert(rotated_rows(j_base, base_from_task, axes)),
    }
}
