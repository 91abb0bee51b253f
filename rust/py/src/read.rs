//! Readers of arguments that are numbers, arrays or poses. C-ordered float64 arrays are copied directly; NumPy converts
//! other objects.

use numpy::{PyArrayDyn, PyArrayMethods, PyUntypedArrayMethods};
use pliant_core::{JointVec, MAX_JOINTS, Pose as CorePose};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyList, PyTuple};

use crate::error::{OrRaise, shape, shown, wrong_type};
use crate::ndarray;
use crate::pose::Pose;

/// Attributes and methods with which libraries expose a homogeneous matrix.
const ACCESSORS: [&str; 4] = ["homogeneous", "as_matrix", "matrix", "A"];

/// Expected shape of a pose, for the error about seven numbers.
const SEVEN: &str = "(4, 4): seven numbers do not say whether w comes first or last; \
                     use pliant.Pose.from_wxyz(position, quaternion) or pliant.Pose.from_xyzw(position, quaternion)";

/// Reads an array-like of real numbers; returns its shape and its values, row-major. Booleans, complex numbers, text
/// and masked arrays raise a `TypeError`.
pub(crate) fn numbers(name: &str, value: &Bound<'_, PyAny>) -> PyResult<(Vec<usize>, Vec<f64>)> {
    let py = value.py();
    let numpy = py.import("numpy")?;
    let expected = "an array of numbers (float64)";
    let refused = |cause: PyErr| {
        let error = PyTypeError::new_err(format!("{name} must be {expected}, got {}: {cause}", shown(value)));
        error.set_cause(py, Some(cause));
        error
    };
    if is_masked(value)? {
        let message = format!("{name} must be {expected}, got a masked array; fill it first: array.filled(value)");
        return Err(PyTypeError::new_err(message));
    }
    let array = numpy.call_method1("asarray", (value,)).map_err(refused)?;
    let kind: String = array.getattr("dtype")?.getattr("kind")?.extract()?;
    if !matches!(kind.as_str(), "f" | "i" | "u") {
        let dtype = array.getattr("dtype")?;
        return Err(if value.is_instance(&numpy.getattr("ndarray")?)? {
            PyTypeError::new_err(format!("{name} must be {expected}, got an array of dtype {dtype}"))
        } else {
            wrong_type(name, expected, value)
        });
    }
    let options = PyDict::new(py);
    options.set_item("dtype", "float64")?;
    options.set_item("order", "C")?;
    let array = numpy.call_method("array", (array,), Some(&options)).map_err(refused)?;
    let array = array.cast::<PyArrayDyn<f64>>()?;
    Ok((array.shape().to_vec(), array.readonly().as_slice()?.to_vec()))
}

/// Reads an array into `out`; an error if its shape is not `expected`.
#[inline]
pub(crate) fn array_into(name: &str, value: &Bound<'_, PyAny>, expected: &[usize], out: &mut [f64]) -> PyResult<()> {
    if ndarray::copy(value, expected, out) { Ok(()) } else { array_slowly(name, value, expected, out) }
}

#[cold]
fn array_slowly(name: &str, value: &Bound<'_, PyAny>, expected: &[usize], out: &mut [f64]) -> PyResult<()> {
    let (got, values) = numbers(name, value)?;
    if got != expected {
        return Err(shape(name, &got, crate::error::tuple(expected)));
    }
    for (slot, value) in out.iter_mut().zip(values) {
        *slot = value;
    }
    Ok(())
}

/// Reads a vector (n,) with one number per joint; entries of the result beyond `n` are 0.
#[inline]
pub(crate) fn joints(name: &str, value: &Bound<'_, PyAny>, n: usize) -> PyResult<JointVec> {
    let mut out = [0.0; MAX_JOINTS];
    array_into(name, value, &[n], &mut out)?;
    Ok(out)
}

