//! The equations of the paper as Python functions of NumPy arrays.
#![expect(non_snake_case, reason = "arguments carry the letters of the equations, as documented")]

use nalgebra::DMatrix;
use pliant_core as core;
use pliant_core::params::{Projector, parse_axes};
use pyo3::prelude::*;

use crate::error::{OrRaise, config, shape, shown, wrong_type};
use crate::kinds::Kind;
use crate::ndarray::new_array;
use crate::pose::matrix as pose_matrix;
use crate::read::compact::pose;
use crate::read::{matrix, number, real, vector};
use crate::words::Word;

#[doc = stub!(damped_pseudo_inverse)]
#[pyfunction]
pub(crate) fn damped_pseudo_inverse<'py>(
    J: &Bound<'py, PyAny>,
    damping: &Bound<'_, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let inverse = core::damped_pseudo_inverse(&read(J, "J")?, real("damping", "a number", damping)?).or_raise()?;
    Ok(table(J.py(), &inverse))
}

#[doc = stub!(null_space_projector)]
#[pyfunction]
#[pyo3(signature = (J, damping = None, kind = None), text_signature = "(J, damping=0.0, kind='exact')")]
pub(crate) fn null_space_projector<'py>(
    J: &Bound<'py, PyAny>,
    damping: Option<&Bound<'_, PyAny>>,
    kind: Option<&Bound<'_, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let kind = kind.map_or(Ok(Projector::Exact), |word| Word::<Projector>::read("kind", word))?;
    let damping = damping.map_or(Ok(0.0), |damping| real("damping", "a number", damping))?;
    let projector = core::null_space_projector(&read(J, "J")?, damping, kind).or_raise()?;
    Ok(table(J.py(), &projector))
}

#[doc = stub!(responsibility)]
#[pyfunction]
pub(crate) fn responsibility<'py>(
    J_pinv: &Bound<'py, PyAny>,
    dx: &Bound<'_, PyAny>,
    N: &Bound<'_, PyAny>,
    gradient: &Bound<'_, PyAny>,
    alpha: &Bound<'_, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let (inverse, projector) = (read(J_pinv, "J_pinv")?, read(N, "N")?);
    let (dx, gradient) = (vector("dx", dx)?, vector("gradient", gradient)?);
    let shares = core::responsibility(&inverse, &dx, &projector, &gradient, real("alpha", "a number [1/s]", alpha)?)
        .or_raise()?;
    Ok(table(J_pinv.py(), &shares))
}

#[doc = stub!(activation)]
#[pyfunction]
#[pyo3(signature = (J_pinv, N, gradient = None))]
pub(crate) fn activation<'py>(
    J_pinv: &Bound<'py, PyAny>,
    N: &Bound<'_, PyAny>,
    gradient: Option<&Bound<'_, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (inverse, projector) = (read(J_pinv, "J_pinv")?, read(N, "N")?);
    let gradient = gradient.map(|gradient| vector("gradient", gradient)).transpose()?;
    let shares = core::activation(&inverse, &projector, gradient.as_deref()).or_raise()?;
    Ok(table(J_pinv.py(), &shares))
}

#[doc = stub!(compliance)]
#[pyfunction]
pub(crate) fn compliance<'py>(
    deviation: &Bound<'py, PyAny>,
    soft_until: &Bound<'_, PyAny>,
    firm_from: &Bound<'_, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let of = list("deviation", deviation)?;
    let k = of.len();
    let c = core::compliance(
        &of,
        &number_or_vector("soft_until", soft_until, k)?,
        &number_or_vector("firm_from", firm_from, k)?,
    )
    .or_raise()?;
    like(deviation, &c)
}

#[doc = stub!(holding_torque)]
#[pyfunction]
pub(crate) fn holding_torque<'py>(
    c: &Bound<'py, PyAny>,
    soft: &Bound<'_, PyAny>,
    firm: &Bound<'_, PyAny>,
    hold: &Bound<'_, PyAny>,
    compliant: &Bound<'_, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let of = list("c", c)?;
    let k = of.len();
    let (soft, firm, hold) =
        (number_or_vector("soft", soft, k)?, number_or_vector("firm", firm, k)?, number_or_vector("hold", hold, k)?);
    let torque = core::holding_torque(&of, &soft, &firm, &hold, &flags(compliant, k)?).or_raise()?;
    like(c, &torque)
}

