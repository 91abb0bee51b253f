//! Python class `BusCycle`: control cycles of a servo bus in which nothing needs attention, each request in one call.

#[cfg(unix)]
use pyo3::exceptions::PyOSError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

#[cfg(unix)]
use crate::{
    bus_status::BusStatus,
    error::{shape, tuple},
    joint_readings::JointReadings,
    port_state::PortState,
    read::vector,
    servo_group::ServoGroup,
};

#[doc = stub!(BusCycle)]
#[pyclass(module = "pliant._core", subclass)]
#[derive(Debug, Default)]
pub(crate) struct BusCycle {
    #[cfg(unix)]
    reading: Option<Reading>,
    #[cfg(unix)]
    writing: Option<Writing>,
    #[cfg(unix)]
    polling: Option<Polling>,
}

/// Request that reads all servos.
#[cfg(unix)]
#[derive(Debug)]
struct Reading {
    port: Py<PortState>,
    status: Py<BusStatus>,
    group: Py<ServoGroup>,
    /// Numbers of missed readings of silent servos.
    misses: Py<PyDict>,
    /// Address and size of the registers that are read, without and with those of the status.
    blocks: [[usize; 2]; 2],
    /// Timeouts of the two blocks [s].
    timeouts: [f64; 2],
    /// Servo whose status is taken last.
    last: usize,
    /// Age of the last readings above which new ones are not stored [s].
    longest: f64,
    /// Time after which a cycle makes no further request [s].
    budget: f64,
}

/// Packets that write to all servos.
#[cfg(unix)]
#[derive(Debug)]
struct Writing {
    group: Py<ServoGroup>,
    blocks: Vec<[usize; 2]>,
    /// Timeouts in a control cycle and outside [s].
    timeouts: [f64; 2],
    max_speed: f64,
    /// Value of `BusStatus.torque_changes` for which this holds.
    torque_changes: u64,
}

/// Statuses of the joints.
#[cfg(unix)]
#[derive(Debug)]
struct Polling {
    /// Servo of each step.
    servos: Vec<usize>,
    /// Status of its joint.
    statuses: Py<PyTuple>,
    /// Value of `BusStatus.changes` for which this holds.
    changes: u64,
}

#[cfg(unix)]
impl Reading {
    fn is_clear(&self, py: Python<'_>) -> bool {
        self.misses.bind(py).is_empty() && self.port.borrow(py).is_clear(py)
    }
}

#[cfg(unix)]
impl BusCycle {
    /// Reads all servos; `None`, and no request, if something needs attention.
    fn read_usual<'py>(slf: &Bound<'py, Self>) -> PyResult<Option<Bound<'py, PyAny>>> {
        let py = slf.py();
        let cycle = slf.borrow();
        let Some(reading) = cycle.reading.as_ref().filter(|reading| reading.is_clear(py)) else { return Ok(None) };
        let (has_status, is_driven) = {
            let status = reading.status.borrow(py);
            let is_driven = cycle.writing.as_ref().is_some_and(|found| found.torque_changes == status.torque_changes)
                && cycle.polling.as_ref().is_some_and(|found| found.changes == status.changes);
            (!status.has_new(reading.last), is_driven)
        };
        if has_status && !is_driven {
            return Ok(None);
        }
        let (port, status, group) =
            (reading.port.bind(py).clone(), reading.status.bind(py).clone(), reading.group.bind(py).clone());
        let i = usize::from(has_status);
        let (block, timeout, longest, budget) =
            (reading.blocks[i], reading.timeouts[i], reading.longest, reading.budget);
        // The interpreter lock is released in the request.
        drop(cycle);
        let times = PortState::start_cycle(&port, budget)?;
        let found = match group.get().read(py, block, timeout, times[1], longest, true) {
            Ok(found) if found.is_instance_of::<JointReadings>() => {
                if has_status {
                    status.borrow_mut().note_commands(times[1]);
                }
                return Ok(Some(found));
            }
            Ok(found) => found,
            Err(error) => port_error(py, error)?,
        };
        slf.call_method1("_finish_read", (found, has_status, times)).map(Some)
    }

    /// Sends a command; `false`, and no request, if something needs attention or the command is invalid.
    fn write_usual(
        slf: &Bound<'_, Self>,
        goal: &Bound<'_, PyAny>,
        limit: &Bound<'_, PyAny>,
        velocity: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<bool> {
        let py = slf.py();
        let cycle = slf.borrow();
        let (Some(reading), Some(writing)) = (&cycle.reading, &cycle.writing) else { return Ok(false) };
        if writing.torque_changes != reading.status.borrow(py).torque_changes || !reading.misses.bind(py).is_empty() {
            return Ok(false);
        }
        let port = reading.port.bind(py).clone();
        let is_relaxed = {
            let port = port.borrow();
            if port.is_gone {
                return Ok(false);
            }
            port.is_relaxed
        };
        let timeout = writing.timeouts[usize::from(is_relaxed)];
        let (group, blocks, max_speed) = (writing.group.bind(py).clone(), writing.blocks.clone(), writing.max_speed);
        // The interpreter lock is released in the request.
        drop(cycle);
        let requests = blocks.len() as u64;
        let result = group.get().write(py, blocks, timeout, goal, limit, velocity, max_speed);
        let error = result.err().map(|error| port_error(py, error)).transpose();
        let Ok(error) = error else { return Ok(false) };
        port.borrow_mut().transactions += requests;
        if let Some(error) = error {
            slf.call_method1("_finish_write", (error,))?;
        }
        Ok(true)
    }

    /// Returns the status of the next joint; `None` if something needs attention.
    fn poll_usual<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyAny>> {
        let (reading, polling) = (self.reading.as_ref()?, self.polling.as_ref()?);
        let mut status = reading.status.borrow_mut(py);
        let servo = *polling.servos.get(status.next_step)?;
        if polling.changes != status.changes || !status.has_new(servo) || reading.port.borrow(py).is_gone {
            return None;
        }
        let found = polling.statuses.bind(py).get_item(status.next_step).ok()?;
        status.set_new(servo, false);
        status.next_step = (status.next_step + 1) % polling.servos.len();
        Some(found)
    }
}

