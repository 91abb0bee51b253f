//! Python class `ExclusiveAccess`: lock of an arm, and the time of the last access to it.
#![expect(unsafe_code, reason = "memory that another process reads is written in place")]

use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};

use pyo3::buffer::PyBuffer;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

#[doc = stub!(ExclusiveAccess)]
#[pyclass(module = "pliant._core", subclass)]
#[derive(Debug)]
pub(crate) struct ExclusiveAccess {
    #[doc = stub!(ExclusiveAccess.lock)]
    #[pyo3(get)]
    lock: Py<PyAny>,
    #[doc = stub!(ExclusiveAccess.reason)]
    #[pyo3(get, set)]
    reason: Option<Py<PyAny>>,
    #[doc = stub!(ExclusiveAccess.last_call)]
    #[pyo3(get, set)]
    last_call: f64,
    acquire: Py<PyAny>,
    release: Py<PyAny>,
    clock: Py<PyAny>,
    /// The memory that Python sees as `heartbeat`, and the same memory as numbers; `None` before the first assignment.
    heartbeat: Option<(Py<PyAny>, PyBuffer<f64>)>,
    not_forked: PyBuffer<u8>,
}

#[pymethods]
impl ExclusiveAccess {
    #[new]
    fn new(lock: &Bound<'_, PyAny>, not_forked: &Bound<'_, PyAny>, clock: Py<PyAny>) -> PyResult<Self> {
        let not_forked = PyBuffer::get(not_forked)?;
        if not_forked.item_count() == 0 || !not_forked.is_c_contiguous() {
            return Err(PyValueError::new_err("not_forked has no bytes in a row"));
        }
        Ok(Self {
            acquire: lock.getattr("acquire")?.unbind(),
            release: lock.getattr("release")?.unbind(),
            lock: lock.clone().unbind(),
            clock,
            reason: None,
            last_call: 0.0,
            heartbeat: None,
            not_forked,
        })
    }

    #[doc = stub!(ExclusiveAccess.heartbeat)]
    #[getter]
    fn heartbeat<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyAny>> {
        self.heartbeat.as_ref().map(|(memory, _)| memory.bind(py).clone())
    }

    #[setter]
    fn set_heartbeat(&mut self, memory: &Bound<'_, PyAny>) -> PyResult<()> {
        let times = PyBuffer::get(memory)?;
        if times.readonly() || times.item_count() < 2 || !times.is_c_contiguous() {
            return Err(PyValueError::new_err("heartbeat is no memory of two numbers in a row that can be written"));
        }
        self.heartbeat = Some((memory.clone().unbind(), times));
        Ok(())
    }

    #[doc = stub!(ExclusiveAccess.__enter__)]
    fn __enter__(slf: &Bound<'_, Self>) -> PyResult<()> {
        let py = slf.py();
        let (acquire, needs_check) = {
            let access = slf.borrow();
            // SAFETY: `new` has checked that there is a byte, and `PyBuffer` keeps it alive.
            let not_forked = unsafe { AtomicU8::from_ptr(access.not_forked.buf_ptr().cast()) };
            let is_forked = not_forked.load(Ordering::Relaxed) == 0;
            (access.acquire.bind(py).clone(), is_forked || access.reason.is_some())
        };
        if needs_check {
            slf.call_method0("check")?;
        }
        acquire.call0()?;
        if slf.borrow().reason.is_some() {
            let release = slf.borrow().release.bind(py).clone();
            release.call0()?;
            slf.call_method0("check")?;
        }
        Ok(())
    }

    #[doc = stub!(ExclusiveAccess.__exit__)]
    #[pyo3(signature = (*_exception))]
    fn __exit__(slf: &Bound<'_, Self>, _exception: &Bound<'_, PyTuple>) -> PyResult<()> {
        let py = slf.py();
        let clock = slf.borrow().clock.bind(py).clone();
        let now = clock.call0().and_then(|now| now.extract::<f64>());
        let release = {
            let mut access = slf.borrow_mut();
            if let Ok(now) = now {
                access.last_call = now;
                if let Some((_, times)) = &access.heartbeat {
                    // SAFETY: the setter has checked that these are aligned numbers that can be written, and `PyBuffer`
                    // keeps them alive. Another process reads them.
                    let last = unsafe { AtomicU64::from_ptr(times.buf_ptr().cast()) };
                    last.store(now.to_bits(), Ordering::Relaxed);
                }
            }
            access.release.bind(py).clone()
        };
        release.call0()?;
        now.map(|_| ())
    }
}
