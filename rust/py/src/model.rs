//! `Model` and `Payload`.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use pliant_core::{JointVec, MAX_AXES, MAX_JOINTS, Model as CoreModel, ModelOptions, Payload as CorePayload, Pose, Reference};
use pyo3::exceptions::PyFileNotFoundError;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyTuple;

use crate::convert::{freeze, new_array};
use crate::error::{OrRaise, config, shown};
use crate::pose::matrix;
use crate::read::{joints, number, vector3};
use crate::servos::Servos;
use crate::tree::{Joint, Link};
use crate::words::{Word, Words};
use crate::kinds::Kind;

impl Words for Reference {
    const WORDS: &'static [(&'static str, Self)] = &[("world_aligned", Self::WorldAligned), ("local", Self::Local)];
}

/// A point mass in the tool frame.
#[pyclass(name = "Payload", module = "pliant", frozen, eq, from_py_object)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Payload(pub(crate) CorePayload);

#[pymethods]
impl Payload {
    #[new]
    #[pyo3(signature = (mass, com = None))]
    fn new(mass: &Bound<'_, PyAny>, com: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let mass = number(mass).ok_or_else(|| config("payload.mass", format!("must be a number, got {}", shown(mass))))?;
        let payload = CorePayload { mass, com: com.map_or(Ok([0.0; 3]), |com| vector3("payload.com", com))? };
        payload.validate().or_raise()?;
        Ok(Self(payload))
    }

    #[getter]
    fn mass(&self) -> f64 {
        self.0.mass
    }

    #[getter]
    fn com<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[3], &self.0.com)
    }

    fn __repr__(&self) -> String {
        format!("Payload(mass={:?}, com={:?})", self.0.mass, self.0.com)
    }

    fn __getnewargs__(&self) -> (f64, [f64; 3]) {
        (self.0.mass, self.0.com)
    }
}

/// One kinematic chain with every body it carries; immutable.
#[pyclass(module = "pliant", frozen)]
#[derive(Debug)]
pub(crate) struct Model {
    pub(crate) core: Arc<CoreModel>,
    /// Spread to the chain's joints.
    pub(crate) servos: Option<Py<Servos>>,
    links: PyOnceLock<Py<PyTuple>>,
    joints: PyOnceLock<Py<PyTuple>>,
}

/// Arguments that say which part of a robot a model is, and what it carries.
struct Choice<'a, 'py> {
    payload: Option<&'a Bound<'py, PyAny>>,
    gravity: Option<&'a Bound<'py, PyAny>>,
    servos: Option<&'a Servos>,
    options: ModelOptions,
}

impl Choice<'_, '_> {
    fn options(&self) -> PyResult<ModelOptions> {
        let mut options = self.options.clone();
        options.payload = self.payload.map(read_payload).transpose()?;
        if let Some(gravity) = self.gravity {
            options.gravity = vector3("gravity", gravity)?;
        }
        Ok(options)
    }

    fn model(&self, py: Python<'_>, core: CoreModel) -> PyResult<Model> {
        let spread = self.servos.map(|servos| servos.0.for_joints(core.n()).or_raise()).transpose()?;
        let servos = spread.map(|servos| Py::new(py, Servos(servos))).transpose()?;
        Ok(Model { core: Arc::new(core), servos, links: PyOnceLock::new(), joints: PyOnceLock::new() })
    }
}

fn read_payload(value: &Bound<'_, PyAny>) -> PyResult<CorePayload> {
    if let Ok(payload) = value.cast::<Payload>() {
        return Ok(payload.get().0);
    }
    match value.extract::<(Bound<'_, PyAny>, Bound<'_, PyAny>)>() {
        Ok((mass, com)) => Payload::new(&mass, Some(&com)).map(|payload| payload.0),
        Err(_) => Err(config("payload", format!("must be a Payload or (mass, com), got {}", shown(value)))),
    }
}

