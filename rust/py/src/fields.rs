//! Python value classes for structs of the core: frozen, created from keyword arguments, with getters, `replace`, repr
//! and pickling.

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyFloat, PyList, PyTuple};

use crate::error::{config, suggestion};

/// Hooks with which a value class extends what [`fields!`](crate::fields::fields) defines.
pub(crate) trait Special: Sized {
    /// Adjusts an object that a constructor or `replace` has created with `changes`. A group of settings records here
    /// which fields were given; the default returns the object unchanged.
    fn after(self, _before: Option<&Self>, _changes: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        Ok(self)
    }

    /// Returns a hint for the error message about the unknown field `name`, if another class has that field.
    fn elsewhere(_name: &str) -> Option<String> {
        None
    }
}

/// A value class for a struct of the core, defined by [`fields!`](crate::fields::fields).
pub(crate) trait Fields: Special {
    /// Struct of the core that the class wraps.
    type Core: Clone;

    /// Name of the Python class.
    const CLASS: &'static str;

    /// Prefix of field names in messages, e.g. `tracking.`; empty if the names are clear without one.
    const OWNER: &'static str;

    /// Names of the fields, in the order of their declaration.
    const NAMES: &'static [&'static str];

    /// Sets one field; returns `false` if `name` is not in [`Fields::NAMES`].
    fn set(core: &mut Self::Core, name: &str, value: &Bound<'_, PyAny>) -> PyResult<bool>;

    /// Returns the fields in which `core` differs from `base`, as plain Python values.
    fn changed<'py>(core: &Self::Core, base: &Self::Core, py: Python<'py>) -> PyResult<Bound<'py, PyDict>>;

    /// Returns the fields for which `given` is true, as plain Python values.
    fn chosen<'py>(core: &Self::Core, given: impl Fn(&str) -> bool, py: Python<'py>) -> PyResult<Bound<'py, PyDict>>;

    /// Copies the fields for which `given` is true from `from` to `to`.
    fn copy(to: &mut Self::Core, from: &Self::Core, given: impl Fn(&str) -> bool);

    /// Validates a struct of the core and wraps it.
    fn validated(core: Self::Core) -> PyResult<Self>;

    /// Returns `base` with the fields in `changes` replaced, after validation.
    fn with(mut base: Self::Core, changes: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        for (key, value) in changes.into_iter().flatten() {
            let name: String = key.extract()?;
            if !Self::set(&mut base, &name, &value)? {
                let hint = Self::elsewhere(&name).unwrap_or_else(|| suggestion(key.py(), &name, Self::NAMES, "."));
                let known = Self::NAMES.join(", ");
                return Err(config(&name, format!("{} has no such field{hint} Fields: {known}", Self::CLASS)));
            }
        }
        Self::validated(base)
    }
}

/// Formats `Class(name=value, …)` with the given fields.
pub(crate) fn call_text(class: &str, fields: &Bound<'_, PyDict>) -> PyResult<String> {
    let parts = fields.iter().map(|(name, value)| Ok(format!("{name}={}", text(&value)?)));
    Ok(format!("{class}({})", parts.collect::<PyResult<Vec<_>>>()?.join(", ")))
}

/// Returns Python's repr of a value, with infinity written as `float('inf')` so that the text can be evaluated.
pub(crate) fn text(value: &Bound<'_, PyAny>) -> PyResult<String> {
    if let Ok(number) = value.cast::<PyFloat>() {
        return Ok(match number.value() {
            x if x == f64::INFINITY => "float('inf')".into(),
            x if x == f64::NEG_INFINITY => "-float('inf')".into(),
            _ => number.repr()?.to_string(),
        });
    }
    let parts = |items: Vec<Bound<'_, PyAny>>| items.iter().map(text).collect::<PyResult<Vec<_>>>();
    if let Ok(list) = value.cast::<PyList>() {
        return Ok(format!("[{}]", parts(list.iter().collect())?.join(", ")));
    }
    if let Ok(tuple) = value.cast::<PyTuple>() {
        let comma = if tuple.len() == 1 { "," } else { "" };
        return Ok(format!("({}{comma})", parts(tuple.iter().collect())?.join(", ")));
    }
    Ok(value.repr()?.to_string())
}

