//! Python class `Settings` with its presets.

use pliant_core::MAX_AXES;
use pliant_core::analysis;
use pliant_core::params::{Axis, Law, Settings as CoreSettings, parse_axes};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple, PyType};

use crate::error::{OrRaise, config};
use crate::fields::{Fields, Special, fields};
use crate::groups::{Compensation, Group, NullSpace, PaperOptions, TorqueLimits, Tracking};
use crate::kinds::{Flag, Kind, Number, Speeds};
use crate::model::Model;
use crate::read::real;
use crate::report::path as postures;
use crate::servos::Servos;
use crate::task::{AxesField, TaskField, merged};
use crate::words::Word;
use crate::{arguments, groups};

#[doc = stub!(Settings)]
#[pyclass(name = "Settings", module = "pliant", frozen, eq, from_py_object)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Settings(pub(crate) CoreSettings);

impl Special for Settings {
    fn elsewhere(name: &str) -> Option<String> {
        groups::owner(name)
    }
}

impl Settings {
    fn check(core: &CoreSettings) -> PyResult<Self> {
        core.validate().or_raise()?;
        Ok(Self(core.clone()))
    }

    fn fields<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        Self::changed(&self.0, &CoreSettings::default(), py)
    }

    /// Creates a preset with the fields in `overrides` replaced. Axes, and fields of a group, that are not given keep
    /// the values of the preset.
    ///
    /// If `overrides` has a task, the preset's settings of axes outside that task are dropped, except those of the axes
    /// `named`: the validation then reports that the task lacks them.
    fn preset(mut core: CoreSettings, named: &str, overrides: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let Some(overrides) = overrides else { return Self::check(&core) };
        let rest = overrides.copy()?;
        if let Some(task) = rest.get_item("task")? {
            core.task = TaskField::read("task", &task)?;
            let needed = if named.is_empty() { [false; MAX_AXES] } else { parse_axes("axis", named).or_raise()? };
            for ((axis, on), needed) in core.axes.iter_mut().zip(core.task.axes).zip(needed) {
                if !on && !needed {
                    *axis = Axis::default();
                }
            }
        }
        if let Some(axes) = rest.get_item("axes")? {
            core.axes = merged("axes", &axes, core.axes)?;
            rest.del_item("axes")?;
        }
        Self::with(core, Some(&rest))
    }

    /// Creates a preset in which the axis `named` yields and pushes. Returns an error under law `impedance` if the axis
    /// has no spring, because then it could not push.
    fn driven(core: CoreSettings, named: &str, overrides: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        let settings = Self::preset(core, named, overrides)?;
        let mut driven = settings.0.axes.iter().zip(parse_axes("axis", named).or_raise()?);
        if settings.0.law == Law::Impedance && driven.any(|(axis, on)| on && axis.stiffness.is_none()) {
            let message = format!(
                "under law=\"impedance\" '{named}' yields without a spring, so that nothing would push: give \
                 axes={{\"{named}\": Axis(stiffness=... [N/m], yields=\"both\", soft=... [N])}}, or leave law=\"cap\""
            );
            return Err(config(&format!("axes.{named}.stiffness"), message));
        }
        Ok(settings)
    }
}

fields! {
    Settings("Settings") of CoreSettings {
        task: TaskField,
        axes: AxesField,
        law: Word<Law>,
        rate: Number,
        delay: Number,
        gravity: Flag,
        max_tool_speed: Speeds,
        max_tool_acceleration: Speeds,
        accept_high_adaptation: Flag,
        accept_high_stiffness: Flag,
        tracking: Group<Tracking>,
        null_space: Group<NullSpace>,
        compensation: Group<Compensation>,
        torque_limits: Group<TorqueLimits>,
        paper_options: Group<PaperOptions>,
    }
}

