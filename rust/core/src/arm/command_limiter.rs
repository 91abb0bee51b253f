//! Limits of a command before it is sent: position limits, thermal and supply budgets, and the ramp after torque on.

use super::lowering::margin;
use super::{SUPPORT, ThermalModel};
use crate::error::{Error, Result};
use crate::model::Model;
use crate::params::Servos;

/// A goal that exceeds its position limit by more than this plus `max_torque / k_p`, the lead of the usable torque,
/// probably has a wrong unit [rad].
const MAX_GOAL_EXCESS: f64 = 1.0;

/// Command for the n joints of the chain, and the state of the arm for which it is limited.
#[derive(Debug, Clone, Copy)]
pub struct LimiterInput<'a> {
    /// Requested goal of each joint of the chain [rad].
    pub goal: &'a [f64],
    /// Requested torque limit of each joint of the chain [N·m].
    pub torque_limit: &'a [f64],
    /// Torque of each joint of the chain that holds the arm against gravity [N·m].
    pub gravity: &'a [f64],
    /// Position of each of the N joints [rad]; NaN where unknown.
    pub position: &'a [f64],
    /// Goal [rad] and torque limit [N·m] of each of the N − n joints off the chain, in the order of the drive.
    pub off_chain: &'a [[f64; 2]],
    /// Progress of the ramp from holding torque to usable torque, 0 to 1.
    pub ramp: f64,
    /// Lower bound on the torque `holding`, at which the ramp starts, for each joint of the chain [N·m].
    pub ramp_start: &'a [f64],
    /// True if goals may lie beyond the position limits by the lead of the usable torque, to exert a force; false: by
    /// the lead that the gravity torque needs.
    pub may_lead: bool,
}

/// Limits the goals and torque limits of all N joints of a drive; the chain has n of them.
///
/// With gravity torque g, usable torque `τ_max`, stiffness k_p and the margin m of [`super::torque_margin`], for each
/// joint of the chain:
///
/// ```text
/// goal    = clip(goal, lower − ℓ, upper + ℓ),  ℓ = τ_max/k_p, or the lead that g needs on that side
/// holding = min(max(1.1 |g| + m, ramp_start), τ_max)
/// limit   = min(limit, holding + ramp (τ_max − holding), max(thermal ceiling, 1.1 |g|))
/// ```
///
/// The limits of the chain are then reduced to the current of the supply, but not below 1.1 |g|. A joint off the chain
/// keeps its goal, with a limit of at most its thermal ceiling.
#[derive(Debug, Clone)]
pub struct CommandLimiter {
    /// Indices of the n joints of the chain, and of the N − n others, in the order of the drive.
    chain: Vec<usize>,
    off_chain: Vec<usize>,
    lower: Vec<f64>,
    upper: Vec<f64>,
    /// Friction of each joint of the chain [N·m].
    friction: Vec<f64>,
    /// `max_torque` of the servo table for each joint of the chain [N·m], without later reductions; it determines the
    /// torque margin.
    rated_torque: Vec<f64>,
    kp: Vec<f64>,
    max_torque: Vec<f64>,
    goals: Vec<f64>,
    limits: Vec<f64>,
    reduced: Vec<f64>,
    ceiling: Vec<f64>,
    support: Vec<f64>,
    pull: Vec<f64>,
    torque: Vec<f64>,
    speeds: Vec<f64>,
}

