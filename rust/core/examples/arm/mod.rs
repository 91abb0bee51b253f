//! An arm to try the library on: servos that are springs with a limit, joints that are dampers without mass.

use std::sync::Arc;

use pliant_core::nalgebra::Vector6;
use pliant_core::{Model, ModelOptions, Reference, Result, Servos};

/// Stiffness of every servo, k_p [N·m/rad].
const STIFFNESS: f64 = 150.0;

/// What gears and motors resist with [N·m·s/rad].
const DAMPING: f64 = 3.0;

/// Time between two steps [s], and the part of it that the simulation goes at once.
const TICK: f64 = 0.01;
const STEP: f64 = 0.002;

/// Where the arm begins [rad].
pub(crate) const START: [f64; 7] = [-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17];

/// The built-in arm; yours comes from `Model::from_urdf_file`.
pub(crate) fn model() -> Result<Arc<Model>> {
    let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
    Model::from_urdf_str(include_str!("../../robots/arm7.urdf"), &options).map(Arc::new)
}

/// What the controller is told of the servos; 10.7 N·m is what they can exert.
pub(crate) fn servos() -> Servos {
    Servos { damping: vec![DAMPING], stiffness_known: true, ..Servos::new(vec![STIFFNESS], vec![10.7]) }
}

/// Moves the joints for one tick: `q̇ = (clip(k_p (goal − q), ±limit) − g + JᵀF) / d`, F [N, N·m] pushing at the tool.
pub(crate) fn advance(model: &Model, q: &mut [f64], goal: &[f64], limit: &[f64], push: &Vector6<f64>) -> Result<()> {
    let mut left = TICK;
    while left > 0.5 * STEP {
        let (_, jacobian) = model.kinematics(q, Reference::WorldAligned)?;
        let others = jacobian.transpose() * push - model.gravity(q)?;
        for (i, position) in q.iter_mut().enumerate() {
            let servo = (STIFFNESS * (goal[i] - *position)).clamp(-limit[i], limit[i]);
            *position += STEP * (servo + others[i]) / DAMPING;
        }
        left -= STEP;
    }
    Ok(())
}
