//! Thermal model of servos and current limit of their supply: reduces torque limits before the hardware switches off.

use crate::error::{Error, Result};

/// Share of the thermal budget above which torque limits are reduced.
const WARM: f64 = 0.8;
/// Range of temperatures over which torque limits fall from their full value to zero [°C].
const DERATING_RANGE: f64 = 8.0;
/// Difference between the servo's shutdown temperature and the temperature at which its limit is zero [°C].
const SHUTDOWN_MARGIN: f64 = 2.0;
/// Largest ratio of torque to continuous torque; above it the heat would overflow.
const MAX_RATIO: f64 = 1e3;
/// Evaluations of the current in the bisection for the share of the torque limits that the supply allows.
const MAX_EVALUATIONS: usize = 12;

/// Parameters of a [`ThermalModel`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThermalOptions {
    /// Share of the usable torque that a servo can exert continuously, in (0, 1].
    pub continuous: f64,
    /// Thermal time constant of the winding [s].
    pub time_constant: f64,
    /// Largest current that the supply delivers to all servos together [A]; `None`: no limit.
    pub supply: Option<f64>,
    /// Temperature at which the servos switch off [°C].
    pub shutdown_temperature: f64,
}

/// Thermal model of N servos, from which torque limits follow.
///
/// The heat h of a servo is the share of its thermal budget in use: `ḣ = ((τ/τ_max)²/continuous² − h) / time_constant`
/// with torque τ and usable torque τ_max. In steady state at the continuous torque, h is 1.
#[derive(Debug, Clone)]
pub struct ThermalModel {
    options: ThermalOptions,
    max_torque: Vec<f64>,
    /// Stall current per usable torque of each servo [A/(N·m)]; empty if the stall currents are unknown.
    current_per_torque: Vec<f64>,
    heat: Vec<f64>,
    temperature: Vec<f64>,
}

impl ThermalModel {
    /// Creates the model of N cold servos from usable torque [N·m] and stall current [A] of each; `None`: unknown.
    ///
    /// # Errors
    /// [`Error::Config`] if an option is out of range, or if a supply is given and the currents are not known.
    pub fn new(options: ThermalOptions, max_torque: &[f64], stall_current: Option<&[f64]>) -> Result<Self> {
        if !(options.continuous > 0.0 && options.continuous <= 1.0) {
            let message = format!("must be in (0, 1], got {}", options.continuous);
            return Err(Error::config("Budget.continuous", message));
        }
        let above_zero = |name: &str, value: f64, unit: &str| {
            if value > 0.0 { Ok(()) } else { Err(Error::config(name, format!("must be above 0 {unit}, got {value}"))) }
        };
        above_zero("Budget.seconds", options.time_constant, "s")?;
        above_zero("Budget.supply", options.supply.unwrap_or(1.0), "A, or None")?;
        above_zero("Budget.hottest", options.shutdown_temperature, "°C")?;
        let n = max_torque.len();
        let known = stall_current.filter(|current| current.len() == n && current.iter().all(|x| x.is_finite()));
        if options.supply.is_some() && known.is_none() {
            let message = "needs the servos' stall currents, which this drive does not know: leave supply out";
            return Err(Error::config("Budget.supply", message));
        }
        let per_torque = known.map(|current| current.iter().zip(max_torque).map(|(i, torque)| i / torque).collect());
        Ok(Self {
            options,
            max_torque: max_torque.to_vec(),
            current_per_torque: per_torque.unwrap_or_default(),
            heat: vec![0.0; n],
            temperature: vec![f64::NAN; n],
        })
    }

    /// Returns the heat of each of the N servos: the share of its thermal budget in use, which is 1 in steady state at
    /// the continuous torque.
    pub fn heat(&self) -> &[f64] {
        &self.heat
    }

    /// Returns the last measured temperature of each servo [°C]; NaN before the first measurement.
    pub fn temperature(&self) -> &[f64] {
        &self.temperature
    }

