//! Docstrings of classes and members, taken from the stub `python/pliant/_core.pyi`, their single source.
//!
//! PyO3 makes docstrings from Rust comments, which would duplicate the stub. A class keeps the tables of its methods
//! and attributes, and `help()` reads the docstrings from there. Therefore the stub's texts, read by `build.rs`, are
//! written into these tables when the module is loaded. Functions have no such table: they use the attribute `#[doc =
//! stub!(name)]`.
#![expect(
    unsafe_code,
    reason = "the tables are C arrays, which Python's C interface hands out and nothing else can reach"
)]

use std::ffi::{CStr, CString, c_char, c_int};

use pyo3::ffi;
use pyo3::prelude::*;
use pyo3::types::PyType;

include!(concat!(env!("OUT_DIR"), "/stub.rs"));

/// Name and docstring of a class, names and docstrings of its members.
type Class = (&'static str, &'static str, &'static [(&'static str, &'static CStr)]);

/// Separator between signature and docstring in the text of a method.
const SEPARATOR: &str = "--\n\n";

/// Sets the docstrings of all classes of the module and of their members.
pub(crate) fn attach(module: &Bound<'_, PyModule>) -> PyResult<()> {
    for (name, doc, members) in CLASSES {
        let class = module.getattr(*name)?.cast_into::<PyType>()?;
        class.setattr("__doc__", doc)?;
        if members.is_empty() {
            continue;
        }
        let of = |name: *const c_char| {
            // SAFETY: names in these tables are C strings that live as long as the class.
            let name = unsafe { CStr::from_ptr(name) };
            members.iter().find(|(member, _)| member.as_bytes() == name.to_bytes()).map(|(_, doc)| *doc)
        };
        each::<ffi::PyMethodDef>(&class, ffi::Py_tp_methods, |method| {
            let Some(doc) = of(method.ml_name) else { return Ok(()) };
            method.ml_doc = with_signature(method.ml_doc, doc)?.into_raw();
            Ok(())
        })?;
        each::<ffi::PyGetSetDef>(&class, ffi::Py_tp_getset, |attribute| {
            attribute.doc = of(attribute.name).map_or(attribute.doc, CStr::as_ptr);
            Ok(())
        })?;
        each::<ffi::PyMemberDef>(&class, ffi::Py_tp_members, |field| {
            field.doc = of(field.name).map_or(field.doc, CStr::as_ptr);
            Ok(())
        })?;
    }
    Ok(())
}

/// Entry of a class's method or attribute table.
trait Entry {
    fn name(&self) -> *const c_char;
}

impl Entry for ffi::PyMethodDef {
    fn name(&self) -> *const c_char {
        self.ml_name
    }
}

impl Entry for ffi::PyGetSetDef {
    fn name(&self) -> *const c_char {
        self.name
    }
}

impl Entry for ffi::PyMemberDef {
    fn name(&self) -> *const c_char {
        self.name
    }
}

/// Applies a function to the entries of one table of a class.
fn each<T: Entry>(
    class: &Bound<'_, PyType>,
    slot: c_int,
    mut change: impl FnMut(&mut T) -> PyResult<()>,
) -> PyResult<()> {
    // SAFETY: a class made from a specification, as PyO3 makes them, answers for every slot, with null for an empty
    // one.
    let mut entry = unsafe { ffi::PyType_GetSlot(class.as_type_ptr(), slot) }.cast::<T>();
    // SAFETY: such a table ends with a nameless entry. PyO3 leaks it on the heap and does not access it again; fields
    // lie within the class itself. Python's descriptors read it only under the interpreter lock, held here.
    while let Some(found) = unsafe { entry.as_mut() }.filter(|found| !found.name().is_null()) {
        change(found)?;
        // SAFETY: the entry had a name, so another follows.
        entry = unsafe { entry.add(1) };
    }
    Ok(())
}

/// Returns a docstring after the signature that PyO3 wrote.
fn with_signature(old: *const c_char, doc: &CStr) -> PyResult<CString> {
    // SAFETY: PyO3's text of a method is a C string that is never freed; null means no text.
    let old = if old.is_null() { c"" } else { unsafe { CStr::from_ptr(old) } }.to_string_lossy();
    let signature = old.split_once(SEPARATOR).map_or(String::new(), |(signature, _)| format!("{signature}{SEPARATOR}"));
    Ok(CString::new(signature + &doc.to_string_lossy())?)
}
