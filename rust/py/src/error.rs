//! Python exceptions for the errors of the core: one class per cause, with the details as attributes.

use pliant_core::Error;
use pyo3::exceptions::{PyException, PyLookupError, PyTimeoutError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyTuple, PyType};

/// Exception classes for the variants of the core's [`Error`].
struct Classes {
    urdf: Py<PyType>,
    frame: Py<PyType>,
    out_of_range: Py<PyType>,
    shape: Py<PyType>,
    config: Py<PyType>,
    servo_timeout: Py<PyType>,
}

static CLASSES: PyOnceLock<Classes> = PyOnceLock::new();

/// Creates the exception classes and adds them to the module.
pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    let class = |name: &str, doc: &str, bases: &[&Bound<'_, PyType>], facts: &[&str]| -> PyResult<Py<PyType>> {
        let namespace = PyDict::new(py);
        namespace.set_item("__doc__", doc)?;
        for fact in facts {
            namespace.set_item(fact, py.None())?;
        }
        namespace.set_item("__module__", "pliant")?;
        let made = py.get_type::<PyType>().call1((name, PyTuple::new(py, bases)?, namespace))?;
        let made = made.cast_into::<PyType>()?;
        module.add(name, &made)?;
        Ok(made.unbind())
    };
    let base = class("PliantError", stub!(PliantError), &[&py.get_type::<PyException>()], &[])?;
    let base = base.bind(py);
    let servo = class("ServoError", stub!(ServoError), &[base], &[])?;
    let timeout = &py.get_type::<PyTimeoutError>();
    let servo_timeout = class("ServoTimeoutError", stub!(ServoTimeoutError), &[servo.bind(py), timeout], &[])?;
    class("ServoFaultError", stub!(ServoFaultError), &[servo.bind(py)], &[])?;
    let value_error = &py.get_type::<PyValueError>();
    let classes = Classes {
        urdf: class("UrdfError", stub!(UrdfError), &[base, value_error], &["source", "line", "column"])?,
        frame: class(
            "FrameNotFoundError",
            stub!(FrameNotFoundError),
            &[base, &py.get_type::<PyLookupError>()],
            &["frame", "available"],
        )?,
        out_of_range: class(
            "OutOfRangeError",
            stub!(OutOfRangeError),
            &[base, value_error],
            &["what", "value", "bound"],
        )?,
        shape: class("ShapeError", stub!(ShapeError), &[base, value_error], &["what", "got", "expected"])?,
        config: class("ConfigError", stub!(ConfigError), &[base, value_error], &["key"])?,
        servo_timeout,
    };
    CLASSES.get_or_init(py, || classes);
    Ok(())
}

/// Returns true for a `ServoTimeoutError`.
pub(crate) fn is_timeout(py: Python<'_>, error: &PyErr) -> bool {
    CLASSES.get(py).is_some_and(|classes| error.matches(py, &classes.servo_timeout).unwrap_or_default())
}

/// Returns true for a `ShapeError`, an `OutOfRangeError` or a `TypeError`.
pub(crate) fn is_bad_value(py: Python<'_>, error: &PyErr) -> bool {
    let is_of = |class: &Py<PyType>| error.matches(py, class).unwrap_or_default();
    error.is_instance_of::<PyTypeError>(py)
        || CLASSES.get(py).is_some_and(|classes| is_of(&classes.shape) || is_of(&classes.out_of_range))
}

/// Returns the Python exception for an error of the core.
#[cold]
#[inline(never)]
fn raised(error: &Error) -> PyErr {
    Python::attach(|py| build(py, error).unwrap_or_else(|failure| failure))
}