#[doc = stub!(joint_torque_limits)]
#[pyfunction]
pub(crate) fn joint_torque_limits<'py>(
    A: &Bound<'py, PyAny>,
    strength: &Bound<'_, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let limits = core::joint_torque_limits(&read(A, "A")?, &vector("strength", strength)?).or_raise()?;
    Ok(new_array(A.py(), &[limits.len()], limits.as_slice()))
}

#[doc = stub!(adapt_target)]
#[pyfunction]
pub(crate) fn adapt_target<'py>(
    actual: &Bound<'py, PyAny>,
    target: &Bound<'_, PyAny>,
    eta: &Bound<'_, PyAny>,
    compliant: &Bound<'_, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let (from, to) = (pose("actual", actual, false)?, pose("target", target, false)?);
    let axes = match compliant.extract::<String>() {
        Ok(key) => parse_axes("compliant", &key).or_raise()?,
        Err(_) => <[bool; 6]>::try_from(flags(compliant, 6)?).unwrap_or_default(),
    };
    let adapted = core::adapt_target(&from, &to, real("eta", "a number, 0 to 1", eta)?, axes).or_raise()?;
    Ok(pose_matrix(actual.py(), &adapted))
}

#[doc = stub!(pose_error)]
#[pyfunction]
pub(crate) fn pose_error<'py>(actual: &Bound<'py, PyAny>, target: &Bound<'_, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let (from, to) = (pose("actual", actual, false)?, pose("target", target, false)?);
    Ok(new_array(actual.py(), &[6], &core::pose_error(&from, &to).or_raise()?))
}

fn read(value: &Bound<'_, PyAny>, name: &str) -> PyResult<DMatrix<f64>> {
    let (rows, columns, values) = matrix(name, value)?;
    Ok(DMatrix::from_row_slice(rows, columns, &values))
}

/// Converts a matrix to a NumPy array (rows, columns).
pub(crate) fn table<'py>(py: Python<'py>, m: &DMatrix<f64>) -> Bound<'py, PyAny> {
    new_array(py, &[m.nrows(), m.ncols()], m.transpose().as_slice())
}

/// Reads a vector; a number is read as a vector of length 1.
fn list(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
    number(value).map_or_else(|| vector(name, value), |one| Ok(vec![one]))
}

/// Reads a vector of any length, or repeats a number `k` times; the core checks the length.
fn number_or_vector(name: &str, value: &Bound<'_, PyAny>, k: usize) -> PyResult<Vec<f64>> {
    match number(value) {
        Some(one) => Ok(vec![one; k]),
        None => vector(name, value),
    }
}

/// Reads `k` booleans, or one boolean for all `k` entries.
fn flags(value: &Bound<'_, PyAny>, k: usize) -> PyResult<Vec<bool>> {
    if value.is_instance_of::<pyo3::types::PyString>() {
        return Err(config("compliant", format!("must be True, False or one of them per axis, got {}", shown(value))));
    }
    if let Ok(one) = value.extract::<bool>() {
        return Ok(vec![one; k]);
    }
    let all: Vec<bool> = value.extract().map_err(|_| wrong_type("compliant", "booleans, one per axis", value))?;
    if all.len() == k { Ok(all) } else { Err(shape("compliant", &[all.len()], format!("({k},)"))) }
}

/// Returns the result as a float if the argument `given` is a number, else as an array.
fn like<'py>(given: &Bound<'py, PyAny>, values: &[f64]) -> PyResult<Bound<'py, PyAny>> {
    let py = given.py();
    match values {
        [one] if number(given).is_some() => Ok(one.into_pyobject(py)?.into_any()),
        all => Ok(new_array(py, &[all.len()], all)),
    }
}
