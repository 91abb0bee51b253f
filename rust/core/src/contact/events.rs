//! Touch and stop events: one force threshold per axis and kind, with hysteresis and a minimum time.

use crate::{AxisVec, MAX_AXES};

/// State of one kind of event, touch or stop, for all axes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Events {
    /// Threshold for each axis [N, N·m]; ∞ for an axis without events.
    thresholds: AxisVec,
    /// Share of the threshold by which the force must fall below it to end an event.
    hysteresis: f64,
    /// Time for which the force must be beyond a threshold before an event begins or ends [s].
    min_time: f64,
    /// Lower bound on a threshold, as a multiple of the uncertainty.
    guard: f64,
    /// Time for which the force along each axis has contradicted its state in `on` [s].
    against: AxisVec,
    /// True for axes with an event.
    on: [bool; MAX_AXES],
}

impl Events {
    pub(super) fn new(thresholds: &[Option<f64>; MAX_AXES], hysteresis: f64, min_time: f64, guard: f64) -> Self {
        let thresholds = thresholds.map(|threshold| threshold.unwrap_or(f64::INFINITY));
        Self { thresholds, hysteresis, min_time, guard, against: [f64::NEG_INFINITY; MAX_AXES], on: [false; MAX_AXES] }
    }

    pub(super) fn reset(&mut self) {
        (self.against, self.on) = ([f64::NEG_INFINITY; MAX_AXES], [false; MAX_AXES]);
    }

    /// Updates the events with force and uncertainty [N, N·m] `dt` [s] after the last update; returns true for axes
    /// with an event.
    ///
    /// An event begins once |force| has been above `max(threshold, guard · uncertainty)` for the minimum time, counted
    /// from the first such reading. It ends once |force| has been below `(1 − hysteresis)` times that value for the
    /// same time.
    pub(super) fn update(&mut self, force: &AxisVec, uncertainty: &AxisVec, dt: f64) -> [bool; MAX_AXES] {
        for axis in 0..MAX_AXES {
            let threshold = self.thresholds[axis].max(self.guard * uncertainty[axis]);
            let size = force[axis].abs();
            let contradicts = if self.on[axis] { size < (1.0 - self.hysteresis) * threshold } else { size > threshold };
            // −dt, so that the time is 0 at the first reading beyond a threshold.
            self.against[axis] = if contradicts { self.against[axis].max(-dt) + dt } else { -dt };
            if contradicts && self.against[axis] >= self.min_time - 1e-9 {
                self.on[axis] = !self.on[axis];
                self.against[axis] = -dt;
            }
        }
        self.on
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn events(guard: f64) -> Events {
        Events::new(&[Some(10.0); MAX_AXES], 0.3, 0.02, guard)
    }

    fn feel(events: &mut Events, force: f64, uncertainty: f64) -> bool {
        events.update(&[force; MAX_AXES], &[uncertainty; MAX_AXES], 0.01)[0]
    }

    #[test]
    fn events_have_a_minimum_time_and_hysteresis() {
        let mut z = events(1.0);
        assert!(!feel(&mut z, -11.0, 1.0) && !feel(&mut z, -11.0, 1.0));
        assert!(feel(&mut z, -11.0, 1.0), "after 20 ms");
        assert!(feel(&mut z, -8.0, 1.0), "above seven tenths it stays");
        (0..2).for_each(|_| assert!(feel(&mut z, -6.0, 1.0)));
        assert!(!feel(&mut z, -6.0, 1.0));
    }

    #[test]
    fn one_reading_below_the_threshold_restarts_the_time() {
        let mut z = events(1.0);
        for _ in 0..10 {
            assert!(!feel(&mut z, 11.0, 1.0) && !feel(&mut z, 11.0, 1.0) && !feel(&mut z, 9.0, 1.0));
        }
    }

    #[test]
    fn a_threshold_is_at_least_guard_times_the_uncertainty() {
        let (mut guarded, mut unguarded) = (events(1.0), events(0.0));
        for _ in 0..10 {
            assert!(!feel(&mut guarded, 11.0, 12.0));
        }
        (0..2).for_each(|_| assert!(!feel(&mut unguarded, 11.0, 12.0)));
        assert!(feel(&mut unguarded, 11.0, 12.0));
    }

    #[test]
    fn without_a_minimum_time_events_start_and_end_at_once() {
        let mut z = Events::new(&[Some(10.0); MAX_AXES], 0.3, 0.0, 1.0);
        assert!(feel(&mut z, 10.5, 1.0) && !feel(&mut z, 1.0, 1.0));
        assert!(!feel(&mut z, f64::NAN, 1.0));
    }
}
