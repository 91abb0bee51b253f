//! Python class `ThermalModel`: heat of the servos, and the torque limits that follow from it.

use pliant_core::arm::{ThermalModel as CoreThermalModel, ThermalOptions};
use pyo3::prelude::*;

use crate::error::OrRaise;
use crate::ndarray::new_array;
use crate::read::compact::array_into;

#[doc = stub!(ThermalModel)]
#[pyclass(module = "pliant._core")]
#[derive(Debug)]
pub(crate) struct ThermalModel {
    pub(crate) core: CoreThermalModel,
}

impl ThermalModel {
    fn read(&self, name: &str, value: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
        let mut numbers = vec![0.0; self.core.heat().len()];
        array_into(name, value, &[numbers.len()], &mut numbers)?;
        Ok(numbers)
    }
}

#[pymethods]
impl ThermalModel {
    #[new]
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 passes extracted arguments by value")]
    #[pyo3(signature = (max_torque, stall_current=None, *, continuous, seconds, supply, hottest))]
    fn new(
        max_torque: Vec<f64>,
        stall_current: Option<Vec<f64>>,
        continuous: f64,
        seconds: f64,
        supply: Option<f64>,
        hottest: f64,
    ) -> PyResult<Self> {
        let options = ThermalOptions { continuous, time_constant: seconds, supply, shutdown_temperature: hottest };
        let core = CoreThermalModel::new(options, &max_torque, stall_current.as_deref()).or_raise()?;
        Ok(Self { core })
    }

    #[doc = stub!(ThermalModel.heat)]
    #[getter]
    fn heat<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[self.core.heat().len()], self.core.heat())
    }

    #[doc = stub!(ThermalModel.temperature)]
    #[getter]
    fn temperature<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        new_array(py, &[self.core.heat().len()], self.core.temperature())
    }

    #[doc = stub!(ThermalModel.zero_torque_temperature)]
    #[getter]
    fn zero_torque_temperature(&self) -> f64 {
        self.core.zero_torque_temperature()
    }

    #[doc = stub!(ThermalModel.set_temperature)]
    fn set_temperature(&mut self, servo: usize, temperature: f64) {
        self.core.set_temperature(servo, temperature);
    }

    #[doc = stub!(ThermalModel.is_too_hot)]
    fn is_too_hot(&self, max_heat: f64) -> bool {
        self.core.is_too_hot(max_heat)
    }

    #[doc = stub!(ThermalModel.update)]
    fn update(&mut self, torque: &Bound<'_, PyAny>, dt: f64) -> PyResult<()> {
        let torque = self.read("torque", torque)?;
        self.core.update(&torque, dt);
        Ok(())
    }

    #[doc = stub!(ThermalModel.torque_ceiling)]
    fn torque_ceiling<'py>(&self, py: Python<'py>) -> Bound<'py, PyAny> {
        let mut ceiling = vec![0.0; self.core.heat().len()];
        self.core.torque_ceiling(&mut ceiling);
        new_array(py, &[ceiling.len()], &ceiling)
    }

    #[doc = stub!(ThermalModel.limit_current)]
    fn limit_current<'py>(
        &self,
        torque: &Bound<'py, PyAny>,
        least: &Bound<'py, PyAny>,
        limit: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyAny>> {
        let mut limits = self.read("limit", limit)?;
        self.core.limit_current(&self.read("torque", torque)?, &self.read("least", least)?, &mut limits);
        Ok(new_array(limit.py(), &[limits.len()], &limits))
    }
}