    /// Stores the measured temperature of a servo [°C]; an index beyond N is ignored.
    pub fn set_temperature(&mut self, servo: usize, temperature: f64) {
        if let Some(stored) = self.temperature.get_mut(servo) {
            *stored = temperature;
        }
    }

    /// Returns the temperature at which the torque limit of a servo becomes zero [°C].
    pub fn zero_torque_temperature(&self) -> f64 {
        self.options.shutdown_temperature - SHUTDOWN_MARGIN
    }

    /// Returns true if the heat of a servo is above `max_heat`, or its temperature is at least
    /// [`Self::zero_torque_temperature`].
    pub fn is_too_hot(&self, max_heat: f64) -> bool {
        self.heat.iter().any(|heat| *heat > max_heat)
            || self.temperature.iter().any(|temperature| *temperature >= self.zero_torque_temperature())
    }

    /// Updates the heat after each of the N servos has exerted its `torque` [N·m] for `dt` [s].
    ///
    /// A NaN torque counts as the usable torque; a NaN or negative time counts as 0.
    pub fn update(&mut self, torque: &[f64], dt: f64) {
        let gain = if dt > 0.0 { -(-dt / self.options.time_constant).exp_m1() } else { 0.0 };
        // NaN if both the time and the time constant are infinite.
        let gain = if gain.is_nan() { 0.0 } else { gain };
        for ((heat, torque), max_torque) in self.heat.iter_mut().zip(torque).zip(&self.max_torque) {
            let ratio = torque / (max_torque * self.options.continuous);
            let share = if ratio.is_nan() { 1.0 / self.options.continuous } else { ratio.abs() }.min(MAX_RATIO);
            *heat += gain * (share * share - *heat);
        }
    }

    /// Writes to `out` the largest torque limit of each servo [N·m] that the present heat and temperature allow; an
    /// unknown temperature reduces nothing.
    pub fn torque_ceiling(&self, out: &mut [f64]) {
        for (i, ceiling) in out.iter_mut().enumerate().take(self.heat.len()) {
            let over = ((self.heat[i] - WARM) / (1.0 - WARM)).clamp(0.0, 1.0);
            *ceiling = self.max_torque[i] * (1.0 - (1.0 - self.options.continuous) * over);
            let left = (self.zero_torque_temperature() - self.temperature[i]) / DERATING_RANGE;
            if !left.is_nan() {
                *ceiling *= left.clamp(0.0, 1.0);
            }
        }
    }

    /// Reduces the torque `limit` of each servo [N·m] to `least + s (limit − least)` with the largest s in [0, 1] for
    /// which the total current stays within the supply; s = 0 if no s does. Does nothing without a supply limit.
    ///
    /// `torque` is the expected torque of each servo without limits [N·m]; `least` is its limit that holds the weight
    /// of the arm and is never reduced [N·m].
    pub fn limit_current(&self, torque: &[f64], least: &[f64], limit: &mut [f64]) {
        let (Some(supply), false) = (self.options.supply, self.current_per_torque.is_empty()) else { return };
        let bounded = |i: usize, share: f64, limit: &[f64]| {
            let least = least[i].min(limit[i]);
            least + share * (limit[i] - least)
        };
        let n = self.current_per_torque.len().min(torque.len()).min(least.len()).min(limit.len());
        let is_allowed = |share: f64, limit: &[f64]| {
            let current: f64 =
                (0..n).map(|i| self.current_per_torque[i] * torque[i].abs().min(bounded(i, share, limit))).sum();
            current <= supply
        };
        let (mut low, mut high) = (0.0, 1.0);
        if is_allowed(high, limit) {
            return;
        }
        for _ in 1..MAX_EVALUATIONS {
            let share = 0.5 * (low + high);
            if is_allowed(share, limit) {
                low = share;
            } else {
                high = share;
            }
        }
        for i in 0..n {
            limit[i] = bounded(i, low, limit);
        }
    }
}
