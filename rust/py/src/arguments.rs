//! Readers of arguments that must be objects of this package. For another type they raise a `TypeError` that says how
//! to create the object.

use pyo3::PyClass;
use pyo3::prelude::*;

use crate::controller::Controller;
use crate::error::wrong_type;
use crate::model::Model;
use crate::servos::Servos;
use crate::settings::Settings;

fn object<T: PyClass>(name: &str, expected: &str, value: &Bound<'_, PyAny>) -> PyResult<Py<T>> {
    value.cast::<T>().map(|object| object.clone().unbind()).map_err(|_| wrong_type(name, expected, value))
}

pub(crate) fn model(value: &Bound<'_, PyAny>) -> PyResult<Py<Model>> {
    let expected = "a Model, as pliant.robots.arm7(), .so101(), .koch() or Model.from_urdf(path) make one";
    object("model", expected, value)
}

pub(crate) fn settings(value: &Bound<'_, PyAny>) -> PyResult<Py<Settings>> {
    object("settings", "Settings, e.g. Settings.soft('y')", value)
}

pub(crate) fn settings_or_none(value: &Bound<'_, PyAny>) -> PyResult<Option<Py<Settings>>> {
    if value.is_none() { Ok(None) } else { settings(value).map(Some) }
}

pub(crate) fn servos(value: &Bound<'_, PyAny>) -> PyResult<Py<Servos>> {
    object("servos", "Servos, e.g. Servos.of(['sts3215'] * model.n)", value)
}

pub(crate) fn servos_or_none(value: &Bound<'_, PyAny>) -> PyResult<Option<Py<Servos>>> {
    if value.is_none() { Ok(None) } else { servos(value).map(Some) }
}

pub(crate) fn controller(value: &Bound<'_, PyAny>) -> PyResult<Py<Controller>> {
    object("controller", "a Controller, e.g. Controller(model, settings)", value)
}

/// Reads a string; another type raises a `TypeError` with the text `expected`.
#[inline(never)]
pub(crate) fn text(name: &str, expected: &str, value: &Bound<'_, PyAny>) -> PyResult<String> {
    value.extract().map_err(|_| wrong_type(name, expected, value))
}
