//! Follows joint targets from a leader arm or a policy, with the force of the tool bounded along x, y and z.
//!
//! The goals follow the targets in joint space, so every joint follows its own target, also near a singular pose. The
//! torque limits allow for the weight and the largest forces F_a along the base axes. Per joint i, with the reference
//! r, the gravity torque g, the friction ρ, the usable torque τ_max, and the damping d, which includes back-EMF:
//!
//! ```text
//! r′   = r + s (q_target − r)                          with s ≤ 1 so that tool and joints keep their speed limits
//! v    = low-pass((r′ − r) / dt); for a joint that the clip holds back, at most its measured speed
//! f_i  = min(maxₐ F_a max(|J_ai|, l |J_ωai|) + ρ_i, τ_max,i)
//! r    = clip(r′, q ± f / k_p)
//! goal = r + (g + b_d d v + b_f ρ tanh(v / v₀)) / k_p
//! limit_i = min(|g_i| + f_i + b_d |d_i v_i|, τ_max,i)
//! ```
//!
//! The clip keeps the reference no farther from the joint than the torque f requires, so an arm that was held back
//! starts to return immediately. The clip in the direction of motion narrows as the speed that the joints will have
//! when the goal acts comes near the limits, because a soft servo stores energy in its lead. For a joint that moves the
//! tool point little, such as the roll of a wrist, the force acts at the lever l.

use std::sync::Arc;

use super::{MIN_STEP, finite_joint_vector, holding_torque, padded};
use crate::controller::Command;
use crate::error::{Error, Result};
use crate::kinematics::{GroupMasses, Reference};
use crate::model::Model;
use crate::params::{LimitType, Servos};
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Share b_f of the friction that is fed forward.
const FRICTION_SHARE: f64 = 0.8;
/// Share b_d of the viscous damping that is fed forward.
const DAMPING_SHARE: f64 = 0.8;
/// Speed v₀ in the friction feed-forward `tanh(v/v₀)` [rad/s].
const FRICTION_SPEED: f64 = 0.1;
/// Time constant of the low-pass of the reference's speed [s]. It smooths targets that arrive at 30 Hz only.
const SPEED_FILTER: f64 = 0.03;
/// Distance l [m] from the tool point up to which the force bounds apply; about the length of a finger.
const LEVER: f64 = 0.1;
/// Time constant of the low-pass of the measured joint speeds [s].
const MEASURED_SPEED_FILTER: f64 = 0.02;
/// Time steps from a motion until a changed goal acts on it: reading, sending, and the servo's response.
const REACTION_STEPS: f64 = 3.0;
/// Share of the speed limits above which the lead that accelerates the arm decreases.
const FADE_FROM: f64 = 0.7;
/// Share of the speed limits at which the lead that accelerates the arm is 0.
const FADE_TO: f64 = 1.1;
/// Largest time step of one call [s]; a longer `dt` is clamped to it.
const LONGEST_STEP: f64 = 0.1;

/// Options of [`JointFollower`].
#[derive(Debug, Clone, Copy)]
pub struct JointFollowerOptions {
    /// Largest force at the tool along x, y and z of the base [N]. Each joint may exert the torque that the axis
    /// which loads it most needs, so with different values the force along the other axes may exceed theirs. One ∞
    /// lifts all three bounds: only the usable torque of the servos then limits the force.
    pub max_force: [f64; 3],
    /// Speed limit of the tool point [m/s]; ∞ for none.
    pub max_tool_speed: f64,
    /// Speed limit of each joint [rad/s]; ∞ for none.
    pub max_joint_speed: f64,
}

impl JointFollowerOptions {
    fn validate(&self) -> Result<()> {
        for (axis, &force) in self.max_force.iter().enumerate() {
            if force.is_nan() || force < 0.0 {
                return Err(Error::out_of_range(format!("max_force[{axis}]"), force, "[0, ∞] N"));
            }
        }
        for (name, speed, unit) in
            [("max_tool_speed", self.max_tool_speed, "m/s"), ("max_joint_speed", self.max_joint_speed, "rad/s")]
        {
            if speed.is_nan() || speed <= 0.0 {
                return Err(Error::out_of_range(name, speed, format!("(0, ∞] {unit}")));
            }
        }
        Ok(())
    }
}

