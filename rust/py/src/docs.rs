//! Docstrings of classes and members, out of the stub `python/pliant/_core.pyi`, the one place that has them.
//!
//! PyO3 makes docstrings of Rust comments, which would say everything a second time. But a class keeps the tables of
//! methods and attributes that it was made of, and what `help()` shows it reads from there when asked; so the stub's
//! texts, which `build.rs` read, are put into the tables when the module is loaded. Functions have no such table: they
//! carry the attribute `#[doc = stub!(name)]`.
#![expect(
    unsafe_code,
    reason = "the tables are C arrays, which Python's C interface hands out and nothing else can reach"
)]

use std::ffi::{CStr, CString, c_char, c_int};

use pyo3::ffi;
use pyo3::prelude::*;
use pyo3::types::PyType;

include!(concat!(env!("OUT_DIR"), "/stub.rs"));

/// A class, its docstring, its members and theirs.
type Class = (&'static str, &'static str, &'static [(&'static str, &'static CStr)]);

/// What separates a signature from the docstring in the text of a method.
const SEPARATOR: &str = "--\n\n";

/// Gives every class of the module and its members their docstrings.
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

/// An entry of a table of a class.
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

/// Changes the entries of one table of a class.
fn each<T: Entry>(
    class: &Bound<'_, PyType>,
    slot: c_int,
    mut change: impl FnMut(&mut T) -> PyResult<()>,
) -> PyResult<()> {
    // SAFETY: a class made from a specification, as PyO3 makes them, answers for every slot, with null for none.
    let mut entry = unsafe { ffi::PyType_GetSlot(class.as_type_ptr(), slot) }.cast::<T>();
    // SAFETY: such a table ends with a nameless entry. PyO3 gives it away on the heap and never looks at it again,
    // fields lie within the class itself; Python's descriptors read it only under the interpreter lock, held here.
    while let Some(found) = unsafe { entry.as_mut() }.filter(|found| !found.name().is_null()) {
        change(found)?;
        // SAFETY: the entry had a name, so another follows.
        entry = unsafe { entry.add(1) };
    }
    Ok(())
}

/// A docstring behind the signature that PyO3 put before it.
fn with_signature(old: *const c_char, doc: &CStr) -> PyResult<CString> {
    // SAFETY: PyO3's text of a method is a C string that is never freed; Python allows null for none.
    let old = if old.is_null() { c"" } else { unsafe { CStr::from_ptr(old) } }.to_string_lossy();
    let signature = old.split_once(SEPARATOR).map_or(String::new(), |(signature, _)| format!("{signature}{SEPARATOR}"));
    Ok(CString::new(signature + &doc.to_string_lossy())?)
}
