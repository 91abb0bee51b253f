//! Access to NumPy arrays through their C structure: the only unsafe code of the binding.
//!
//! A *plain array* is of the exact type `numpy.ndarray`, native float64, aligned and in C order. Every access first
//! checks this and the shape. Other objects are rejected here; [`crate::read`] converts them or raises an error. The
//! safe functions copy while they hold the interpreter lock. Only [`lend`] works on arrays in place without it.
#![expect(unsafe_code, reason = "NumPy's C structure is read directly: a checked borrow costs four times as much")]
#![expect(clippy::cast_ptr_alignment, reason = "the flag ALIGNED of the array is checked before its data are cast")]

use std::convert::Infallible;
use std::sync::atomic::{AtomicBool, Ordering};

use nalgebra::DMatrix;
use numpy::npyffi::{
    NPY_ARRAY_ALIGNED, NPY_ARRAY_C_CONTIGUOUS, NPY_ARRAY_OWNDATA, NPY_ARRAY_WRITEABLE, NPY_TYPES, PyArrayObject,
    PyArrayObject_fields,
};
use numpy::{PyArray1, PyArray2, PyArrayDyn, PyArrayMethods};
use pliant_core::MAX_JOINTS;
use pyo3::exceptions::PyValueError;
use pyo3::ffi::Py_REFCNT;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyTuple, PyType};

/// The type `numpy.ndarray`; the stored reference keeps its address valid.
static ARRAY_TYPE: PyOnceLock<Py<PyType>> = PyOnceLock::new();

/// NumPy flags that an array must have to be read in place.
const READABLE: i32 = NPY_ARRAY_C_CONTIGUOUS | NPY_ARRAY_ALIGNED;

/// NumPy flags that an array must have to be written in place.
const WRITABLE: i32 = READABLE | NPY_ARRAY_WRITEABLE;

/// NumPy's code for native byte order, `=`. As a number, because `c_char` is signed or unsigned depending on the
/// platform.
const NATIVE: std::ffi::c_char = 0x3d;

/// True on a free-threaded Python, where a reference count of 1 does not prove that no other thread uses the object.
static FREE_THREADED: AtomicBool = AtomicBool::new(false);

/// Initialises [`ARRAY_TYPE`] and [`FREE_THREADED`].
pub(crate) fn initialise(py: Python<'_>) -> PyResult<()> {
    let version: String = py.import("sys")?.getattr("version")?.extract()?;
    FREE_THREADED.store(version.contains("free-threading"), Ordering::Relaxed);
    let array_type = py.import("numpy")?.getattr("ndarray")?.cast_into::<PyType>()?;
    ARRAY_TYPE.get_or_init(py, || array_type.unbind());
    Ok(())
}

/// Returns the C structure of an exact `numpy.ndarray` of native float64; `None` for any other object.
#[inline]
fn structure_of<'a>(array: &'a Bound<'_, PyAny>) -> Option<&'a PyArrayObject_fields> {
    let array_type = ARRAY_TYPE.get(array.py())?;
    if !std::ptr::eq(array.get_type_ptr().cast(), array_type.as_ptr()) {
        return None;
    }
    // SAFETY: the object is exactly an ndarray, whose layout is part of NumPy's stable C interface; it is alive as long
    // as the reference that `array` holds, and the interpreter lock keeps Python code from changing the structure.
    let fields = unsafe { &(*array.as_ptr().cast::<PyArrayObject>()).fields };
    // SAFETY: every array has a descriptor; the fields read here are at the same place in all versions of NumPy.
    let (type_number, order) = unsafe { ((*fields.descr).fields.type_num, (*fields.descr).fields.byteorder) };
    (type_number == NPY_TYPES::NPY_DOUBLE as i32 && order == NATIVE).then_some(fields)
}

/// Returns the C structure of a native float64 array with this shape and at least these NumPy flags; `None` for any
/// other object.
#[inline]
fn structure<'a>(array: &'a Bound<'_, PyAny>, shape: &[usize], flags: i32) -> Option<&'a PyArrayObject_fields> {
    let fields = structure_of(array)?;
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
    Some(fields)
}

/// Copies `count` numbers between arrays.
///
/// Up to [`MAX_JOINTS`] numbers are copied inline, which is faster than a call of `memcpy`. They are copied in pairs,
/// because processors forward a recent store only to a load within that store.
///
/// # Safety
/// `from` is valid for `count` reads and `to` for as many writes, and they do not overlap.
#[inline(always)]
unsafe fn copy_numbers(from: *const f64, to: *mut f64, count: usize) {
    // SAFETY: as the caller promises; a pair is aligned as a number is, and ends before `count`.
    unsafe {
        if count > MAX_JOINTS {
            return std::ptr::copy_nonoverlapping(from, to, count);
        }
        for i in (1..count).step_by(2) {
            to.add(i - 1).cast::<[f64; 2]>().write(from.add(i - 1).cast::<[f64; 2]>().read());
        }
        if count % 2 == 1 {
            to.add(count - 1).write(from.add(count - 1).read());
        }
    }
}

