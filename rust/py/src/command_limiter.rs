//! Python class `CommandLimiter`: limits of goals and torque limits before they are sent.

use pliant_core::CommandLimiter as CoreLimiter;
use pliant_core::arm::LimiterInput;
use pyo3::prelude::*;

use crate::arguments;
use crate::error::OrRaise;
use crate::ndarray::new_array;
use crate::read::compact::{array_into, joints};
use crate::read::vector;
use crate::thermal::ThermalModel;

/// Goals and torque limits of all joints, arrays (N,).
type Limited<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>);

#[doc = stub!(CommandLimiter)]
#[pyclass(module = "pliant._core")]
#[derive(Debug)]
pub(crate) struct CommandLimiter {
    core: CoreLimiter,
    thermal: Py<ThermalModel>,
    position: Vec<f64>,
    off_chain: Vec<[f64; 2]>,
    goal: Vec<f64>,
    limit: Vec<f64>,
    load: Vec<f64>,
}

#[pymethods]
impl CommandLimiter {
    #[new]
    #[pyo3(signature = (model, servos, thermal, *, chain, kp, max_torque))]
    #[expect(clippy::needless_pass_by_value, reason = "what PyO3 extracts it hands over")]
    fn new(
        model: &Bound<'_, PyAny>,
        servos: &Bound<'_, PyAny>,
        thermal: Py<ThermalModel>,
        chain: Vec<usize>,
        kp: &Bound<'_, PyAny>,
        max_torque: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let (model, servos) = (arguments::model(model)?, arguments::servos(servos)?);
        let (kp, max_torque) = (vector("kp", kp)?, vector("max_torque", max_torque)?);
        let core = CoreLimiter::new(&model.get().core, &servos.get().0, &chain, &kp, &max_torque).or_raise()?;
        let zeros = || vec![0.0; kp.len()];
        let off_chain = vec![[0.0; 2]; core.size() - core.n()];
        Ok(Self { core, thermal, off_chain, position: zeros(), goal: zeros(), limit: zeros(), load: zeros() })
    }

    #[doc = stub!(CommandLimiter.unreachable)]
    fn unreachable(&self, goal: &Bound<'_, PyAny>) -> PyResult<Option<usize>> {
        let n = self.core.n();
        Ok(self.core.unreachable(&joints("goal", goal, n)?[..n]))
    }

    #[doc = stub!(CommandLimiter.limit)]
    #[pyo3(signature = (goal, limit, gravity, position, off_chain, *, ramp, ramp_start, lead))]
    #[expect(clippy::too_many_arguments, reason = "keyword-only and named")]
    fn limit<'py>(
        &mut self,
        goal: &Bound<'py, PyAny>,
        limit: &Bound<'py, PyAny>,
        gravity: &Bound<'py, PyAny>,
        position: &Bound<'py, PyAny>,
        off_chain: &Bound<'py, PyAny>,
        ramp: f64,
        ramp_start: &Bound<'py, PyAny>,
        lead: bool,
    ) -> PyResult<Limited<'py>> {
        let (py, n, size) = (goal.py(), self.core.n(), self.core.size());
        array_into("position", position, &[size], &mut self.position)?;
        array_into("off_chain", off_chain, &[size - n, 2], self.off_chain.as_flattened_mut())?;
        let thermal = self.thermal.bind(py).borrow();
        let input = LimiterInput {
            goal: &joints("goal", goal, n)?[..n],
            torque_limit: &joints("limit", limit, n)?[..n],
            gravity: &joints("gravity", gravity, n)?[..n],
            position: &self.position,
            off_chain: &self.off_chain,
            ramp,
            ramp_start: &joints("ramp_start", ramp_start, n)?[..n],
            may_lead: lead,
        };
        let (goals, limits) = self.core.limit(&thermal.core, &input).or_raise()?;
        Ok((new_array(py, &[size], goals), new_array(py, &[size], limits)))
    }

    #[doc = stub!(CommandLimiter.update_heat)]
    fn update_heat<'py>(
        &mut self,
        goal: &Bound<'py, PyAny>,
        limit: &Bound<'py, PyAny>,
        position: &Bound<'py, PyAny>,
        load: Option<&Bound<'py, PyAny>>,
        dt: f64,
    ) -> PyResult<()> {
        let shape = [self.core.size()];
        array_into("goal", goal, &shape, &mut self.goal)?;
        array_into("limit", limit, &shape, &mut self.limit)?;
        array_into("position", position, &shape, &mut self.position)?;
        if let Some(load) = load {
            array_into("load", load, &shape, &mut self.load)?;
        }
        let mut thermal = self.thermal.bind(goal.py()).borrow_mut();
        let load = load.map(|_| &self.load[..]);
        self.core.update_heat(&mut thermal.core, [&self.goal, &self.limit], &self.position, load, dt).or_raise()
    }
}
