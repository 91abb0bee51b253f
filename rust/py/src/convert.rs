//! NumPy arrays by their C structure: the one module of the binding with unsafe code.
//!
//! What is read and written here is checked first: exact type `numpy.ndarray`, native float64, aligned, C order, the
//! shape asked for. Everything else is refused here and converted or explained by [`crate::read`]. Numbers are copied
//! before use, so that another thread that writes into an array during a call changes numbers and nothing else.
#![expect(unsafe_code, reason = "NumPy's C structure is read directly: a checked borrow costs four times as much")]
#![expect(clippy::cast_ptr_alignment, reason = "the flag ALIGNED of the array is checked before its data are cast")]

use numpy::npyffi::{
    NPY_ARRAY_ALIGNED, NPY_ARRAY_C_CONTIGUOUS, NPY_ARRAY_OWNDATA, NPY_ARRAY_WRITEABLE, NPY_TYPES, PyArrayObject,
    PyArrayObject_fields,
};
use numpy::{PyArrayDyn, PyArrayMethods};
use pyo3::ffi::Py_REFCNT;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyType;

/// `numpy.ndarray`, held so that its address stays what it is.
static ARRAY_TYPE: PyOnceLock<Py<PyType>> = PyOnceLock::new();

/// What a plain array must be to be read here.
const READABLE: i32 = NPY_ARRAY_C_CONTIGUOUS | NPY_ARRAY_ALIGNED;

/// What it must be to be written here.
const WRITABLE: i32 = READABLE | NPY_ARRAY_WRITEABLE;

/// Byte order that NumPy writes for the machine's own.
const NATIVE: u8 = b'=';

/// Looks `numpy.ndarray` up, once.
pub(crate) fn initialise(py: Python<'_>) -> PyResult<()> {
    let array_type = py.import("numpy")?.getattr("ndarray")?.cast_into::<PyType>()?;
    ARRAY_TYPE.get_or_init(py, || array_type.unbind());
    Ok(())
}

/// The structure of an exact `numpy.ndarray` of native float64 with this shape and at least these flags.
#[inline]
fn structure<'a>(array: &'a Bound<'_, PyAny>, shape: &[usize], flags: i32) -> Option<&'a PyArrayObject_fields> {
    let array_type = ARRAY_TYPE.get(array.py())?;
    if !std::ptr::eq(array.get_type_ptr().cast(), array_type.as_ptr()) {
        return None;
    }
    // SAFETY: the object is exactly an ndarray, whose layout is part of NumPy's stable C interface; it is alive as long
    // as the reference that `array` holds, and the interpreter lock keeps Python code from changing the structure.
    let fields = unsafe { &(*array.as_ptr().cast::<PyArrayObject>()).fields };
    if fields.flags & flags != flags || usize::try_from(fields.nd) != Ok(shape.len()) {
        return None;
    }
    for (i, &size) in shape.iter().enumerate() {
        // SAFETY: `dimensions` has `nd` entries, which is the length of `shape`.
        let dimension = unsafe { *fields.dimensions.add(i) };
        if usize::try_from(dimension) != Ok(size) {
            return None;
        }
    }
    // SAFETY: every array has a descriptor; the fields read here are at the same place in all versions of NumPy.
    let (type_number, order) = unsafe { ((*fields.descr).fields.type_num, (*fields.descr).fields.byteorder) };
    (type_number == NPY_TYPES::NPY_DOUBLE as i32 && order.cast_unsigned() == NATIVE).then_some(fields)
}

/// Copies the numbers of a plain array of this shape; `false` and nothing done for any other object.
#[inline]
pub(crate) fn copy(array: &Bound<'_, PyAny>, shape: &[usize], out: &mut [f64]) -> bool {
    let Some(fields) = structure(array, shape, READABLE) else { return false };
    let count: usize = shape.iter().product();
    if out.len() < count {
        return false;
    }
    // SAFETY: the array is C-contiguous, aligned and holds `count` float64 values; `out` has room and is ours alone.
    unsafe { std::ptr::copy_nonoverlapping(fields.data.cast::<f64>().cast_const(), out.as_mut_ptr(), count) };
    true
}

/// Whether [`write`] would write.
pub(crate) fn writable(array: &Bound<'_, PyAny>, shape: &[usize]) -> bool {
    structure(array, shape, WRITABLE).is_some()
}

/// Writes numbers into a plain, writable array of this shape; `false` and nothing done for any other object.
#[inline]
pub(crate) fn write(array: &Bound<'_, PyAny>, shape: &[usize], values: &[f64]) -> bool {
    let Some(fields) = structure(array, shape, WRITABLE) else { return false };
    let count: usize = shape.iter().product();
    if values.len() < count {
        return false;
    }
    // SAFETY: as in `copy`; the array is writable, and `values` lies in Rust's memory, never in the array's.
    unsafe { std::ptr::copy_nonoverlapping(values.as_ptr(), fields.data.cast::<f64>(), count) };
    true
}

/// Writes numbers into a vector that nobody but one of our own objects can see; `false` and nothing done otherwise.
///
/// Seen by others means: another reference (a view and a memoryview hold one), a weak reference, memory of someone else.
#[inline]
pub(crate) fn overwrite(array: &Bound<'_, PyAny>, values: &[f64]) -> bool {
    let Some(fields) = structure(array, &[values.len()], WRITABLE | NPY_ARRAY_OWNDATA) else { return false };
    if references(array) != 1 || !fields.weakreflist.is_null() {
        return false;
    }
    // SAFETY: as in `write`.
    unsafe { std::ptr::copy_nonoverlapping(values.as_ptr(), fields.data.cast::<f64>(), values.len()) };
    true
}

/// How many references an object has. With the interpreter lock held, 1 means that only the asking one is left.
#[inline]
pub(crate) fn references(object: &Bound<'_, PyAny>) -> isize {
    // SAFETY: the pointer is that of a living object.
    unsafe { Py_REFCNT(object.as_ptr()) }
}

/// A new array with these numbers, row by row.
pub(crate) fn new_array<'py>(py: Python<'py>, shape: &[usize], values: &[f64]) -> Bound<'py, PyAny> {
    let array = PyArrayDyn::<f64>::zeros(py, shape, false);
    let count: usize = shape.iter().product();
    // SAFETY: the array is new, C-contiguous and has `count` entries; no more are copied than there are.
    unsafe { std::ptr::copy_nonoverlapping(values.as_ptr(), array.data(), count.min(values.len())) };
    array.into_any()
}

/// A new array that `fill` writes while other Python threads run.
pub(crate) fn filled<'py, E: Send>(
    py: Python<'py>,
    shape: &[usize],
    fill: impl FnOnce(&mut [f64]) -> Result<(), E> + Send,
) -> Result<Bound<'py, PyAny>, E> {
    let array = PyArrayDyn::<f64>::zeros(py, shape, false);
    let count = shape.iter().product();
    // SAFETY: the array is new, so that nobody else can reach its memory; it is C-contiguous with `count` entries.
    let values = unsafe { std::slice::from_raw_parts_mut(array.data(), count) };
    py.detach(|| fill(values))?;
    Ok(array.into_any())
}

/// Makes an array read-only for Python.
pub(crate) fn freeze(array: &Bound<'_, PyAny>) -> PyResult<()> {
    array.getattr("flags")?.setattr("writeable", false)
}
