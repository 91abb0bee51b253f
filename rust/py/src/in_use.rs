//! Borrows of Python objects with mutable state. If the object is already in use, they raise a `RuntimeError` with a
//! remedy.

use pyo3::PyClass;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::pyclass::boolean_struct::False;

/// Borrows an object for reading; `RuntimeError` if another call is changing it.
#[inline]
pub(crate) fn shared<'py, T: PyClass>(object: &Bound<'py, T>) -> PyResult<PyRef<'py, T>> {
    object.try_borrow().map_err(|_| in_use::<T>())
}

/// Borrows an object for writing; `RuntimeError` if another call uses it. All arguments must be read before, because
/// that may run Python code that uses the same object.
#[inline]
pub(crate) fn exclusive<'py, T: PyClass<Frozen = False>>(object: &Bound<'py, T>) -> PyResult<PyRefMut<'py, T>> {
    object.try_borrow_mut().map_err(|_| in_use::<T>())
}

#[cold]
#[inline(never)]
fn in_use<T: PyClass>() -> PyErr {
    let name = T::NAME;
    PyRuntimeError::new_err(format!(
        "this {name} is in use by another call, of another thread or one that reads its arguments; \
         give each thread a {name} of its own, or share one behind a threading.Lock"
    ))
}
