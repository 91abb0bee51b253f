//! Python class `Servos`: servo parameters with one number per joint.

use pliant_core::params::{LimitType, Servos as CoreServos};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyTuple};

use crate::error::{OrRaise, config};
use crate::fields::{Fields, Special, fields};
use crate::kinds::{Flag, Joints, Optional};
use crate::words::Word;

#[doc = stub!(Servos)]
#[pyclass(name = "Servos", module = "pliant", frozen, eq, from_py_object)]
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Servos(pub(crate) CoreServos);

impl Special for Servos {}

impl Servos {
    /// Checks that `kp` and `max_torque` are given, expands single numbers to the length of the longest vector, and
    /// validates the values.
    fn check(core: &CoreServos) -> PyResult<Self> {
        for (name, values) in [("kp", &core.kp), ("max_torque", &core.max_torque)] {
            if values.is_empty() {
                return Err(config(&format!("servos.{name}"), "is required: one number per joint, or one for all"));
            }
        }
        let lists = [
            &core.kp,
            &core.max_torque,
            &core.friction,
            &core.load_friction,
            &core.stribeck,
            &core.load_stribeck,
            &core.stribeck_speed,
            &core.damping,
            &core.kv,
            &core.armature,
            &core.encoder_step,
        ];
        let speeds = core.no_load_speed.as_ref().map_or(0, Vec::len);
        let n = lists.into_iter().map(Vec::len).max().unwrap_or(1).max(speeds);
        core.for_joints(n).or_raise().map(Self)
    }

    fn fields<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let rest = vec![0.0; self.0.kp.len()];
        let base = CoreServos {
            friction: rest.clone(),
            load_friction: rest.clone(),
            stribeck: rest.clone(),
            load_stribeck: rest.clone(),
            stribeck_speed: vec![1.0; self.0.kp.len()],
            damping: rest.clone(),
            kv: rest.clone(),
            armature: rest.clone(),
            encoder_step: rest,
            ..CoreServos::new(Vec::new(), Vec::new())
        };
        Self::changed(&self.0, &base, py)
    }
}

fields! {
    Servos("Servos") of CoreServos {
        kp: Joints,
        max_torque: Joints,
        friction: Joints,
        load_friction: Joints,
        stribeck: Joints,
        load_stribeck: Joints,
        stribeck_speed: Joints,
        damping: Joints,
        kv: Joints,
        armature: Joints,
        encoder_step: Joints,
        limit_type: Word<LimitType>,
        no_load_speed: Optional<Joints>,
        stiffness_known: Flag,
    }
}

#[pymethods]
impl Servos {
    #[new]
    #[pyo3(
        signature = (**fields),
        text_signature = "(*, kp, max_torque, friction=0.0, load_friction=0.0, stribeck=0.0, load_stribeck=0.0, \
                          stribeck_speed=1.0, damping=0.0, kv=0.0, armature=0.0, encoder_step=0.0, limit_type='current', \
                          no_load_speed=None, stiffness_known=False)"
    )]
    fn new(fields: Option<&Bound<'_, PyDict>>) -> PyResult<Self> {
        Self::with(CoreServos::new(Vec::new(), Vec::new()), fields)
    }

    #[doc = stub!(Servos.of)]
    // Calls Python, because the tables of servo models and their reader are the Python module `pliant.servo`.
    #[staticmethod]
    #[pyo3(signature = (models, *, voltage=None, gains=None))]
    fn of<'py>(
        models: &Bound<'py, PyAny>,
        voltage: Option<&Bound<'py, PyAny>>,
        gains: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let options = PyDict::new(models.py());
        options.set_item("voltage", voltage)?;
        options.set_item("gains", gains)?;
        models.py().import("pliant.servo")?.call_method("servos_of", (models,), Some(&options))
    }

    fn __len__(&self) -> usize {
        self.0.kp.len()
    }
}
