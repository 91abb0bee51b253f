//! Python class `Payload`, and the keyword arguments of `Model.from_urdf`.

use std::collections::BTreeMap;

use pliant_core::{ModelOptions, Payload as CorePayload, Servos as CoreServos};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping};

use crate::error::{OrRaise, config, shown, suggestion};
use crate::kinds::wrong;
use crate::ndarray::new_array;
use crate::read::{number, vector3};
use crate::servos::Servos;

#[doc = stub!(Payload)]
#[pyclass(name = "Payload", module = "pliant", frozen, eq, from_py_object)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Payload(pub(crate) CorePayload);

#[pymethods]
impl Payload {
    #[new]
    #[pyo3(signature = (mass, com = None), text_signature = "(mass, com=(0.0, 0.0, 0.0))")]
    fn new(mass: &Bound<'_, PyAny>, com: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let mass =
            number(mass).ok_or_else(|| config("payload.mass", format!("must be a number, got {}", shown(mass))))?;
        let payload = CorePayload { mass, com: com.map_or(Ok([0.0; 3]), |com| vector3("payload.com", com))? };
        payload.validate().or_raise()?;
        Ok(Self(payload))
    }

    #[doc = stub!(Payload.mass)]
    #[getter]
    fn mass(&self) -> f64 {
        self.0.mass
    }

    #[doc = stub!(Payload.com)]
    #[getter]
    fn com<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[3], &self.0.com)
    }

    fn __repr__(&self) -> String {
        let [x, y, z] = self.0.com;
        format!("Payload(mass={:?}, com=({x:?}, {y:?}, {z:?}))", self.0.mass)
    }

    fn __getnewargs__(&self) -> (f64, [f64; 3]) {
        (self.0.mass, self.0.com)
    }
}

/// Reads a `Payload`, or a pair of mass [kg] and centre of mass (3,) [m].
fn payload(value: &Bound<'_, PyAny>) -> PyResult<CorePayload> {
    if let Ok(payload) = value.cast::<Payload>() {
        return Ok(payload.get().0);
    }
    match value.extract::<(Bound<'_, PyAny>, Bound<'_, PyAny>)>() {
        Ok((mass, com)) => Payload::new(&mass, Some(&com)).map(|payload| payload.0),
        Err(_) => Err(config("payload", format!("must be a Payload or (mass, com), got {}", shown(value)))),
    }
}

/// Reads a mapping from joint names to values. `read` converts a value; its first argument is the key for error
/// messages.
fn by_joint<T>(
    name: &str,
    value: &Bound<'_, PyAny>,
    expected: &str,
    read: impl Fn(&str, &Bound<'_, PyAny>) -> PyResult<T>,
) -> PyResult<BTreeMap<String, T>> {
    let mapping = value.cast::<PyMapping>().map_err(|_| wrong(name, expected, value))?;
    let mut out = BTreeMap::new();
    for item in mapping.items()?.iter() {
        let (key, it): (Bound<'_, PyAny>, Bound<'_, PyAny>) = item.extract()?;
        let key: String = key.extract().map_err(|_| wrong(name, expected, value))?;
        let it = read(&format!("{name}.{key}"), &it)?;
        out.insert(key, it);
    }
    Ok(out)
}

const KEYWORDS: [&str; 7] = ["base", "tip", "locked", "payload", "gravity", "limits", "servos"];

/// Reads the keyword arguments of `Model.from_urdf`; an argument that is `None` keeps its default.
pub(crate) fn read(keywords: Option<&Bound<'_, PyDict>>) -> PyResult<(ModelOptions, Option<CoreServos>)> {
    let (mut options, mut servos) = (ModelOptions::default(), None);
    for (name, value) in keywords.into_iter().flatten() {
        let name: String = name.extract()?;
        let refused = |expected: &str| wrong(&name, expected, &value);
        match name.as_str() {
            known if value.is_none() && KEYWORDS.contains(&known) => {}
            "base" => options.base = Some(value.extract().map_err(|_| refused("the name of a link"))?),
            "tip" => options.tip = Some(value.extract().map_err(|_| refused("the name of a link"))?),
            "locked" => {
                options.locked = by_joint(&name, &value, "a dict such as {'gripper': 0.3}", |of, it| {
                    number(it).ok_or_else(|| wrong(of, "a position [rad or m]", it))
                })?;
            }
            "limits" => {
                options.limits = by_joint(&name, &value, "a dict such as {'elbow': (-1.0, 2.0)}", |of, it| {
                    it.extract().map_err(|_| wrong(of, "a pair (lower, upper) [rad or m]", it))
                })?;
            }
            "payload" => options.payload = Some(payload(&value)?),
            "gravity" => options.gravity = vector3("gravity", &value)?,
            "servos" => servos = Some(value.cast::<Servos>().map_err(|_| refused("Servos"))?.get().0.clone()),
            _ => {
                let hint = suggestion(value.py(), &name, &KEYWORDS, ".");
                return Err(config(&name, format!("no such keyword{hint} Keywords: {}", KEYWORDS.join(", "))));
            }
        }
    }
    Ok((options, servos))
}
