//! Arrays with one row per configuration: read in place where they are plain, copied otherwise, results into the caller's.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::convert::{memory, view, view_mut, writable, zeros};
use crate::error::{shape, tuple, wrong_type};
use crate::read::numbers;

/// Rows (N, `part`) of a batch: the caller's memory if it is a plain array, a copy of anything else.
pub(crate) struct Rows<'a, 'py> {
    pub(crate) count: usize,
    name: &'a str,
    array: &'a Bound<'py, PyAny>,
    part: &'a [usize],
    copy: Option<Vec<f64>>,
}

impl<'a, 'py> Rows<'a, 'py> {
    /// Of an array; copied where it shares memory with one of `outs`.
    pub(crate) fn read(
        name: &'a str,
        array: &'a Bound<'py, PyAny>,
        part: &'a [usize],
        outs: &[&Bound<'_, PyAny>],
    ) -> PyResult<Self> {
        if let Some((count, _)) = view(array, part)
            && !outs.iter().any(|out| shared(array, out))
        {
            return Ok(Self { count, name, array, part, copy: None });
        }
        let (got, values) = numbers(name, array)?;
        match got.split_first() {
            Some((&count, rest)) if rest == part => Ok(Self { count, name, array, part, copy: Some(values) }),
            _ => Err(shape(name, &got, rows_of(part))),
        }
    }

    /// The numbers. To be asked for last: reading another argument may run code that makes another array of this one.
    pub(crate) fn values(&self) -> PyResult<&[f64]> {
        if let Some(copy) = &self.copy {
            return Ok(copy);
        }
        match view(self.array, self.part) {
            Some((count, values)) if count == self.count => Ok(values),
            _ => Err(PyValueError::new_err(format!("{} changed while the other arguments were read", self.name))),
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
