//! Python class `PositionFilter`: rejects implausible joint positions.

use numpy::{PyArray1, PyArrayMethods};
use pliant_core::PositionFilter as CoreFilter;
use pyo3::prelude::*;
use pyo3::types::PyFloat;

use crate::error::{OrRaise, shape};
use crate::ndarray::new_array;
use crate::read::compact::array_into;
use crate::read::vector;

#[doc = stub!(PositionFilter)]
#[pyclass(module = "pliant._core")]
#[derive(Debug)]
pub(crate) struct PositionFilter {
    core: CoreFilter,
    position: Vec<f64>,
    time: Vec<f64>,
    ok: Vec<bool>,
}

#[pymethods]
impl PositionFilter {
    #[new]
    fn new(max_speed: &Bound<'_, PyAny>) -> PyResult<Self> {
        let max_speed = vector("max_speed", max_speed)?;
        let n = max_speed.len();
        let core = CoreFilter::new(&max_speed).or_raise()?;
        Ok(Self { core, position: vec![0.0; n], time: vec![0.0; n], ok: vec![false; n] })
    }

    #[doc = stub!(PositionFilter.position)]
    #[getter]
    fn position<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[self.ok.len()], self.core.position())
    }

    #[doc = stub!(PositionFilter.time)]
    #[getter]
    fn time<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[self.ok.len()], self.core.time())
    }

    #[doc = stub!(PositionFilter.jumps)]
    #[getter]
    fn jumps(&self) -> u64 {
        self.core.jumps()
    }

    #[doc = stub!(PositionFilter.update)]
    fn update<'py>(
        &mut self,
        position: &Bound<'py, PyAny>,
        ok: &Bound<'py, PyAny>,
        time: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let n = self.ok.len();
        array_into("position", position, &[n], &mut self.position)?;
        if let Ok(one) = time.cast::<PyFloat>() {
            self.time.fill(one.value());
        } else {
            array_into("time", time, &[n], &mut self.time)?;
        }
        read_mask(ok, &mut self.ok)?;
        let accepted = self.core.update(&self.position, &self.ok, &self.time);
        Ok(PyArray1::from_slice(position.py(), accepted))
    }

    #[doc = stub!(PositionFilter.select)]
    #[expect(clippy::needless_pass_by_value, reason = "what PyO3 extracts it hands over")]
    fn select<'py>(
        &self,
        py: Python<'py>,
        joints: Vec<usize>,
        now: f64,
    ) -> (Bound<'py, PyAny>, Bound<'py, PyAny>, f64) {
        let (all, times) = (self.core.position(), self.core.time());
        let chosen = |values: &[f64], scale: f64, offset: f64| -> Vec<f64> {
            joints.iter().map(|&joint| offset + scale * values.get(joint).copied().unwrap_or(f64::NAN)).collect()
        };
        let (position, age) = (chosen(all, 1.0, 0.0), chosen(times, -1.0, now));
        let oldest = joints.iter().filter_map(|&joint| times.get(joint)).copied().fold(f64::INFINITY, f64::min);
        (new_array(py, &[joints.len()], &position), new_array(py, &[joints.len()], &age), oldest)
    }

    #[doc = stub!(PositionFilter.assume)]
    fn assume(&mut self, position: &Bound<'_, PyAny>, time: f64) -> PyResult<()> {
        array_into("position", position, &[self.ok.len()], &mut self.position)?;
        self.core.assume(&self.position, time);
        Ok(())
    }

    #[doc = stub!(PositionFilter.implausible)]
    fn implausible(&self, count: u32) -> Vec<(usize, f64)> {
        let rows = self.core.rejected().iter().zip(self.core.jump()).enumerate();
        rows.filter(|(_, (rejected, _))| **rejected >= count).map(|(i, (_, jump))| (i, *jump)).collect()
    }

    #[doc = stub!(PositionFilter.reset)]
    fn reset(&mut self) {
        self.core.reset();
    }
}

/// Reads a mask (N,), an array of bool.
fn read_mask(value: &Bound<'_, PyAny>, out: &mut [bool]) -> PyResult<()> {
    let array = value.cast::<PyArray1<bool>>()?.readonly();
    let mask = array.as_slice()?;
    if mask.len() != out.len() {
        return Err(shape("ok", &[mask.len()], crate::error::tuple(&[out.len()])));
    }
    out.copy_from_slice(mask);
    Ok(())
}
