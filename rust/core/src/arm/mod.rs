//! Operation of an arm without the controller: descent, hand guiding, following of joint targets, the filter of
//! measured positions, the limits of commands with the thermal model of the servos, and the registers of servos on a
//! bus.
//!
//! Each part is called once per tick and does not allocate in that call. Except for the thermal model and the
//! registers, the parts use measured joint positions only.

mod command_limiter;
mod hand_guiding;
mod joint_follower;
mod lowering;
mod position_filter;
mod servo_codec;
mod thermal;

use crate::error::{Error, Result};
use crate::kinematics::{GroupMasses, JointFrames};
use crate::model::Model;
use crate::{JointVec, MAX_JOINTS};

pub use command_limiter::{CommandLimiter, LimiterInput};
pub use hand_guiding::{HandGuiding, HandGuidingOptions, SwingResult};
pub use joint_follower::{JointFollower, JointFollowerOptions};
pub use lowering::{DEFAULT_SPEED, Lowering, LoweringPhase, LoweringStart, SUPPORT, torque_margin};
pub use position_filter::PositionFilter;
pub use servo_codec::{Decoded, MAX_PACKET, Register, SentCommand, ServoCodec, ServoReading, ServoUnits};
pub use thermal::{ThermalModel, ThermalOptions};

/// Largest absolute value in a joint vector; larger numbers could overflow in squares and rates.
const MAX_VALUE: f64 = 1e6;
/// Lower bound on the time between two steps [s]; a shorter `dt` is raised to it.
const MIN_STEP: f64 = 1e-6;

/// Copies n numbers into a joint vector; returns an error for another length or a number outside ±[`MAX_VALUE`].
fn finite_joint_vector(name: &str, n: usize, values: &[f64]) -> Result<JointVec> {
    if values.len() != n {
        return Err(Error::length(name, values.len(), n));
    }
    if let Some(i) = values.iter().position(|value| value.is_nan() || value.abs() > MAX_VALUE) {
        return Err(Error::out_of_range(format!("{name}[{i}]"), values[i], "[-10⁶, 10⁶]"));
    }
    Ok(padded(values, 0.0))
}

/// Copies numbers into a joint vector and sets its remaining entries to `fill`.
fn padded(values: &[f64], fill: f64) -> JointVec {
    std::array::from_fn(|i| values.get(i).copied().unwrap_or(fill))
}

/// Returns the torques that hold the arm at q against gravity, for the given masses [N·m].
fn holding_torque(model: &Model, masses: &GroupMasses, q: &JointVec) -> JointVec {
    let (mut frames, mut torques) = (JointFrames::default(), [0.0; MAX_JOINTS]);
    model.chain().forward(q, &mut frames);
    model.chain().gravity(&frames, masses, model.gravity_vector(), &mut torques);
    torques
}
