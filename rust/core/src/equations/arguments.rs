//! Checks of lists and matrices, and conversion to fixed-size arrays.

use nalgebra::DMatrix;

use crate::error::{Error, Result};
use crate::math::rows::JointMatrix;
use crate::{MAX_AXES, MAX_JOINTS, Rows};

/// Returns [`Error::OutOfRange`] for `value` unless `ok`; `bound` is the valid range, as text for the message.
pub(super) fn check(what: impl Into<String>, value: f64, ok: bool, bound: &str) -> Result<()> {
    if ok { Ok(()) } else { Err(Error::out_of_range(what, value, bound)) }
}

/// Returns [`Error::Shape`] unless a list has the expected length.
pub(super) fn same_length(what: &str, got: usize, expected: usize) -> Result<()> {
    if got == expected { Ok(()) } else { Err(Error::length(what, got, expected)) }
}

/// Returns [`Error::OutOfRange`] for the first entry that is not finite.
pub(super) fn finite(what: &str, m: &DMatrix<f64>) -> Result<()> {
    for (i, row) in m.row_iter().enumerate() {
        for (j, value) in row.iter().enumerate() {
            check(format!("{what}[{i}, {j}]"), *value, value.is_finite(), "finite")?;
        }
    }
    Ok(())
}

/// Returns `result`, or an error if an entry is not finite because of an overflow.
pub(super) fn without_overflow(what: &str, result: DMatrix<f64>) -> Result<DMatrix<f64>> {
    if result.iter().all(|value| value.is_finite()) {
        return Ok(result);
    }
    let message = "the result overflows: an argument is too large, or too small to divide by";
    Err(Error::config(what, message))
}

/// Returns `A B`. nalgebra's operator would link its kernels for large matrices, one per instruction set.
pub(super) fn product(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    DMatrix::from_fn(a.nrows(), b.ncols(), |i, j| (0..a.ncols()).map(|k| a[(i, k)] * b[(k, j)]).sum())
}

/// Copies `size` finite numbers into an array, padded with zeros.
pub(super) fn array<const N: usize>(what: &str, values: &[f64], size: usize) -> Result<[f64; N]> {
    same_length(what, values.len(), size)?;
    let mut out = [0.0; N];
    for (i, (slot, value)) in out.iter_mut().zip(values).enumerate() {
        check(format!("{what}[{i}]"), *value, value.is_finite(), "finite")?;
        *slot = *value;
    }
    Ok(out)
}

/// Converts a finite matrix of at most six rows and sixteen columns; returns its rows padded with zeros, the number k
/// of rows and the number n of columns.
pub(super) fn task_rows(what: &str, m: &DMatrix<f64>) -> Result<(Rows, usize, usize)> {
    let (k, n) = m.shape();
    if k == 0 || k > MAX_AXES || n == 0 || n > MAX_JOINTS {
        let expected = format!("(1 to {MAX_AXES} axes, 1 to {MAX_JOINTS} joints)");
        return Err(Error::Shape { what: what.into(), got: format!("({k}, {n})"), expected });
    }
    finite(what, m)?;
    let mut rows = [[0.0; MAX_JOINTS]; MAX_AXES];
    for (r, row) in rows.iter_mut().enumerate().take(k) {
        (0..n).for_each(|i| row[i] = m[(r, i)]);
    }
    Ok((rows, k, n))
}

/// Converts a pseudo-inverse (n × k); returns the rows of its transpose padded with zeros, k and n.
pub(super) fn inverse_rows(pseudo_inverse: &DMatrix<f64>) -> Result<(Rows, usize, usize)> {
    let (n, k) = pseudo_inverse.shape();
    task_rows("J_pinv", &pseudo_inverse.transpose()).map_err(|error| match error {
        Error::Shape { what, .. } => {
            let expected = format!("(1 to {MAX_JOINTS} joints, 1 to {MAX_AXES} axes)");
            Error::Shape { what, got: format!("({n}, {k})"), expected }
        }
        other => other,
    })
}

/// Converts a finite n × n matrix to an array padded with zeros.
pub(super) fn square(what: &str, m: &DMatrix<f64>, n: usize) -> Result<JointMatrix> {
    if m.shape() != (n, n) {
        let got = format!("({}, {})", m.nrows(), m.ncols());
        return Err(Error::Shape { what: what.into(), got, expected: format!("({n}, {n})") });
    }
    finite(what, m)?;
    let mut out = [[0.0; MAX_JOINTS]; MAX_JOINTS];
    for (i, row) in out.iter_mut().enumerate().take(n) {
        (0..n).for_each(|j| row[j] = m[(i, j)]);
    }
    Ok(out)
}
