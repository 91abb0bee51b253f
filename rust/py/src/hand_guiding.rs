//! Python class `HandGuidingLaw`: goals that follow an arm guided by hand.

use std::sync::Arc;

use pliant_core::HandGuiding;
use pliant_core::arm::{HandGuidingOptions, SwingResult};
use pyo3::prelude::*;

use crate::arguments;
use crate::command::{Command, Pool};
use crate::error::OrRaise;
use crate::ndarray::new_array;
use crate::read::compact::joints;

#[doc = stub!(HandGuidingLaw)]
#[pyclass(module = "pliant._core")]
#[derive(Debug)]
pub(crate) struct HandGuidingLaw {
    core: HandGuiding,
    n: usize,
    pool: Pool,
}

#[pymethods]
impl HandGuidingLaw {
    #[new]
    #[pyo3(signature = (model, servos, *, q, goal, swung, lead, friction, damping, stiffness_error, delay, torque_share, payload_moments))]
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 passes extracted arguments by value")]
    #[expect(clippy::too_many_arguments, reason = "keyword-only: the result of a swing")]
    fn new(
        model: &Bound<'_, PyAny>,
        servos: &Bound<'_, PyAny>,
        q: &Bound<'_, PyAny>,
        goal: &Bound<'_, PyAny>,
        swung: Vec<bool>,
        lead: &Bound<'_, PyAny>,
        friction: &Bound<'_, PyAny>,
        damping: &Bound<'_, PyAny>,
        stiffness_error: f64,
        delay: f64,
        torque_share: f64,
        payload_moments: [f64; 4],
    ) -> PyResult<Self> {
        let (model, servos) = (arguments::model(model)?, arguments::servos(servos)?);
        let model = &model.get().core;
        let n = model.n();
        let (q, goal, damping) = (joints("q", q, n)?, joints("goal", goal, n)?, joints("damping", damping, n)?);
        let (lead, friction) = (joints("lead", lead, n)?, joints("friction", friction, n)?);
        let swing =
            SwingResult { q: &q[..n], goal: &goal[..n], swung: &swung, lead: &lead[..n], friction: &friction[..n] };
        let options = HandGuidingOptions { stiffness_error, delay, torque_share, payload_moments };
        let core = HandGuiding::new(Arc::clone(model), &servos.get().0, &damping[..n], &swing, options).or_raise()?;
        Ok(Self { core, n, pool: Pool::default() })
    }

    #[doc = stub!(HandGuidingLaw.stiffness)]
    #[getter]
    fn stiffness<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[2, self.n], &self.core.stiffness().concat())
    }

    #[doc = stub!(HandGuidingLaw.play)]
    #[getter]
    fn play<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[self.n], self.core.play())
    }

    #[doc = stub!(HandGuidingLaw.speed)]
    #[getter]
    fn speed<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[self.n], self.core.speed())
    }

    #[doc = stub!(HandGuidingLaw.step)]
    #[pyo3(signature = (q, *, dt))]
    fn step(&mut self, q: &Bound<'_, PyAny>, dt: f64) -> PyResult<Py<Command>> {
        let command = self.core.step(&joints("q", q, self.n)?[..self.n], dt).or_raise()?;
        self.pool.take(q.py(), &command)
    }
}