#[pymethods]
impl Model {
    #[staticmethod]
    #[pyo3(
        signature = (source, *, base = None, tip = None, locked = None, payload = None, gravity = None, limits = None, servos = None),
        text_signature = "(source, *, base=None, tip=None, locked=None, payload=None, gravity=(0.0, 0.0, -9.81), limits=None, \
                          servos=None)"
    )]
    #[expect(clippy::too_many_arguments, reason = "keyword-only and named")]
    fn from_urdf(
        py: Python<'_>,
        source: PathBuf,
        base: Option<String>,
        tip: Option<String>,
        locked: Option<BTreeMap<String, f64>>,
        payload: Option<&Bound<'_, PyAny>>,
        gravity: Option<&Bound<'_, PyAny>>,
        limits: Option<BTreeMap<String, (f64, f64)>>,
        servos: Option<&Servos>,
    ) -> PyResult<Self> {
        let options = ModelOptions {
            base,
            tip,
            locked: locked.unwrap_or_default(),
            limits: limits.unwrap_or_default(),
            ..ModelOptions::default()
        };
        let choice = Choice { payload, gravity, servos, options };
        if !source.exists() {
            let shown = source.display().to_string();
            let hint = if shown.trim_start().starts_with('<') {
                "this is XML text: use Model.from_urdf_str".into()
            } else {
                format!("no such file: '{shown}'")
            };
            return Err(PyFileNotFoundError::new_err(hint));
        }
        let options = choice.options()?;
        choice.model(py, py.detach(|| CoreModel::from_urdf_file(&source, &options)).or_raise()?)
    }

    #[staticmethod]
    #[pyo3(
        signature = (text, *, base = None, tip = None, locked = None, payload = None, gravity = None, limits = None, servos = None),
        text_signature = "(text, *, base=None, tip=None, locked=None, payload=None, gravity=(0.0, 0.0, -9.81), limits=None, \
                          servos=None)"
    )]
    #[expect(clippy::too_many_arguments, reason = "keyword-only and named")]
    fn from_urdf_str(
        py: Python<'_>,
        text: &str,
        base: Option<String>,
        tip: Option<String>,
        locked: Option<BTreeMap<String, f64>>,
        payload: Option<&Bound<'_, PyAny>>,
        gravity: Option<&Bound<'_, PyAny>>,
        limits: Option<BTreeMap<String, (f64, f64)>>,
        servos: Option<&Servos>,
    ) -> PyResult<Self> {
        let options = ModelOptions {
            base,
            tip,
            locked: locked.unwrap_or_default(),
            limits: limits.unwrap_or_default(),
            ..ModelOptions::default()
        };
        let choice = Choice { payload, gravity, servos, options };
        let options = choice.options()?;
        choice.model(py, py.detach(|| CoreModel::from_urdf_str(text, &options)).or_raise()?)
    }

    #[getter]
    fn name(&self) -> &str {
        self.core.name()
    }

    #[getter]
    fn n(&self) -> usize {
        self.core.n()
    }

    #[getter]
    fn joint_names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.core.joint_names())
    }

    #[getter]
    fn lower<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frozen(py, self.core.lower())
    }

    #[getter]
    fn upper<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frozen(py, self.core.upper())
    }

    #[getter]
    fn velocity_limit<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frozen(py, &present(self.core.velocity_limit()))
    }

    #[getter]
    fn effort_limit<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frozen(py, &present(self.core.effort_limit()))
    }

    #[getter]
    fn prismatic<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.core.prismatic())
    }

    #[getter]
    fn frames<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.core.frames())
    }

    #[getter]
    fn base(&self) -> &str {
        self.core.base()
    }

    #[getter]
    fn tip(&self) -> &str {
        self.core.tip()
    }

    #[getter]
    fn reach(&self) -> f64 {
        self.core.reach()
    }

    #[getter]
    fn gravity_vector<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frozen(py, &self.core.gravity_vector())
    }

    #[getter]
    fn payload(&self) -> Option<Payload> {
        self.core.payload().copied().map(Payload)
    }

    #[getter]
    fn servos(&self, py: Python<'_>) -> Option<Py<Servos>> {
        self.servos.as_ref().map(|servos| servos.clone_ref(py))
    }

    #[getter]
    fn links(&self, py: Python<'_>) -> PyResult<Py<PyTuple>> {
        let made = || PyTuple::new(py, self.core.links().iter().map(|link| Link(link.clone()))).map(Bound::unbind);
        self.links.get_or_try_init(py, made).map(|links| links.clone_ref(py))
    }

    #[getter]
    fn joints(&self, py: Python<'_>) -> PyResult<Py<PyTuple>> {
        let made = || PyTuple::new(py, self.core.joints().iter().map(|joint| Joint(joint.clone()))).map(Bound::unbind);
        self.joints.get_or_try_init(py, made).map(|joints| joints.clone_ref(py))
    }

    fn __repr__(&self) -> String {
        let core = &self.core;
        format!("<Model '{}': {} joints, {} to {}>", core.name(), core.n(), core.base(), core.tip())
    }
}
