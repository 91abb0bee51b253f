//! `Diagnostics`: the intermediate values of a controller's last step.

use nalgebra::DMatrix;
use numpy::PyArray1;
use pliant_core::{Controller as CoreController, Diagnostics as CoreDiagnostics};
use pyo3::prelude::*;

use crate::convert::new_array;
use crate::functions::table;

#[pyclass(module = "pliant", frozen)]
pub(crate) struct Diagnostics {
    record: CoreDiagnostics,
    n: usize,
    axes: usize,
    sigma: [f64; 2],
    damping_constants: (f64, f64, f64),
    gain_factor: f64,
    singular_values: Vec<f64>,
    activation: DMatrix<f64>,
    responsibility: DMatrix<f64>,
    task_jacobian: DMatrix<f64>,
}

impl Diagnostics {
    pub(crate) fn new(core: &CoreController) -> Self {
        let damping = core.singularity_damping();
        Self {
            record: core.diagnostics(),
            n: core.model().n(),
            axes: core.task_dim(),
            sigma: core.sigma_range(),
            damping_constants: (damping.lambda_0, damping.sigma_0, damping.lambda_max),
            gain_factor: core.gain_factor(),
            singular_values: core.singular_values().as_slice().to_vec(),
            activation: core.activation(),
            responsibility: core.responsibility(),
            task_jacobian: core.task_jacobian(),
        }
    }

    fn per_axis<'py>(&self, py: Python<'py>, values: &[f64]) -> Bound<'py, PyAny> {
        new_array(py, &[self.axes], values)
    }

    fn per_joint<'py>(&self, py: Python<'py>, values: &[f64]) -> Bound<'py, PyAny> {
        new_array(py, &[self.n], values)
    }
}

#[pymethods]
impl Diagnostics {
    #[getter]
    fn deviation<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.per_axis(py, &self.record.deviation)
    }

    #[getter]
    fn adapted_deviation<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.per_axis(py, &self.record.adapted_deviation)
    }

    #[getter]
    fn task_velocity<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.per_axis(py, &self.record.task_velocity)
    }

    #[getter]
    fn softness<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.per_axis(py, &self.record.softness)
    }

    #[getter]
    fn compliance<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.per_axis(py, &self.record.compliance)
    }

    #[getter]
    fn axis_strength<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.per_axis(py, &self.record.axis_strength)
    }

    #[getter]
    fn wrench<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.per_axis(py, &self.record.wrench)
    }

    #[getter]
    fn deviation_limited<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        PyArray1::from_slice(py, &self.record.deviation_limited[..self.axes]).into_any()
    }

    #[getter]
    fn reference<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[4, 4], &self.record.reference.to_rows().concat())
    }

    #[getter]
    fn activation<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        table(py, &self.activation)
    }

    #[getter]
    fn responsibility<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        table(py, &self.responsibility)
    }

    #[getter]
    fn task_jacobian<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        table(py, &self.task_jacobian)
    }

    #[getter]
    fn singular_values<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[self.singular_values.len()], &self.singular_values)
    }

    #[getter]
    fn sigma_min(&self) -> f64 {
        self.sigma[0]
    }

    #[getter]
    fn sigma_max(&self) -> f64 {
        self.sigma[1]
    }

    #[getter]
    fn damping(&self) -> f64 {
        self.record.damping
    }

    #[getter]
    fn damping_constants(&self) -> (f64, f64, f64) {
        self.damping_constants
    }

    #[getter]
    fn gain_factor(&self) -> f64 {
        self.gain_factor
    }

    #[getter]
    fn gamma(&self) -> f64 {
        self.record.gamma
    }

    #[getter]
    fn factors(&self) -> (f64, f64, f64) {
        self.record.factors.into()
    }

    #[getter]
    fn q_predicted<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.per_joint(py, &self.record.q)
    }

    #[getter]
    fn velocity<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.per_joint(py, &self.record.velocity)
    }

    #[getter]
    fn gravity<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.per_joint(py, &self.record.gravity)
    }

    #[getter]
    fn feed_forward<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.per_joint(py, &self.record.feed_forward)
    }

    #[getter]
    fn gradient<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        self.per_joint(py, &self.record.gradient)
    }

    #[getter]
    fn saturated<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        PyArray1::from_slice(py, &self.record.saturated[..self.n]).into_any()
    }

    #[getter]
    fn locked<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        PyArray1::from_slice(py, &self.record.locked[..self.n]).into_any()
    }
}
