//! Arrays with one row per configuration: read in place where they are plain, copied otherwise, results into the caller's.

use std::borrow::Cow;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::convert::{memory, view, view_mut, writable, zeros};
use crate::error::{shape, tuple, wrong_type};
use crate::read::numbers;

/// Rows (N, …) of a batch: the caller's memory if it is a plain array, a copy of anything else.
pub(crate) struct Rows<'a> {
    pub(crate) count: usize,
    pub(crate) values: Cow<'a, [f64]>,
}

impl<'a> Rows<'a> {
    /// Of an array (N, `part`); copied where it shares memory with one of `outs`.
    pub(crate) fn read(
        name: &str,
        array: &'a Bound<'_, PyAny>,
        part: &[usize],
        outs: &[&Bound<'_, PyAny>],
    ) -> PyResult<Self> {
        if let Some((count, values)) = view(array, part)
            && !outs.iter().any(|out| shared(array, out))
        {
            return Ok(Self { count, values: Cow::Borrowed(values) });
        }
        let (got, values) = numbers(name, array)?;
        match got.split_first() {
            Some((&count, rest)) if rest == part => Ok(Self { count, values: Cow::Owned(values) }),
            _ => Err(shape(name, &got, rows_of(part))),
        }
    }
}

/// `(N, 4, 4)` and the like.
pub(crate) fn rows_of(part: &[usize]) -> String {
    let sizes: Vec<String> = std::iter::once("N".into()).chain(part.iter().map(ToString::to_string)).collect();
    format!("({})", sizes.join(", "))
}

/// Whether two plain arrays share memory.
fn shared(a: &Bound<'_, PyAny>, b: &Bound<'_, PyAny>) -> bool {
    match (memory(a), memory(b)) {
        (Some(a), Some(b)) => a.start < b.end && b.start < a.end,
        _ => false,
    }
}

/// Refuses arrays to write into that share memory.
pub(crate) fn disjoint(outs: &[&Bound<'_, PyAny>]) -> PyResult<()> {
    for (j, second) in outs.iter().enumerate() {
        for (i, first) in outs[..j].iter().enumerate() {
            if shared(first, second) {
                return Err(PyValueError::new_err(format!("out[{i}] and out[{j}] must not share memory")));
            }
        }
    }
    Ok(())
}

/// The caller's array, or a new one, of (`count`, `part`).
pub(crate) fn target<'py>(
    py: Python<'py>,
    name: &str,
    out: Option<&Bound<'py, PyAny>>,
    count: usize,
    part: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    let shape = shape_of(count, part);
    match out {
        None => zeros(py, &shape),
        Some(out) if writable(out, &shape) => Ok(out.clone()),
        Some(out) => Err(unfit(name, out, &shape)),
    }
}

/// The memory of an array that [`target`] gave.
pub(crate) fn target_of<'a>(array: &'a Bound<'_, PyAny>, count: usize, part: &[usize]) -> &'a mut [f64] {
    view_mut(array, &shape_of(count, part)).unwrap_or_default()
}

fn shape_of(count: usize, part: &[usize]) -> Vec<usize> {
    std::iter::once(count).chain(part.iter().copied()).collect()
}

/// Why an array cannot be written into.
#[cold]
pub(crate) fn unfit(name: &str, array: &Bound<'_, PyAny>, expected: &[usize]) -> PyErr {
    let got: Option<Vec<usize>> = array.getattr("shape").and_then(|shape| shape.extract()).ok();
    match got {
        Some(got) if got != expected => shape(name, &got, tuple(expected)),
        _ => wrong_type(name, "a writable float64 array in C order", array),
    }
}
