//! Input and output arrays with one row per configuration. C-ordered float64 inputs are read in place, others are
//! copied; results are written to arrays of the caller or to new arrays.

use pyo3::prelude::*;

use crate::error::{shape, tuple, wrong_type};
use crate::ndarray::{Lent, rows, share_memory, writable, zeros};
use crate::read::numbers;

/// Input array (N, `part`) of a batch: the caller's memory if it is a C-ordered float64 array, else a copy.
pub(crate) struct Rows<'a, 'py> {
    pub(crate) count: usize,
    name: &'a str,
    array: &'a Bound<'py, PyAny>,
    part: &'a [usize],
    copy: Option<Vec<f64>>,
}

impl<'a, 'py> Rows<'a, 'py> {
    /// Reads an array (N, `part`). Copies it if it is not a C-ordered float64 array, or if it shares memory with one of
    /// `outs`.
    pub(crate) fn read(
        name: &'a str,
        array: &'a Bound<'py, PyAny>,
        part: &'a [usize],
        outs: &[&Bound<'_, PyAny>],
    ) -> PyResult<Self> {
        if let Some(count) = rows(array, part)
            && !outs.iter().any(|out| share_memory(array, out))
        {
            return Ok(Self { count, name, array, part, copy: None });
        }
        let (got, values) = numbers(name, array)?;
        match got.split_first() {
            Some((&count, rest)) if rest == part => Ok(Self { count, name, array, part, copy: Some(values) }),
            _ => Err(shape(name, &got, rows_of(part))),
        }
    }

    /// Returns the rows as an input of [`crate::ndarray::lend`].
    pub(crate) fn lent(&self) -> Lent<'_, 'py> {
        match &self.copy {
            Some(copy) => Lent::Numbers(copy),
            None => Lent::Array(self.name, self.array, shape_of(self.count, self.part)),
        }
    }
}

/// Formats the shape (N, `part`) for a message, e.g. `(N, 4, 4)`.
pub(crate) fn rows_of(part: &[usize]) -> String {
    let sizes: Vec<String> = std::iter::once("N".into()).chain(part.iter().map(ToString::to_string)).collect();
    format!("({})", sizes.join(", "))
}

/// Returns the output array of shape (`count`, `part`): `out`, or a new array if `out` is `None`; an error if `out` has
/// another shape, type or layout.
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

/// Returns the shape (`count`, `part`).
pub(crate) fn shape_of(count: usize, part: &[usize]) -> Vec<usize> {
    std::iter::once(count).chain(part.iter().copied()).collect()
}

/// Returns the error for an output array with a wrong shape, type or layout.
#[cold]
pub(crate) fn unfit(name: &str, array: &Bound<'_, PyAny>, expected: &[usize]) -> PyErr {
    let got: Option<Vec<usize>> = array.getattr("shape").and_then(|shape| shape.extract()).ok();
    match got {
        Some(got) if got != expected => shape(name, &got, tuple(expected)),
        _ => wrong_type(name, "a writable float64 array in C order", array),
    }
}
