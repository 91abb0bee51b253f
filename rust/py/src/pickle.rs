//! Pickling of models and controllers.

use pliant_core::Carried;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::controller::Controller;
use crate::convert::new_array;
use crate::model::Model;
use crate::options::Payload;
use crate::read::vector;
use crate::servos::Servos;
use crate::settings::Settings;

/// A function and its arguments, as `__reduce__` returns them.
pub(crate) type Reduced<'py> = (Bound<'py, PyAny>, Bound<'py, PyTuple>);

/// Model, settings and servos of a controller.
type Parts = (Py<Model>, Py<Settings>, Option<Py<Servos>>);

/// The numbers of a [`Carried`]: payload, gravity, payload change, delay, captured stiffness, state.
type Numbers<'py> = (Option<Payload>, [f64; 3], Option<[f64; 5]>, f64, Option<Vec<f64>>, Bound<'py, PyAny>);

/// Adds the functions that pickles call to the module, but not to its public names.
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

pub(crate) fn of_controller<'py>(py: Python<'py>, parts: Parts, carried: &Carried) -> PyResult<Reduced<'py>> {
    let memory = new_array(py, &[carried.memory.len()], &carried.memory);
    let numbers: Numbers<'py> = (
        carried.payload.map(Payload),
        carried.gravity,
        carried.fading,
        carried.delay,
        carried.captured.clone(),
        memory,
    );
    let (model, settings, servos) = parts;
    Ok((function(py, "_controller")?, (model, settings, servos, numbers).into_pyobject(py)?))
}

/// Restores a model from the result of [`of_model`].
#[pyfunction(name = "_model")]
fn model(py: Python<'_>, text: &str, options: &Bound<'_, PyDict>) -> PyResult<Model> {
    Model::from_text(py, text, Some(options))
}

/// Restores a controller from the result of [`of_controller`].
#[pyfunction(name = "_controller")]
fn controller(
    py: Python<'_>,
    model: Py<Model>,
    settings: Py<Settings>,
    servos: Option<Py<Servos>>,
    numbers: Numbers<'_>,
) -> PyResult<Controller> {
    let (payload, gravity, fading, delay, captured, memory) = numbers;
    let memory = vector("memory", &memory)?;
    let carried = Carried { payload: payload.map(|payload| payload.0), gravity, fading, delay, captured, memory };
    Controller::made(py, model, settings, servos, Some(&carried))
}
