//! `Model` and `Payload`.
#![expect(non_snake_case, reason = "`Q` holds many `q`, as documented")]

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;

use pliant_core::{IkOptions, Model as CoreModel, ModelOptions, Payload as CorePayload, Reference};
use pyo3::exceptions::PyFileNotFoundError;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyTuple;

use crate::convert::{freeze, new_array};
use crate::error::{OrRaise, config, shown};
use crate::kinds::Kind;
use crate::kinematics::{self, positions};
use crate::pose::matrix;
use crate::read::{number, vector3};
use crate::servos::Servos;
use crate::solution::{IkSolution, search};
use crate::tree::{Joint, Link};
use crate::words::{Word, Words};

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
        let mass =
            number(mass).ok_or_else(|| config("payload.mass", format!("must be a number, got {}", shown(mass))))?;
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

    #[pyo3(signature = (q, reference = None, out = None), text_signature = "($self, q, reference='world_aligned', out=None)")]
    fn kinematics<'py>(
        &self,
        q: &Bound<'py, PyAny>,
        reference: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        kinematics::both(&self.core, q, axes_of(reference)?, out)
    }

    fn forward_kinematics<'py>(&self, q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let pose = self.core.forward_kinematics(&positions(&self.core, q)?[..self.core.n()]).or_raise()?;
        Ok(matrix(q.py(), &pose))
    }

    #[pyo3(signature = (q, reference = None), text_signature = "($self, q, reference='world_aligned')")]
    fn jacobian<'py>(
        &self,
        q: &Bound<'py, PyAny>,
        reference: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        kinematics::jacobian(&self.core, q, axes_of(reference)?)
    }

    fn gravity<'py>(&self, q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let n = self.core.n();
        let torque = self.core.gravity(&positions(&self.core, q)?[..n]).or_raise()?;
        Ok(new_array(q.py(), &[n], torque.as_slice()))
    }

    #[pyo3(
        signature = (target, q0, *, axes = None, position_tolerance = 1e-8, rotation_tolerance = 1e-8, max_iterations = 100, restarts = 8),
        text_signature = "($self, target, q0, *, axes='xyz rpy', position_tolerance=1e-08, rotation_tolerance=1e-08, \
                          max_iterations=100, restarts=8)"
    )]
    #[expect(clippy::too_many_arguments, reason = "keyword-only and named")]
    fn inverse_kinematics(
        &self,
        target: &Bound<'_, PyAny>,
        q0: &Bound<'_, PyAny>,
        axes: Option<&Bound<'_, PyAny>>,
        position_tolerance: f64,
        rotation_tolerance: f64,
        max_iterations: usize,
        restarts: usize,
    ) -> PyResult<IkSolution> {
        let options =
            IkOptions { position_tolerance, rotation_tolerance, max_iterations, restarts, ..IkOptions::default() };
        search(self, target, q0, axes, options)
    }

    #[pyo3(signature = (Q, reference = None), text_signature = "($self, Q, reference='world_aligned')")]
    fn kinematics_batch<'py>(
        &self,
        Q: &Bound<'py, PyAny>,
        reference: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        Ok((kinematics::poses(&self.core, Q)?, kinematics::jacobians(&self.core, Q, axes_of(reference)?)?))
    }

    fn forward_kinematics_batch<'py>(&self, Q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        kinematics::poses(&self.core, Q)
    }

    #[pyo3(signature = (Q, reference = None), text_signature = "($self, Q, reference='world_aligned')")]
    fn jacobian_batch<'py>(
        &self,
        Q: &Bound<'py, PyAny>,
        reference: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        kinematics::jacobians(&self.core, Q, axes_of(reference)?)
    }

    fn gravity_batch<'py>(&self, Q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        kinematics::gravities(&self.core, Q)
    }

    fn __repr__(&self) -> String {
        let core = &self.core;
        format!("<Model '{}': {} joints, {} to {}>", core.name(), core.n(), core.base(), core.tip())
    }
}

fn axes_of(reference: Option<&Bound<'_, PyAny>>) -> PyResult<Reference> {
    reference.map_or(Ok(Reference::WorldAligned), |word| Word::<Reference>::read("reference", word))
}

/// A read-only vector.
fn frozen<'py>(py: Python<'py>, values: &[f64]) -> PyResult<Bound<'py, PyAny>> {
    let array = new_array(py, &[values.len()], values);
    freeze(&array)?;
    Ok(array)
}

/// NaN where there is no value.
fn present(values: &[Option<f64>]) -> Vec<f64> {
    values.iter().map(|value| value.unwrap_or(f64::NAN)).collect()
}
