//! Goals and torque limits of the servos, computed from the motion and force of the law.

pub(crate) mod goal;
pub(crate) mod host_loss;
pub(crate) mod integrator;
pub(crate) mod torque_limit;

/// Largest lead (goal − q) if the servos' stiffness or usable torque is unknown [rad].
const DEFAULT_OFFSET_LIMIT: f64 = 0.3;
