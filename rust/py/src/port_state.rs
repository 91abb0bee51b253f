//! Python class `PortState`: state of the requests on one serial port.

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

#[doc = stub!(PortState)]
#[pyclass(module = "pliant._core", subclass)]
#[derive(Debug)]
pub(crate) struct PortState {
    #[doc = stub!(PortState.is_dirty)]
    #[pyo3(get, set)]
    pub(crate) is_dirty: bool,
    #[doc = stub!(PortState.is_gone)]
    #[pyo3(get, set)]
    pub(crate) is_gone: bool,
    #[doc = stub!(PortState.is_relaxed)]
    #[pyo3(get, set)]
    pub(crate) is_relaxed: bool,
    #[doc = stub!(PortState.deadline)]
    #[pyo3(get, set)]
    pub(crate) deadline: f64,
    #[doc = stub!(PortState.transactions)]
    #[pyo3(get, set)]
    pub(crate) transactions: u64,
    #[doc = stub!(PortState.missing)]
    #[pyo3(get)]
    missing: Py<PyDict>,
    #[doc = stub!(PortState.clock)]
    #[pyo3(get, set)]
    clock: Py<PyAny>,
    #[doc = stub!(PortState.sample_clock)]
    #[pyo3(get, set)]
    sample_clock: Py<PyAny>,
}

#[cfg(unix)]
impl PortState {
    /// Returns true if the last request has not failed, and no reply is missing.
    pub(crate) fn is_clear(&self, py: Python<'_>) -> bool {
        !(self.is_dirty || self.is_gone) && self.missing.bind(py).is_empty()
    }

    /// Starts a control cycle of `budget` [s] and counts its first request; returns the start time [s] on the clock of
    /// timeouts and on that of readings.
    pub(crate) fn start_cycle(slf: &Bound<'_, Self>, budget: f64) -> PyResult<[f64; 2]> {
        let py = slf.py();
        let (clock, sample_clock) = {
            let state = slf.borrow();
            (state.clock.bind(py).clone(), state.sample_clock.bind(py).clone())
        };
        let started = clock.call0()?.extract()?;
        let sampled = sample_clock.call0()?.extract()?;
        let mut state = slf.borrow_mut();
        (state.deadline, state.is_relaxed) = (started + budget, false);
        state.transactions += 1;
        Ok([started, sampled])
    }
}

#[pymethods]
impl PortState {
    #[new]
    #[pyo3(signature = (*_args, **_options))]
    fn new(py: Python<'_>, _args: &Bound<'_, PyTuple>, _options: Option<&Bound<'_, PyDict>>) -> Self {
        Self {
            is_dirty: false,
            is_gone: false,
            is_relaxed: true,
            deadline: f64::INFINITY,
            transactions: 0,
            missing: PyDict::new(py).unbind(),
            clock: py.None(),
            sample_clock: py.None(),
        }
    }
}
