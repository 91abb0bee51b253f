//! Python classes `Task` and `Axis`, and the fields of `Settings` that hold them.

use pliant_core::MAX_AXES;
use pliant_core::params::{
    AXIS_NAMES, Axis as CoreAxis, CompliantSide, OnDeviationLimit, Profile, Task as CoreTask, parse_axes,
};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyMapping, PyMappingProxy, PyTuple};

use crate::error::{OrRaise, config, shown};
use crate::fields::{Fields, Special, fields};
use crate::kinds::{AxisKey, Kind, Number, Optional, Sides, TaskFrame};
use crate::words::Word;

#[doc = stub!(Task)]
#[pyclass(name = "Task", module = "pliant", frozen, eq, from_py_object)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Task(pub(crate) CoreTask);

impl Special for Task {}

impl Task {
    fn check(core: &CoreTask) -> PyResult<Self> {
        core.validate().or_raise()?;
        Ok(Self(core.clone()))
    }

    fn fields<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        Self::changed(&self.0, &CoreTask::default(), py)
    }
}

fields! {
    Task("Task") of CoreTask {
        axes: AxisKey,
        frame: TaskFrame,
        length: Optional<Number>,
    }
}

#[pymethods]
impl Task {
    #[new]
    #[pyo3(signature = (axes = None, **fields), text_signature = "(axes='xyz rpy', *, frame='base', length=None)")]
    fn new(axes: Option<&Bound<'_, PyAny>>, fields: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let mut core = CoreTask::default();
        if let Some(axes) = axes {
            core.axes = AxisKey::read("axes", axes)?;
        }
        Self::with(core, fields)
    }

    #[doc = stub!(Task.names)]
    #[getter]
    fn names<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyTuple>> {
        let chosen: Vec<_> = AXIS_NAMES.iter().zip(self.0.axes).filter(|(_, on)| *on).map(|(name, _)| name).collect();
        PyTuple::new(py, chosen)
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }
}

#[doc = stub!(Axis)]
#[pyclass(name = "Axis", module = "pliant", frozen, eq, from_py_object)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Axis(pub(crate) CoreAxis);

impl Special for Axis {}

impl Axis {
    fn check(core: &CoreAxis) -> PyResult<Self> {
        core.validate("Axis").or_raise()?;
        Ok(Self(*core))
    }

    fn fields<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        Self::changed(&self.0, &CoreAxis::default(), py)
    }
}

fields! {
    Axis("Axis", "Axis.") of CoreAxis {
        soft: Optional<Sides>,
        firm: Optional<Sides>,
        hold: Optional<Number>,
        stiffness: Optional<Sides>,
        damping: Optional<Sides>,
        yields: Optional<Word<CompliantSide>>,
        adaptation: Number,
        soft_until: Optional<Number>,
        firm_from: Optional<Number>,
        profile: Word<Profile>,
        max_velocity: Optional<Number>,
        soft_step_limit: Optional<Number>,
        deviation_limit: Optional<Number>,
        on_deviation_limit: Word<OnDeviationLimit>,
    }
}

#[pymethods]
impl Axis {
    #[new]
    #[pyo3(
        signature = (**fields),
        text_signature = "(*, soft=None, firm=None, hold=None, stiffness=None, damping=None, yields=None, adaptation=0.0, \
                          soft_until=None, firm_from=None, profile='hardening', max_velocity=None, soft_step_limit=None, \
                          deviation_limit=None, on_deviation_limit='yield')"
    )]
    fn new(fields: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        Self::with(CoreAxis::default(), fields)
    }
}

/// The field `task` of the settings: a `Task`, or its axis key.
pub(crate) struct TaskField;

impl Kind for TaskField {
    type Core = CoreTask;

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<CoreTask> {
        if let Ok(task) = value.cast::<Task>() {
            return Ok(task.get().0.clone());
        }
        match value.extract::<String>() {
            Ok(key) => CoreTask::parse(&key).or_raise(),
            Err(_) => {
                Err(config(name, format!("must be a Task or an axis key such as 'xyz rpy', got {}", shown(value))))
            }
        }
    }

    fn plain<'py>(core: &CoreTask, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        Ok(Bound::new(py, Task(core.clone()))?.into_any())
    }
}

/// The field `axes` of the settings: a mapping from axis keys to `Axis`.
pub(crate) struct AxesField;

impl Kind for AxesField {
    type Core = [CoreAxis; MAX_AXES];

    fn read(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Self::Core> {
        merged(name, value, Self::Core::default())
    }

    fn plain<'py>(core: &Self::Core, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let out = PyDict::new(py);
        for (name, axis) in AXIS_NAMES.iter().zip(core).filter(|(_, axis)| **axis != CoreAxis::default()) {
            out.set_item(name, Axis(*axis).into_pyobject(py)?)?;
        }
        Ok(out.into_any())
    }

    fn show<'py>(core: &Self::Core, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let out = PyDict::new(py);
        for (name, axis) in AXIS_NAMES.iter().zip(core) {
            out.set_item(name, Axis(*axis).into_pyobject(py)?)?;
        }
        Ok(PyMappingProxy::new(py, out.as_mapping()).into_any())
    }
}

/// Returns `axes` with the entries of the mapping `value` replaced; an error if it names an axis twice.
pub(crate) fn merged(
    name: &str,
    value: &Bound<'_, PyAny>,
    mut axes: [CoreAxis; MAX_AXES],
) -> PyResult<[CoreAxis; MAX_AXES]> {
    let no_mapping = |_| config(name, format!("must be a dict such as {{'y': Axis(soft=4.0)}}, got {}", shown(value)));
    let mapping = value.cast::<PyMapping>().map_err(no_mapping)?;
    let mut owner: [Option<String>; MAX_AXES] = Default::default();
    for item in mapping.items()?.iter() {
        let (key, axis): (Bound<'_, PyAny>, Bound<'_, PyAny>) = item.extract()?;
        let key: String =
            key.extract().map_err(|_| config(name, format!("keys are axis names, got {}", shown(&key))))?;
        let axis = axis
            .cast::<Axis>()
            .map_err(|_| config(&format!("axes.{key}"), format!("must be an Axis, got {}", shown(&axis))))?;
        let named = parse_axes(name, &key).or_raise()?;
        for i in (0..MAX_AXES).filter(|&i| named[i]) {
            if let Some(before) = owner[i].replace(key.clone()) {
                let message = format!("'{}' is named by both '{before}' and '{key}'", AXIS_NAMES[i]);
                return Err(config(name, message));
            }
            axes[i] = axis.get().0;
        }
    }
    Ok(axes)
}