/// Returns the numbers of a plain array of this shape in place; `None` for any other object.
///
/// # Safety
/// While the slice is in use, the array must keep its memory and must not be written to: no Python code runs in this
/// thread, and the caller writes to no array that may share this memory.
#[inline]
unsafe fn read<'a>(array: &'a Bound<'_, PyAny>, shape: &[usize]) -> Option<&'a [f64]> {
    let fields = structure(array, shape, READABLE)?;
    // SAFETY: the array is C-contiguous, aligned and holds as many float64 values; the caller promises that it stays
    // so.
    Some(unsafe { std::slice::from_raw_parts(fields.data.cast::<f64>().cast_const(), shape.iter().product()) })
}

/// Copies the numbers of a plain array of this shape to `out`; returns `false` and does nothing for any other object,
/// or if `out` is too short.
#[inline]
pub(crate) fn copy(array: &Bound<'_, PyAny>, shape: &[usize], out: &mut [f64]) -> bool {
    // SAFETY: the slice is read before any other code runs; `out` is Rust's memory.
    let Some(values) = (unsafe { read(array, shape) }) else { return false };
    if out.len() < values.len() {
        return false;
    }
    // SAFETY: `out` has room and is exclusively borrowed.
    unsafe { copy_numbers(values.as_ptr(), out.as_mut_ptr(), values.len()) };
    true
}

/// Returns the first `N` numbers of a plain array of this shape; `None` for any other object. By value, so that they
/// can stay in registers.
#[inline(always)]
pub(crate) fn first_numbers<const N: usize>(array: &Bound<'_, PyAny>, shape: &[usize]) -> Option<[f64; N]> {
    // SAFETY: the slice is copied before any other code runs.
    unsafe { read(array, shape) }?.first_chunk().copied()
}

/// Returns true for a plain, writable array of this shape, which [`write`] can write into.
pub(crate) fn writable(array: &Bound<'_, PyAny>, shape: &[usize]) -> bool {
    structure(array, shape, WRITABLE).is_some()
}

/// Writes numbers into a plain, writable array of this shape; returns `false` and does nothing for any other object, or
/// if there are too few `values`.
#[inline]
pub(crate) fn write(array: &Bound<'_, PyAny>, shape: &[usize], values: &[f64]) -> bool {
    let Some(fields) = structure(array, shape, WRITABLE) else { return false };
    let count: usize = shape.iter().product();
    if values.len() < count {
        return false;
    }
    // SAFETY: as in `copy`; the array is writable, and `values` lies in Rust's memory, never in the array's.
    unsafe { copy_numbers(values.as_ptr(), fields.data.cast::<f64>(), count) };
    true
}

/// Writes the first `width` numbers of each row into a plain, writable array (R, `width`); returns `false` and does
/// nothing for any other object.
#[inline]
pub(crate) fn write_rows<const R: usize, const C: usize>(
    array: &Bound<'_, PyAny>,
    width: usize,
    rows: &[[f64; C]; R],
) -> bool {
    let width = width.min(C);
    let Some(fields) = structure(array, &[R, width], WRITABLE) else { return false };
    let data = fields.data.cast::<f64>();
    for (r, row) in rows.iter().enumerate() {
        // SAFETY: as in `write`; row `r` of the array begins at `r · width`.
        unsafe { copy_numbers(row.as_ptr(), data.add(r * width), width) };
    }
    true
}

/// Returns N for a plain array of shape (N, `part`); `None` for any other object.
pub(crate) fn rows(array: &Bound<'_, PyAny>, part: &[usize]) -> Option<usize> {
    let fields = structure_of(array)?;
    if fields.flags & READABLE != READABLE || usize::try_from(fields.nd) != Ok(part.len() + 1) {
        return None;
    }
    // SAFETY: `dimensions` has `nd` entries, and there is at least one.
    let rows = usize::try_from(unsafe { *fields.dimensions }).ok()?;
    let mut count = rows;
    for (i, &size) in part.iter().enumerate() {
        // SAFETY: as above; `nd` is one more than the length of `part`.
        let dimension = unsafe { *fields.dimensions.add(i + 1) };
        if usize::try_from(dimension) != Ok(size) {
            return None;
        }
        count = count.checked_mul(size)?;
    }
    Some(rows)
}

