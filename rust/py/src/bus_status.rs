//! Python class `BusStatus`: record of the status readings of all servos on a bus.

use pyo3::prelude::*;

#[doc = stub!(BusStatus)]
#[pyclass(module = "pliant._core")]
#[derive(Debug)]
pub(crate) struct BusStatus {
    #[doc = stub!(BusStatus.torque_changes)]
    #[pyo3(get, set)]
    pub(crate) torque_changes: u64,
    #[doc = stub!(BusStatus.changes)]
    #[pyo3(get, set)]
    pub(crate) changes: u64,
    #[doc = stub!(BusStatus.next_step)]
    #[pyo3(get, set)]
    pub(crate) next_step: usize,
    /// For each servo: true if a reading contained its status, and `StatusPoller` has not taken it.
    is_new: Vec<bool>,
    /// For each servo: last time at which all status registers were as written [s].
    matched: Vec<f64>,
}

#[cfg(unix)]
impl BusStatus {
    /// Notes that at `time` [s] all status registers of all servos were as written.
    pub(crate) fn note_commands(&mut self, time: f64) {
        self.is_new.fill(true);
        self.matched.fill(time);
    }
}

#[pymethods]
impl BusStatus {
    #[new]
    #[pyo3(signature = (matched, is_new = None, torque_changes = 0, changes = 0, next_step = 0))]
    fn new(matched: Vec<f64>, is_new: Option<Vec<bool>>, torque_changes: u64, changes: u64, next_step: usize) -> Self {
        let is_new = is_new.unwrap_or_else(|| vec![false; matched.len()]);
        Self { torque_changes, changes, next_step, is_new, matched }
    }

    fn __getnewargs__(&self) -> (Vec<f64>, Vec<bool>, u64, u64, usize) {
        (self.matched.clone(), self.is_new.clone(), self.torque_changes, self.changes, self.next_step)
    }

    #[doc = stub!(BusStatus.has_new)]
    pub(crate) fn has_new(&self, servo: usize) -> bool {
        self.is_new.get(servo).copied().unwrap_or_default()
    }

    #[doc = stub!(BusStatus.set_new)]
    pub(crate) fn set_new(&mut self, servo: usize, is_new: bool) {
        if let Some(slot) = self.is_new.get_mut(servo) {
            *slot = is_new;
        }
    }

    #[doc = stub!(BusStatus.matched)]
    fn matched(&self, servo: usize) -> f64 {
        self.matched.get(servo).copied().unwrap_or_default()
    }
}
