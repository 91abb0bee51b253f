//! From motion and force to the servo command: lines 11 and 12 of the control step.

pub(crate) mod goal;
pub(crate) mod host_loss;
pub(crate) mod integrator;
pub(crate) mod torque_limit;

/// Largest offset of a goal from the measured position [rad] without known servos.
const DEFAULT_OFFSET_LIMIT: f64 = 0.3;
