//! `IkResult`.

use pliant_core::{IkOptions, IkResult as CoreSolution};
use pyo3::prelude::*;

use crate::convert::new_array;
use crate::error::OrRaise;
use crate::kinds::{AxisKey, Kind};
use crate::model::Model;
use crate::read::{joints, pose};

#[pyclass(module = "pliant.model", frozen)]
#[derive(Debug)]
pub(crate) struct IkResult(CoreSolution);

#[pymethods]
impl IkResult {
    #[getter]
    fn q<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[self.0.q.len()], &self.0.q)
    }

    #[getter]
    fn converged(&self) -> bool {
        self.0.converged
    }

    #[getter]
    fn iterations(&self) -> usize {
        self.0.iterations
    }

    #[getter]
    fn position_error(&self) -> f64 {
        self.0.position_error
    }

    #[getter]
    fn rotation_error(&self) -> f64 {
        self.0.rotation_error
    }

    #[getter]
    fn reason(&self) -> String {
        self.0.reason.to_string()
    }

    fn __bool__(&self) -> bool {
        self.0.converged
    }

    fn __repr__(&self) -> String {
        let (solution, status) = (&self.0, &self.0.reason);
        format!(
            "<IkResult: {status}; {:.1e} m, {:.1e} rad after {} iterations>",
            solution.position_error, solution.rotation_error, solution.iterations
        )
    }
}

/// Runs the search with the keywords of [`IkOptions`].
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
    model.core.inverse_kinematics(&target, &start[..n], &options).or_raise().map(IkResult)
}