/// Readers that are not inlined, for functions whose latency matters less: each inlined copy is half a kilobyte of
/// code.
pub(crate) mod compact {
    use super::{Bound, CorePose, JointVec, PyAny, PyResult};

    /// See [`super::array_into`].
    #[inline(never)]
    pub(crate) fn array_into(
        name: &str,
        value: &Bound<'_, PyAny>,
        expected: &[usize],
        out: &mut [f64],
    ) -> PyResult<()> {
        super::array_into(name, value, expected, out)
    }

    /// See [`super::joints`].
    #[inline(never)]
    pub(crate) fn joints(name: &str, value: &Bound<'_, PyAny>, n: usize) -> PyResult<JointVec> {
        super::joints(name, value, n)
    }

    /// See [`super::pose`].
    #[inline(never)]
    pub(crate) fn pose(name: &str, value: &Bound<'_, PyAny>, position_only: bool) -> PyResult<CorePose> {
        super::pose(name, value, position_only)
    }
}

/// Reads a vector (3,).
pub(crate) fn vector3(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
    let mut out = [0.0; 3];
    array_into(name, value, &[3], &mut out)?;
    Ok(out)
}

/// Reads a matrix (3, 3); returns its rows.
pub(crate) fn matrix3(name: &str, value: &Bound<'_, PyAny>) -> PyResult<[[f64; 3]; 3]> {
    let mut m = [0.0; 9];
    array_into(name, value, &[3, 3], &mut m)?;
    Ok([[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]])
}

/// Reads a matrix of any size; returns the number of rows, the number of columns, and the values, row-major.
pub(crate) fn matrix(name: &str, value: &Bound<'_, PyAny>) -> PyResult<(usize, usize, Vec<f64>)> {
    let (got, values) = numbers(name, value)?;
    match got[..] {
        [rows, columns] => Ok((rows, columns, values)),
        _ => Err(shape(name, &got, "a matrix (rows, columns)")),
    }
}

/// Reads a vector of any length.
pub(crate) fn vector(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    let (got, values) = numbers(name, value)?;
    match got[..] {
        [_] => Ok(values),
        _ => Err(shape(name, &got, "a vector (n,)")),
    }
}

/// Reads a pose: 4×4 array, `Pose`, any object with a 4×4 accessor, or, if `position_only`, a position (3,).
///
/// The core checks that the rotation is valid. Inlined, because a copy of the result would stall on the stores just
/// made.
#[inline(always)]
pub(crate) fn pose(name: &str, value: &Bound<'_, PyAny>, position_only: bool) -> PyResult<CorePose> {
    match ndarray::first_numbers(value, &[4, 4]) {
        Some(m) => from_vec(name, &m),
        None => pose_slowly(name, value, position_only),
    }
}

#[cold]
#[inline(never)]
fn pose_slowly(name: &str, value: &Bound<'_, PyAny>, position_only: bool) -> PyResult<CorePose> {
    match pose_of_object(name, value)? {
        Some(pose) => Ok(pose),
        None => from_array(name, value, position_only),
    }
}

