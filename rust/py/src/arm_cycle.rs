//! Python class `ArmCycle`: the readings and commands of all joints of an arm.

use pyo3::exceptions::PyAttributeError;
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::command_limiter::CommandLimiter;
use crate::error::{is_bad_value, is_timeout};
use crate::joint_readings::JointReadings;
use crate::position_filter::PositionFilter;

#[doc = stub!(ArmCycle)]
#[pyclass(module = "pliant._core", subclass)]
#[derive(Debug)]
pub(crate) struct ArmCycle {
    #[doc = stub!(ArmCycle.drive)]
    #[pyo3(get, set)]
    drive: Py<PyAny>,
    #[doc = stub!(ArmCycle.clock)]
    #[pyo3(get, set)]
    clock: Py<PyAny>,
    #[doc = stub!(ArmCycle.limiter)]
    #[pyo3(get, set)]
    limiter: Option<Py<CommandLimiter>>,
    #[doc = stub!(ArmCycle.positions)]
    #[pyo3(get, set)]
    positions: Option<Py<PositionFilter>>,
    #[doc = stub!(ArmCycle.readings)]
    #[pyo3(get, set)]
    readings: Option<Py<JointReadings>>,
    #[doc = stub!(ArmCycle.goals)]
    #[pyo3(get, set)]
    goals: Py<PyAny>,
    #[doc = stub!(ArmCycle.limits)]
    #[pyo3(get, set)]
    limits: Py<PyAny>,
    #[doc = stub!(ArmCycle.is_sent)]
    #[pyo3(get, set)]
    is_sent: bool,
    #[doc = stub!(ArmCycle.orders)]
    #[pyo3(get, set)]
    orders: Py<PyDict>,
    #[doc = stub!(ArmCycle.reported)]
    #[pyo3(get)]
    reported: Py<PyDict>,
    #[doc = stub!(ArmCycle.ramp_start)]
    #[pyo3(get, set)]
    ramp_start: f64,
    #[doc = stub!(ArmCycle.ramp_time)]
    #[pyo3(get, set)]
    ramp_time: f64,
    #[doc = stub!(ArmCycle.min_limit)]
    #[pyo3(get, set)]
    min_limit: Py<PyAny>,
    #[doc = stub!(ArmCycle.watchdog_time)]
    #[pyo3(get, set)]
    watchdog_time: f64,
    #[doc = stub!(ArmCycle.last_update)]
    #[pyo3(get, set)]
    last_update: f64,
    #[doc = stub!(ArmCycle.last_access)]
    #[pyo3(get, set)]
    last_access: f64,
    #[doc = stub!(ArmCycle.last_write)]
    #[pyo3(get, set)]
    last_write: f64,
    /// True if the last command was not one of a controller.
    watches_limits: bool,
    /// Last status of each joint.
    statuses: Vec<Option<Py<PyAny>>>,
}

/// Returns an attribute that `ArmIO` has to set.
fn part<'py, T>(py: Python<'py>, attribute: Option<&Py<T>>) -> PyResult<Bound<'py, T>> {
    let missing = || PyAttributeError::new_err("limiter and positions are not set");
    attribute.map(|found| found.bind(py).clone()).ok_or_else(missing)
}

impl ArmCycle {
    /// Returns the present time [s].
    fn now(slf: &Bound<'_, Self>) -> PyResult<f64> {
        let py = slf.py();
        let clock = slf.borrow().clock.bind(py).clone();
        clock.call_method0(intern!(py, "now"))?.extract()
    }

    /// Returns goals and torque limits of the joints off the chain.
    fn off_chain(limiter: &Bound<'_, CommandLimiter>, orders: &Bound<'_, PyDict>) -> PyResult<Vec<[f64; 2]>> {
        let extra = limiter.try_borrow()?.extra.bind(limiter.py()).clone();
        extra.iter().map(|name| orders.as_any().get_item(name)?.extract::<(f64, f64)>().map(Into::into)).collect()
    }
}

#[pymethods]
impl ArmCycle {
    #[new]
    #[pyo3(signature = (*_args, **_options))]
    fn new(py: Python<'_>, _args: &Bound<'_, PyTuple>, _options: Option<&Bound<'_, PyDict>>) -> Self {
        Self {
            drive: py.None(),
            clock: py.None(),
            limiter: None,
            positions: None,
            readings: None,
            goals: py.None(),
            limits: py.None(),
            is_sent: false,
            orders: PyDict::new(py).unbind(),
            reported: PyDict::new(py).unbind(),
            ramp_start: f64::NEG_INFINITY,
            ramp_time: 0.0,
            min_limit: py.None(),
            watchdog_time: 0.0,
            last_update: f64::NAN,
            last_access: f64::NAN,
            last_write: f64::NEG_INFINITY,
            watches_limits: false,
            statuses: Vec::new(),
        }
    }

