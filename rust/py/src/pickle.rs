//! Pickling of `Model` and `Controller`: a pickle contains the name of a function of this module and its arguments.

use pliant_core::Snapshot;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::controller::Controller;
use crate::model::Model;
use crate::ndarray::new_array;
use crate::options::Payload;
use crate::read::vector;
use crate::servos::Servos;
use crate::settings::Settings;

/// A function and its arguments, as `__reduce__` returns them.
pub(crate) type Reduced<'py> = (Bound<'py, PyAny>, Bound<'py, PyTuple>);

/// Model, settings and servos of a controller; `None` for a controller without servos.
type Parts = (Py<Model>, Py<Settings>, Option<Py<Servos>>);

/// The fields of a [`Snapshot`] as Python values: payload, gravity, payload ramp, delay, captured offset, state.
type Numbers<'py> = (Option<Payload>, [f64; 3], Option<[f64; 5]>, f64, Option<[Vec<f64>; 2]>, Bound<'py, PyAny>);

/// Adds the functions that unpickling calls to the module, but not to `__all__`.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.setattr("_model", wrap_pyfunction!(model, module)?)?;
    module.setattr("_controller", wrap_pyfunction!(controller, module)?)
}

fn function<'py>(py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
    py.import("pliant._core")?.getattr(name)
}

pub(crate) fn of_model<'py>(py: Python<'py>, text: &str, options: Bound<'py, PyDict>) -> PyResult<Reduced<'py>> {
    Ok((function(py, "_model")?, (text, options).into_pyobject(py)?))
}

pub(crate) fn of_controller<'py>(py: Python<'py>, parts: Parts, snapshot: &Snapshot) -> PyResult<Reduced<'py>> {
    let state = new_array(py, &[snapshot.state.len()], &snapshot.state);
    let numbers: Numbers<'py> = (
        snapshot.payload.map(Payload),
        snapshot.gravity,
        snapshot.payload_ramp,
        snapshot.delay,
        snapshot.captured.clone(),
        state,
    );
    let (model, settings, servos) = parts;
    Ok((function(py, "_controller")?, (model, settings, servos, numbers).into_pyobject(py)?))
}

/// Creates a model from the arguments that [`of_model`] stored in a pickle.
#[pyfunction(name = "_model")]
fn model(py: Python<'_>, text: &str, options: &Bound<'_, PyDict>) -> PyResult<Model> {
    Model::from_text(py, text, Some(options))
}

/// Creates a controller from the arguments that [`of_controller`] stored in a pickle.
#[pyfunction(name = "_controller")]
fn controller(
    py: Python<'_>,
    model: Py<Model>,
    settings: Py<Settings>,
    servos: Option<Py<Servos>>,
    numbers: Numbers<'_>,
) -> PyResult<Controller> {
    let (payload, gravity, payload_ramp, delay, captured, state) = numbers;
    let state = vector("state", &state)?;
    let snapshot =
        Snapshot { payload: payload.map(|payload| payload.0), gravity, payload_ramp, delay, captured, state };
    Controller::create(py, model, settings, servos, Some(&snapshot))
}
