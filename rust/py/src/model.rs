//! Python class `Model`: a kinematic chain read from a URDF.
#![expect(non_snake_case, reason = "`Q` holds many `q`, as documented")]

use std::path::PathBuf;
use std::sync::Arc;

use pliant_core::{IkOptions, Model as CoreModel, Reference, Servos as CoreServos};
use pyo3::exceptions::PyFileNotFoundError;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::{PyDict, PyTuple};

use crate::error::{OrRaise, wrong_type};
use crate::kinds::Kind;
use crate::kinematics::positions;
use crate::ndarray::{freeze, new_array};
use crate::options::Payload;
use crate::pickle::Reduced;
use crate::pose::matrix;
use crate::read::{count, joints, pose, real, set_if_some};
use crate::servos::Servos;
use crate::solution::{IkResult, search};
use crate::tree::{Joint, Link};
use crate::words::Word;
use crate::{arguments, kinematics, pickle};

#[doc = stub!(Model)]
#[pyclass(module = "pliant", frozen)]
pub(crate) struct Model {
    pub(crate) core: Arc<CoreModel>,
    /// Default servos of a controller, with one entry per joint; `None` if the model has none.
    pub(crate) servos: Option<Py<Servos>>,
    /// URDF text of the model.
    text: String,
    /// Keyword arguments of the call that created the model; `None` if there were none.
    options: Option<Py<PyDict>>,
    links: PyOnceLock<Py<PyTuple>>,
    joints: PyOnceLock<Py<PyTuple>>,
}

impl Model {
    fn new(
        py: Python<'_>,
        core: CoreModel,
        servos: Option<&CoreServos>,
        text: String,
        options: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        // A deep copy, so that a pickle contains the arguments of this call even if the caller changes them later.
        let options = match options {
            Some(given) => Some(py.import("copy")?.call_method1("deepcopy", (given,))?.cast_into::<PyDict>()?.unbind()),
            None => None,
        };
        let spread = servos.map(|servos| servos.for_joints(core.n()).or_raise()).transpose()?;
        let servos = spread.map(|servos| Py::new(py, Servos(servos))).transpose()?;
        Ok(Self { core: Arc::new(core), servos, text, options, links: PyOnceLock::new(), joints: PyOnceLock::new() })
    }

    pub(crate) fn from_text(py: Python<'_>, text: &str, options: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let (read, servos) = crate::options::read(options)?;
        let core = py.detach(|| CoreModel::from_urdf_str(text, &read)).or_raise()?;
        Self::new(py, core, servos.as_ref(), text.to_owned(), options)
    }
}

