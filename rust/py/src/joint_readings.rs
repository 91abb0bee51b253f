//! Python class `JointReadings`: one reading of all joints of a drive.

use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::fields::{attributes, replaced};
use crate::ndarray::new_array;

/// A value for each of the N joints: position [rad], time [s], velocity [rad/s], torque [N·m] and current [A].
pub(crate) type Row = [f64; 5];

/// Names of the attributes, in the order of the constructor's arguments.
const NAMES: [&str; 6] = ["position", "ok", "time", "velocity", "load", "current"];

#[doc = stub!(JointReadings)]
#[pyclass(module = "pliant.drive", frozen)]
#[derive(Debug)]
pub(crate) struct JointReadings {
    pub(crate) values: Values,
}

/// Values of a reading. Those of servos become arrays only when Python asks for them.
#[derive(Debug)]
pub(crate) enum Values {
    /// Values of each of the N joints, and true for joints that were read.
    Servos(Vec<Row>, Vec<bool>),
    Arrays(Arrays),
}

/// Arrays (N,) that a drive has created.
#[derive(Debug)]
pub(crate) struct Arrays {
    pub(crate) position: Py<PyAny>,
    pub(crate) ok: Py<PyAny>,
    pub(crate) time: Py<PyAny>,
    pub(crate) velocity: Option<Py<PyAny>>,
    pub(crate) load: Option<Py<PyAny>>,
    pub(crate) current: Option<Py<PyAny>>,
}

impl JointReadings {
    pub(crate) fn of_servos(joints: &[Row], ok: &[bool]) -> Self {
        Self { values: Values::Servos(joints.to_vec(), ok.to_vec()) }
    }

    /// Returns entry `column` of the rows of servos as an array, or else the array that `array` chooses.
    fn vector<'a, 'py>(
        &'a self,
        py: Python<'py>,
        column: usize,
        array: impl FnOnce(&'a Arrays) -> Option<&'a Py<PyAny>>,
    ) -> Option<Bound<'py, PyAny>> {
        match &self.values {
            Values::Servos(rows, _) => {
                let values: Vec<f64> = rows.iter().map(|row| row[column]).collect();
                Some(new_array(py, &[values.len()], &values))
            }
            Values::Arrays(arrays) => array(arrays).map(|array| array.bind(py).clone()),
        }
    }
}

#[pymethods]
impl JointReadings {
    #[new]
    #[pyo3(signature = (position, ok, time, velocity = None, load = None, current = None))]
    fn new(
        position: Py<PyAny>,
        ok: Py<PyAny>,
        time: Py<PyAny>,
        velocity: Option<Py<PyAny>>,
        load: Option<Py<PyAny>>,
        current: Option<Py<PyAny>>,
    ) -> Self {
        Self { values: Values::Arrays(Arrays { position, ok, time, velocity, load, current }) }
    }

    #[doc = stub!(JointReadings.replace)]
    #[pyo3(signature = (**changes))]
    fn replace<'py>(slf: &Bound<'py, Self>, changes: Option<&Bound<'py, PyDict>>) -> PyResult<Bound<'py, PyAny>> {
        replaced(slf.as_any(), &NAMES, changes)
    }

    fn __getnewargs__<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyTuple>> {
        attributes(slf.as_any(), &NAMES)
    }

    #[doc = stub!(JointReadings.position)]
    #[getter]
    fn position<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyAny>> {
        self.vector(py, 0, |arrays| Some(&arrays.position))
    }

    #[doc = stub!(JointReadings.ok)]
    #[getter]
    fn ok<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        match &self.values {
            Values::Servos(_, ok) => PyArray1::from_slice(py, ok).into_any(),
            Values::Arrays(arrays) => arrays.ok.bind(py).clone(),
        }
    }

    #[doc = stub!(JointReadings.time)]
    #[getter]
    fn time<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyAny>> {
        self.vector(py, 1, |arrays| Some(&arrays.time))
    }

    #[doc = stub!(JointReadings.velocity)]
    #[getter]
    fn velocity<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyAny>> {
        self.vector(py, 2, |arrays| arrays.velocity.as_ref())
    }

    #[doc = stub!(JointReadings.load)]
    #[getter]
    fn load<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyAny>> {
        self.vector(py, 3, |arrays| arrays.load.as_ref())
    }

    #[doc = stub!(JointReadings.current)]
    #[getter]
    fn current<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyAny>> {
        self.vector(py, 4, |arrays| arrays.current.as_ref())
    }
}
