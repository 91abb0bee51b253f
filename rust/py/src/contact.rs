//! Python classes `ContactEstimator` and `WrenchEstimate`: estimation of the external wrench at the tool.

use numpy::PyArray1;
use pliant_core::params::{AXIS_NAMES, parse_axes};
use pliant_core::{
    ContactEstimator as CoreContact, ContactInput, ContactOptions, JointVec, MAX_AXES, WrenchEstimate as CoreEstimate,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::batch::{Rows, target};
use crate::controller::Controller;
use crate::error::{OrRaise, config, shape, wrong_type};
use crate::extras::SECONDS;
use crate::kinds::{Flag, Kind};
use crate::ndarray::{copy, lend, new_array, rows};
use crate::read::compact::joints;
use crate::read::{number, numbers, real, set_if_some, vector};
use crate::{arguments, in_use};

#[doc = stub!(WrenchEstimate)]
#[pyclass(module = "pliant.types", frozen, eq)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct WrenchEstimate(CoreEstimate);

/// Defines getters for the array fields of the core's estimate: one number per axis, per joint, or one flag per axis.
macro_rules! attributes {
    (axes: $($axis:ident),*; joints: $($joint:ident),*; flags: $($flag:ident),*;) => {
        #[pymethods]
        impl WrenchEstimate {
            $(#[doc = stub!(WrenchEstimate.$axis)]
            #[getter]
            fn $axis<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
                new_array(py, &[self.0.$axis.len()], &self.0.$axis)
            })*

            $(#[doc = stub!(WrenchEstimate.$joint)]
            #[getter]
            fn $joint<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
                new_array(py, &[self.0.n], &self.0.$joint)
            })*

            $(#[doc = stub!(WrenchEstimate.$flag)]
            #[getter]
            fn $flag<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
                PyArray1::from_slice(py, &self.0.$flag).into_any()
            })*
        }
    };
}

attributes! {
    axes: force, uncertainty, force_base, uncertainty_base;
    joints: torque_residual, torque_uncertainty, torque, velocity;
    flags: touch, stop;
}

#[pymethods]
impl WrenchEstimate {
    #[doc = stub!(WrenchEstimate.residual_ratio)]
    #[getter]
    fn residual_ratio(&self) -> f64 {
        self.0.residual_ratio
    }

    #[doc = stub!(WrenchEstimate.saturated)]
    #[getter]
    fn saturated<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        PyArray1::from_slice(py, &self.0.saturated[..self.0.n]).into_any()
    }

    fn __str__(&self) -> String {
        let felt = AXIS_NAMES.iter().enumerate().filter(|(axis, _)| self.0.uncertainty[*axis].is_finite());
        let texts: Vec<String> = felt
            .map(|(axis, name)| {
                let unit = if axis < 3 { "N" } else { "N·m" };
                format!("{name} {:+.1} ± {:.1} {unit}", self.0.force[axis], self.0.uncertainty[axis])
            })
            .collect();
        if texts.is_empty() { "nothing known yet".into() } else { texts.join(", ") }
    }

    fn __repr__(&self) -> String {
        format!("<WrenchEstimate: {}>", self.__str__())
    }
}

#[doc = stub!(ContactEstimator)]
#[pyclass(module = "pliant")]
pub(crate) struct ContactEstimator {
    core: CoreContact,
    controller: Py<Controller>,
    n: usize,
}

/// Returns the values of the `n` joints, without the padding.
fn of_joints(values: Option<&JointVec>, n: usize) -> Option<&[f64]> {
    values.map(|values| &values[..n])
}

/// Expected value of a share, for error messages.
const SHARE: &str = "a number; a share of 2 % is 0.02";

/// Reads the argument `axes`, an axis key, as one flag per axis.
fn axis_flags(axes: &Bound<'_, PyAny>) -> PyResult<[bool; MAX_AXES]> {
    parse_axes("axes", &arguments::text("axes", "an axis key such as 'xyz rpy'", axes)?).or_raise()
}

