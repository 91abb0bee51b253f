//! Python class `CommandLimiter`: limits goals and torque limits before they are sent.

use pliant_core::arm::LimiterInput;
use pliant_core::{CommandLimiter as CoreLimiter, MAX_JOINTS};
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict, PyFloat, PyTuple};

use crate::arguments;
use crate::error::{OrRaise, shape, tuple};
use crate::joint_readings::{Arrays, JointReadings, Values};
use crate::model::Model;
use crate::ndarray::{Vectors, new_array};
use crate::position_filter::PositionFilter;
use crate::read::compact::{array_into, joints};
use crate::read::vector;
use crate::state::State;
use crate::thermal::ThermalModel;

type Object<'py> = Bound<'py, PyAny>;
/// Goals, torque limits and largest speeds of all joints (N,); gravity torques (n,).
type Limited<'py> = (Object<'py>, Object<'py>, Option<Object<'py>>, Option<Object<'py>>);

#[doc = stub!(CommandLimiter)]
#[pyclass(module = "pliant._core")]
#[derive(Debug)]
pub(crate) struct CommandLimiter {
    core: CoreLimiter,
    model: Py<Model>,
    thermal: Py<ThermalModel>,
    /// Names of the joints off the chain.
    pub(crate) extra: Py<PyTuple>,
    max_jumps: u32,
    max_heat: f64,
    /// Voltage and temperature of the next states.
    supply: [Option<Py<PyAny>>; 2],
    goal: Vec<f64>,
    limit: Vec<f64>,
    load: Vec<f64>,
    state_vectors: [Vectors; 5],
    command_vectors: [Vectors; 3],
}

#[pymethods]
impl CommandLimiter {
    #[new]
    #[pyo3(signature = (model, servos, thermal, *, chain, extra, kp, max_torque, max_jumps, max_heat))]
    #[expect(clippy::too_many_arguments, reason = "the arm and its limits")]
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 passes extracted arguments by value")]
    fn new(
        model: &Bound<'_, PyAny>,
        servos: &Bound<'_, PyAny>,
        thermal: Py<ThermalModel>,
        chain: Vec<usize>,
        extra: Py<PyTuple>,
        kp: &Bound<'_, PyAny>,
        max_torque: &Bound<'_, PyAny>,
        max_jumps: u32,
        max_heat: f64,
    ) -> PyResult<Self> {
        let (model, servos) = (arguments::model(model)?, arguments::servos(servos)?);
        let (kp, max_torque) = (vector("kp", kp)?, vector("max_torque", max_torque)?);
        let core = CoreLimiter::new(&model.get().core, &servos.get().0, &chain, &kp, &max_torque).or_raise()?;
        let zeros = || vec![0.0; kp.len()];
        Ok(Self {
            core,
            model,
            thermal,
            extra,
            max_jumps,
            max_heat,
            supply: [None, None],
            goal: zeros(),
            limit: zeros(),
            load: zeros(),
            state_vectors: Default::default(),
            command_vectors: Default::default(),
        })
    }

    #[doc = stub!(CommandLimiter.unreachable)]
    fn unreachable(&self, goal: &Bound<'_, PyAny>) -> PyResult<Option<usize>> {
        let n = self.core.n();
        Ok(self.core.unreachable(&joints("goal", goal, n)?[..n]))
    }

    #[doc = stub!(CommandLimiter.set_supply)]
    fn set_supply(&mut self, voltage: Py<PyAny>, temperature: Py<PyAny>) {
        self.supply = [Some(voltage), Some(temperature)];
    }