/// Goals that follow joint targets, and torque limits that bound the force; call [`JointFollower::step`] once per tick.
#[derive(Debug, Clone)]
pub struct JointFollower {
    model: Arc<Model>,
    masses: GroupMasses,
    options: JointFollowerOptions,
    n: usize,
    kp: JointVec,
    max_torque: JointVec,
    friction: JointVec,
    /// Sum of viscous damping, derivative gain and back-EMF [N·m·s/rad].
    damping: JointVec,
    /// Reference r [rad]; `None` before the first step.
    reference: Option<JointVec>,
    /// Low-passed speed v of the reference [rad/s].
    speed: JointVec,
    /// Low-passed measured speeds of the joints [rad/s].
    measured_speed: JointVec,
    /// Speeds of the joints at the time at which the next goal acts, if their acceleration continues [rad/s].
    predicted_speed: JointVec,
    /// Positions in the last step [rad]; `None` before the first step.
    last_q: Option<JointVec>,
}

impl JointFollower {
    /// Creates a follower that starts from the positions of its first step.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] for an option out of range; [`Error::Config`], [`Error::Shape`] if the servos do not fit
    /// the model.
    pub fn new(model: Arc<Model>, servos: &Servos, options: JointFollowerOptions) -> Result<Self> {
        options.validate()?;
        let n = model.n();
        let servos = servos.for_joints(n)?;
        let max_torque = padded(&servos.max_torque, 0.0);
        let no_load = match (servos.limit_type, &servos.no_load_speed) {
            (LimitType::Pwm, Some(speed)) => padded(speed, f64::INFINITY),
            _ => [f64::INFINITY; MAX_JOINTS],
        };
        let (damping, kv) = (padded(&servos.damping, 0.0), padded(&servos.kv, 0.0));
        Ok(Self {
            masses: model.chain().masses(model.payload()),
            model,
            options,
            n,
            kp: padded(&servos.kp, 1.0),
            max_torque,
            friction: padded(&servos.friction, 0.0),
            damping: std::array::from_fn(|i| damping[i] + kv[i] + max_torque[i] / no_load[i]),
            reference: None,
            speed: [0.0; MAX_JOINTS],
            measured_speed: [0.0; MAX_JOINTS],
            predicted_speed: [0.0; MAX_JOINTS],
            last_q: None,
        })
    }

    /// Returns the options.
    pub const fn options(&self) -> &JointFollowerOptions {
        &self.options
    }

    /// Replaces the options while running; the goals continue from their present values.
    ///
    /// # Errors
    /// [`Error::OutOfRange`]; the options are then unchanged.
    pub fn set_options(&mut self, options: JointFollowerOptions) -> Result<()> {
        options.validate()?;
        self.options = options;
        Ok(())
    }