/// Reads the argument `sent`: goals [rad] and torque limits [N·m] of the `n` joints.
fn pair<T>(
    sent: &Bound<'_, PyAny>,
    n: usize,
    read: impl Fn(&str, &Bound<'_, PyAny>, usize) -> PyResult<T>,
) -> PyResult<[T; 2]> {
    let (goal, limit): (Bound<'_, PyAny>, Bound<'_, PyAny>) =
        sent.extract().map_err(|_| wrong_type("sent", "a pair (goal, torque_limit)", sent))?;
    Ok([read("goal", &goal, n)?, read("torque_limit", &limit, n)?])
}

/// Reads numbers of the `n` joints at several readings, an array (T, n).
fn series(name: &str, values: &Bound<'_, PyAny>, n: usize) -> PyResult<Vec<f64>> {
    if let Some(count) = rows(values, &[n]) {
        let mut out = vec![0.0; count * n];
        if copy(values, &[count, n], &mut out) {
            return Ok(out);
        }
    }
    match numbers(name, values)? {
        (got, values) if matches!(got[..], [_, width] if width == n) => Ok(values),
        (got, _) => Err(shape(name, &got, format!("(T, {n})"))),
    }
}

/// Reads thresholds [N, N·m] by axis key, e.g. `{"xyz": 8.0, "yaw": 1.0}`; `None` for axes that are not named.
fn thresholds(name: &str, value: Option<&Bound<'_, PyAny>>) -> PyResult<[Option<f64>; 6]> {
    let mut out = [None; 6];
    let Some(value) = value else { return Ok(out) };
    let expected = "a mapping from axes to thresholds [N, N·m], e.g. {\"xyz\": 8.0}";
    let mapping = value.cast::<PyDict>().map_err(|_| wrong_type(name, expected, value))?;
    for (key, threshold) in mapping {
        let text: String = key.extract().map_err(|_| wrong_type(name, expected, value))?;
        let threshold = number(&threshold).ok_or_else(|| wrong_type(name, expected, value))?;
        for (axis, on) in parse_axes(name, &text).or_raise()?.into_iter().enumerate() {
            if on && out[axis].replace(threshold).is_some() {
                return Err(config(name, format!("{} is named twice", AXIS_NAMES[axis])));
            }
        }
    }
    Ok(out)
}

#[pymethods]
impl ContactEstimator {
    #[new]
    #[pyo3(signature = (
        controller, *, axes = None, filter = None, friction_error = None, kp_error = None, gravity_error = None,
        payload_error = None, inertia_error = None, load_error = None, torque_constant = None, max_wrench = None,
        touch = None, stop = None, hysteresis = None, min_time = None, guard = None,
        accept_thresholds = None
    ))]
    #[pyo3(text_signature = "(controller, *, axes=None, filter=0.04, friction_error=0.3, kp_error=None, \
        gravity_error=0.05, payload_error=0.0, inertia_error=0.3, load_error=0.2, torque_constant=None, \
        max_wrench=(100.0, 20.0), touch=None, stop=None, hysteresis=0.3, min_time=0.02, guard=1.0, \
        accept_thresholds=False)")]
    #[expect(clippy::too_many_arguments, reason = "keyword-only and named")]
    fn new(
        py: Python<'_>,
        #[pyo3(from_py_with = arguments::controller)] controller: Py<Controller>,
        axes: Option<&Bound<'_, PyAny>>,
        filter: Option<&Bound<'_, PyAny>>,
        friction_error: Option<&Bound<'_, PyAny>>,
        kp_error: Option<&Bound<'_, PyAny>>,
        gravity_error: Option<&Bound<'_, PyAny>>,
        payload_error: Option<&Bound<'_, PyAny>>,
        inertia_error: Option<&Bound<'_, PyAny>>,
        load_error: Option<&Bound<'_, PyAny>>,
        torque_constant: Option<&Bound<'_, PyAny>>,
        max_wrench: Option<&Bound<'_, PyAny>>,
        touch: Option<&Bound<'_, PyAny>>,
        stop: Option<&Bound<'_, PyAny>>,
        hysteresis: Option<&Bound<'_, PyAny>>,
        min_time: Option<&Bound<'_, PyAny>>,
        guard: Option<&Bound<'_, PyAny>>,
        accept_thresholds: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let mut options = ContactOptions {
            axes: axes.map(axis_flags).transpose()?,
            kp_error: kp_error.map(|share| real("kp_error", SHARE, share)).transpose()?,
            torque_constant: torque_constant.map(|values| vector("torque_constant", values)).transpose()?,
            touch: thresholds("touch", touch)?,
            stop: thresholds("stop", stop)?,
            accept_thresholds: accept_thresholds.map_or(Ok(false), |flag| Flag::read("accept_thresholds", flag))?,
            ..ContactOptions::default()
        };
        set_if_some(&mut options.max_wrench, max_wrench, |pair| {
            pair.extract().map_err(|_| wrong_type("max_wrench", "a pair (force [N], torque [N·m])", pair))
        })?;
        for (slot, name, expected, value) in [
            (&mut options.filter, "filter", SECONDS, filter),
            (&mut options.friction_error, "friction_error", SHARE, friction_error),
            (&mut options.gravity_error, "gravity_error", SHARE, gravity_error),
            (&mut options.payload_error, "payload_error", "a number [kg]", payload_error),
            (&mut options.inertia_error, "inertia_error", SHARE, inertia_error),
            (&mut options.load_error, "load_error", SHARE, load_error),
            (&mut options.hysteresis, "hysteresis", SHARE, hysteresis),
            (&mut options.min_time, "min_time", SECONDS, min_time),
            (&mut options.guard, "guard", SHARE, guard),
        ] {
            set_if_some(slot, value, |value| real(name, expected, value))?;
        }
        let (core, n) = {
            let borrowed = in_use::shared(controller.bind(py))?;
            (CoreContact::new(&borrowed.core, options).or_raise()?, borrowed.core.model().n())
        };
        Ok(Self { core, controller, n })
    }

    #[doc = stub!(ContactEstimator.update)]
    #[pyo3(signature = (q, *, dt = None, dq = None, load = None, current = None, sent = None))]
    #[expect(clippy::too_many_arguments, reason = "keyword-only and named")]
    fn update(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        q: &Bound<'_, PyAny>,
        dt: Option<&Bound<'_, PyAny>>,
        dq: Option<&Bound<'_, PyAny>>,
        load: Option<&Bound<'_, PyAny>>,
        current: Option<&Bound<'_, PyAny>>,
        sent: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<WrenchEstimate> {
        let n = in_use::shared(slf)?.n;
        let read = |name: &str, value: Option<&Bound<'_, PyAny>>| value.map(|value| joints(name, value, n)).transpose();
        let q = joints("q", q, n)?;
        let (dq, load, current) = (read("dq", dq)?, read("load", load)?, read("current", current)?);
        let sent = sent.map(|sent| pair(sent, n, joints)).transpose()?;
        let dt = dt.map(|dt| real("dt", SECONDS, dt)).transpose()?;
        let input = ContactInput {
            dt,
            dq: of_joints(dq.as_ref(), n),
            load: of_joints(load.as_ref(), n),
            current: of_joints(current.as_ref(), n),
            sent: sent.as_ref().map(|[goal, limit]| [&goal[..n], &limit[..n]]),
        };
        let mut own = in_use::exclusive(slf)?;
        let Self { core, controller, .. } = &mut *own;
        let controller = in_use::shared(controller.bind(py))?;
        core.update(&controller.core, &q[..n], &input).or_raise().map(|felt| WrenchEstimate(*felt))
    }

    #[doc = stub!(ContactEstimator.update_series)]
    #[pyo3(signature = (Q, *, dt = None, dq = None, load = None, current = None, sent = None))]
    #[expect(clippy::too_many_arguments, reason = "keyword-only and named")]
    #[expect(non_snake_case, reason = "`Q` holds many `q`, as documented")]
    fn update_series(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        Q: &Bound<'_, PyAny>,
        dt: Option<&Bound<'_, PyAny>>,
        dq: Option<&Bound<'_, PyAny>>,
        load: Option<&Bound<'_, PyAny>>,
        current: Option<&Bound<'_, PyAny>>,
        sent: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<WrenchEstimate> {
        let n = in_use::shared(slf)?.n;
        let read = |name: &str, value: Option<&Bound<'_, PyAny>>| value.map(|value| series(name, value, n)).transpose();
        let q = series("Q", Q, n)?;
        let (dq, load, current) = (read("dq", dq)?, read("load", load)?, read("current", current)?);
        let sent = sent.map(|sent| pair(sent, n, series)).transpose()?;
        let dt = dt.map(|dt| real("dt", SECONDS, dt)).transpose()?;
        let input = ContactInput {
            dt,
            dq: dq.as_deref(),
            load: load.as_deref(),
            current: current.as_deref(),
            sent: sent.as_ref().map(|[goal, limit]| [&goal[..], &limit[..]]),
        };
        let mut own = in_use::exclusive(slf)?;
        let Self { core, controller, .. } = &mut *own;
        let controller = in_use::shared(controller.bind(py))?;
        core.update_series(&controller.core, &q, &input).or_raise().map(|felt| WrenchEstimate(*felt))
    }

    #[doc = stub!(ContactEstimator.uncertainty_at)]
    fn uncertainty_at<'py>(slf: &Bound<'py, Self>, q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let (py, n) = (q.py(), in_use::shared(slf)?.n);
        let at = joints("q", q, n)?;
        let own = in_use::shared(slf)?;
        let bound = own.core.uncertainty_at(&in_use::shared(own.controller.bind(py))?.core, &at[..n]).or_raise()?;
        Ok(new_array(py, &[bound.len()], &bound))
    }

    #[doc = stub!(ContactEstimator.typical_uncertainty)]
    fn typical_uncertainty<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let bound = self.core.typical_uncertainty(&in_use::shared(self.controller.bind(py))?.core);
        Ok(new_array(py, &[bound.len()], &bound))
    }

    #[doc = stub!(ContactEstimator.reset)]
    fn reset(&mut self) {
        self.core.reset();
    }

    #[doc = stub!(ContactEstimator.tare)]
    fn tare(&mut self) -> PyResult<()> {
        self.core.tare().or_raise()
    }

    #[doc = stub!(ContactEstimator.clear_tare)]
    fn clear_tare(&mut self) {
        self.core.clear_tare();
    }

    #[doc = stub!(ContactEstimator.tared)]
    #[getter]
    fn tared(&self) -> bool {
        self.core.is_tared()
    }

    #[doc = stub!(ContactEstimator.estimate)]
    #[getter]
    fn estimate(&self) -> WrenchEstimate {
        WrenchEstimate(*self.core.estimate())
    }

    #[doc = stub!(ContactEstimator.guard)]
    #[getter]
    fn guard(&self) -> f64 {
        let options = self.core.options();
        if options.accept_thresholds { 0.0 } else { options.guard }
    }

    #[doc = stub!(ContactEstimator.latency)]
    #[getter]
    fn latency(&self, py: Python<'_>) -> PyResult<f64> {
        Ok(self.core.latency(&in_use::shared(self.controller.bind(py))?.core))
    }

    #[doc = stub!(ContactEstimator.axes)]
    #[getter]
    fn axes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.core.axes())
    }

    #[doc = stub!(ContactEstimator.controller)]
    #[getter]
    fn controller(&self, py: Python<'_>) -> Py<Controller> {
        self.controller.clone_ref(py)
    }

    fn __repr__(&self) -> String {
        format!("<Contact: axes {}; {}>", self.core.axes().join(" "), WrenchEstimate(*self.core.estimate()).__str__())
    }
}