    #[doc = stub!(ArmCycle.read)]
    fn read<'py>(slf: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        let py = slf.py();
        let (drive, has_watchdog) = {
            let cycle = slf.borrow();
            (cycle.drive.bind(py).clone(), cycle.watchdog_time != 0.0)
        };
        if has_watchdog {
            slf.call_method0("_rearm_after_silence")?;
        }
        let found = drive.call_method0(intern!(py, "read"));
        let now = Self::now(slf)?;
        slf.borrow_mut().last_access = now;
        let found = match found {
            Err(error) if is_timeout(py, &error) => slf.call_method0("_readings_of_none")?,
            found => found?,
        };
        let readings = found.cast::<JointReadings>()?;
        slf.borrow_mut().readings = Some(readings.clone().unbind());
        if has_watchdog {
            slf.call_method1("_note_answers", (readings, now))?;
        }
        let (limiter, positions, goals, limits, dt) = {
            let mut cycle = slf.borrow_mut();
            let dt = if cycle.is_sent { now - cycle.last_update } else { 0.0 };
            cycle.last_update = now;
            (
                part(py, cycle.limiter.as_ref())?,
                part(py, cycle.positions.as_ref())?,
                cycle.goals.bind(py).clone(),
                cycle.limits.bind(py).clone(),
                dt,
            )
        };
        let (state, is_suspect) = limiter.try_borrow_mut()?.update(&positions, readings, &goals, &limits, dt, now)?;
        let state = Bound::new(py, state)?.into_any();
        if is_suspect || !slf.borrow().reported.bind(py).is_empty() {
            return slf.call_method1("_with_faults", (state,));
        }
        Ok(state)
    }

    #[doc = stub!(ArmCycle.write)]
    #[pyo3(signature = (goal, limit, extra, *, lead, velocity = None))]
    fn write<'py>(
        slf: &Bound<'py, Self>,
        goal: Bound<'py, PyAny>,
        limit: Bound<'py, PyAny>,
        extra: Option<&Bound<'py, PyAny>>,
        lead: bool,
        velocity: Option<Bound<'py, PyAny>>,
    ) -> PyResult<()> {
        let py = slf.py();
        let mut command = (goal, limit, velocity);
        if command.1.is_none() {
            command.1 = slf.getattr("limit")?;
        }
        let orders = match extra {
            None => slf.borrow().orders.bind(py).clone(),
            Some(extra) => slf.call_method1("_orders_with", (extra,))?.cast_into()?,
        };
        let now = Self::now(slf)?;
        let (limiter, positions, min_limit, ramp) = {
            let cycle = slf.borrow();
            (
                part(py, cycle.limiter.as_ref())?,
                part(py, cycle.positions.as_ref())?,
                cycle.min_limit.bind(py).clone(),
                (now - cycle.ramp_start) / cycle.ramp_time,
            )
        };
        let off_chain = Self::off_chain(&limiter, &orders)?;
        let limited = |(goal, limit, velocity): &(Bound<'py, PyAny>, Bound<'py, PyAny>, Option<Bound<'py, PyAny>>)| {
            let mut limiter = limiter.try_borrow_mut()?;
            limiter.limit(goal, limit, velocity.as_ref(), &positions, off_chain.clone(), ramp, &min_limit, lead)
        };
        let found = match limited(&command) {
            // Convert other array-likes with NumPy, or raise an error that names the joint.
            Err(error) if is_bad_value(py, &error) => {
                command = slf.call_method1("_check_command", command)?.extract()?;
                limited(&command)
            }
            found => found,
        };
        let (goals, limits, speeds, gravity) = found?;
        slf.borrow_mut().orders = orders.unbind();
        Self::transmit(slf, goals, limits, speeds)?;
        let watched = std::mem::replace(&mut slf.borrow_mut().watches_limits, gravity.is_some());
        if watched || gravity.is_some() {
            slf.call_method1("_watch_limits", (command.1, gravity))?;
        }
        Ok(())
    }

    #[doc = stub!(ArmCycle.transmit)]
    fn transmit<'py>(
        slf: &Bound<'py, Self>,
        goals: Bound<'py, PyAny>,
        limits: Bound<'py, PyAny>,
        speeds: Option<Bound<'py, PyAny>>,
    ) -> PyResult<()> {
        let py = slf.py();
        if slf.borrow().watchdog_time != 0.0 {
            slf.call_method0("_rearm_after_silence")?;
        }
        let drive = {
            let mut cycle = slf.borrow_mut();
            (cycle.goals, cycle.limits) = (goals.clone().unbind(), limits.clone().unbind());
            cycle.is_sent = true;
            cycle.drive.bind(py).clone()
        };
        drive.call_method1(intern!(py, "write"), (goals, limits, speeds))?;
        let now = Self::now(slf)?;
        {
            let mut cycle = slf.borrow_mut();
            (cycle.last_write, cycle.last_access) = (now, now);
        }
        let status = drive.call_method0(intern!(py, "poll_status"))?;
        if status.is_none() {
            return slf.call_method0("_report_silent").map(|_| ());
        }
        if slf.borrow().statuses.iter().flatten().any(|last| last.is(&status)) {
            return Ok(());
        }
        let joint: usize = slf.call_method1("_update_status", (&status,))?.extract()?;
        let statuses = &mut slf.borrow_mut().statuses;
        if statuses.len() <= joint {
            statuses.resize_with(joint + 1, || None);
        }
        statuses[joint] = Some(status.unbind());
        Ok(())
    }
}
