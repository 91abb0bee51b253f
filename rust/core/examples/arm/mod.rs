//! Simulated arm for the examples: servos are springs with a torque limit, joints are dampers without inertia.

use std::sync::Arc;

use pliant_core::nalgebra::Vector6;
use pliant_core::{Model, ModelOptions, Reference, Result, Servos};

/// Stiffness of every servo, k_p [N·m/rad].
const STIFFNESS: f64 = 150.0;

/// Viscous damping of gears and motors [N·m·s/rad].
const DAMPING: f64 = 3.0;

/// Period of the control loop [s], and time step of the simulation [s].
const TICK: f64 = 0.01;
const STEP: f64 = 0.002;

/// Joint positions at the start [rad].
pub(crate) const START: [f64; 7] = [-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17];

/// Returns the built-in arm; for your own arm, use `Model::from_urdf_file`.
pub(crate) fn model() -> Result<Arc<Model>> {
    let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
    Model::from_urdf_str(include_str!("../../robots/arm7.urdf"), &options).map(Arc::new)
}

/// Returns the servo parameters for the controller; their usable torque is 10.7 N·m.
pub(crate) fn servos() -> Servos {
    Servos { damping: vec![DAMPING], stiffness_known: true, ..Servos::new(vec![STIFFNESS], vec![10.7]) }
}

/// Moves the joints for one tick: `q̇ = (clip(k_p (goal − q), ±limit) − g + JᵀF) / d`, with the external force F =
/// `push` [N, N·m] at the tool.
pub(crate) fn advance(model: &Model, q: &mut [f64], goal: &[f64], limit: &[f64], push: &Vector6<f64>) -> Result<()> {
    let mut remaining = TICK;
    while remaining > 0.5 * STEP {
        let (_, jacobian) = model.kinematics(q, Reference::WorldAligned)?;
        let external = jacobian.transpose() * push - model.gravity(q)?;
        for (i, position) in q.iter_mut().enumerate() {
            let servo = (STIFFNESS * (goal[i] - *position)).clamp(-limit[i], limit[i]);
            *position += STEP * (servo + external[i]) / DAMPING;
        }
        remaining -= STEP;
    }
    Ok(())
}