impl CommandLimiter {
    /// Creates the limiter of an arm.
    ///
    /// `servos` is the table of the chain, `chain` the index of each of its n joints in the drive. `kp` [N·m/rad] and
    /// `max_torque` [N·m] are stiffness and usable torque of each of the N joints of the drive.
    ///
    /// # Errors
    /// [`Error::Shape`] if lengths differ; [`Error::Config`] if an index is beyond N or occurs twice, if the servos do
    /// not fit the model, or if a stiffness is not above 0.
    pub fn new(model: &Model, servos: &Servos, chain: &[usize], kp: &[f64], max_torque: &[f64]) -> Result<Self> {
        let (n, size) = (model.n(), kp.len());
        let servos = servos.for_joints(n)?;
        if chain.len() != n {
            return Err(Error::length("chain", chain.len(), n));
        }
        if max_torque.len() != size {
            return Err(Error::length("max_torque", max_torque.len(), size));
        }
        for (i, joint) in chain.iter().enumerate() {
            if *joint >= size || chain[..i].contains(joint) {
                let message = format!("must be n different indices below {size}, got {chain:?}");
                return Err(Error::config("chain", message));
            }
        }
        if let Some(i) = kp.iter().position(|kp| !(*kp > 0.0)) {
            return Err(Error::config("kp", format!("must be above 0 N·m/rad, got {} at index {i}", kp[i])));
        }
        let zeros = || vec![0.0; size];
        Ok(Self {
            off_chain: (0..size).filter(|joint| !chain.contains(joint)).collect(),
            chain: chain.to_vec(),
            lower: model.lower().to_vec(),
            upper: model.upper().to_vec(),
            friction: servos.friction.clone(),
            rated_torque: servos.max_torque.clone(),
            kp: kp.to_vec(),
            max_torque: max_torque.to_vec(),
            goals: zeros(),
            limits: zeros(),
            reduced: zeros(),
            ceiling: zeros(),
            support: zeros(),
            pull: zeros(),
            torque: zeros(),
            speeds: zeros(),
        })
    }

    /// Returns the number of joints of the chain.
    pub fn n(&self) -> usize {
        self.chain.len()
    }

    /// Returns the indices of the n joints of the chain, in the order of the drive.
    pub fn chain(&self) -> &[usize] {
        &self.chain
    }

    /// Returns the indices of the N − n joints off the chain, in the order of the drive.
    pub fn off_chain(&self) -> &[usize] {
        &self.off_chain
    }

    /// Returns the number of all joints.
    pub fn size(&self) -> usize {
        self.kp.len()
    }

    /// Returns the index of the joint of the chain whose goal [rad] is farthest outside its limits, if that is so far
    /// that its unit is probably wrong; else `None`.
    pub fn unreachable(&self, goal: &[f64]) -> Option<usize> {
        let mut farthest = (0, f64::NEG_INFINITY);
        for (i, goal) in goal.iter().enumerate().take(self.n()) {
            let excess = (self.lower[i] - goal).max(goal - self.upper[i]);
            if excess > farthest.1 {
                farthest = (i, excess);
            }
        }
        let joint = *self.chain.get(farthest.0)?;
        (farthest.1 > MAX_GOAL_EXCESS + self.max_torque[joint] / self.kp[joint]).then_some(farthest.0)
    }

