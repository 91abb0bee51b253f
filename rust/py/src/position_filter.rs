//! Python class `PositionFilter`: rejects implausible joint positions.

use numpy::{PyArray1, PyArrayMethods};
use pliant_core::PositionFilter as CoreFilter;
use pyo3::prelude::*;
use pyo3::types::PyFloat;

use crate::error::{OrRaise, shape};
use crate::joint_readings::{JointReadings, Values};
use crate::ndarray::new_array;
use crate::read::compact::array_into;
use crate::read::vector;

#[doc = stub!(PositionFilter)]
#[pyclass(module = "pliant._core")]
#[derive(Debug)]
pub(crate) struct PositionFilter {
    pub(crate) core: CoreFilter,
    position: Vec<f64>,
    time: Vec<f64>,
    ok: Vec<bool>,
}

impl PositionFilter {
    /// Stores the plausible positions of a reading; returns the mask of their joints.
    pub(crate) fn store_readings(&mut self, py: Python<'_>, readings: &JointReadings) -> PyResult<&[bool]> {
        match &readings.values {
            Values::Servos(rows, ok) => {
                if rows.len() != self.ok.len() {
                    return Err(shape("position", &[rows.len()], crate::error::tuple(&[self.ok.len()])));
                }
                for (i, row) in rows.iter().enumerate() {
                    (self.position[i], self.time[i]) = (row[0], row[1]);
                }
                Ok(self.core.update(&self.position, ok, &self.time))
            }
            Values::Arrays(arrays) => self.store(arrays.position.bind(py), arrays.ok.bind(py), arrays.time.bind(py)),
        }
    }

    /// Stores the plausible positions among `position` (N,); returns the mask of their joints.
    fn store(
        &mut self,
        position: &Bound<'_, PyAny>,
        ok: &Bound<'_, PyAny>,
        time: &Bound<'_, PyAny>,
    ) -> PyResult<&[bool]> {
        let n = self.ok.len();
        array_into("position", position, &[n], &mut self.position)?;
        if let Ok(one) = time.cast::<PyFloat>() {
            self.time.fill(one.value());
        } else {
            array_into("time", time, &[n], &mut self.time)?;
        }
        read_mask(ok, &mut self.ok)?;
        Ok(self.core.update(&self.position, &self.ok, &self.time))
    }
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

    #[doc = stub!(PositionFilter.accepted)]
    #[getter]
    fn accepted<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        PyArray1::from_slice(py, self.core.accepted())
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
        let accepted = self.store(position, ok, time)?;
        Ok(PyArray1::from_slice(position.py(), accepted))
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

/// Reads a mask (N,).
fn read_mask(value: &Bound<'_, PyAny>, out: &mut [bool]) -> PyResult<()> {
    let array = if let Ok(array) = value.cast::<PyArray1<bool>>() {
        array.readonly()
    } else {
        let array = value.py().import("numpy")?.call_method1("array", (value, "bool"))?;
        array.cast_into::<PyArray1<bool>>()?.readonly()
    };
    let mask = array.as_slice()?;
    if mask.len() != out.len() {
        return Err(shape("ok", &[mask.len()], crate::error::tuple(&[out.len()])));
    }
    out.copy_from_slice(mask);
    Ok(())
}
