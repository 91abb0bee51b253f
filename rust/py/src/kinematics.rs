//! Pose, Jacobian and gravity of a model, one configuration or many.

use pliant_core::{Frames, JointVec, MAX_AXES, MAX_JOINTS, Model as CoreModel, Pose, Reference};
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::convert::{filled, new_array, write};
use crate::error::{OrRaise, shape, wrong_type};
use crate::pose::matrix;
use crate::read::{joints, numbers};

/// A Jacobian, row by row without gaps.
type Flat = [f64; MAX_AXES * MAX_JOINTS];

/// Joint positions, checked.
pub(crate) fn positions(core: &CoreModel, q: &Bound<'_, PyAny>) -> PyResult<JointVec> {
    let n = core.n();
    core.joint_vector(&joints("q", q, n)?[..n]).or_raise()
}

fn at(core: &CoreModel, q: &JointVec, reference: Reference) -> pliant_core::Result<(Pose, Flat)> {
    let n = core.n();
    let mut flat = [0.0; MAX_AXES * MAX_JOINTS];
    if reference == Reference::Local {
        let (pose, jacobian) = core.kinematics(&q[..n], reference)?;
        for (row, to) in flat.chunks_exact_mut(n).take(MAX_AXES).enumerate() {
            to.iter_mut().enumerate().for_each(|(i, value)| *value = jacobian[(row, i)]);
        }
        return Ok((pose, flat));
    }
    let mut frames = Frames::default();
    let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
    core.chain().forward(q, &mut frames);
    core.chain().jacobian(&frames, &mut rows);
    for (to, row) in flat.chunks_exact_mut(n).zip(&rows) {
        to.copy_from_slice(&row[..n]);
    }
    Ok((frames.tool, flat))
}

/// Pose (4, 4) and Jacobian (6, n), new ones or into the caller's.
pub(crate) fn both<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    reference: Reference,
    out: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyAny>> {
    let py = q.py();
    let (pose, jacobian) = at(core, &positions(core, q)?, reference).or_raise()?;
    let Some(out) = out else {
        let pair = [matrix(py, &pose), new_array(py, &[6, core.n()], &jacobian)];
        return Ok(PyTuple::new(py, pair)?.into_any());
    };
    let expected = "a pair of arrays to write into";
    let pair = out.cast::<PyTuple>().map_err(|_| wrong_type("out", expected, out))?;
    let (first, second) = match pair.len() {
        2 => (pair.get_item(0)?, pair.get_item(1)?),
        _ => return Err(wrong_type("out", expected, out)),
    };
    into("out[0]", &first, &[4, 4], pose.to_rows().as_flattened())?;
    into("out[1]", &second, &[6, core.n()], &jacobian)?;
    Ok(out.clone())
}

fn into(name: &str, array: &Bound<'_, PyAny>, expected: &[usize], values: &[f64]) -> PyResult<()> {
    if write(array, expected, values) {
        return Ok(());
    }
    let got: Option<Vec<usize>> = array.getattr("shape").and_then(|shape| shape.extract()).ok();
    match got {
        Some(got) if got != expected => Err(shape(name, &got, crate::error::tuple(expected))),
        _ => Err(wrong_type(name, "a writable float64 array in C order", array)),
    }
}

/// Jacobian (6, n).
pub(crate) fn jacobian<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    reference: Reference,
) -> PyResult<Bound<'py, PyAny>> {
    let (_, jacobian) = at(core, &positions(core, q)?, reference).or_raise()?;
    Ok(new_array(q.py(), &[6, core.n()], &jacobian))
}

/// Configurations (N, n) of a batch.
pub(crate) struct Batch {
    count: usize,
    n: usize,
    values: Vec<f64>,
}

impl Batch {
    pub(crate) fn read(core: &CoreModel, q: &Bound<'_, PyAny>) -> PyResult<Self> {
        let n = core.n();
        match numbers("Q", q)? {
            (got, values) if got.len() == 2 && got[1] == n => Ok(Self { count: got[0], n, values }),
            (got, _) => Err(shape("Q", &got, format!("(N, {n})"))),
        }
    }

    /// An array (N, …) whose parts `each` writes, other Python threads running.
    pub(crate) fn map<'py>(
        &self,
        py: Python<'py>,
        core: &CoreModel,
        part: &[usize],
        each: impl Fn(&JointVec, &mut [f64]) -> pliant_core::Result<()> + Sync,
    ) -> PyResult<Bound<'py, PyAny>> {
        let size: usize = part.iter().product();
        let shape: Vec<usize> = std::iter::once(self.count).chain(part.iter().copied()).collect();
        let done = filled(py, &shape, |out| {
            for (row, (q, to)) in self.values.chunks_exact(self.n).zip(out.chunks_exact_mut(size)).enumerate() {
                core.joint_vector(q).and_then(|q| each(&q, to)).map_err(|error| (row, error))?;
            }
            Ok(())
        });
        done.map_err(|(row, error)| in_row(error, row)).or_raise()
    }
}

/// The error of one configuration with its row.
fn in_row(error: pliant_core::Error, row: usize) -> pliant_core::Error {
    match error {
        pliant_core::Error::Limit { what, value, bound } => {
            pliant_core::Error::Limit { what: format!("Q[{row}]: {what}"), value, bound }
        }
        other => other,
    }
}

/// Poses (N, 4, 4).
pub(crate) fn poses<'py>(core: &CoreModel, q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    Batch::read(core, q)?.map(q.py(), core, &[4, 4], |q, to| {
        let mut frames = Frames::default();
        core.chain().forward(q, &mut frames);
        to.copy_from_slice(frames.tool.to_rows().as_flattened());
        Ok(())
    })
}

/// Jacobians (N, 6, n).
pub(crate) fn jacobians<'py>(
    core: &CoreModel,
    q: &Bound<'py, PyAny>,
    reference: Reference,
) -> PyResult<Bound<'py, PyAny>> {
    let n = core.n();
    Batch::read(core, q)?.map(q.py(), core, &[6, n], |q, to| {
        let (_, flat) = at(core, q, reference)?;
        to.copy_from_slice(&flat[..6 * n]);
        Ok(())
    })
}

/// Holding torques (N, n).
pub(crate) fn gravities<'py>(core: &CoreModel, q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
    let n = core.n();
    let masses = core.chain().masses(core.payload());
    Batch::read(core, q)?.map(q.py(), core, &[n], |q, to| {
        let (mut frames, mut torque) = (Frames::default(), [0.0; MAX_JOINTS]);
        core.chain().forward(q, &mut frames);
        core.chain().gravity(&frames, &masses, core.gravity_vector(), &mut torque);
        to.copy_from_slice(&torque[..n]);
        Ok(())
    })
}
