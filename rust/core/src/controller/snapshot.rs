//! Snapshot of a controller: its inputs and its state, to continue in another process.

use std::sync::Arc;

use crate::controller::Controller;
use crate::controller::state_vector::width;
use crate::error::{Error, Result};
use crate::model::{Model, Payload, finite_vector};
use crate::params::{Servos, Settings};
use crate::pose::COORDINATE_BOUND;

/// Snapshot of a controller without model, settings and servos. Valid for the same version of this crate only.
#[derive(Debug, Clone, PartialEq)]
pub struct Carried {
    /// Current payload.
    pub payload: Option<Payload>,
    /// Current gravity vector [m/s²], base axes.
    pub gravity: [f64; 3],
    /// During a payload change: previous mass [kg] and first moment (3) [kg·m], time since the change [s].
    pub fading: Option<[f64; 5]>,
    /// Current delay T_d [s].
    pub delay: f64,
    /// 1/k_g (n) [rad/(N·m)] if the gravity offset was captured.
    pub captured: Option<Vec<f64>>,
    /// State between steps; empty before the first step if there was no reset.
    pub memory: Vec<f64>,
}

impl Controller {
    /// Returns a snapshot for [`Controller::resumed`].
    pub fn carried(&self) -> Carried {
        let n = self.plan.n;
        let mut memory = vec![0.0; if self.memory.started { width(n) } else { 0 }];
        self.memory.clone().keep(n, &mut memory);
        Carried {
            payload: self.payload,
            gravity: self.gravity,
            fading: self.fading(),
            delay: self.delay,
            captured: self.captured.map(|captured| captured[..n].to_vec()),
            memory,
        }
    }

    /// Creates a controller from a snapshot. If both run on the same instructions, its next step is bit-identical to
    /// that of the original.
    ///
    /// The diagnostics of the last step are not part of the snapshot.
    ///
    /// # Errors
    /// As [`Controller::new`], without the check that the servos can hold the arm, and as [`Controller::set_delay`];
    /// [`Error::Shape`] for a snapshot of an arm of another size, [`Error::OutOfRange`] for impossible values.
    pub fn resumed(model: Arc<Model>, settings: Settings, servos: Option<Servos>, carried: &Carried) -> Result<Self> {
        let n = model.n();
        let captured = carried.captured.as_deref();
        if let Some(other) = captured.filter(|values| values.len() != n) {
            return Err(Error::length("captured", other.len(), n));
        }
        if let Some(&value) = captured.into_iter().flatten().find(|value| !(**value > 0.0 && value.is_finite())) {
            return Err(Error::out_of_range("captured [rad/(N·m)]", value, "(0, ∞)"));
        }
        finite_vector("gravity", "m/s²", &carried.gravity)?;
        let mut controller = Self::made(model, settings, servos, captured)?;
        if let Some(payload) = &carried.payload {
            payload.validate()?;
        }
        // No check whether the servos can hold the payload: `set_payload` made it with the settings and gravity of that
        // time.
        controller.payload = carried.payload;
        controller.masses = controller.model.chain().masses(carried.payload.as_ref());
        controller.gravity = carried.gravity;
        controller.set_delay(carried.delay)?;
        if !carried.memory.is_empty() {
            if carried.memory.len() != width(n) {
                return Err(Error::length("memory", carried.memory.len(), width(n)));
            }
            if carried.memory.iter().any(|value| value.is_nan()) {
                return Err(Error::out_of_range("memory", f64::NAN, "numbers"));
            }
            controller.memory.recall(n, &carried.memory);
        }
        if let Some(fading) = carried.fading {
            if let Some(&value) = fading.iter().find(|value| !(value.abs() <= COORDINATE_BOUND)) {
                return Err(Error::out_of_range("fading", value, format!("±{COORDINATE_BOUND:e}")));
            }
            controller.resume_fade(fading);
        }
        Ok(controller)
    }
}
