//! Conversion of enums of the core from and to names such as `"cap"`.

use std::marker::PhantomData;

use pliant_core::{
    CompliantSide, Follow, GravityUse, Law, LimitRule, LimitType, OnDeviationLimit, Profile, Projector, Reference,
};
use pyo3::prelude::*;
use pyo3::types::PyString;

use crate::error::{config, shown, suggestion};
use crate::kinds::Kind;

/// A field that holds an enum, whose variants are strings in Python.
pub(crate) struct Word<E>(PhantomData<E>);

/// An enum whose variants have names in Python.
pub(crate) trait Words: Copy + PartialEq + 'static {
    /// Name and value of each variant.
    const WORDS: &'static [(&'static str, Self)];
}

impl<E: Words> Kind for Word<E> {
    type Core = E;

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<E> {
        let word: Option<String> = value.extract().ok();
        if let Some((_, found)) = E::WORDS.iter().find(|(known, _)| Some(*known) == word.as_deref()) {
            return Ok(*found);
        }
        let names: Vec<&str> = E::WORDS.iter().map(|(known, _)| *known).collect();
        let hint = word.map_or_else(String::new, |word| suggestion(value.py(), &word, &names, ""));
        let list = names.iter().map(|known| format!("'{known}'")).collect::<Vec<_>>().join(", ");
        Err(config(name, format!("must be one of {list}, got {}{hint}", shown(value))))
    }

    fn plain<'py>(core: &E, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let word = E::WORDS.iter().find(|(_, known)| known == core).map_or("", |(word, _)| word);
        Ok(PyString::new(py, word).into_any())
    }
}

/// Implements [`Words`] for enums whose names are defined in the core.
macro_rules! words_of_core {
    ($($choice:ty),*) => {
        $(impl Words for $choice {
            const WORDS: &'static [(&'static str, Self)] = <$choice>::NAMES;
        })*
    };
}

words_of_core!(Law, Follow, LimitRule, Projector, Profile, OnDeviationLimit, CompliantSide, LimitType, Reference);

impl Words for GravityUse {
    const WORDS: &'static [(&'static str, Self)] =
        &[("both", Self::Both), ("goal", Self::Goal), ("limits", Self::Limits)];
}
