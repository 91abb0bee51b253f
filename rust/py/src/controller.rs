//! Python class `Controller`.

use std::sync::Arc;

use pliant_core::analysis;
use pliant_core::params::{AXIS_NAMES, Axis as CoreAxis, Law};
use pliant_core::{
    Command as CoreCommand, Controller as CoreController, MAX_JOINTS, Payload as CorePayload, Settings as CoreSettings,
    Snapshot,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::command::{Command, Pool};
use crate::diagnostics::Diagnostics;
use crate::error::OrRaise;
use crate::extras::{Extras, SECONDS};
use crate::in_use::{exclusive, shared};
use crate::model::Model;
use crate::ndarray::new_array;
use crate::options::Payload;
use crate::pickle::Reduced;
use crate::read::{array_into, joints, pose, real, vector3};
use crate::report::{FeasibilityReport, PoseReport, check_with};
use crate::servos::Servos;
use crate::settings::Settings;
use crate::step_batch::{BatchCall, BatchState};
use crate::task::Axis;
use crate::{arguments, pickle, read};

#[doc = stub!(Controller)]
#[pyclass(module = "pliant")]
pub(crate) struct Controller {
    pub(crate) core: CoreController,
    n: usize,
    /// True for a task without rotations: its target may be a position (3,).
    position_only: bool,
    pool: Pool,
    model: Py<Model>,
    settings: Py<Settings>,
    servos: Option<Py<Servos>>,
}

impl Controller {
    /// Creates a controller, which continues from `snapshot` if one is given.
    pub(crate) fn create(
        py: Python<'_>,
        model: Py<Model>,
        settings: Py<Settings>,
        servos: Option<Py<Servos>>,
        snapshot: Option<&Snapshot>,
    ) -> PyResult<Self> {
        let arm = Arc::clone(&model.get().core);
        let (core_settings, core_servos) =
            (settings.get().0.clone(), servos.as_ref().map(|servos| servos.get().0.clone()));
        let core = py
            .detach(|| match snapshot {
                Some(snapshot) => CoreController::from_snapshot(arm, core_settings, core_servos, snapshot),
                None => CoreController::new(arm, core_settings, core_servos),
            })
            .or_raise()?;
        let (n, position_only) = (core.model().n(), position_only(&settings.get().0));
        Ok(Self { core, n, position_only, pool: Pool::default(), model, settings, servos })
    }

    /// Returns a copy with the same settings, payload and state, but a separate command pool.
    fn copy(&self, py: Python<'_>) -> Self {
        Self {
            core: self.core.clone(),
            n: self.n,
            position_only: self.position_only,
            pool: Pool::default(),
            model: self.model.clone_ref(py),
            settings: self.settings.clone_ref(py),
            servos: self.servos.as_ref().map(|servos| servos.clone_ref(py)),
        }
    }
}

#[pymethods]
impl Controller {
    #[new]
    #[pyo3(signature = (model, settings = None, servos = None))]
    pub(crate) fn new(
        py: Python<'_>,
        #[pyo3(from_py_with = arguments::model)] model: Py<Model>,
        #[pyo3(from_py_with = arguments::settings_or_none)] settings: Option<Py<Settings>>,
        #[pyo3(from_py_with = arguments::servos_or_none)] servos: Option<Py<Servos>>,
    ) -> PyResult<Self> {
        let settings = match settings {
            Some(settings) => settings,
            None => Py::new(py, Settings(CoreSettings::default()))?,
        };
        let servos = match servos {
            Some(servos) => Some(Py::new(py, Servos(servos.get().0.for_joints(model.get().core.n()).or_raise()?))?),
            None => model.get().servos.as_ref().map(|servos| servos.clone_ref(py)),
        };
        Self::create(py, model, settings, servos, None)
    }

    #[doc = stub!(Controller.step)]
    #[pyo3(signature = (q, target, *, dt = None, dq = None, twist = None, gradient = None, out = None))]
    #[expect(clippy::too_many_arguments, reason = "keyword-only and named")]
    fn step(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        q: &Bound<'_, PyAny>,
        target: &Bound<'_, PyAny>,
        dt: Option<&Bound<'_, PyAny>>,
        dq: Option<&Bound<'_, PyAny>>,
        twist: Option<&Bound<'_, PyAny>>,
        gradient: Option<&Bound<'_, PyAny>>,
        out: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Py<Command>> {
        let (n, position_only) = sizes(slf)?;
        let target = pose("target", target, position_only)?;
        let mut extras = Extras::default();
        extras.read(n, dt, dq, twist, gradient)?;
        // Read last, because reading the other arguments may run Python code that changes `q`.
        let mut position = [0.0; MAX_JOINTS];
        array_into("q", q, &[n], &mut position)?;
        let out = out.map(|out| Command::writable(out, n)).transpose()?;
        let Self { core, pool, .. } = &mut *exclusive(slf)?;
        let command = core.step(&position[..n], &target, &extras.input(n)).or_raise()?;
        to_python(py, pool, command, out)
    }

    #[doc = stub!(Controller.step_joints)]
    #[pyo3(signature = (q, q_target, *, dt = None, dq = None, twist = None, gradient = None, out = None))]
    #[expect(clippy::too_many_arguments, reason = "keyword-only and named")]
    fn step_joints(
        slf: &Bound<'_, Self>,
        py: Python<'_>,
        q: &Bound<'_, PyAny>,
        q_target: &Bound<'_, PyAny>,
        dt: Option<&Bound<'_, PyAny>>,
        dq: Option<&Bound<'_, PyAny>>,
        twist: Option<&Bound<'_, PyAny>>,
        gradient: Option<&Bound<'_, PyAny>>,
        out: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Py<Command>> {
        let (n, _) = sizes(slf)?;
        let (q, q_target) = (joints("q", q, n)?, joints("q_target", q_target, n)?);
        let mut extras = Extras::default();
        extras.read(n, dt, dq, twist, gradient)?;
        let out = out.map(|out| Command::writable(out, n)).transpose()?;
        let Self { core, pool, .. } = &mut *exclusive(slf)?;
        let command = core.step_joints(&q[..n], &q_target[..n], &extras.input(n)).or_raise()?;
        to_python(py, pool, command, out)
    }

    #[doc = stub!(Controller.step_batch)]
    #[pyo3(
        signature = (Q, targets, *, state = None, dt = None, dq = None, caps = None, adaptation = None, invalid = None, out = None),
        text_signature = "($self, Q, targets, *, state=None, dt=None, dq=None, caps=None, adaptation=None, invalid='raise', out=None)"
    )]
    #[expect(clippy::too_many_arguments, reason = "keyword-only and named")]
    #[expect(non_snake_case, reason = "`Q` holds many `q`, as documented")]
    fn step_batch(
        &self,
        py: Python<'_>,
        Q: &Bound<'_, PyAny>,
        targets: &Bound<'_, PyAny>,
        state: Option<&Bound<'_, PyAny>>,
        dt: Option<&Bound<'_, PyAny>>,
        dq: Option<&Bound<'_, PyAny>>,
        caps: Option<&Bound<'_, PyAny>>,
        adaptation: Option<&Bound<'_, PyAny>>,
        invalid: Option<&Bound<'_, PyAny>>,
        out: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Py<Command>> {
        let mut extras = Extras::default();
        extras.read(self.n, dt, None, None, None)?;
        let (position_only, dt) = (self.position_only, extras.dt);
        let call = BatchCall { targets, position_only, dt, dq, caps, adaptation, invalid, out };
        call.run(py, &self.core, Q, state.map(BatchState::from_argument).transpose()?)
    }

    #[doc = stub!(Controller.batch_state)]
    fn batch_state(&self, count: &Bound<'_, PyAny>) -> PyResult<BatchState> {
        BatchState::of(self.n, read::count("count", count)?)
    }

    #[doc = stub!(Controller.reset)]
    fn reset(slf: &Bound<'_, Self>, q: &Bound<'_, PyAny>) -> PyResult<()> {
        let (n, _) = sizes(slf)?;
        let q = joints("q", q, n)?;
        exclusive(slf)?.core.reset(&q[..n]).or_raise()
    }

    #[doc = stub!(Controller.update)]
    fn update(
        slf: &Bound<'_, Self>,
        #[pyo3(from_py_with = arguments::settings)] settings: Py<Settings>,
    ) -> PyResult<()> {
        let mut controller = exclusive(slf)?;
        controller.core.update(settings.get().0.clone()).or_raise()?;
        controller.position_only = position_only(&settings.get().0);
        controller.settings = settings;
        Ok(())
    }

    #[doc = stub!(Controller.payload)]
    #[getter]
    fn payload(&self) -> Option<Payload> {
        self.core.payload().copied().map(Payload)
    }

    #[doc = stub!(Controller.set_payload)]
    #[pyo3(signature = (mass, com = None), text_signature = "($self, mass, com=(0.0, 0.0, 0.0))")]
    fn set_payload(slf: &Bound<'_, Self>, mass: &Bound<'_, PyAny>, com: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        let mass = real("mass", "a number [kg]; 0 for no payload", mass)?;
        let com = com.map_or(Ok([0.0; 3]), |com| vector3("com", com))?;
        exclusive(slf)?.core.set_payload(Some(&CorePayload { mass, com })).or_raise()
    }

    #[doc = stub!(Controller.set_gravity)]
    fn set_gravity(slf: &Bound<'_, Self>, vector: &Bound<'_, PyAny>) -> PyResult<()> {
        let vector = vector3("vector", vector)?;
        exclusive(slf)?.core.set_gravity(vector).or_raise()
    }

    #[doc = stub!(Controller.set_delay)]
    fn set_delay(slf: &Bound<'_, Self>, delay: &Bound<'_, PyAny>) -> PyResult<()> {
        let delay = real("delay", SECONDS, delay)?;
        exclusive(slf)?.core.set_delay(delay).or_raise()
    }

    #[doc = stub!(Controller.capture_gravity)]
    fn capture_gravity<'py>(
        slf: &Bound<'py, Self>,
        q: &Bound<'py, PyAny>,
        goal: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let (n, _) = sizes(slf)?;
        let (at, goal) = (joints("q", q, n)?, joints("goal", goal, n)?);
        let stiffness = exclusive(slf)?.core.capture_gravity(&at[..n], &goal[..n]).or_raise()?;
        Ok(new_array(q.py(), &[n], &stiffness))
    }

    #[doc = stub!(Controller.report)]
    #[pyo3(signature = (q = None))]
    fn report(&self, q: Option<&Bound<'_, PyAny>>) -> PyResult<PoseReport> {
        let report = match q {
            Some(q) => analysis::report_at(&self.core, &joints("q", q, self.n)?[..self.n]),
            None => analysis::report(&self.core),
        };
        report.or_raise().map(PoseReport)
    }

    #[doc = stub!(Controller.check)]
    #[pyo3(signature = (path_or_pose, *, q0 = None))]
    pub(crate) fn check(
        &self,
        path_or_pose: &Bound<'_, PyAny>,
        q0: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<FeasibilityReport> {
        check_with(&self.core, self.position_only, path_or_pose, q0)
    }

    #[doc = stub!(Controller.model)]
    #[getter]
    fn model(&self, py: Python<'_>) -> Py<Model> {
        self.model.clone_ref(py)
    }

    #[doc = stub!(Controller.settings)]
    #[getter]
    fn settings(&self, py: Python<'_>) -> Py<Settings> {
        self.settings.clone_ref(py)
    }

    #[doc = stub!(Controller.servos)]
    #[getter]
    fn servos(&self, py: Python<'_>) -> Option<Py<Servos>> {
        self.servos.as_ref().map(|servos| servos.clone_ref(py))
    }

    #[doc = stub!(Controller.axes)]
    #[getter]
    fn axes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let settings = self.core.settings();
        let axes = (0..AXIS_NAMES.len()).filter(|&axis| settings.task.axes[axis]);
        let out = PyDict::new(py);
        let springs = settings.law == Law::Impedance;
        for ((axis, strength), impedance) in axes.zip(self.core.axis_strengths()).zip(self.core.axis_impedances()) {
            let user_axis = settings.axes[axis];
            let yields = Some(user_axis.compliant_side());
            let complete_axis = CoreAxis {
                soft: Some(strength.soft),
                firm: Some(strength.firm),
                hold: Some(strength.hold),
                stiffness: springs.then_some(impedance.stiffness),
                damping: springs.then_some(impedance.damping),
                yields,
                ..user_axis
            };
            out.set_item(AXIS_NAMES[axis], Axis(complete_axis).into_pyobject(py)?)?;
        }
        Ok(out)
    }

    #[doc = stub!(Controller.diagnostics)]
    #[getter]
    fn diagnostics(&self) -> Diagnostics {
        Diagnostics::new(&self.core)
    }

    #[doc = stub!(Controller.simd_level)]
    #[getter]
    fn simd_level(&self) -> &'static str {
        self.core.simd_level().name()
    }

    #[doc = stub!(Controller.commands_made)]
    #[getter]
    fn commands_made(&self) -> u64 {
        self.pool.created
    }

    fn __copy__(&self, py: Python<'_>) -> Self {
        self.copy(py)
    }

    fn __deepcopy__(&self, py: Python<'_>, _memo: &Bound<'_, PyAny>) -> Self {
        self.copy(py)
    }

    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<Reduced<'py>> {
        let parts = (self.model.clone_ref(py), self.settings.clone_ref(py), self.servos(py));
        pickle::of_controller(py, parts, &self.core.snapshot())
    }

    fn __repr__(&self, py: Python<'_>) -> PyResult<String> {
        let (model, settings) = (self.model.bind(py).repr()?, self.settings.bind(py).repr()?);
        Ok(format!("<Controller of {model} with {settings}>"))
    }
}

/// Returns `command` as a Python object: `out` with its arrays overwritten, or a command of the pool if `out` is
/// `None`.
#[inline]
fn to_python(
    py: Python<'_>,
    pool: &mut Pool,
    command: &CoreCommand,
    out: Option<&Bound<'_, Command>>,
) -> PyResult<Py<Command>> {
    match out {
        Some(out) => {
            out.get().fill(py, command)?;
            Ok(out.clone().unbind())
        }
        None => pool.take(py, command),
    }
}

/// Returns the number of joints, and true if a target may be a position, for a task without rotations.
#[inline]
fn sizes(controller: &Bound<'_, Controller>) -> PyResult<(usize, bool)> {
    let controller = shared(controller)?;
    Ok((controller.n, controller.position_only))
}

fn position_only(settings: &CoreSettings) -> bool {
    settings.task.axes[3..].iter().all(|on| !on)
}
