//! Pose, Jacobian and gravity of a model, one configuration or many.

use std::borrow::Cow;

use pliant_core::{JointVec, MAX_AXES, MAX_JOINTS, Model as CoreModel, Pose, Reference, Rows};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::convert::{memory, view, view_mut, write, write_rows, zeros};
use crate::error::{OrRaise, shape, tuple, wrong_type};
use crate::pose::matrix;
use crate::read::{joints, numbers};

/// Joint positions, checked.
pub(crate) fn positions(core: &CoreModel, q: &Bound<'_, PyAny>) -> PyResult<JointVec> {
    let n = core.n();
    core.joint_vector(&joints("q", q, n)?[..n]).or_raise()
}

#[inline]
fn at(core: &CoreModel, q: &Bound<'_, PyAny>, reference: Reference, rows: &mut Rows) -> PyResult<Pose> {
    let n = core.n();
    core.kinematics_into(&joints("q", q, n)?[..n], reference, rows).or_raise()
}

/// Pose (4, 4) and Jacobian (6, n), new ones or into the caller's.
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
        let jacobian = zeros(py, &[6, n]);
        write_rows(&jacobian, n, &rows);
        return Ok(PyTuple::new(py, [matrix(py, &pose), jacobian])?.into_any());
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

/// Two arrays to write into.
fn pair<'py>(out: &Bound<'py, PyAny>) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    match out.cast::<PyTuple>() {
        Ok(pair) if pair.len() == 2 => Ok((pair.get_item(0)?, pair.get_item(1)?)),
        _ => Err(wrong_type("out", "a pair of arrays to write into", out)),
    }
}

/// Why an array cannot be written into.
#[cold]
fn unfit(name: &str, array: &Bound<'_, PyAny>, expected: &[usize]) -> PyErr {
    let got: Option<Vec<usize>> = array.getattr("shape").and_then(|shape| shape.extract()).ok();
    match got {
        Some(got) if got != expected => shape(name, &got, tuple(expected)),
        _ => wrong_type(name, "a writable float64 array in C order", array),
    }
}

/// Jacobian (6, n).
pub(crate) fn jacobian<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    reference: Reference,
) -> PyResult<Bound<'py, PyAny>> {
    let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
    at(core, q, reference, &mut rows)?;
    let jacobian = zeros(q.py(), &[6, core.n()]);
    write_rows(&jacobian, core.n(), &rows);
    Ok(jacobian)
}

/// Configurations (N, n) of a batch: the caller's memory if it is a plain array, a copy of anything else.
struct Batch<'a> {
    count: usize,
    values: Cow<'a, [f64]>,
}

impl<'a> Batch<'a> {
    fn read(core: &CoreModel, q: &'a Bound<'_, PyAny>, outs: &[&Bound<'_, PyAny>]) -> PyResult<Self> {
        let n = core.n();
        let own = memory(q);
        let shared = |out: &&Bound<'_, PyAny>| match (&own, memory(out)) {
            (Some(q), Some(out)) => q.start < out.end && out.start < q.end,
            _ => false,
        };
        if let Some(values) = view(q, n)
            && !outs.iter().any(shared)
        {
            return Ok(Self { count: values.len() / n, values: Cow::Borrowed(values) });
        }
        match numbers("Q", q)? {
            (got, values) if got.len() == 2 && got[1] == n => Ok(Self { count: got[0], values: Cow::Owned(values) }),
            (got, _) => Err(shape("Q", &got, format!("(N, {n})"))),
        }
    }

    /// The caller's array, or a new one, of (N, …).
    fn target<'py>(
        &self,
        py: Python<'py>,
        name: &str,
        out: Option<&Bound<'py, PyAny>>,
        part: &[usize],
    ) -> PyResult<Bound<'py, PyAny>> {
        let shape: Vec<usize> = std::iter::once(self.count).chain(part.iter().copied()).collect();
        match out {
            None => Ok(zeros(py, &shape)),
            Some(out) if crate::convert::writable(out, &shape) => Ok(out.clone()),
            Some(out) => Err(unfit(name, out, &shape)),
        }
    }
}

/// The memory of an array of (N, …) that [`Batch::target`] gave.
fn target_of<'a>(array: &'a Bound<'_, PyAny>, count: usize, part: &[usize]) -> &'a mut [f64] {
    let shape: Vec<usize> = std::iter::once(count).chain(part.iter().copied()).collect();
    view_mut(array, &shape).unwrap_or_default()
}

/// Poses (N, 4, 4) and Jacobians (N, 6, n).
pub(crate) fn both_batch<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    reference: Reference,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
    let (py, n) = (q.py(), core.n());
    let own = out.map(pair).transpose()?;
    let outs: Vec<_> = own.iter().flat_map(|(first, second)| [first, second]).collect();
    let batch = Batch::read(core, q, &outs)?;
    let poses = batch.target(py, "out[0]", own.as_ref().map(|own| &own.0), &[4, 4])?;
    let jacobians = batch.target(py, "out[1]", own.as_ref().map(|own| &own.1), &[6, n])?;
    if let (Some(a), Some(b)) = (memory(&poses), memory(&jacobians))
        && a.start < b.end
        && b.start < a.end
    {
        return Err(PyValueError::new_err("out[0] and out[1] must not share memory"));
    }
    let (to_poses, to_jacobians) =
        (target_of(&poses, batch.count, &[4, 4]), target_of(&jacobians, batch.count, &[6, n]));
    let values: &[f64] = &batch.values;
    py.detach(|| core.kinematics_batch(values, reference, to_poses, to_jacobians)).or_raise()?;
    Ok((poses, jacobians))
}

/// One array of (N, …) that the core fills while other Python threads run.
fn one_batch<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    out: Option<&Bound<'py, PyAny>>,
    part: &[usize],
    fill: impl FnOnce(&[f64], &mut [f64]) -> pliant_core::Result<()> + Send,
) -> PyResult<Bound<'py, PyAny>> {
    let py = q.py();
    let batch = Batch::read(core, q, &out.into_iter().collect::<Vec<_>>())?;
    let array = batch.target(py, "out", out, part)?;
    let (values, to): (&[f64], _) = (&batch.values, target_of(&array, batch.count, part));
    py.detach(|| fill(values, to)).or_raise()?;
    Ok(array)
}

/// Poses (N, 4, 4).
pub(crate) fn poses<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    one_batch(core, q, out, &[4, 4], |q, to| core.kinematics_batch(q, Reference::WorldAligned, to, &mut []))
}

/// Jacobians (N, 6, n).
pub(crate) fn jacobians<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    reference: Reference,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    one_batch(core, q, out, &[6, core.n()], |q, to| core.kinematics_batch(q, reference, &mut [], to))
}

/// Holding torques (N, n).
pub(crate) fn gravities<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    one_batch(core, q, out, &[core.n()], |q, to| core.gravity_batch(q, to))
}