/// Returns an `OSError` as an object; other errors remain errors.
#[cfg(unix)]
fn port_error(py: Python<'_>, error: PyErr) -> PyResult<Bound<'_, PyAny>> {
    if error.is_instance_of::<PyOSError>(py) { Ok(error.into_value(py).into_bound(py).into_any()) } else { Err(error) }
}

#[pymethods]
impl BusCycle {
    #[new]
    #[pyo3(signature = (*_args, **_options))]
    fn new(_args: &Bound<'_, PyTuple>, _options: Option<&Bound<'_, PyDict>>) -> Self {
        Self::default()
    }

    #[doc = stub!(BusCycle.read)]
    fn read<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        #[cfg(unix)]
        if let Some(found) = Self::read_usual(slf)? {
            return Ok(found);
        }
        slf.call_method0(intern!(slf.py(), "_read_each"))
    }

    #[doc = stub!(BusCycle.write)]
    #[pyo3(signature = (goal, limit, velocity = None))]
    fn write(
        slf: &Bound<'_, Self>,
        goal: &Bound<'_, PyAny>,
        limit: &Bound<'_, PyAny>,
        velocity: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<()> {
        #[cfg(unix)]
        if Self::write_usual(slf, goal, limit, velocity)? {
            return Ok(());
        }
        slf.call_method1(intern!(slf.py(), "_write_each"), (goal, limit, velocity)).map(|_| ())
    }

    #[doc = stub!(BusCycle.poll_status)]
    fn poll_status<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        #[cfg(unix)]
        if let Some(found) = slf.borrow().poll_usual(slf.py()) {
            return Ok(found);
        }
        slf.call_method0(intern!(slf.py(), "_poll_each"))
    }
}

#[cfg(unix)]
#[pymethods]
impl BusCycle {
    #[doc = stub!(BusCycle.set_reading)]
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "addresses, sizes and an index")]
    fn set_reading(
        &mut self,
        port: Py<PortState>,
        status: Py<BusStatus>,
        group: Py<ServoGroup>,
        misses: Py<PyDict>,
        numbers: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let numbers = vector("numbers", numbers)?;
        let &[address, size, with_status, size_with_status, first, second, last, longest, budget] = &numbers[..] else {
            return Err(shape("numbers", &[numbers.len()], tuple(&[9])));
        };
        (self.writing, self.polling) = (None, None);
        self.reading = Some(Reading {
            port,
            status,
            group,
            misses,
            blocks: [[address, size], [with_status, size_with_status]].map(|block| block.map(|number| number as usize)),
            timeouts: [first, second],
            last: last as usize,
            longest,
            budget,
        });
        Ok(())
    }

    #[doc = stub!(BusCycle.set_writing)]
    fn set_writing(
        &mut self,
        group: Py<ServoGroup>,
        blocks: Vec<[usize; 2]>,
        numbers: &Bound<'_, PyAny>,
        torque_changes: u64,
    ) -> PyResult<()> {
        let numbers = vector("numbers", numbers)?;
        let &[timeout, relaxed_timeout, max_speed] = &numbers[..] else {
            return Err(shape("numbers", &[numbers.len()], tuple(&[3])));
        };
        let timeouts = [timeout, relaxed_timeout];
        self.writing = Some(Writing { group, blocks, timeouts, max_speed, torque_changes });
        Ok(())
    }

    #[doc = stub!(BusCycle.set_polling)]
    fn set_polling(&mut self, servos: Vec<usize>, statuses: Py<PyTuple>, changes: u64) {
        self.polling = Some(Polling { servos, statuses, changes });
    }

    #[doc = stub!(BusCycle.end_cycles)]
    fn end_cycles(&mut self) {
        *self = Self::default();
    }
}
