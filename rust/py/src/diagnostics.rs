//! Python class `Diagnostics`: the intermediate values of a controller's last step.

use pliant_core::Controller as CoreController;
use pyo3::prelude::*;

use crate::ndarray::{Array, Flags};

#[doc = stub!(Diagnostics)]
#[pyclass(module = "pliant.types", frozen, get_all)]
pub(crate) struct Diagnostics {
    #[doc = stub!(Diagnostics.deviation)]
    deviation: Array,
    #[doc = stub!(Diagnostics.adapted_deviation)]
    adapted_deviation: Array,
    #[doc = stub!(Diagnostics.task_velocity)]
    task_velocity: Array,
    #[doc = stub!(Diagnostics.softness)]
    softness: Array,
    #[doc = stub!(Diagnostics.compliance)]
    compliance: Array,
    #[doc = stub!(Diagnostics.axis_strength)]
    axis_strength: Array,
    #[doc = stub!(Diagnostics.wrench)]
    wrench: Array,
    #[doc = stub!(Diagnostics.deviation_limited)]
    deviation_limited: Flags,
    #[doc = stub!(Diagnostics.reference)]
    reference: Array,
    #[doc = stub!(Diagnostics.activation)]
    activation: Array,
    #[doc = stub!(Diagnostics.responsibility)]
    responsibility: Array,
    #[doc = stub!(Diagnostics.task_jacobian)]
    task_jacobian: Array,
    #[doc = stub!(Diagnostics.singular_values)]
    singular_values: Array,
    #[doc = stub!(Diagnostics.sigma_min)]
    sigma_min: f64,
    #[doc = stub!(Diagnostics.sigma_max)]
    sigma_max: f64,
    #[doc = stub!(Diagnostics.damping)]
    damping: f64,
    #[doc = stub!(Diagnostics.damping_constants)]
    damping_constants: (f64, f64, f64),
    #[doc = stub!(Diagnostics.gain_factor)]
    gain_factor: f64,
    #[doc = stub!(Diagnostics.gamma)]
    gamma: f64,
    #[doc = stub!(Diagnostics.factors)]
    factors: (f64, f64, f64),
    #[doc = stub!(Diagnostics.q_predicted)]
    q_predicted: Array,
    #[doc = stub!(Diagnostics.velocity)]
    velocity: Array,
    #[doc = stub!(Diagnostics.gravity)]
    gravity: Array,
    #[doc = stub!(Diagnostics.feed_forward)]
    feed_forward: Array,
    #[doc = stub!(Diagnostics.gradient)]
    gradient: Array,
    #[doc = stub!(Diagnostics.saturated)]
    saturated: Flags,
    #[doc = stub!(Diagnostics.locked)]
    locked: Flags,
}

impl Diagnostics {
    pub(crate) fn new(core: &CoreController) -> Self {
        let (record, n, axes, [sigma_min, sigma_max]) =
            (core.diagnostics(), core.model().n(), core.task_dim(), core.sigma_range());
        let damping = core.singularity_damping();
        let per_axis = |values: &[f64]| Array::vector(&values[..axes]);
        let per_joint = |values: &[f64]| Array::vector(&values[..n]);
        Self {
            deviation: per_axis(&record.deviation),
            adapted_deviation: per_axis(&record.adapted_deviation),
            task_velocity: per_axis(&record.task_velocity),
            softness: per_axis(&record.softness),
            compliance: per_axis(&record.compliance),
            axis_strength: per_axis(&record.axis_strength),
            wrench: per_axis(&record.wrench),
            deviation_limited: Flags(record.deviation_limited[..axes].to_vec()),
            reference: Array::rows(&record.reference.to_rows()),
            activation: Array::matrix(&core.activation()),
            responsibility: Array::matrix(&core.responsibility()),
            task_jacobian: Array::matrix(&core.task_jacobian()),
            singular_values: Array::vector(core.singular_values().as_slice()),
            sigma_min,
            sigma_max,
            damping: record.damping,
            damping_constants: (damping.lambda_0, damping.sigma_0, damping.lambda_max),
            gain_factor: core.gain_factor(),
            gamma: record.gamma,
            factors: record.factors.into(),
            q_predicted: per_joint(&record.q),
            velocity: per_joint(&record.velocity),
            gravity: per_joint(&record.gravity),
            feed_forward: per_joint(&record.feed_forward),
            gradient: per_joint(&record.gradient),
            saturated: Flags(record.saturated[..n].to_vec()),
            locked: Flags(record.locked[..n].to_vec()),
        }
    }
}
