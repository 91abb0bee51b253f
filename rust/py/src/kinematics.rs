//! Poses, Jacobians and gravity torques of a model as NumPy arrays, for one configuration or many.

use pliant_core::{JointVec, MAX_AXES, MAX_JOINTS, Model as CoreModel, Pose, Reference, Rows as JointRows};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::batch::{Rows, shape_of, target, unfit};
use crate::error::{OrRaise, wrong_type};
use crate::ndarray::{lend, new_rows, write, write_rows};
use crate::pose::matrix;
use crate::read::joints;

/// Reads joint positions (n,) [rad or m] and checks that they are finite and within the bound of the core.
pub(crate) fn positions(core: &CoreModel, q: &Bound<'_, PyAny>) -> PyResult<JointVec> {
    let n = core.n();
    core.joint_vector(&joints("q", q, n)?[..n]).or_raise()
}

#[inline]
fn at(core: &CoreModel, q: &Bound<'_, PyAny>, reference: Reference, rows: &mut JointRows) -> PyResult<Pose> {
    let n = core.n();
    core.kinematics_into(&joints("q", q, n)?[..n], reference, rows).or_raise()
}

/// Returns a tuple of pose (4, 4) and Jacobian (6, n) at `q`, written to the arrays of `out` if it is given.
pub(crate) fn both<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    reference: Reference,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let (py, n) = (q.py(), core.n());
    let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
    let pose = at(core, q, reference, &mut rows)?;
    let Some(out) = out else {
        return Ok(PyTuple::new(py, [matrix(py, &pose), new_rows(py, n, &rows)])?.into_any());
    };
    let (first, second) = pair(out)?;
    if !write(&first, &[4, 4], pose.to_rows().as_flattened()) {
        return Err(unfit("out[0]", &first, &[4, 4]));
    }
    if !write_rows(&second, n, &rows) {
        return Err(unfit("out[1]", &second, &[6, n]));
    }
    Ok(out.clone())
}

/// Unpacks `out`, a tuple of two output arrays.
fn pair<'py>(out: &Bound<'py, PyAny>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    match out.cast::<PyTuple>() {
        Ok(pair) if pair.len() == 2 => Ok((pair.get_item(0)?, pair.get_item(1)?)),
        _ => Err(wrong_type("out", "a pair of arrays to write into", out)),
    }
}

/// Returns the Jacobian (6, n) at `q` as a new array, linear rows first.
pub(crate) fn jacobian<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    reference: Reference,
) -> PyResult<Bound<'py, PyAny>> {
    let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
    at(core, q, reference, &mut rows)?;
    Ok(new_rows(q.py(), core.n(), &rows))
}

/// Returns poses (N, 4, 4) and Jacobians (N, 6, n) of configurations `q` (N, n), written to the arrays of `out` if
/// given.
pub(crate) fn both_batch<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    reference: Reference,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let (py, n) = (q.py(), core.n());
    let own = out.map(pair).transpose()?;
    let outs: Vec<_> = own.iter().flat_map(|(first, second)| [first, second]).collect();
    let part = [n];
    let batch = Rows::read("Q", q, &part, &outs)?;
    let count = batch.count;
    let poses = target(py, "out[0]", own.as_ref().map(|own| &own.0), count, &[4, 4])?;
    let jacobians = target(py, "out[1]", own.as_ref().map(|own| &own.1), count, &[6, n])?;
    let targets = [("out[0]", &poses, &[count, 4, 4][..]), ("out[1]", &jacobians, &[count, 6, n])];
    lend(py, &[batch.lent()], targets, |[q], [to_poses, to_jacobians]| {
        core.kinematics_batch(q, reference, to_poses, to_jacobians)
    })?
    .or_raise()?;
    Ok((poses, jacobians))
}

/// Returns an array (N, `part`), `out` if given, which `fill` computes from configurations `q` (N, n) without the
/// interpreter lock.
fn one_batch<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    out: Option<&Bound<'py, PyAny>>,
    part: &[usize],
    fill: impl FnOnce(&[f64], &mut [f64]) -> pliant_core::Result<()> + Send,
) -> PyResult<Bound<'py, PyAny>> {
    let py = q.py();
    let width = [core.n()];
    let batch = Rows::read("Q", q, &width, &out.into_iter().collect::<Vec<_>>())?;
    let array = target(py, "out", out, batch.count, part)?;
    let shape = shape_of(batch.count, part);
    lend(py, &[batch.lent()], [("out", &array, &shape)], |[q], [to]| fill(q, to))?.or_raise()?;
    Ok(array)
}

/// Returns the poses (N, 4, 4) of configurations `q` (N, n), written to `out` if given.
pub(crate) fn poses<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    one_batch(core, q, out, &[4, 4], |q, to| core.kinematics_batch(q, Reference::WorldAligned, to, &mut []))
}

/// Returns the Jacobians (N, 6, n) of configurations `q` (N, n), written to `out` if given.
pub(crate) fn jacobians<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    reference: Reference,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    one_batch(core, q, out, &[6, core.n()], |q, to| core.kinematics_batch(q, reference, &mut [], to))
}

/// Returns the torques (N, n) that hold the arm at rest in configurations `q` (N, n), written to `out` if given.
pub(crate) fn gravities<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    one_batch(core, q, out, &[core.n()], |q, to| core.gravity_batch(q, to))
}
