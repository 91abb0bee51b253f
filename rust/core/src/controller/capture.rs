//! Capture of the gravity offset from an arm that is held still.

use crate::controller::Controller;
use crate::error::{Error, Result};
use crate::pose::COORDINATE_BOUND;

impl Controller {
    /// Captures the gravity offset of an arm that an integrating goal holds still.
    ///
    /// Uses `k_g,i = g_i / lead_i` with `lead = goal − q` where |g_i| exceeds three times the torque that friction and
    /// one encoder count of the lead can hide, within 0.3…3 × the configured `k_p`. Uses the configured `k_p` for the
    /// other joints. The result serves the gravity offset only. Returns k_g [N·m/rad].
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::OutOfRange`] for `q` or `goal`; [`Error::Config`] without `k_p`.
    pub fn capture_gravity(&mut self, q: &[f64], goal: &[f64]) -> Result<Vec<f64>> {
        let q = self.positions("q", q)?;
        let goal = self.joints("goal", goal, COORDINATE_BOUND)?;
        if !self.plan.servos.has_kp {
            return Err(Error::config("servos", "capturing gravity needs an assumed k_p: give servos"));
        }
        let holding = self.holding_torques(&q);
        let servos = &self.plan.servos;
        let mut captured = servos.compliance;
        for i in 0..self.plan.n {
            if holding[i].abs() > 3.0 * servos.friction[i].max(servos.kp[i] * servos.encoder_step[i]) {
                let (compliance, believed) = ((goal[i] - q[i]) / holding[i], servos.compliance[i]);
                captured[i] = compliance.clamp(believed / 3.0, believed / 0.3);
            }
        }
        // Subtract the share of this offset that the integrating goal holds, so that it does not count twice.
        if self.settings.gravity_use().in_goal() {
            for i in 0..self.plan.n {
                let more = holding[i] * (captured[i] - self.plan.gravity_compliance[i]);
                self.memory.integral[i] -= more;
                self.memory.weight[i] += more;
            }
        }
        self.captured = Some(captured);
        self.plan.gravity_compliance = captured;
        Ok(captured[..self.plan.n].iter().map(|compliance| 1.0 / compliance).collect())
    }
}