/// Returns attributes of an object by name, in this order.
pub(crate) fn attributes<'py>(object: &Bound<'py, PyAny>, names: &[&str]) -> PyResult<Bound<'py, PyTuple>> {
    let values = names.iter().map(|name| object.getattr(*name)).collect::<PyResult<Vec<_>>>()?;
    PyTuple::new(object.py(), values)
}

/// Calls the class of an object with its attributes `names`, of which some are changed.
pub(crate) fn replaced<'py>(
    object: &Bound<'py, PyAny>,
    names: &[&str],
    changes: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let arguments = PyDict::new(object.py());
    for name in names {
        arguments.set_item(*name, object.getattr(*name)?)?;
    }
    if let Some(changes) = changes {
        arguments.update(changes.as_mapping())?;
    }
    object.get_type().call((), Some(&arguments))
}

pub(crate) fn differ<T: PartialEq>(a: &T, b: &T) -> bool {
    a != b
}

/// Implements [`Fields`], the getters, `replace`, repr and pickling of a value class.
macro_rules! fields {
    (
        $class:ident($name:literal $(, $prefix:literal)?) of $core:ty {
            $($field:ident: $kind:ty,)*
        }
    ) => {
        impl $crate::fields::Fields for $class {
            type Core = $core;

            const CLASS: &'static str = $name;

            const OWNER: &'static str = concat!($($prefix)?);

            const NAMES: &'static [&'static str] = &[$(stringify!($field)),*];

            fn set(core: &mut $core, name: &str, value: &Bound<'_, PyAny>) -> PyResult<bool> {
                match name {
                    $(stringify!($field) => {
                        $crate::kinds::update::<$kind>(&mut core.$field, &format!("{}{name}", Self::OWNER), value)?;
                    })*
                    _ => return Ok(false),
                }
                Ok(true)
            }

            fn changed<'py>(core: &$core, base: &$core, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
                let out = PyDict::new(py);
                $(if $crate::fields::differ(&core.$field, &base.$field) {
                    out.set_item(stringify!($field), $crate::kinds::plain::<$kind>(&core.$field, py)?)?;
                })*
                Ok(out)
            }

            fn chosen<'py>(
                core: &$core,
                given: impl Fn(&str) -> bool,
                py: Python<'py>,
            ) -> PyResult<Bound<'py, PyDict>> {
                let out = PyDict::new(py);
                $(if given(stringify!($field)) {
                    out.set_item(stringify!($field), $crate::kinds::plain::<$kind>(&core.$field, py)?)?;
                })*
                Ok(out)
            }

            fn copy(to: &mut $core, from: &$core, given: impl Fn(&str) -> bool) {
                $(if given(stringify!($field)) {
                    to.$field.clone_from(&from.$field);
                })*
            }

            fn validated(core: $core) -> PyResult<Self> {
                $class::check(&core)
            }
        }

        #[pymethods]
        impl $class {
            $(#[doc = stub!($class.$field)]
            #[getter]
            fn $field<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
                $crate::kinds::show::<$kind>(&self.0.$field, py)
            })*

            #[doc = stub!($class.replace)]
            #[pyo3(signature = (**changes))]
            fn replace(&self, changes: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
                let made = <Self as $crate::fields::Fields>::with(self.0.clone(), changes)?;
                $crate::fields::Special::after(made, Some(self), changes)
            }

            fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
                $crate::fields::call_text($name, &self.fields(py)?)
            }

            fn __getnewargs_ex__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyTuple>, Bound<'py, PyDict>)> {
                Ok((PyTuple::empty(py), self.fields(py)?))
            }
        }
    };
}

pub(crate) use fields;