    /// Starts again from the joint positions q [rad], at rest.
    ///
    /// # Errors
    /// [`Error::Shape`] if q does not have n entries; [`Error::OutOfRange`] if one is not finite.
    pub fn reset(&mut self, q: &[f64]) -> Result<()> {
        self.reference = Some(finite_joint_vector("q", self.n, q)?);
        (self.speed, self.measured_speed, self.last_q) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], None);
        self.predicted_speed = [0.0; MAX_JOINTS];
        Ok(())
    }

    /// Computes goals and torque limits for measured positions q and targets of the n joints [rad]; `dt` is the time
    /// since the last step [s]. Targets are clipped to the position limits.
    ///
    /// # Errors
    /// [`Error::Shape`] for a vector without n entries; [`Error::OutOfRange`] for a number that is not finite, or `dt`
    /// not above 0. After an error the state is unchanged.
    pub fn step(&mut self, q: &[f64], target: &[f64], dt: f64) -> Result<Command> {
        let (q, target) = (finite_joint_vector("q", self.n, q)?, finite_joint_vector("q_target", self.n, target)?);
        if !(dt > 0.0 && dt.is_finite()) {
            return Err(Error::out_of_range("dt", dt, "(0, ∞) s"));
        }
        let dt = dt.clamp(MIN_STEP, LONGEST_STEP);
        let mut rows: Rows = [[0.0; MAX_JOINTS]; MAX_AXES];
        self.model.kinematics_into(&q[..self.n], Reference::WorldAligned, &mut rows)?;
        let gravity = holding_torque(&self.model, &self.masses, &q);
        self.update_measured_speed(&q, dt);
        let fade = self.lead_fade(&rows);
        let before = self.reference.unwrap_or(q);
        let moved = self.toward(&before, &target, &rows, dt);
        let share = dt / (SPEED_FILTER + dt);
        let (mut goal, mut limit, mut reference) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], moved);
        for i in 0..self.n {
            let force = self.force_torque(&rows, i).min(self.max_torque[i]);
            let lead = force / self.kp[i];
            let (back, ahead) = if self.measured_speed[i] > 0.0 { (lead, fade * lead) } else { (fade * lead, lead) };
            reference[i] = moved[i].max(q[i] - back).min(q[i] + ahead);
            let requested_rate = (moved[i] - before[i]) / dt;
            let is_clipped = (reference[i] - moved[i]).abs() > f64::EPSILON;
            // A blocked joint gets no feed-forward for a motion that it does not make.
            let actual_rate = self.measured_speed[i].max(requested_rate.min(0.0)).min(requested_rate.max(0.0));
            let rate = if is_clipped { actual_rate } else { requested_rate };
            self.speed[i] += (rate - self.speed[i]) * share;
            let viscous = DAMPING_SHARE * self.damping[i] * self.speed[i];
            let dry = FRICTION_SHARE * self.friction[i] * (self.speed[i] / FRICTION_SPEED).tanh();
            goal[i] = reference[i] + (gravity[i] + viscous + dry) / self.kp[i];
            limit[i] = self.max_torque[i].min(gravity[i].abs() + force + viscous.abs());
        }
        (self.reference, self.last_q) = (Some(reference), Some(q));
        Ok(Command::new(self.n, goal, limit, [self.options.max_joint_speed; MAX_JOINTS]))
    }

    /// Updates the low-passed measured speeds of the joints, and the predicted ones.
    fn update_measured_speed(&mut self, q: &JointVec, dt: f64) {
        let last = self.last_q.unwrap_or(*q);
        // The low-pass delays a steady acceleration by its time constant.
        let ahead = MEASURED_SPEED_FILTER + REACTION_STEPS * dt;
        for i in 0..self.n {
            let rate = (q[i] - last[i]) / dt;
            let change = (rate - self.measured_speed[i]) * dt / (MEASURED_SPEED_FILTER + dt);
            self.measured_speed[i] += change;
            self.predicted_speed[i] = self.measured_speed[i] + change * ahead / dt;
        }
    }

    /// Returns the factor on a lead that accelerates the arm: 1 up to `FADE_FROM` of the speed limits, 0 from `FADE_TO`
    /// on.
    fn lead_fade(&self, rows: &Rows) -> f64 {
        let fastest = self.predicted_speed.iter().fold(0.0_f64, |max, speed| max.max(speed.abs()));
        let ratio = (fastest / self.options.max_joint_speed)
            .max(self.tool_path(rows, &self.predicted_speed) / self.options.max_tool_speed);
        ((FADE_TO - ratio) / (FADE_TO - FADE_FROM)).clamp(0.0, 1.0)
    }

    /// Returns the distance that the tool point moves for small joint motions [m], or its speed for joint speeds [m/s].
    fn tool_path(&self, rows: &Rows, joints: &JointVec) -> f64 {
        (0..3).map(|axis| (0..self.n).map(|i| rows[axis][i] * joints[i]).sum::<f64>().powi(2)).sum::<f64>().sqrt()
    }

    /// Moves the reference `from` straight toward the targets for `dt`, within the speed limits of tool and joints.
    fn toward(&self, from: &JointVec, target: &JointVec, rows: &Rows, dt: f64) -> JointVec {
        let (lower, upper) = (self.model.lower(), self.model.upper());
        let mut gap = [0.0; MAX_JOINTS];
        for i in 0..self.n {
            gap[i] = target[i].max(lower[i]).min(upper[i]) - from[i];
        }
        let largest = gap.iter().fold(0.0_f64, |max, step| max.max(step.abs()));
        let path = self.tool_path(rows, &gap);
        let mut share = 1.0_f64;
        if largest > self.options.max_joint_speed * dt {
            share = share.min(self.options.max_joint_speed * dt / largest);
        }
        if path > self.options.max_tool_speed * dt {
            share = share.min(self.options.max_tool_speed * dt / path);
        }
        std::array::from_fn(|i| share.mul_add(gap[i], from[i]))
    }

    /// Returns the torque [N·m] of joint i for the force bound of the base axis that loads it most, plus its friction.
    fn force_torque(&self, rows: &Rows, i: usize) -> f64 {
        let mut max = 0.0_f64;
        for (axis, &force) in self.options.max_force.iter().enumerate() {
            if force.is_infinite() {
                return self.max_torque[i];
            }
            max = max.max(force * rows[axis][i].abs().max(LEVER * rows[axis + 3][i].abs()));
        }
        max + self.friction[i]
    }
}