    /// Returns the goal [rad] and the torque limit [N·m] to send to each of the N joints.
    ///
    /// # Errors
    /// [`Error::Shape`] if a slice has a wrong length; [`Error::OutOfRange`] if a goal, torque limit or gravity torque
    /// of the chain is not finite, a torque limit negative, or a goal [unreachable](Self::unreachable).
    pub fn limit(&mut self, thermal: &ThermalModel, input: &LimiterInput<'_>) -> Result<(&[f64], &[f64])> {
        let (n, size) = (self.n(), self.size());
        for (name, got, expected) in [
            ("goal", input.goal.len(), n),
            ("limit", input.torque_limit.len(), n),
            ("gravity", input.gravity.len(), n),
            ("ramp_start", input.ramp_start.len(), n),
            ("position", input.position.len(), size),
            ("thermal", thermal.heat().len(), size),
            ("off_chain", input.off_chain.len(), size - n),
        ] {
            if got != expected {
                return Err(Error::length(name, got, expected));
            }
        }
        for (name, values, least) in [
            ("goal", input.goal, f64::NEG_INFINITY),
            ("limit", input.torque_limit, 0.0),
            ("gravity", input.gravity, f64::NEG_INFINITY),
        ] {
            if let Some(i) = values.iter().position(|value| !(value.is_finite() && *value >= least)) {
                let bounds = if least < 0.0 { "(-∞, ∞)" } else { "[0, ∞) N·m" };
                return Err(Error::out_of_range(format!("{name}[{i}]"), values[i], bounds));
            }
        }
        if let Some(joint) = self.unreachable(input.goal) {
            let bound = format!("{} to {} rad by far", self.lower[joint], self.upper[joint]);
            return Err(Error::out_of_range(format!("goal[{joint}]"), input.goal[joint], bound));
        }
        // NaN counts as 0: the limits then start from the holding torques.
        let ramp = if input.ramp > 0.0 { input.ramp.min(1.0) } else { 0.0 };
        thermal.torque_ceiling(&mut self.ceiling);
        self.support.fill(0.0);
        for (i, &joint) in self.chain.iter().enumerate() {
            let (usable, kp, gravity) = (self.max_torque[joint], self.kp[joint], input.gravity[i]);
            let lead = gravity / kp;
            let (below, above) =
                if input.may_lead { (usable / kp, usable / kp) } else { ((-lead).max(0.0), lead.max(0.0)) };
            self.goals[joint] = input.goal[i].max(self.lower[i] - below).min(self.upper[i] + above);
            let support = SUPPORT * gravity.abs();
            let held = support + margin(self.rated_torque[i], self.friction[i], gravity);
            let holding = held.max(input.ramp_start[i]).min(usable);
            let ramped = holding + ramp * (usable - holding);
            self.support[joint] = support;
            self.limits[joint] = input.torque_limit[i].min(ramped).min(self.ceiling[joint].max(support));
        }
        for (&joint, &[goal, limit]) in self.off_chain.iter().zip(input.off_chain) {
            (self.goals[joint], self.limits[joint]) = (goal, limit.min(self.ceiling[joint]));
        }
        for (i, pull) in self.pull.iter_mut().enumerate() {
            let error = self.goals[i] - input.position[i];
            *pull = if error.is_nan() { 0.0 } else { self.kp[i] * error };
        }
        self.reduced.copy_from_slice(&self.limits);
        thermal.limit_current(&self.pull, &self.support, &mut self.reduced);
        for &joint in &self.chain {
            self.limits[joint] = self.reduced[joint];
        }
        Ok((&self.goals, &self.limits))
    }

    /// Extends the largest speed of each of the chain's n joints [rad/s] to all N joints; the others are not limited.
    ///
    /// # Errors
    /// [`Error::Shape`] if the length is not n; [`Error::OutOfRange`] if a speed is negative or NaN.
    pub fn speeds(&mut self, speed: &[f64]) -> Result<&[f64]> {
        if speed.len() != self.n() {
            return Err(Error::length("velocity", speed.len(), self.n()));
        }
        self.speeds.fill(f64::INFINITY);
        for (&joint, &speed) in self.chain.iter().zip(speed) {
            if !(speed >= 0.0) {
                return Err(Error::out_of_range("velocity", speed, "[0, ∞] rad/s"));
            }
            self.speeds[joint] = speed;
        }
        Ok(&self.speeds)
    }

    /// Updates the heat of the servos after `dt` [s], from their torques.
    ///
    /// The torque of each of the N servos is its measured `load` [N·m], where that is finite; else it is estimated from
    /// `goal` [rad] and `torque_limit` [N·m] in the servo and from its position [rad]: `min(k_p |goal − q|, limit)`.
    ///
    /// # Errors
    /// [`Error::Shape`] if a slice does not have N entries.
    pub fn update_heat(
        &mut self,
        thermal: &mut ThermalModel,
        sent: [&[f64]; 2],
        position: &[f64],
        load: Option<&[f64]>,
        dt: f64,
    ) -> Result<()> {
        let size = self.size();
        let [goal, limit] = sent;
        for (name, values) in
            [("goal", goal), ("limit", limit), ("position", position), ("load", load.unwrap_or(position))]
        {
            if values.len() != size {
                return Err(Error::length(name, values.len(), size));
            }
        }
        for i in 0..size {
            let error = goal[i] - position[i];
            let pull = if error.is_nan() { 0.0 } else { (self.kp[i] * error).abs() };
            let measured = load.map_or(f64::NAN, |load| load[i]);
            self.torque[i] = if measured.is_finite() { measured.abs() } else { pull.min(limit[i]) };
        }
        thermal.update(&self.torque, dt);
        Ok(())
    }
}