fn build(py: Python<'_>, error: &Error) -> PyResult<PyErr> {
    let Some(classes) = CLASSES.get(py) else { return Ok(PyValueError::new_err(error.to_string())) };
    let make = |class: &Py<PyType>| class.bind(py).call1((error.to_string(),));
    let value = match error {
        Error::Urdf { source_name, at, .. } => {
            let value = make(&classes.urdf)?;
            value.setattr("source", source_name)?;
            value.setattr("line", at.0.map(|(line, _)| line))?;
            value.setattr("column", at.0.map(|(_, column)| column))?;
            value
        }
        Error::FrameNotFound { frame, available } => {
            let value = make(&classes.frame)?;
            value.setattr("frame", frame)?;
            value.setattr("available", PyTuple::new(py, available)?)?;
            value
        }
        Error::OutOfRange { what, value: number, bound } => {
            let value = make(&classes.out_of_range)?;
            value.setattr("what", what)?;
            value.setattr("value", number)?;
            value.setattr("bound", bound)?;
            value
        }
        Error::Shape { what, got, expected } => {
            let value = make(&classes.shape)?;
            value.setattr("what", what)?;
            value.setattr("got", got)?;
            value.setattr("expected", expected)?;
            value
        }
        Error::Config { key, .. } => {
            let value = make(&classes.config)?;
            value.setattr("key", key)?;
            value
        }
        // Variants without an exception class here raise a `ValueError`.
        other => return Ok(PyValueError::new_err(other.to_string())),
    };
    Ok(PyErr::from_value(value))
}

/// Converts a result of the core to a [`PyResult`].
pub(crate) trait OrRaise<T> {
    /// Returns the value, or the Python exception for the error.
    fn or_raise(self) -> PyResult<T>;
}

impl<T> OrRaise<T> for pliant_core::Result<T> {
    fn or_raise(self) -> PyResult<T> {
        self.map_err(|error| raised(&error))
    }
}

/// Creates a `ConfigError` about the setting `key`.
#[cold]
#[inline(never)]
pub(crate) fn config(key: &str, message: impl Into<String>) -> PyErr {
    raised(&Error::Config { key: key.into(), message: message.into() })
}

/// Creates a `ShapeError` about the argument `what`.
#[cold]
#[inline(never)]
pub(crate) fn shape(what: &str, got: &[usize], expected: impl Into<String>) -> PyErr {
    raised(&Error::Shape { what: what.into(), got: tuple(got), expected: expected.into() })
}

/// Creates a `TypeError` for an argument, with a description of the expected value and the given value.
#[cold]
#[inline(never)]
pub(crate) fn wrong_type(name: &str, expected: &str, value: &Bound<'_, PyAny>) -> PyErr {
    PyTypeError::new_err(format!("{name} must be {expected}, got {}", shown(value)))
}

/// Formats a value and its type for a message; the type alone if the value's repr has more than 60 characters.
#[cold]
#[inline(never)]
pub(crate) fn shown(value: &Bound<'_, PyAny>) -> String {
    let text = value.repr().map_or_else(|_| String::new(), |repr| repr.to_string());
    let kind = value.get_type().name().map_or_else(|_| String::new(), |name| name.to_string());
    if text.is_empty() || text.chars().count() > 60 { kind } else { format!("{text} ({kind})") }
}

/// Formats a shape as Python prints it, e.g. `(6,)`.
#[cold]
#[inline(never)]
pub(crate) fn tuple(shape: &[usize]) -> String {
    match shape {
        [one] => format!("({one},)"),
        many => format!("({})", many.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")),
    }
}

/// Returns `; did you mean 'x'?` with the name most similar to `word`, or the text `stop` if none is similar.
#[cold]
#[inline(never)]
pub(crate) fn suggestion(py: Python<'_>, word: &str, names: &[&str], stop: &str) -> String {
    let close = || -> PyResult<Option<String>> {
        let matches = py.import("difflib")?.call_method1("get_close_matches", (word, names.to_vec(), 1))?;
        matches.extract::<Vec<String>>().map(|found| found.into_iter().next())
    };
    close().ok().flatten().map_or_else(|| stop.to_owned(), |name| format!("; did you mean '{name}'?"))
}
