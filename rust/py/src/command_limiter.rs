//! Python class `CommandLimiter`: limits of goals and torque limits before they are sent.

use numpy::PyArray1;
use pliant_core::arm::LimiterInput;
use pliant_core::{CommandLimiter as CoreLimiter, MAX_JOINTS};
use pyo3::prelude::*;

use crate::arguments;
use crate::error::{OrRaise, shape, tuple};
use crate::ndarray::new_array;
use crate::position_filter::PositionFilter;
use crate::read::compact::{array_into, joints};
use crate::read::vector;
use crate::thermal::ThermalModel;

/// Goals and torque limits of all joints, arrays (N,).
type Limited<'py> = (Bound<'py, PyAny>, Bound<'py, PyAny>);
/// Mask of new positions, positions and their ages, arrays (n,); oldest time; positions off the chain; true for faults.
type Updated<'py> = (Bound<'py, PyArray1<bool>>, Bound<'py, PyAny>, Bound<'py, PyAny>, f64, Vec<f64>, bool);

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

    #[doc = stub!(CommandLimiter.update)]
    #[pyo3(signature = (positions, position, ok, time, load, *, goal, limit, dt, now, max_jumps, max_heat))]
    #[expect(clippy::too_many_arguments, reason = "keyword-only and named")]
    fn update<'py>(
        &mut self,
        positions: &Bound<'py, PositionFilter>,
        position: &Bound<'py, PyAny>,
        ok: &Bound<'py, PyAny>,
        time: &Bound<'py, PyAny>,
        load: Option<&Bound<'py, PyAny>>,
        goal: &Bound<'py, PyAny>,
        limit: &Bound<'py, PyAny>,
        dt: f64,
        now: f64,
        max_jumps: u32,
        max_heat: f64,
    ) -> PyResult<Updated<'py>> {
        let (py, size) = (positions.py(), self.core.size());
        let mut filter = positions.try_borrow_mut()?;
        let accepted = filter.store(position, ok, time)?;
        if accepted.len() != size {
            return Err(shape("position", &[accepted.len()], tuple(&[size])));
        }
        let chosen = self.core.chain().iter().map(|joint| accepted[*joint]);
        let mask: Vec<bool> = chosen.collect();
        let shape = [size];
        array_into("goal", goal, &shape, &mut self.goal)?;
        array_into("limit", limit, &shape, &mut self.limit)?;
        if let Some(load) = load {
            array_into("load", load, &shape, &mut self.load)?;
        }
        let filter = &filter.core;
        let mut thermal = self.thermal.bind(py).try_borrow_mut()?;
        let load = load.map(|_| &self.load[..]);
        self.core.update_heat(&mut thermal.core, [&self.goal, &self.limit], filter.position(), load, dt).or_raise()?;
        let chain = self.core.chain();
        let (mut q, mut age, mut oldest) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], f64::INFINITY);
        for (i, &joint) in chain.iter().enumerate() {
            let sampled = filter.time()[joint];
            (q[i], age[i], oldest) = (filter.position()[joint], now - sampled, sampled.min(oldest));
        }
        let has_jumped = filter.rejected().iter().any(|rejected| *rejected >= max_jumps);
        let n = chain.len();
        Ok((
            PyArray1::from_slice(py, &mask),
            new_array(py, &[n], &q[..n]),
            new_array(py, &[n], &age[..n]),
            oldest,
            self.core.off_chain().iter().map(|joint| filter.position()[*joint]).collect(),
            has_jumped || thermal.core.is_too_hot(max_heat),
        ))
    }
}