#[pymethods]
impl Model {
    #[doc = stub!(Model.from_urdf)]
    #[staticmethod]
    #[pyo3(
        signature = (source, **options),
        text_signature = "(source, *, base=None, tip=None, locked=None, payload=None, gravity=(0.0, 0.0, -9.81), \
                          limits=None, servos=None)"
    )]
    fn from_urdf(source: &Bound<'_, PyAny>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let expected = "the path of a URDF file (str or pathlib.Path); for XML text there is Model.from_urdf_str";
        let path = source.extract::<PathBuf>().map_err(|_| wrong_type("source", expected, source))?;
        let py = source.py();
        let (read, servos) = crate::options::read(options)?;
        if !path.exists() {
            let path = path.display().to_string();
            let is_text = path.trim_start().starts_with('<');
            let message = if is_text { "this is XML text: use Model.from_urdf_str" } else { "no such file" };
            return Err(PyFileNotFoundError::new_err(format!(
                "{message}: '{}'",
                path.chars().take(200).collect::<String>()
            )));
        }
        let (core, text) = py.detach(|| CoreModel::from_urdf_file_with_text(&path, &read)).or_raise()?;
        Self::new(py, core, servos.as_ref(), text, options)
    }

    #[doc = stub!(Model.from_urdf_str)]
    #[staticmethod]
    #[pyo3(
        signature = (text, **options),
        text_signature = "(text, *, base=None, tip=None, locked=None, payload=None, gravity=(0.0, 0.0, -9.81), \
                          limits=None, servos=None)"
    )]
    fn from_urdf_str(text: &Bound<'_, PyAny>, options: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let expected = "URDF text; for a file there is Model.from_urdf";
        Self::from_text(text.py(), &arguments::text("text", expected, text)?, options)
    }

    #[doc = stub!(Model.source)]
    #[getter]
    fn source<'py>(&self, py: Python<'py>) -> PyResult<(&str, Bound<'py, PyDict>)> {
        let options = match &self.options {
            Some(own) => py.import("copy")?.call_method1("deepcopy", (own,))?.cast_into()?,
            None => PyDict::new(py),
        };
        Ok((&self.text, options))
    }

    #[doc = stub!(Model.with_servos)]
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 passes extracted arguments by value")]
    fn with_servos(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = arguments::servos)] servos: Py<Servos>,
    ) -> PyResult<Self> {
        let servos = Py::new(py, Servos(servos.get().0.for_joints(self.core.n()).or_raise()?))?;
        let options = self.options.as_ref().map_or_else(|| Ok(PyDict::new(py)), |options| options.bind(py).copy())?;
        options.set_item("servos", &servos)?;
        Ok(Self {
            core: Arc::clone(&self.core),
            servos: Some(servos),
            text: self.text.clone(),
            options: Some(options.unbind()),
            links: PyOnceLock::new(),
            joints: PyOnceLock::new(),
        })
    }

    #[doc = stub!(Model.name)]
    #[getter]
    fn name(&self) -> &str {
        self.core.name()
    }

    #[doc = stub!(Model.n)]
    #[getter]
    fn n(&self) -> usize {
        self.core.n()
    }

    #[doc = stub!(Model.joint_names)]
    #[getter]
    fn joint_names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.core.joint_names())
    }

    #[doc = stub!(Model.lower)]
    #[getter]
    fn lower<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frozen(py, self.core.lower())
    }

    #[doc = stub!(Model.upper)]
    #[getter]
    fn upper<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frozen(py, self.core.upper())
    }

    #[doc = stub!(Model.velocity_limit)]
    #[getter]
    fn velocity_limit<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frozen(py, &present(self.core.velocity_limit()))
    }

    #[doc = stub!(Model.effort_limit)]
    #[getter]
    fn effort_limit<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frozen(py, &present(self.core.effort_limit()))
    }

    #[doc = stub!(Model.prismatic)]
    #[getter]
    fn prismatic<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.core.prismatic())
    }

    #[doc = stub!(Model.frames)]
    #[getter]
    fn frames<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        PyTuple::new(py, self.core.frames())
    }

    #[doc = stub!(Model.base)]
    #[getter]
    fn base(&self) -> &str {
        self.core.base()
    }

    #[doc = stub!(Model.tip)]
    #[getter]
    fn tip(&self) -> &str {
        self.core.tip()
    }

    #[doc = stub!(Model.reach)]
    #[getter]
    fn reach(&self) -> f64 {
        self.core.reach()
    }

    #[doc = stub!(Model.reach_origin)]
    #[getter]
    fn reach_origin<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frozen(py, &self.core.reach_origin())
    }

    #[doc = stub!(Model.gravity_vector)]
    #[getter]
    fn gravity_vector<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        frozen(py, &self.core.gravity_vector())
    }

    #[doc = stub!(Model.payload)]
    #[getter]
    fn payload(&self) -> Option<Payload> {
        self.core.payload().copied().map(Payload)
    }

    #[doc = stub!(Model.servos)]
    #[getter]
    fn servos(&self, py: Python<'_>) -> Option<Py<Servos>> {
        self.servos.as_ref().map(|servos| servos.clone_ref(py))
    }

    #[doc = stub!(Model.links)]
    #[getter]
    fn links(&self, py: Python<'_>) -> PyResult<Py<PyTuple>> {
        let made = || PyTuple::new(py, self.core.links().iter().map(Link::from)).map(Bound::unbind);
        self.links.get_or_try_init(py, made).map(|links| links.clone_ref(py))
    }

    #[doc = stub!(Model.joints)]
    #[getter]
    fn joints(&self, py: Python<'_>) -> PyResult<Py<PyTuple>> {
        let made = || PyTuple::new(py, self.core.joints().iter().map(Joint::from)).map(Bound::unbind);
        self.joints.get_or_try_init(py, made).map(|joints| joints.clone_ref(py))
    }

    #[doc = stub!(Model.kinematics)]
    #[pyo3(signature = (q, reference = None, out = None), text_signature = "($self, q, reference='world_aligned', out=None)")]
    fn kinematics<'py>(
        &self,
        q: &Bound<'py, PyAny>,
        reference: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        kinematics::both(&self.core, q, axes_of(reference)?, out)
    }

    #[doc = stub!(Model.forward_kinematics)]
    fn forward_kinematics<'py>(&self, q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let pose = self.core.forward_kinematics(&positions(&self.core, q)?[..self.core.n()]).or_raise()?;
        Ok(matrix(q.py(), &pose))
    }

    #[doc = stub!(Model.jacobian)]
    #[pyo3(signature = (q, reference = None), text_signature = "($self, q, reference='world_aligned')")]
    fn jacobian<'py>(
        &self,
        q: &Bound<'py, PyAny>,
        reference: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        kinematics::jacobian(&self.core, q, axes_of(reference)?)
    }

    #[doc = stub!(Model.gravity)]
    fn gravity<'py>(&self, q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let n = self.core.n();
        let torque = self.core.gravity(&positions(&self.core, q)?[..n]).or_raise()?;
        Ok(new_array(q.py(), &[n], torque.as_slice()))
    }

    #[doc = stub!(Model.inverse_kinematics)]
    #[pyo3(
        signature = (target, q0, *, axes = None, position_tolerance = None, rotation_tolerance = None, max_iterations = None, restarts = None),
        text_signature = "($self, target, q0, *, axes='xyz rpy', position_tolerance=1e-08, rotation_tolerance=1e-08, \
                          max_iterations=100, restarts=8)"
    )]
    #[expect(clippy::too_many_arguments, reason = "keyword-only and named")]
    fn inverse_kinematics(
        &self,
        target: &Bound<'_, PyAny>,
        q0: &Bound<'_, PyAny>,
        axes: Option<&Bound<'_, PyAny>>,
        position_tolerance: Option<&Bound<'_, PyAny>>,
        rotation_tolerance: Option<&Bound<'_, PyAny>>,
        max_iterations: Option<&Bound<'_, PyAny>>,
        restarts: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<IkResult> {
        let mut options = IkOptions::default();
        set_if_some(&mut options.position_tolerance, position_tolerance, |it| {
            real("position_tolerance", "a number [m]", it)
        })?;
        set_if_some(&mut options.rotation_tolerance, rotation_tolerance, |it| {
            real("rotation_tolerance", "a number [rad]", it)
        })?;
        set_if_some(&mut options.max_iterations, max_iterations, |it| count("max_iterations", it))?;
        set_if_some(&mut options.restarts, restarts, |it| count("restarts", it))?;
        search(self, target, q0, axes, &options)
    }

    #[doc = stub!(Model.check_target)]
    fn check_target(&self, target: &Bound<'_, PyAny>) -> PyResult<()> {
        self.core.check_target(&pose("target", target, true)?).or_raise()
    }

    #[doc = stub!(Model.check_joint_target)]
    fn check_joint_target(&self, q: &Bound<'_, PyAny>) -> PyResult<()> {
        let n = self.core.n();
        self.core.check_joint_target(&joints("q", q, n)?[..n]).or_raise()
    }

    #[doc = stub!(Model.kinematics_batch)]
    #[pyo3(signature = (Q, reference = None, out = None), text_signature = "($self, Q, reference='world_aligned', out=None)")]
    fn kinematics_batch<'py>(
        &self,
        Q: &Bound<'py, PyAny>,
        reference: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        kinematics::both_batch(&self.core, Q, axes_of(reference)?, out)
    }

    #[doc = stub!(Model.forward_kinematics_batch)]
    #[pyo3(signature = (Q, out = None))]
    fn forward_kinematics_batch<'py>(
        &self,
        Q: &Bound<'py, PyAny>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        kinematics::poses(&self.core, Q, out)
    }

    #[doc = stub!(Model.jacobian_batch)]
    #[pyo3(signature = (Q, reference = None, out = None), text_signature = "($self, Q, reference='world_aligned', out=None)")]
    fn jacobian_batch<'py>(
        &self,
        Q: &Bound<'py, PyAny>,
        reference: Option<&Bound<'py, PyAny>>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        kinematics::jacobians(&self.core, Q, axes_of(reference)?, out)
    }

    #[doc = stub!(Model.gravity_batch)]
    #[pyo3(signature = (Q, out = None))]
    fn gravity_batch<'py>(
        &self,
        Q: &Bound<'py, PyAny>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        kinematics::gravities(&self.core, Q, out)
    }

    fn __copy__(model: Py<Self>) -> Py<Self> {
        model
    }

    fn __deepcopy__(model: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        model
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Reduced<'py>> {
        let (text, options) = self.source(py)?;
        pickle::of_model(py, text, options)
    }

    fn __repr__(&self) -> String {
        let core = &self.core;
        format!("<Model '{}': {} joints, {} to {}>", core.name(), core.n(), core.base(), core.tip())
    }
}

fn axes_of(reference: Option<&Bound<'_, PyAny>>) -> PyResult<Reference> {
    reference.map_or(Ok(Reference::WorldAligned), |word| Word::<Reference>::read("reference", word))
}

/// Creates a read-only array (n,).
fn frozen<'py>(py: Python<'py>, values: &[f64]) -> PyResult<Bound<'py, PyAny>> {
    let array = new_array(py, &[values.len()], values);
    freeze(&array)?;
    Ok(array)
}

/// Returns the values with NaN in place of `None`.
fn present(values: &[Option<f64>]) -> Vec<f64> {
    values.iter().map(|value| value.unwrap_or(f64::NAN)).collect()
}
