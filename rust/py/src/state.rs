//! Python class `State`: the state of an arm in one control cycle.

use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyTuple};

use crate::fields::{attributes, replaced};
use crate::ndarray::new_array;

type Object = Py<PyAny>;

// Attributes that are Python objects are read without a call.
#[doc = stub!(State)]
#[pyclass(module = "pliant.drive", frozen, get_all)]
#[derive(Debug)]
pub(crate) struct State {
    #[doc = stub!(State.q)]
    pub(crate) q: Object,
    #[doc = stub!(State.dq)]
    pub(crate) dq: Option<Object>,
    #[doc = stub!(State.time)]
    pub(crate) time: Py<PyFloat>,
    #[doc = stub!(State.fresh)]
    pub(crate) fresh: Py<PyBool>,
    #[doc = stub!(State.extra)]
    pub(crate) extra: Object,
    #[doc = stub!(State.age)]
    pub(crate) age: Object,
    #[doc = stub!(State.load)]
    pub(crate) load: Option<Object>,
    #[doc = stub!(State.current)]
    pub(crate) current: Option<Object>,
    #[doc = stub!(State.voltage)]
    pub(crate) voltage: Option<Object>,
    #[doc = stub!(State.temperature)]
    pub(crate) temperature: Option<Object>,
    #[doc = stub!(State.faults)]
    pub(crate) faults: Py<PyTuple>,
}

/// Names of the attributes, in the order of the constructor's arguments.
const NAMES: [&str; 11] =
    ["q", "dq", "time", "fresh", "extra", "age", "load", "current", "voltage", "temperature", "faults"];

#[pymethods]
impl State {
    #[new]
    #[pyo3(signature = (
        q, dq = None, time = 0.0, fresh = true, extra = None, age = None, load = None, current = None, voltage = None,
        temperature = None, faults = None
    ))]
    #[expect(clippy::too_many_arguments, reason = "the attributes")]
    fn new(
        py: Python<'_>,
        q: Object,
        dq: Option<Object>,
        time: f64,
        fresh: bool,
        extra: Option<Object>,
        age: Option<Object>,
        load: Option<Object>,
        current: Option<Object>,
        voltage: Option<Object>,
        temperature: Option<Object>,
        faults: Option<Py<PyTuple>>,
    ) -> PyResult<Self> {
        let age = match age {
            Some(age) => age,
            None => new_array(py, &[q.bind(py).len()?], &[]).unbind(),
        };
        let extra = extra.unwrap_or_else(|| PyDict::new(py).into_any().unbind());
        let faults = faults.unwrap_or_else(|| PyTuple::empty(py).unbind());
        let (time, fresh) = (PyFloat::new(py, time).unbind(), PyBool::new(py, fresh).to_owned().unbind());
        Ok(Self { q, dq, time, fresh, extra, age, load, current, voltage, temperature, faults })
    }

    #[doc = stub!(State.replace)]
    #[pyo3(signature = (**changes))]
    fn replace<'py>(slf: &Bound<'py, Self>, changes: Option<&Bound<'py, PyDict>>) -> PyResult<Bound<'py, PyAny>> {
        replaced(slf.as_any(), &NAMES, changes)
    }

    fn __getnewargs__<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyTuple>> {
        attributes(slf.as_any(), &NAMES)
    }

    fn __repr__(slf: &Bound<'_, Self>) -> PyResult<String> {
        let parts = NAMES.iter().map(|name| Ok(format!("{name}={}", slf.getattr(*name)?.repr()?)));
        Ok(format!("State({})", parts.collect::<PyResult<Vec<_>>>()?.join(", ")))
    }
}
