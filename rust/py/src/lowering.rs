//! Python class `Lowering`, the controlled descent of an arm, and function `torque_margin`.

use std::sync::Arc;

use pliant_core::arm::{LoweringPhase, LoweringStart, torque_margin as core_torque_margin};
use pliant_core::kinematics::ArmPoints;
use pliant_core::{Lowering as CoreLowering, MAX_JOINTS};
use pyo3::prelude::*;

use crate::arguments;
use crate::command::{Command, Pool};
use crate::error::{OrRaise, shape};
use crate::ndarray::new_array;
use crate::read::compact::{array_into, joints as vector};

#[doc = stub!(Lowering)]
#[pyclass(module = "pliant.arm")]
#[derive(Debug)]
pub(crate) struct Lowering {
    core: CoreLowering,
    n: usize,
    pool: Pool,
}

#[pymethods]
impl Lowering {
    #[new]
    #[pyo3(signature = (model, servos, q, *, goal=None, limit=None, rest=None, speed=0.15))]
    fn new(
        model: &Bound<'_, PyAny>,
        servos: &Bound<'_, PyAny>,
        q: &Bound<'_, PyAny>,
        goal: Option<&Bound<'_, PyAny>>,
        limit: Option<&Bound<'_, PyAny>>,
        rest: Option<&Bound<'_, PyAny>>,
        speed: f64,
    ) -> PyResult<Self> {
        let (model, servos) = (arguments::model(model)?, arguments::servos(servos)?);
        let (model, servos) = (&model.get().core, &servos.get().0);
        let n = model.n();
        let read = |name: &str, value: Option<&Bound<'_, PyAny>>| value.map(|value| vector(name, value, n)).transpose();
        let (q, goal) = (vector("q", q, n)?, read("goal", goal)?);
        let (limit, rest) = (read("limit", limit)?, read("rest", rest)?);
        let servos = servos.for_joints(n).or_raise()?;
        let points = Arc::new(ArmPoints::new(model, &servos.armature).or_raise()?);
        let start = LoweringStart {
            q: &q[..n],
            goal: goal.as_ref().map(|goal| &goal[..n]),
            torque_limit: limit.as_ref().map(|limit| &limit[..n]),
            rest_q: rest.as_ref().map(|rest| &rest[..n]),
            speed,
        };
        let core = CoreLowering::new(Arc::clone(model), &servos, points, &start).or_raise()?;
        Ok(Self { core, n, pool: Pool::default() })
    }

    #[doc = stub!(Lowering.phase)]
    #[getter]
    fn phase(&self) -> &'static str {
        match self.core.phase() {
            LoweringPhase::Rest => "rest",
            LoweringPhase::Down => "down",
            LoweringPhase::Ramp => "ramp",
            LoweringPhase::Done => "done",
        }
    }

    #[doc = stub!(Lowering.blind)]
    #[getter]
    fn blind(&self) -> bool {
        self.core.is_blind()
    }

    #[doc = stub!(Lowering.skip_rest)]
    fn skip_rest(&mut self) {
        self.core.skip_rest();
    }

    #[doc = stub!(Lowering.take_over)]
    #[pyo3(signature = (joints, q, goal, limit))]
    fn take_over(
        &mut self,
        joints: &Bound<'_, PyAny>,
        q: &Bound<'_, PyAny>,
        goal: &Bound<'_, PyAny>,
        limit: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let n = self.n;
        let taken = mask("joints", joints, n)?;
        let (q, goal, limit) = (vector("q", q, n)?, vector("goal", goal, n)?, vector("limit", limit, n)?);
        self.core.take_over(&taken, &q[..n], &goal[..n], &limit[..n]).or_raise()
    }

    #[doc = stub!(Lowering.step)]
    #[pyo3(signature = (q, ok=None, *, dt, age=0.0))]
    fn step(
        &mut self,
        q: &Bound<'_, PyAny>,
        ok: Option<&Bound<'_, PyAny>>,
        dt: f64,
        age: f64,
    ) -> PyResult<Option<Py<Command>>> {
        // NaN is accepted: the core treats such a position as lost.
        let mut positions = [0.0; MAX_JOINTS];
        array_into("q", q, &[self.n], &mut positions[..self.n])?;
        let fresh = ok.map_or_else(|| Ok(vec![true; self.n]), |ok| mask("ok", ok, self.n))?;
        match self.core.step(&positions[..self.n], &fresh, dt, age).or_raise()? {
            Some(command) => self.pool.take(q.py(), &command).map(Some),
            None => Ok(None),
        }
    }
}

/// Reads the argument `name`, an iterable of `n` booleans.
fn mask(name: &str, value: &Bound<'_, PyAny>, n: usize) -> PyResult<Vec<bool>> {
    let flags = value.try_iter()?.map(|flag| flag?.is_truthy()).collect::<PyResult<Vec<_>>>()?;
    if flags.len() == n { Ok(flags) } else { Err(shape(name, &[flags.len()], format!("({n},)"))) }
}

#[doc = stub!(torque_margin)]
#[pyfunction]
pub(crate) fn torque_margin<'py>(
    servos: &Bound<'py, PyAny>,
    gravity: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let servos = arguments::servos(servos)?;
    let n = servos.get().0.kp.len();
    let margin = core_torque_margin(&servos.get().0, &vector("gravity", gravity, n)?[..n]);
    Ok(new_array(gravity.py(), &[n], &margin))
}
