//! Python class `JointFollower`: goals that follow joint targets, with bounded forces.

use std::sync::Arc;

use pliant_core::JointFollower as CoreFollower;
use pliant_core::arm::JointFollowerOptions;
use pyo3::prelude::*;

use crate::arguments;
use crate::command::{Command, Pool};
use crate::error::{OrRaise, config, shape};
use crate::ndarray::new_array;
use crate::read::compact::joints;
use crate::read::numbers;

#[doc = stub!(JointFollower)]
#[pyclass(module = "pliant.teleop")]
#[derive(Debug)]
pub(crate) struct JointFollower {
    core: CoreFollower,
    n: usize,
    pool: Pool,
}

#[pymethods]
impl JointFollower {
    #[new]
    #[pyo3(signature = (model, servos = None, *, max_force, max_tool_speed = 0.6, max_joint_speed = 4.0))]
    fn new(
        model: &Bound<'_, PyAny>,
        servos: Option<&Bound<'_, PyAny>>,
        max_force: &Bound<'_, PyAny>,
        max_tool_speed: f64,
        max_joint_speed: f64,
    ) -> PyResult<Self> {
        let model = arguments::model(model)?;
        let (model, model_servos) = (&model.get().core, model.get().servos.as_ref());
        let options = JointFollowerOptions { max_force: force(max_force)?, max_tool_speed, max_joint_speed };
        let servos = servos.map(arguments::servos_or_none).transpose()?.flatten();
        let Some(core_servos) = servos.as_ref().or(model_servos).map(|servos| &servos.get().0) else {
            return Err(config("servos", "JointFollower needs a servo table: servos=pliant.Servos(...)"));
        };
        let core = CoreFollower::new(Arc::clone(model), core_servos, options).or_raise()?;
        Ok(Self { n: model.n(), core, pool: Pool::default() })
    }

    #[doc = stub!(JointFollower.max_force)]
    #[getter]
    fn max_force<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[3], &self.core.options().max_force)
    }

    #[setter]
    fn set_max_force(&mut self, value: &Bound<'_, PyAny>) -> PyResult<()> {
        let options = JointFollowerOptions { max_force: force(value)?, ..*self.core.options() };
        self.core.set_options(options).or_raise()
    }

    #[doc = stub!(JointFollower.reset)]
    fn reset(&mut self, q: &Bound<'_, PyAny>) -> PyResult<()> {
        self.core.reset(&joints("q", q, self.n)?[..self.n]).or_raise()
    }

    #[doc = stub!(JointFollower.step)]
    #[pyo3(signature = (q, q_target, *, dt))]
    fn step(&mut self, q: &Bound<'_, PyAny>, q_target: &Bound<'_, PyAny>, dt: f64) -> PyResult<Py<Command>> {
        let (measured, target) = (joints("q", q, self.n)?, joints("q_target", q_target, self.n)?);
        let command = self.core.step(&measured[..self.n], &target[..self.n], dt).or_raise()?;
        self.pool.take(q.py(), &command)
    }
}

/// Reads one force for all axes, or one for each of x, y and z [N].
fn force(value: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
    let (_, values) = numbers("max_force", value)?;
    match values[..] {
        [one] => Ok([one; 3]),
        [x, y, z] => Ok([x, y, z]),
        _ => Err(shape("max_force", &[values.len()], "a number, or (3,)")),
    }
}
