//! Python class `ArmPoints`: motion and effective masses of the joint origins and the tool.

use pliant_core::kinematics::ArmPoints as CorePoints;
use pliant_core::{JointVec, MAX_JOINTS};
use pyo3::prelude::*;

use crate::arguments;
use crate::error::OrRaise;
use crate::ndarray::new_array;
use crate::read::compact::joints;

#[doc = stub!(ArmPoints)]
#[pyclass(module = "pliant._core", frozen)]
#[derive(Debug)]
pub(crate) struct ArmPoints {
    core: CorePoints,
    n: usize,
}

#[pymethods]
impl ArmPoints {
    #[new]
    #[pyo3(signature = (model, armature=None))]
    fn new(model: &Bound<'_, PyAny>, armature: Option<&Bound<'_, PyAny>>) -> PyResult<Self> {
        let model = arguments::model(model)?;
        let core = &model.get().core;
        let n = core.n();
        let rotors = armature.map_or(Ok([0.0; MAX_JOINTS]), |armature| joints("armature", armature, n))?;
        Ok(Self { core: CorePoints::new(core, &rotors[..n]).or_raise()?, n })
    }

    #[doc = stub!(ArmPoints.position)]
    fn position<'py>(&self, q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let here = self.core.evaluate(&joints("q", q, self.n)?);
        Ok(rows(q.py(), here.position()))
    }

    #[doc = stub!(ArmPoints.velocity)]
    fn velocity<'py>(&self, q: &Bound<'py, PyAny>, dq: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let here = self.core.evaluate(&joints("q", q, self.n)?);
        let velocity = here.velocity(&joints("dq", dq, self.n)?);
        Ok(rows(q.py(), &velocity[..here.position().len()]))
    }

    #[doc = stub!(ArmPoints.inertia)]
    fn inertia<'py>(&self, q: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let here = self.core.evaluate(&joints("q", q, self.n)?);
        let numbers: Vec<f64> = here.inertia().iter().flat_map(|row: &JointVec| row[..self.n].to_vec()).collect();
        Ok(new_array(q.py(), &[self.n, self.n], &numbers))
    }

    #[doc = stub!(ArmPoints.effective_mass)]
    fn effective_mass<'py>(&self, q: &Bound<'py, PyAny>, dq: &Bound<'py, PyAny>) -> PyResult<Bound<'py, PyAny>> {
        let here = self.core.evaluate(&joints("q", q, self.n)?);
        let mass = here.effective_mass(&here.velocity(&joints("dq", dq, self.n)?), 0.0);
        let count = here.position().len();
        Ok(new_array(q.py(), &[count], &mass[..count]))
    }
}

/// Returns the points as an array (m, 3).
fn rows<'py>(py: Python<'py>, points: &[[f64; 3]]) -> Bound<'py, PyAny> {
    new_array(py, &[points.len(), 3], points.as_flattened())
}
