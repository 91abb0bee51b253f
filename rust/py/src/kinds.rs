//! Conversion of the fields of settings, axes, tasks and servos from and to Python.

use std::marker::PhantomData;

use pliant_core::params::{AXIS_NAMES, Damping, Frame, Gain, parse_axes};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyList, PyString, PyTuple};

use crate::error::{OrRaise, config, shape, shown};
use crate::ndarray::{freeze, new_array};
use crate::read::{matrix3, number, numbers};

/// Conversion of one type of field between the core and Python.
pub(crate) trait Kind {
    /// Type of the field in the core.
    type Core;

    /// Reads the user's value of the field `name`.
    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Self::Core>;

    /// Updates `core` with the user's value: replaces it, or in a group of settings only the given fields.
    fn update(core: &mut Self::Core, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
        *core = Self::read(name, value)?;
        Ok(())
    }

    /// Converts to a value with an exact repr, such as a list instead of an array, for repr and pickle.
    fn plain<'py>(core: &Self::Core, py: Python<'py>) -> PyResult<Bound<'py, PyAny>>;

    /// Converts to the value that the Python attribute returns.
    fn show<'py>(core: &Self::Core, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Self::plain(core, py)
    }
}

/// Calls [`Kind::update`]. Not inlined, so that it is compiled once per kind instead of once per field.
#[inline(never)]
pub(crate) fn update<K: Kind>(core: &mut K::Core, name: &str, value: &Bound<'_, PyAny>) -> PyResult<()> {
    K::update(core, name, value)
}

/// Calls [`Kind::plain`]. Not inlined, so that it is compiled once per kind instead of once per field.
#[inline(never)]
pub(crate) fn plain<'py, K: Kind>(core: &K::Core, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
    K::plain(core, py)
}

/// Calls [`Kind::show`]. Not inlined, so that it is compiled once per kind instead of once per field.
#[inline(never)]
pub(crate) fn show<'py, K: Kind>(core: &K::Core, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
    K::show(core, py)
}

/// Creates a `ConfigError` with the expected and the given value of the field `name`.
pub(crate) fn wrong(name: &str, expected: &str, value: &Bound<'_, PyAny>) -> PyErr {
    config(name, format!("must be {expected}, got {}", shown(value)))
}

/// A number; `None` is read as infinity (no limit).
pub(crate) struct Number;

impl Kind for Number {
    type Core = f64;

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<f64> {
        if value.is_none() {
            return Ok(f64::INFINITY);
        }
        number(value).ok_or_else(|| wrong(name, "a number", value))
    }

    fn plain<'py>(core: &f64, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Ok(core.into_pyobject(py)?.into_any())
    }
}

/// A boolean.
pub(crate) struct Flag;

impl Kind for Flag {
    type Core = bool;

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<bool> {
        value.extract().map_err(|_| wrong(name, "True or False", value))
    }

    fn plain<'py>(core: &bool, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Ok(PyBool::new(py, *core).to_owned().into_any())
    }
}

/// A value of kind `K`, or `None` for the default.
pub(crate) struct Optional<K>(PhantomData<K>);

impl<K: Kind> Kind for Optional<K> {
    type Core = Option<K::Core>;

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Self::Core> {
        if value.is_none() { Ok(None) } else { K::read(name, value).map(Some) }
    }

    fn plain<'py>(core: &Self::Core, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        core.as_ref().map_or_else(|| Ok(py.None().into_bound(py)), |value| K::plain(value, py))
    }

    fn show<'py>(core: &Self::Core, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        core.as_ref().map_or_else(|| Ok(py.None().into_bound(py)), |value| K::show(value, py))
    }
}

/// A vector with one number per joint; a single number is read as a vector of length 1.
pub(crate) struct Joints;

impl Kind for Joints {
    type Core = Vec<f64>;

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
        if let Some(one) = number(value) {
            return Ok(vec![one]);
        }
        match numbers(name, value)? {
            (got, values) if got.len() == 1 => Ok(values),
            (got, _) => Err(shape(name, &got, "(n,)")),
        }
    }

    fn plain<'py>(core: &Vec<f64>, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Ok(PyList::new(py, core)?.into_any())
    }

    fn show<'py>(core: &Vec<f64>, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let array = new_array(py, &[core.len()], core);
        freeze(&array)?;
        Ok(array)
    }
}

/// A number for both sides, or a pair: pushed toward −, pushed toward +.
pub(crate) struct Sides;

impl Kind for Sides {
    type Core = [f64; 2];

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; 2]> {
        match (number(value), pair(value)) {
            (Some(both), _) => Ok([both; 2]),
            (None, Some(sides)) => Ok(sides),
            _ => Err(wrong(name, "a number, or a pair (pushed toward -, pushed toward +)", value)),
        }
    }

    fn plain<'py>(core: &[f64; 2], py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let [minus, plus] = core;
        if minus.to_bits() == plus.to_bits() { Number::plain(minus, py) } else { Self::show(core, py) }
    }

    fn show<'py>(core: &[f64; 2], py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Ok(PyTuple::new(py, core)?.into_any())
    }
}

/// Limits of speed or acceleration: a pair (translations, rotations); a number for translations, from which the limit
/// of rotations is derived; or `None` for no limit.
pub(crate) struct Speeds;

/// Limit of rotations divided by that of translations [rad/m] if only the latter is given: the ratio of the defaults.
const RADIANS_PER_METRE: f64 = 4.0;