/// Input of [`lend`]: a plain array with its argument name and shape, or a slice of Rust's memory.
pub(crate) enum Lent<'a, 'py> {
    Array(&'a str, &'a Bound<'py, PyAny>, Vec<usize>),
    Numbers(&'a [f64]),
}

/// Runs `work` on the numbers of arrays in place, without the interpreter lock. `outs` are the output arrays with
/// argument name and shape.
///
/// As with NumPy's own functions, Python threads must not use these arrays meanwhile: a write is a data race, and a
/// resize frees memory in use. This cannot be checked here.
///
/// # Errors
/// `ValueError` if an array changed after its argument was read, or if one of `outs` shares memory with another array.
pub(crate) fn lend<const I: usize, const O: usize, T: Send>(
    py: Python<'_>,
    inputs: &[Lent<'_, '_>; I],
    outs: [(&str, &Bound<'_, PyAny>, &[usize]); O],
    work: impl FnOnce([&[f64]; I], [&mut [f64]; O]) -> T + Send,
) -> PyResult<T> {
    check_lent(inputs, &outs)?;
    let mut numbers = [&[][..]; I];
    for (slot, input) in numbers.iter_mut().zip(inputs) {
        *slot = match input {
            Lent::Numbers(values) => values,
            // SAFETY: `work` has no interpreter token, and no output array shares this memory.
            Lent::Array(_, array, shape) => unsafe { read(array, shape) }.unwrap_or_default(),
        };
    }
    // SAFETY: as above; `outs` share no memory with each other.
    let places = outs.map(|(_, array, shape)| unsafe { read_mut(array, shape) }.unwrap_or_default());
    Ok(py.detach(|| work(numbers, places)))
}

/// Checks that no array changed after its argument was read, and that none of `outs` shares memory with another array.
#[inline(never)]
fn check_lent(inputs: &[Lent<'_, '_>], outs: &[(&str, &Bound<'_, PyAny>, &[usize])]) -> PyResult<()> {
    let changed =
        |name: &str| Err(PyValueError::new_err(format!("{name} changed while the other arguments were read")));
    for input in inputs {
        if let Lent::Array(name, array, shape) = input
            && structure(array, shape, READABLE).is_none()
        {
            return changed(name);
        }
    }
    for (i, (name, array, shape)) in outs.iter().enumerate() {
        let read = inputs.iter().filter_map(|input| match input {
            Lent::Array(name, array, _) => Some((*name, *array)),
            Lent::Numbers(_) => None,
        });
        let mut others = outs[..i].iter().map(|(name, array, _)| (*name, *array)).chain(read);
        if let Some((other, _)) = others.find(|(_, other)| share_memory(other, array)) {
            return Err(PyValueError::new_err(format!("{other} and {name} must not share memory")));
        }
        if !writable(array, shape) {
            return changed(name);
        }
    }
    Ok(())
}

/// Returns the elements of a writable, C-contiguous float64 array of this shape as a mutable slice; `None` for any
/// other object.
///
/// # Safety
/// While the slice is in use, the memory of the array must not be freed or reallocated, no Python code may run in this
/// thread, and no other slice may refer to this memory.
#[expect(clippy::mut_from_ref, reason = "the memory is the array's, not the reference's")]
unsafe fn read_mut<'a>(array: &'a Bound<'_, PyAny>, shape: &[usize]) -> Option<&'a mut [f64]> {
    let fields = structure(array, shape, WRITABLE)?;
    // SAFETY: as in `read`; the array is writable.
    Some(unsafe { std::slice::from_raw_parts_mut(fields.data.cast::<f64>(), shape.iter().product()) })
}

/// Returns true if two float64 arrays overlap in memory; false if one of the objects is not a float64 array.
pub(crate) fn share_memory(a: &Bound<'_, PyAny>, b: &Bound<'_, PyAny>) -> bool {
    match (memory(a), memory(b)) {
        (Some(a), Some(b)) => a.start < b.end && b.start < a.end,
        _ => false,
    }
}

/// Returns the address range of an array's numbers; `None` if the object is not a native float64 array.
fn memory(array: &Bound<'_, PyAny>) -> Option<std::ops::Range<usize>> {
    let fields = structure_of(array)?;
    let start = fields.data.addr();
    let mut size = std::mem::size_of::<f64>();
    for i in 0..usize::try_from(fields.nd).ok()? {
        // SAFETY: `dimensions` has `nd` entries.
        size *= usize::try_from(unsafe { *fields.dimensions.add(i) }).ok()?;
    }
    Some(start..start + size)
}

/// Writes numbers into a vector that nothing else refers to; otherwise returns `false` and does nothing.
///
/// Does not write an array that has another reference (e.g. by a view or memoryview) or a weak reference, or that does
/// not own its memory.
#[inline]
pub(crate) fn overwrite(array: &Bound<'_, PyAny>, values: &[f64]) -> bool {
    let Some(fields) = structure(array, &[values.len()], WRITABLE | NPY_ARRAY_OWNDATA) else { return false };
    if !only_reference(array) || !fields.weakreflist.is_null() {
        return false;
    }
    // SAFETY: as in `write`.
    unsafe { copy_numbers(values.as_ptr(), fields.data.cast::<f64>(), values.len()) };
    true
}

/// Returns true if the caller holds the only reference to the object; always false on a free-threaded Python.
#[inline]
pub(crate) fn only_reference(object: &Bound<'_, PyAny>) -> bool {
    // SAFETY: the pointer is that of a live object.
    unsafe { Py_REFCNT(object.as_ptr()) == 1 && !FREE_THREADED.load(Ordering::Relaxed) }
}

/// Numbers with a shape, which become a new NumPy array at each access from Python.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Array {
    shape: Vec<usize>,
    values: Vec<f64>,
}

impl Array {
    pub(crate) fn vector(values: &[f64]) -> Self {
        Self { shape: vec![values.len()], values: values.to_vec() }
    }

    pub(crate) fn rows<const C: usize>(rows: &[[f64; C]]) -> Self {
        Self { shape: vec![rows.len(), C], values: rows.as_flattened().to_vec() }
    }

    pub(crate) fn matrix(m: &DMatrix<f64>) -> Self {
        Self { shape: vec![m.nrows(), m.ncols()], values: m.transpose().as_slice().to_vec() }
    }
}

impl<'py> IntoPyObject<'py> for &Array {
    type Target = PyAny;
    type Output = Bound<'py, PyAny>;
    type Error = Infallible;

    fn into_pyobject(self, py: Python<'py>) -> Result<Self::Output, Infallible> {
        Ok(new_array(py, &self.shape, &self.values))
    }
}

/// Booleans, which become a new NumPy array (n,) at each access from Python.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Flags(pub(crate) Vec<bool>);

impl<'py> IntoPyObject<'py> for &Flags {
    type Target = PyArray1<bool>;
    type Output = Bound<'py, PyArray1<bool>>;
    type Error = Infallible;

    fn into_pyobject(self, py: Python<'py>) -> Result<Self::Output, Infallible> {
        Ok(PyArray1::from_slice(py, &self.0))
    }
}

/// Creates an array of this shape from `values`, row-major; entries without a value are 0.
#[inline(never)]
pub(crate) fn new_array<'py>(py: Python<'py>, shape: &[usize], values: &[f64]) -> Bound<'py, PyAny> {
    let array = PyArrayDyn::<f64>::zeros(py, shape, false);
    let count: usize = shape.iter().product();
    // SAFETY: the array is new, C-contiguous and has `count` entries; at most `count` are copied.
    unsafe { std::ptr::copy_nonoverlapping(values.as_ptr(), array.data(), count.min(values.len())) };
    array.into_any()
}

/// Three vectors in rotation, which are overwritten as soon as nothing else refers to them.
///
/// So a loop that keeps no result allocates nothing, and a vector that the caller keeps never changes, see
/// [`overwrite`].
#[derive(Debug, Default)]
pub(crate) struct Vectors {
    slots: [Option<Py<PyAny>>; 3],
    next: usize,
}

impl Vectors {
    /// Returns an array (n,) with these numbers.
    pub(crate) fn take<'py>(&mut self, py: Python<'py>, values: &[f64]) -> Bound<'py, PyAny> {
        let slot = &mut self.slots[self.next];
        self.next = (self.next + 1) % 3;
        if let Some(array) = slot
            && overwrite(array.bind(py), values)
        {
            return array.bind(py).clone();
        }
        let array = new_array(py, &[values.len()], values);
        *slot = Some(array.clone().unbind());
        array
    }
}

/// Creates an array (R, `width`) of the first `width` numbers of each row.
#[inline(never)]
pub(crate) fn new_rows<'py, const R: usize, const C: usize>(
    py: Python<'py>,
    width: usize,
    rows: &[[f64; C]; R],
) -> Bound<'py, PyAny> {
    let array = PyArray2::<f64>::zeros(py, [R, width], false).into_any();
    write_rows(&array, width, rows);
    array
}

/// Creates an array of zeros; raises `MemoryError` if it does not fit in memory.
pub(crate) fn zeros<'py>(py: Python<'py>, shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    py.import("numpy")?.call_method1("zeros", (PyTuple::new(py, shape)?,))
}

/// Makes an array read-only for Python.
pub(crate) fn freeze(array: &Bound<'_, PyAny>) -> PyResult<()> {
    array.getattr("flags")?.setattr("writeable", false)
}