#[doc = stub!(update_contacts)]
#[pyfunction]
#[pyo3(signature = (contacts, Q, *, dt, sent, out))]
#[expect(non_snake_case, reason = "`Q` holds many `q`, as documented")]
#[expect(clippy::needless_pass_by_value, reason = "PyO3 passes lists and tuples by value")]
pub(crate) fn update_contacts<'py>(
    contacts: Vec<Option<Bound<'py, ContactEstimator>>>,
    Q: &Bound<'py, PyAny>,
    dt: f64,
    sent: (Bound<'py, PyAny>, Bound<'py, PyAny>),
    out: (Bound<'py, PyAny>, Bound<'py, PyAny>, Bound<'py, PyAny>),
) -> PyResult<()> {
    let (py, count) = (Q.py(), contacts.len());
    let (_, ticks, n): (usize, usize, usize) = Q.getattr("shape")?.extract()?;
    let (part, outs) = ([ticks, n], [&out.0, &out.1, &out.2]);
    let inputs = [("Q", Q), ("goal", &sent.0), ("torque_limit", &sent.1)]
        .map(|(name, array)| Rows::read(name, array, &part, &outs).map(|rows| (name, rows)));
    let [q, goal, limit] = inputs;
    let inputs = [q?, goal?, limit?];
    for (name, rows) in &inputs {
        if rows.count != count {
            return Err(shape(name, &[rows.count, ticks, n], format!("({count}, {ticks}, {n})")));
        }
    }
    let shapes = [[count, n], [count, MAX_AXES], [count, MAX_AXES]];
    let names = ["out[0]", "out[1]", "out[2]"];
    for i in 0..3 {
        target(py, names[i], Some(outs[i]), count, &shapes[i][1..])?;
    }
    let own: PyResult<Vec<_>> =
        contacts.iter().map(|contact| contact.as_ref().map(in_use::exclusive).transpose()).collect();
    let mut own = own?;
    let mut estimators = Vec::with_capacity(count);
    for contact in &mut own {
        let Some(contact) = contact.as_deref_mut() else {
            estimators.push(None);
            continue;
        };
        if contact.n != n {
            return Err(shape("Q", &[count, ticks, n], format!("({count}, {ticks}, {})", contact.n)));
        }
        let ContactEstimator { core, controller, .. } = contact;
        estimators.push(Some((core, in_use::shared(controller.bind(py))?)));
    }
    let mut estimators: Vec<_> = estimators
        .iter_mut()
        .map(|pair| pair.as_mut().map(|(core, controller)| (&mut **core, &controller.core)))
        .collect();
    let lent = inputs.each_ref().map(|(_, rows)| rows.lent());
    let outs = [0, 1, 2].map(|i| (names[i], outs[i], &shapes[i][..]));
    let felt = lend(py, &lent, outs, |[q, goal, limit], [velocity, force, uncertainty]| {
        for (row, pair) in estimators.iter_mut().enumerate() {
            let Some((contact, controller)) = pair else { continue };
            let [q, goal, limit] = [q, goal, limit].map(|array| &array[row * ticks * n..][..ticks * n]);
            let input = ContactInput { dt: Some(dt), sent: Some([goal, limit]), ..ContactInput::default() };
            let felt = contact.update_series(controller, q, &input)?;
            velocity[row * n..][..n].copy_from_slice(&felt.velocity[..n]);
            force[row * MAX_AXES..][..MAX_AXES].copy_from_slice(&felt.force);
            uncertainty[row * MAX_AXES..][..MAX_AXES].copy_from_slice(&felt.uncertainty);
        }
        Ok(())
    })?;
    felt.or_raise()
}