impl Kind for Speeds {
    type Core = [f64; 2];

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; 2]> {
        if value.is_none() {
            return Ok([f64::INFINITY; 2]);
        }
        match (number(value), pair(value)) {
            (Some(linear), _) => Ok([linear, RADIANS_PER_METRE * linear]),
            (None, Some(both)) => Ok(both),
            _ => Err(wrong(name, "None, a number, or a pair (translation, rotation)", value)),
        }
    }

    fn plain<'py>(core: &[f64; 2], py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Ok(PyTuple::new(py, core)?.into_any())
    }
}

fn pair(value: &Bound<'_, PyAny>) -> Option<[f64; 2]> {
    let [a, b]: [Bound<'_, PyAny>; 2] = value.extract().ok()?;
    let read = |x: &Bound<'_, PyAny>| if x.is_none() { Some(f64::INFINITY) } else { number(x) };
    Some([read(&a)?, read(&b)?])
}

/// A gain: a number, one number per axis or joint, or a matrix.
pub(crate) struct Gains;

impl Kind for Gains {
    type Core = Gain;

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Gain> {
        if let Some(k) = number(value) {
            return Ok(Gain::Scalar(k));
        }
        let (got, values) = numbers(name, value)?;
        match got[..] {
            [_] => Ok(Gain::Diagonal(values)),
            [_, columns] if columns > 0 => Ok(Gain::Matrix(values.chunks(columns).map(<[f64]>::to_vec).collect())),
            _ => Err(shape(name, &got, "a number, (n,) or (n, n)")),
        }
    }

    fn plain<'py>(core: &Gain, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        match core {
            Gain::Scalar(k) => Number::plain(k, py),
            Gain::Diagonal(diagonal) => Ok(PyList::new(py, diagonal)?.into_any()),
            Gain::Matrix(rows) => Ok(PyList::new(py, rows)?.into_any()),
        }
    }
}

/// A gain: a number, or one number per axis.
pub(crate) struct AxisGains;

impl Kind for AxisGains {
    type Core = Gain;

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Gain> {
        if let Some(k) = number(value) {
            return Ok(Gain::Scalar(k));
        }
        match numbers(name, value)? {
            (got, values) if got.len() == 1 => Ok(Gain::Diagonal(values)),
            (got, _) => Err(shape(name, &got, "a number or (n,)")),
        }
    }

    fn plain<'py>(core: &Gain, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Gains::plain(core, py)
    }
}

/// Damping of the inverse: `None` to derive it from the arm, a number λ, or three numbers λ₀, σ₀, λ_max.
pub(crate) struct Dampings;

impl Kind for Dampings {
    type Core = Damping;

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Damping> {
        if value.is_none() {
            return Ok(Damping::Auto);
        }
        if let Some(lambda) = number(value) {
            return Ok(Damping::Fixed(lambda));
        }
        match value.extract::<[f64; 3]>() {
            Ok([lambda_0, sigma_0, lambda_max]) => Ok(Damping::Adaptive { lambda_0, sigma_0, lambda_max }),
            Err(_) => Err(wrong(name, "None, a number, or (lambda_0, sigma_0, lambda_max)", value)),
        }
    }

    fn plain<'py>(core: &Damping, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        match core {
            Damping::Auto => Ok(py.None().into_bound(py)),
            Damping::Fixed(lambda) => Number::plain(lambda, py),
            Damping::Adaptive { lambda_0, sigma_0, lambda_max } => {
                Ok(PyTuple::new(py, [lambda_0, sigma_0, lambda_max])?.into_any())
            }
        }
    }
}

/// The axes of a task, as an axis key such as `"xyz rpy"`.
pub(crate) struct AxisKey;

impl Kind for AxisKey {
    type Core = [bool; 6];

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[bool; 6]> {
        let text: String = value.extract().map_err(|_| wrong(name, "an axis key such as 'xyz rpy'", value))?;
        parse_axes(&format!("task.{name}"), &text).or_raise()
    }

    fn plain<'py>(core: &[bool; 6], py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let chosen =
            |range: std::ops::Range<usize>| range.filter(|&i| core[i]).map(|i| AXIS_NAMES[i]).collect::<Vec<_>>();
        let (linear, angular) = (chosen(0..3).concat(), chosen(3..6));
        let angular = if angular.len() == 3 { "rpy".into() } else { angular.join(" ") };
        Ok(PyString::new(py, format!("{linear} {angular}").trim()).into_any())
    }
}

/// The frame of a task: `"base"`, `"tool"` or a rotation matrix `base_from_task`.
pub(crate) struct TaskFrame;

impl Kind for TaskFrame {
    type Core = Frame;

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Frame> {
        match value.extract::<String>().as_deref() {
            Ok("base") => Ok(Frame::Base),
            Ok("tool") => Ok(Frame::Tool),
            Ok(_) => Err(wrong(name, "'base', 'tool' or a 3x3 rotation matrix (columns: the task's axes)", value)),
            Err(_) => Ok(Frame::Rotation(matrix3(&format!("task.{name}"), value)?)),
        }
    }

    fn plain<'py>(core: &Frame, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        match core {
            Frame::Base => Ok(PyString::new(py, "base").into_any()),
            Frame::Tool => Ok(PyString::new(py, "tool").into_any()),
            Frame::Rotation(rows) => Ok(PyList::new(py, rows)?.into_any()),
        }
    }

    fn show<'py>(core: &Frame, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let Frame::Rotation(rows) = core else { return Self::plain(core, py) };
        let array = new_array(py, &[3, 3], rows.as_flattened());
        freeze(&array)?;
        Ok(array)
    }
}