#[pymethods]
impl Settings {
    #[new]
    #[pyo3(
        signature = (**fields),
        text_signature = "(*, task='xyz rpy', axes={}, law='cap', rate=100.0, delay=0.0, gravity=True, \
                          max_tool_speed=(0.25, 1.0), max_tool_acceleration=(1.0, 4.0), \
                          accept_high_adaptation=False, accept_high_stiffness=False, tracking=..., \
                          null_space=..., compensation=..., torque_limits=..., \
                          paper_options=...)"
    )]
    fn new(fields: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        Self::with(CoreSettings::default(), fields)
    }

    #[doc = stub!(Settings.paper)]
    #[classmethod]
    #[pyo3(signature = (**overrides))]
    fn paper(_class: &Bound<'_, PyType>, overrides: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        Self::preset(CoreSettings::paper(), "", overrides)
    }

    #[doc = stub!(Settings.raise_soft)]
    #[pyo3(signature = (model, path = None, *, servos = None))]
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 passes extracted arguments by value")]
    fn raise_soft(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = arguments::model)] model: Py<Model>,
        path: Option<&Bound<'_, PyAny>>,
        #[pyo3(from_py_with = arguments::servos_or_none)] servos: Option<Py<Servos>>,
    ) -> PyResult<Self> {
        let model = model.get();
        let poses = path.map_or(Ok(Vec::new()), |path| postures("path", path, model.core.n()))?;
        let servos = servos.as_ref().or(model.servos.as_ref()).map(|servos| &servos.get().0);
        py.detach(|| analysis::raise_soft(&self.0, &model.core, servos, &poses)).or_raise().map(Self)
    }

    #[doc = stub!(Settings.soft)]
    #[classmethod]
    #[pyo3(signature = (axes, /, **overrides))]
    fn soft(
        _class: &Bound<'_, PyType>,
        axes: &Bound<'_, PyAny>,
        overrides: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let axes = &arguments::text("axes", "names of the yielding axes, such as 'y' or 'x yaw'", axes)?;
        Self::preset(CoreSettings::soft(axes).or_raise()?, axes, overrides)
    }

    #[doc = stub!(Settings.firm)]
    #[classmethod]
    #[pyo3(signature = (**overrides))]
    fn firm(_class: &Bound<'_, PyType>, overrides: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        Self::preset(CoreSettings::firm(), "", overrides)
    }

    #[doc = stub!(Settings.door)]
    #[classmethod]
    #[pyo3(signature = (**overrides))]
    fn door(_class: &Bound<'_, PyType>, overrides: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        Self::preset(CoreSettings::door(), "", overrides)
    }

    #[doc = stub!(Settings.drawer)]
    #[classmethod]
    #[pyo3(signature = (*, axis = None, pull = None, **overrides), text_signature = "(*, axis='x', pull=None, **overrides)")]
    fn drawer(
        _class: &Bound<'_, PyType>,
        axis: Option<&Bound<'_, PyAny>>,
        pull: Option<&Bound<'_, PyAny>>,
        overrides: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let (axis, pull) = (&along(axis, "x")?, newtons("pull", pull)?);
        Self::driven(CoreSettings::drawer(axis, pull).or_raise()?, axis, overrides)
    }

    #[doc = stub!(Settings.wipe)]
    #[classmethod]
    #[pyo3(signature = (*, press = None, axis = None, **overrides), text_signature = "(*, press=None, axis='z', **overrides)")]
    fn wipe(
        _class: &Bound<'_, PyType>,
        press: Option<&Bound<'_, PyAny>>,
        axis: Option<&Bound<'_, PyAny>>,
        overrides: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let (axis, press) = (&along(axis, "z")?, newtons("press", press)?);
        Self::driven(CoreSettings::wipe(press, axis).or_raise()?, axis, overrides)
    }

    #[doc = stub!(Settings.hand_over)]
    #[classmethod]
    #[pyo3(signature = (**overrides))]
    fn hand_over(_class: &Bound<'_, PyType>, overrides: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        Self::preset(CoreSettings::hand_over(), "", overrides)
    }

    #[doc = stub!(Settings.plug)]
    #[classmethod]
    #[pyo3(signature = (*, axis = None, push = None, **overrides), text_signature = "(*, axis='-z', push=None, **overrides)")]
    fn plug(
        _class: &Bound<'_, PyType>,
        axis: Option<&Bound<'_, PyAny>>,
        push: Option<&Bound<'_, PyAny>>,
        overrides: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Self> {
        let axis = along(axis, "-z")?;
        let settings = CoreSettings::plug(&axis, newtons("push", push)?).or_raise()?;
        Self::driven(settings, axis.trim_start_matches(['-', '+']), overrides)
    }

    #[doc = stub!(Settings.hand_guiding)]
    #[classmethod]
    #[pyo3(signature = (**overrides))]
    fn hand_guiding(_class: &Bound<'_, PyType>, overrides: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        Self::preset(CoreSettings::hand_guiding(), "", overrides)
    }
}

/// Reads the argument `axis` of a preset; returns `default` if it was not given.
fn along(axis: Option<&Bound<'_, PyAny>>, default: &str) -> PyResult<String> {
    axis.map_or_else(
        || Ok(default.to_owned()),
        |axis| arguments::text("axis", "the name of an axis, such as 'x'", axis),
    )
}

/// Reads a force [N]; `None` if it was not given.
fn newtons(name: &str, force: Option<&Bound<'_, PyAny>>) -> PyResult<Option<f64>> {
    force.map(|force| real(name, "a number [N]", force)).transpose()
}
