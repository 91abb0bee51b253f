//! What a controller was told and remembers, so that one made elsewhere can go on in its place.

use std::sync::Arc;

use crate::controller::Controller;
use crate::controller::kept::width;
use crate::error::{Error, Result};
use crate::model::{Model, Payload, finite_vector};
use crate::pose::COORDINATE_BOUND;
use crate::servos::Servos;
use crate::settings::Settings;

/// What a controller has beside model, settings and servos, to be read by the same version of this crate.
#[derive(Debug, Clone, PartialEq)]
pub struct Carried {
    /// Payload in force.
    pub payload: Option<Payload>,
    /// Gravity vector in force [m/s²], base axes.
    pub gravity: [f64; 3],
    /// While another payload comes into force: mass [kg] and first moment (3) [kg·m] before it, time since then [s].
    pub fading: Option<[f64; 5]>,
    /// Delay T_d in force [s].
    pub delay: f64,
    /// 1/k_g (n) [rad/(N·m)] where the gravity offset was captured.
    pub captured: Option<Vec<f64>>,
    /// Memory between steps; empty before the first one and without a reset.
    pub memory: Vec<f64>,
}

impl Controller {
    /// What [`Controller::resumed`] needs of this one.
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

    /// A controller whose next step is, to the last bit where both run on the same instructions, that of the one that `carried`
    /// is from.
    ///
    /// What can be read of the last step is not carried.
    ///
    /// # Errors
    /// As [`Controller::new`], but for servos that cannot hold the arm, and [`Controller::set_delay`]; [`Error::Shape`] for what
    /// another arm carried, [`Error::OutOfRange`] for what none can have.
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
        // Whether the servos hold it was asked when it was set, with settings and gravity of that time.
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
