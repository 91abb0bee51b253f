//! Python class `IkResult`, and the inverse kinematics that returns it.

use pliant_core::IkOptions;
use pyo3::prelude::*;

use crate::error::OrRaise;
use crate::kinds::{AxisKey, Kind};
use crate::model::Model;
use crate::ndarray::Array;
use crate::read::compact::{joints, pose};

#[doc = stub!(IkResult)]
#[pyclass(module = "pliant.model", frozen, get_all)]
#[derive(Debug)]
pub(crate) struct IkResult {
    #[doc = stub!(IkResult.q)]
    q: Array,
    #[doc = stub!(IkResult.converged)]
    converged: bool,
    #[doc = stub!(IkResult.iterations)]
    iterations: usize,
    #[doc = stub!(IkResult.position_error)]
    position_error: f64,
    #[doc = stub!(IkResult.rotation_error)]
    rotation_error: f64,
    #[doc = stub!(IkResult.reason)]
    reason: String,
}

#[pymethods]
impl IkResult {
    fn __bool__(&self) -> bool {
        self.converged
    }

    fn __repr__(&self) -> String {
        let Self { reason, position_error, rotation_error, iterations, .. } = self;
        format!("<IkResult: {reason}; {position_error:.1e} m, {rotation_error:.1e} rad after {iterations} iterations>")
    }
}

/// Searches for joint positions that bring the tool to `target`, starting at `q0`; `axes` replaces `options.axes` if
/// given.
pub(crate) fn search(
    model: &Model,
    target: &Bound<'_, PyAny>,
    q0: &Bound<'_, PyAny>,
    axes: Option<&Bound<'_, PyAny>>,
    options: &IkOptions,
) -> PyResult<IkResult> {
    let axes = axes.map_or(Ok(options.axes), |axes| AxisKey::read("axes", axes))?;
    let n = model.core.n();
    let (target, start) = (pose("target", target, axes[3..].iter().all(|on| !on))?, joints("q0", q0, n)?);
    let options = IkOptions { axes, ..options.clone() };
    let found = model.core.inverse_kinematics(&target, &start[..n], &options).or_raise()?;
    Ok(IkResult {
        q: Array::vector(&found.q),
        converged: found.converged,
        iterations: found.iterations,
        position_error: found.position_error,
        rotation_error: found.rotation_error,
        reason: found.reason.to_string(),
    })
}