/// Reads a `Pose`, or the pose of an object with a 4×4 accessor; `None` for other objects, which may be arrays.
pub(crate) fn pose_of_object(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Option<CorePose>> {
    if let Ok(pose) = value.cast::<Pose>() {
        return Ok(Some(pose.get().0));
    }
    let plain = value.is_instance_of::<PyList>()
        || value.is_instance_of::<PyTuple>()
        || value.is_instance(&value.py().import("numpy")?.getattr("ndarray")?)?;
    if !plain {
        for accessor in ACCESSORS {
            if let Some(found) = value.getattr_opt(accessor)? {
                let found = if found.is_callable() { found.call0()? } else { found };
                return from_array(&format!("{name}.{accessor}"), &found, false).map(Some);
            }
        }
    }
    Ok(None)
}

fn from_array(name: &str, value: &Bound<'_, PyAny>, position_only: bool) -> PyResult<CorePose> {
    let (got, values) = numbers(name, value)?;
    match (&got[..], &values[..]) {
        ([4, 4], m) => {
            let mut all = [0.0; 16];
            all.copy_from_slice(m);
            from_vec(name, &all)
        }
        ([3], &[x, y, z]) if position_only => Ok(CorePose { position: [x, y, z], ..CorePose::IDENTITY }),
        ([3], _) => Err(shape(name, &got, "(4, 4); a position alone says nothing of the task's rotations")),
        ([7], _) => Err(shape(name, &got, SEVEN)),
        _ => Err(shape(name, &got, if position_only { "(4, 4) or (3,)" } else { "(4, 4)" })),
    }
}

#[inline(always)]
fn from_vec(name: &str, m: &[f64; 16]) -> PyResult<CorePose> {
    let row = |i: usize| [m[4 * i], m[4 * i + 1], m[4 * i + 2], m[4 * i + 3]];
    if m[12..].iter().zip([0.0, 0.0, 0.0, 1.0]).any(|(value, wanted): (&f64, f64)| value.to_bits() != wanted.to_bits())
    {
        // The last row is not exactly 0 0 0 1, e.g. because of a negative zero. The core checks it with a tolerance.
        return CorePose::from_rows_of(name, &[row(0), row(1), row(2), row(3)]).or_raise();
    }
    let rotation = |i: usize| [m[4 * i], m[4 * i + 1], m[4 * i + 2]];
    Ok(CorePose { rotation: [rotation(0), rotation(1), rotation(2)], position: [m[3], m[7], m[11]] })
}

/// Reads a number; for another object, raises a `TypeError` with the text `expected`, which names the unit.
#[inline(never)]
pub(crate) fn real(name: &str, expected: &str, value: &Bound<'_, PyAny>) -> PyResult<f64> {
    number(value).ok_or_else(|| wrong_type(name, expected, value))
}

/// Reads an optional argument into `slot`, which keeps its value if the argument was not given.
pub(crate) fn set_if_some<'py, T>(
    slot: &mut T,
    value: Option<&Bound<'py, PyAny>>,
    read: impl FnOnce(&Bound<'py, PyAny>) -> PyResult<T>,
) -> PyResult<()> {
    if let Some(value) = value {
        *slot = read(value)?;
    }
    Ok(())
}

/// Reads an integer ≥ 0.
#[inline(never)]
pub(crate) fn count(name: &str, value: &Bound<'_, PyAny>) -> PyResult<usize> {
    value.extract().map_err(|_| wrong_type(name, "a whole number, 0 or more", value))
}

/// Reads a real number as a float; `None` for other objects, booleans (also NumPy's) and masked arrays.
pub(crate) fn number(value: &Bound<'_, PyAny>) -> Option<f64> {
    if let Ok(float) = value.cast::<PyFloat>() {
        return Some(float.value());
    }
    if value.is_instance_of::<PyBool>() || is_masked(value).ok()? {
        return None;
    }
    match value.getattr_opt("dtype").ok()? {
        Some(dtype) => {
            let kind: String = dtype.getattr("kind").and_then(|kind| kind.extract()).ok()?;
            if matches!(kind.as_str(), "f" | "i" | "u") { value.extract().ok() } else { None }
        }
        None => value.extract().ok(),
    }
}

/// Returns true for a masked array, or a list or tuple that contains one: NumPy would ignore the mask and return the
/// masked values.
fn is_masked(value: &Bound<'_, PyAny>) -> PyResult<bool> {
    let masked = value.py().import("numpy.ma")?.getattr("MaskedArray")?;
    if value.is_instance(&masked)? {
        return Ok(true);
    }
    if value.is_instance_of::<PyList>() || value.is_instance_of::<PyTuple>() {
        for item in value.try_iter()? {
            if item?.is_instance(&masked)? {
                return Ok(true);
            }
        }
    }
    Ok(false)
}