    #[doc = stub!(CommandLimiter.limit)]
    #[pyo3(signature = (goal, limit, velocity, positions, off_chain, ramp, ramp_start, *, lead))]
    #[expect(clippy::too_many_arguments, reason = "a command and the state of the arm")]
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 passes extracted arguments by value")]
    #[inline(never)]
    pub(crate) fn limit<'py>(
        &mut self,
        goal: &Bound<'py, PyAny>,
        limit: &Bound<'py, PyAny>,
        velocity: Option<&Bound<'py, PyAny>>,
        positions: &Bound<'py, PositionFilter>,
        off_chain: Vec<[f64; 2]>,
        ramp: f64,
        ramp_start: &Bound<'py, PyAny>,
        lead: bool,
    ) -> PyResult<Limited<'py>> {
        let (py, n, size) = (goal.py(), self.core.n(), self.core.size());
        let goal = joints("goal", goal, n)?;
        let [goal_vectors, limit_vectors, speed_vectors] = &mut self.command_vectors;
        let speeds = match velocity {
            Some(velocity) => {
                let speeds = self.core.speeds(&joints("velocity", velocity, n)?[..n]).or_raise()?;
                Some(speed_vectors.take(py, speeds))
            }
            None => None,
        };
        let filter = positions.try_borrow()?;
        let position = filter.core.position();
        if position.len() != size {
            return Err(shape("position", &[position.len()], tuple(&[size])));
        }
        let mut q = [0.0; MAX_JOINTS];
        for (q, joint) in q.iter_mut().zip(self.core.chain()) {
            *q = position[*joint];
        }
        let gravity = self.model.get().core.gravity(&q[..n]).or_raise()?;
        let thermal = self.thermal.bind(py).try_borrow()?;
        let input = LimiterInput {
            goal: &goal[..n],
            torque_limit: &joints("limit", limit, n)?[..n],
            gravity: gravity.as_slice(),
            position,
            off_chain: &off_chain,
            ramp,
            ramp_start: &joints("ramp_start", ramp_start, n)?[..n],
            may_lead: lead,
        };
        let (goals, limits) = self.core.limit(&thermal.core, &input).or_raise()?;
        let gravity = (!lead).then(|| new_array(py, &[n], gravity.as_slice()));
        Ok((goal_vectors.take(py, goals), limit_vectors.take(py, limits), speeds, gravity))
    }

    #[doc = stub!(CommandLimiter.update)]
    #[pyo3(signature = (positions, readings, goal, limit, dt, now))]
    #[inline(never)]
    pub(crate) fn update(
        &mut self,
        positions: &Bound<'_, PositionFilter>,
        readings: &Bound<'_, JointReadings>,
        goal: &Bound<'_, PyAny>,
        limit: &Bound<'_, PyAny>,
        dt: f64,
        now: f64,
    ) -> PyResult<(State, bool)> {
        let (py, shape_of_all) = (positions.py(), [self.core.size()]);
        let mut filter = positions.try_borrow_mut()?;
        let readings = readings.get();
        let accepted = filter.store_readings(py, readings)?.len();
        if accepted != self.core.size() {
            return Err(shape("position", &[accepted], tuple(&shape_of_all)));
        }
        array_into("goal", goal, &shape_of_all, &mut self.goal)?;
        array_into("limit", limit, &shape_of_all, &mut self.limit)?;
        let [of_q, of_age, measured_vectors @ ..] = &mut self.state_vectors;
        let mut measured = [None, None, None];
        let mut note = |i: usize, values: &[f64]| {
            measured[i] = Some(of_chain(py, &self.core, values, &mut measured_vectors[i]).unbind());
        };
        // Note the load last: the thermal model needs it in `self.load` afterwards.
        let has_load = match &readings.values {
            Values::Servos(rows, _) => {
                for (i, column) in [2, 4, 3].into_iter().enumerate() {
                    for (value, row) in self.load.iter_mut().zip(rows) {
                        *value = row[column];
                    }
                    note(i, &self.load);
                }
                true
            }
            Values::Arrays(Arrays { velocity, load, current, .. }) => {
                let names = [("velocity", velocity), ("current", current), ("load", load)];
                for (i, (name, value)) in names.into_iter().enumerate() {
                    if let Some(value) = value {
                        array_into(name, value.bind(py), &shape_of_all, &mut self.load)?;
                        note(i, &self.load);
                    }
                }
                load.is_some()
            }
        };
        let filter = &filter.core;
        let mut thermal = self.thermal.bind(py).try_borrow_mut()?;
        let load = has_load.then_some(&self.load[..]);
        self.core.update_heat(&mut thermal.core, [&self.goal, &self.limit], filter.position(), load, dt).or_raise()?;
        let chain = self.core.chain();
        let (mut age, mut oldest, mut is_fresh) = ([0.0; MAX_JOINTS], f64::INFINITY, true);
        for (age, &joint) in age.iter_mut().zip(chain) {
            let sampled = filter.time()[joint];
            (*age, oldest) = (now - sampled, sampled.min(oldest));
            is_fresh &= filter.accepted()[joint];
        }
        let has_jumped = filter.rejected().iter().any(|rejected| *rejected >= self.max_jumps);
        let extra = PyDict::new(py);
        for (name, joint) in self.extra.bind(py).iter().zip(self.core.off_chain()) {
            extra.set_item(name, filter.position()[*joint])?;
        }
        let [dq, current, load] = measured;
        let [voltage, temperature] =
            self.supply.each_ref().map(|array| array.as_ref().map(|array| array.clone_ref(py)));
        let state = State {
            q: of_chain(py, &self.core, filter.position(), of_q).unbind(),
            dq,
            time: PyFloat::new(py, oldest).unbind(),
            fresh: PyBool::new(py, is_fresh).to_owned().unbind(),
            extra: extra.into_any().unbind(),
            age: of_age.take(py, &age[..chain.len()]).unbind(),
            load,
            current,
            voltage,
            temperature,
            faults: PyTuple::empty(py).unbind(),
        };
        Ok((state, has_jumped || thermal.core.is_too_hot(self.max_heat)))
    }
}

/// Returns the entries of the chain's joints in a vector of all joints (N), as an array (n,) of `vectors`.
fn of_chain<'py>(py: Python<'py>, core: &CoreLimiter, values: &[f64], vectors: &mut Vectors) -> Bound<'py, PyAny> {
    let mut chosen = [0.0; MAX_JOINTS];
    for (slot, joint) in chosen.iter_mut().zip(core.chain()) {
        *slot = values[*joint];
    }
    vectors.take(py, &chosen[..core.n()])
}
