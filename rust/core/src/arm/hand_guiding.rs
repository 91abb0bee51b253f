//! Hand guiding: the arm feels weightless and rests when released; k_p need not be exact.
//!
//! First the caller moves each joint slowly up and down (the swing). The leads (goal − q) in the two directions differ:
//! their mean lead₀ holds the joint against the gravity torque g₀, and half their difference is the friction ρ. Both
//! are in rad and independent of k_p. Then the goals follow the arm with a play, like a drive with backlash. Per joint,
//! with the predicted position q̂, the filtered speed v, the viscous damping d and `c = ½ (c_low + c_high)`:
//!
//! ```text
//! anchor = clip(anchor, q̂ − w, q̂ + w)
//! goal   = anchor + lead₀ + c (g(q̂) − g₀) + b_f ρ tanh(v/v₀) + c_low b_d d v
//! w      = w₀ (1 − 0.9 tanh(|v|/v₀)) + ½ (c_high − c_low) |g − g₀| + w_e
//! ```
//!
//! The interval from c_low to c_high contains the compliance 1/k_p. The play w grows by the possible error of the lead,
//! so a wrong k_p can let the arm sag within the play but cannot make it drift. When the arm rests after a motion, its
//! lead is known within ρ + w₀, unless a hand holds it. Two rests narrow the interval to the values that explain either
//! of them. The goals must not move at rest, so w_e first makes up for the smaller play, and fades with the next
//! motion.

use std::sync::Arc;

use super::{MAX_VALUE, MIN_STEP, finite_joint_vector, holding_torque, padded};
use crate::controller::Command;
use crate::error::{Error, Result};
use crate::kinematics::{GroupMasses, Reference};
use crate::math::simd::BaselineF64;
use crate::math::spatial::{cross, dot, rotate};
use crate::model::Model;
use crate::params::Servos;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Share b_f of the friction that is fed forward.
const FRICTION_SHARE: f64 = 0.8;
/// Share b_d of the viscous damping that is fed forward.
const DAMPING_SHARE: f64 = 0.8;
/// Share of the delay over which positions are predicted.
const PREDICTION_SHARE: f64 = 0.9;
/// Speed v₀ in the friction feed-forward `tanh(v/v₀)` [rad/s].
const FRICTION_SPEED: f64 = 0.05;
/// Time constant of the speed filter [s].
const SPEED_FILTER: f64 = 0.02;
/// Share of w₀ by which the play w becomes smaller while a joint moves fast.
const PLAY_LOSS: f64 = 0.9;
/// Time without motion after which the arm counts as at rest [s].
const REST_TIME: f64 = 0.4;
/// Smallest change of a joint position that counts as motion [rad]; at least 1.1 encoder counts are required.
const MIN_MOTION: f64 = 5e-4;
/// Assumed error of the lead measured in the swing, as a share of the friction ρ.
const LEAD_ERROR_SHARE: f64 = 0.15;
/// Time constant with which the excess play decreases while a joint moves [s].
const SHRINK_TIME: f64 = 0.5;
/// Smallest play w₀ of a joint at rest [rad].
const MIN_PLAY: f64 = 2e-3;
/// Smallest play w₀ of a joint at rest, in encoder counts.
const MIN_PLAY_COUNTS: f64 = 1.5;
/// Smallest play w₀ of a joint at rest, as a multiple of the lead ρ [rad] that overcomes its friction.
const MIN_PLAY_FRICTION: f64 = 0.15;
/// Largest speed at which the tool is followed [m/s], as in
/// [`Settings::max_tool_speed`](crate::Settings::max_tool_speed).
const MAX_TOOL_SPEED: f64 = 0.25;
/// Largest speed of the goals [rad/s].
const MAX_GOAL_SPEED: f64 = 3.0;
/// Largest time step of one call [s]; a longer `dt` is clamped to it.
const MAX_STEP: f64 = 1.0;
/// Largest valid delay [s], as in [`Controller::set_delay`](crate::Controller::set_delay).
const MAX_DELAY: f64 = 0.5;

/// Measurements of the swing, a slow motion of the joints up and down, and state of the arm after it. Vectors have n
/// entries.
#[derive(Debug, Clone, Copy)]
pub struct SwingResult<'a> {
    /// Joint positions at the end of the swing [rad].
    pub q: &'a [f64],
    /// Goals at the end of the swing [rad].
    pub goal: &'a [f64],
    /// True for joints that moved in the swing. The lead of the other joints is computed from the assumed k_p.
    pub swung: &'a [bool],
    /// Mean of the leads (goal − q) in the motions up and down [rad]; 0 for a joint that did not move in the swing.
    pub lead: &'a [f64],
    /// Friction as a lead: half the difference of the leads in the motions up and down [rad].
    pub friction: &'a [f64],
}

/// Options of [`HandGuiding`].
#[derive(Debug, Clone, Copy)]
pub struct HandGuidingOptions {
    /// Factor ≥ 1 by which the true k_p may differ from the assumed k_p in either direction.
    pub stiffness_error: f64,
    /// Time from the reading to the arrival of the goal [s].
    pub delay: f64,
    /// Torque limit beyond what gravity requires, as a share of the usable torque.
    pub torque_share: f64,
    /// Payload in addition to that of the model: mass [kg], then mass times centre of mass in the tool frame [kg·m].
    pub payload_moments: [f64; 4],
}

impl HandGuidingOptions {
    fn validate(&self) -> Result<()> {
        let [mass, moments @ ..] = self.payload_moments;
        let checks = [
            ("stiffness_error", self.stiffness_error, 1.0..=MAX_VALUE, "[1, 10⁶]"),
            ("delay [s]", self.delay, 0.0..=MAX_DELAY, "[0, 0.5]"),
            ("torque_share", self.torque_share, 0.0..=MAX_VALUE, "[0, 10⁶]"),
            ("payload_moments[0] [kg]", mass, 0.0..=MAX_VALUE, "[0, 10⁶]"),
        ];
        for (name, value, range, bound) in checks {
            if !range.contains(&value) {
                return Err(Error::out_of_range(name, value, bound));
            }
        }
        for (i, &moment) in moments.iter().enumerate() {
            if !(moment.abs() <= MAX_VALUE) {
                return Err(Error::out_of_range(format!("payload_moments[{}] [kg·m]", i + 1), moment, "±10⁶"));
            }
        }
        Ok(())
    }
}

/// Goals and torque limits that make an arm weightless; call [`HandGuiding::step`] once per tick.
#[derive(Debug, Clone)]
pub struct HandGuiding {
    model: Arc<Model>,
    masses: GroupMasses,
    options: HandGuidingOptions,
    n: usize,
    kp: JointVec,
    max_torque: JointVec,
    encoder_step: JointVec,
    /// Sum of viscous damping, derivative gain and back-EMF [N·m·s/rad].
    damping: JointVec,
    /// Lower end of the interval that contains the compliance 1/k_p [rad/(N·m)].
    low: JointVec,
    /// Upper end of the interval that contains the compliance 1/k_p [rad/(N·m)].
    high: JointVec,
    /// Lead (goal − q) that holds the joint against the torque `gravity` [rad].
    lead: JointVec,
    /// Lead that overcomes the friction [rad].
    friction: JointVec,
    /// Gravity torque at which `lead` was measured [N·m]; 0 for a joint that did not move in the swing.
    gravity: JointVec,
    /// Least play w₀ [rad].
    min_play: JointVec,
    /// Play w in this tick [rad].
    play: JointVec,
    /// Additional play that keeps the goals in place after the lead was corrected at rest [rad]; it decreases with
    /// motion.
    excess_play: JointVec,
    anchor: JointVec,
    goal: JointVec,
    /// Positions with a hysteresis of one encoder count [rad].
    filtered_q: JointVec,
    /// Filtered rate of `filtered_q` [rad/s].
    speed: JointVec,
    /// Positions at the last motion [rad].
    rest_q: JointVec,
    /// Positions at which the arm was last at rest after a motion [rad].
    learnt_q: JointVec,
    /// Interval of 1/k_p that explains the last rest after a motion [rad/(N·m)].
    learnt: [[f64; 2]; MAX_JOINTS],
    /// Time since the last motion [s].
    rest_time: f64,
    /// True if the arm has moved far enough since that rest to learn from the next one.
    has_moved: bool,
}

impl HandGuiding {
    /// Starts hand guiding from the result of a swing. `servos` gives the assumed k_p; `damping` is the sum of viscous
    /// damping, derivative gain and back-EMF of each joint [N·m·s/rad].
    ///
    /// # Errors
    /// [`Error::Shape`] if a vector does not have n entries; [`Error::OutOfRange`] for a number that is not finite, or
    /// an option out of range; [`Error::Config`] if the servos do not fit the model.
    pub fn new(
        model: Arc<Model>,
        servos: &Servos,
        damping: &[f64],
        swing: &SwingResult<'_>,
        options: HandGuidingOptions,
    ) -> Result<Self> {
        let n = model.n();
        let servos = servos.for_joints(n)?;
        let q = finite_joint_vector("q", n, swing.q)?;
        let goal = finite_joint_vector("goal", n, swing.goal)?;
        let lead = finite_joint_vector("lead", n, swing.lead)?;
        let friction = finite_joint_vector("friction", n, swing.friction)?;
        let damping = finite_joint_vector("damping", n, damping)?;
        if swing.swung.len() != n {
            return Err(Error::length("swung", swing.swung.len(), n));
        }
        options.validate()?;
        let kp = padded(&servos.kp, 1.0);
        let mut guiding = Self {
            masses: model.chain().masses(model.payload()),
            model,
            options,
            n,
            kp,
            max_torque: padded(&servos.max_torque, 0.0),
            encoder_step: padded(&servos.encoder_step, 0.0),
            damping,
            low: kp.map(|kp| 1.0 / (options.stiffness_error * kp)),
            high: kp.map(|kp| options.stiffness_error / kp),
            lead,
            friction,
            gravity: [0.0; MAX_JOINTS],
            min_play: [0.0; MAX_JOINTS],
            play: [MIN_PLAY; MAX_JOINTS],
            excess_play: [0.0; MAX_JOINTS],
            anchor: q,
            goal,
            filtered_q: q,
            speed: [0.0; MAX_JOINTS],
            rest_q: q,
            learnt_q: q,
            learnt: [[f64::NEG_INFINITY, f64::INFINITY]; MAX_JOINTS],
            rest_time: 0.0,
            has_moved: false,
        };
        let gravity = guiding.holding_torque(&q);
        for i in 0..n {
            let count = guiding.encoder_step[i];
            let error = LEAD_ERROR_SHARE * friction[i] + 0.5 * count + MIN_MOTION;
            if swing.swung[i] {
                guiding.gravity[i] = gravity[i];
                if gravity[i] != 0.0 {
                    guiding.narrow(i, [lead[i] - error, lead[i] + error].map(|lead| lead / gravity[i]));
                }
            }
            guiding.min_play[i] = MIN_PLAY.max(MIN_PLAY_COUNTS * count).max(MIN_PLAY_FRICTION * friction[i]);
            // A joint that moved in the swing rests in the middle of its friction band. The anchor of any other joint
            // is such that its goal does not change.
            let carrying = lead[i] + 0.5 * (guiding.low[i] + guiding.high[i]) * (gravity[i] - guiding.gravity[i]);
            guiding.anchor[i] = if swing.swung[i] { q[i] } else { goal[i] - carrying };
            guiding.excess_play[i] = ((guiding.anchor[i] - q[i]).abs() - guiding.min_play[i]).max(0.0);
        }
        Ok(guiding)
    }

    /// Returns the lower, then the upper bounds on k_p of the n joints [N·m/rad], as known so far.
    pub fn stiffness(&self) -> [Vec<f64>; 2] {
        [&self.high, &self.low].map(|compliance| compliance[..self.n].iter().map(|c| 1.0 / c).collect())
    }

    /// Returns the play w of each joint in the last tick [rad]: how far the joint may move before its goal follows.
    pub fn play(&self) -> &[f64] {
        &self.play[..self.n]
    }

    /// Returns the filtered speed of each joint [rad/s].
    pub fn speed(&self) -> &[f64] {
        &self.speed[..self.n]
    }

    /// Computes goals that follow the arm, and torque limits, for measured positions q [rad]; `dt` is the time
    /// since the last step [s].
    ///
    /// # Errors
    /// [`Error::Shape`] if q does not have n entries; [`Error::OutOfRange`] if one is not finite or dt is not above 0.
    /// After an error the state is unchanged.
    pub fn step(&mut self, q: &[f64], dt: f64) -> Result<Command> {
        let q = finite_joint_vector("q", self.n, q)?;
        if !(dt > 0.0 && dt.is_finite()) {
            return Err(Error::out_of_range("dt", dt, "(0, ∞) s"));
        }
        let dt = dt.clamp(MIN_STEP, MAX_STEP);
        self.update_speed(&q, dt);
        let ahead: JointVec = std::array::from_fn(|i| q[i] + PREDICTION_SHARE * self.options.delay * self.speed[i]);
        let gravity = self.holding_torque(&ahead);
        self.learn_at_rest(&q, dt);
        let direction = self.speed.map(|speed| (speed / FRICTION_SPEED).tanh());
        let (mut lead, mut steps, mut limit) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
        for i in 0..self.n {
            let change = gravity[i] - self.gravity[i];
            lead[i] = self.lead[i] + 0.5 * (self.low[i] + self.high[i]) * change;
            let uncertainty = 0.5 * (self.high[i] - self.low[i]) * change.abs();
            // A correction learnt at rest takes effect with motion only, so that no goal moves at rest.
            self.excess_play[i] *= 1.0 - direction[i].abs() * (dt / SHRINK_TIME).min(1.0);
            self.play[i] =
                self.min_play[i] * (1.0 - PLAY_LOSS * direction[i].abs()) + uncertainty + self.excess_play[i];
            steps[i] = self.anchor[i].max(ahead[i] - self.play[i]).min(ahead[i] + self.play[i]) - self.anchor[i];
        }
        let share = self.allowed_share(&q, &steps, dt);
        for i in 0..self.n {
            self.anchor[i] += share * steps[i];
            let feed_forward = FRICTION_SHARE * self.friction[i] * direction[i]
                + DAMPING_SHARE * self.low[i] * self.damping[i] * self.speed[i];
            let goal = (self.anchor[i] + lead[i] + feed_forward)
                .max(self.model.lower()[i] + lead[i])
                .min(self.model.upper()[i] + lead[i]);
            let max_change = MAX_GOAL_SPEED * dt;
            self.goal[i] += (goal - self.goal[i]).max(-max_change).min(max_change);
            let needed = (1.1 * gravity[i].abs()).max(self.kp[i] * lead[i].abs());
            limit[i] = self.max_torque[i].min(needed + self.options.torque_share * self.max_torque[i]);
        }
        Ok(Command::new(self.n, self.goal, limit, [f64::INFINITY; MAX_JOINTS]))
    }

    /// Returns the share of `steps` of the anchors [rad] that moves the tool at [`MAX_TOOL_SPEED`] at most. A faster arm
    /// is held back by its servos: a fall, with a load that the model lacks, then remains slow.
    fn allowed_share(&self, q: &JointVec, steps: &JointVec, dt: f64) -> f64 {
        let mut rows: Rows = [[0.0; MAX_JOINTS]; MAX_AXES];
        if self.model.kinematics_into(&q[..self.n], Reference::WorldAligned, &mut rows).is_err() {
            return 1.0;
        }
        let squares = rows[..3].iter().map(|row| {
            let moved: f64 = row[..self.n].iter().zip(steps).map(|(column, step)| column * step).sum();
            moved * moved
        });
        let moved = squares.sum::<f64>().sqrt();
        if moved > MAX_TOOL_SPEED * dt { MAX_TOOL_SPEED * dt / moved } else { 1.0 }
    }

    /// Narrows the interval of 1/k_p once the arm rests after a motion, to the values that explain this rest or the one
    /// before: at one of them a hand may have held the arm. The goals do not move.
    fn learn_at_rest(&mut self, q: &JointVec, dt: f64) {
        let has_moved_by =
            |from: &JointVec, least: &dyn Fn(usize) -> f64| (0..self.n).any(|i| (q[i] - from[i]).abs() > least(i));
        if has_moved_by(&self.rest_q, &|i| (1.1 * self.encoder_step[i]).max(MIN_MOTION)) {
            self.has_moved |= has_moved_by(&self.learnt_q, &|i| 3.0 * self.min_play[i]);
            (self.rest_q, self.rest_time) = (*q, 0.0);
            return;
        }
        self.rest_time += dt;
        if self.rest_time < REST_TIME || !self.has_moved {
            return;
        }
        (self.has_moved, self.learnt_q) = (false, *q);
        let gravity = self.holding_torque(q);
        for i in 0..self.n {
            let change = gravity[i] - self.gravity[i];
            let (before, uncertainty) = (self.low[i] + self.high[i], 0.5 * (self.high[i] - self.low[i]) * change.abs());
            let (lead_change, band) = (self.goal[i] - q[i] - self.lead[i], self.friction[i] + self.min_play[i]);
            let found = if change == 0.0 {
                [f64::NEG_INFINITY, f64::INFINITY]
            } else {
                let ends = [(lead_change - band) / change, (lead_change + band) / change];
                [ends[0].min(ends[1]), ends[0].max(ends[1])]
            };
            let previous = std::mem::replace(&mut self.learnt[i], found);
            self.narrow(i, [found[0].min(previous[0]), found[1].max(previous[1])]);
            // The anchor compensates the change of the lead, so that the goal does not change.
            self.anchor[i] += 0.5 * (before - self.low[i] - self.high[i]) * change;
            self.excess_play[i] = self.excess_play[i].max(uncertainty);
        }
    }

    /// Intersects the interval of 1/k_p of joint i with the interval from `a` to `b`, in either order.
    ///
    /// If the intersection is empty, e.g. because a hand leans on the arm, the interval does not change.
    fn narrow(&mut self, i: usize, [a, b]: [f64; 2]) {
        let (low, high) = (self.low[i].max(a.min(b)), self.high[i].min(a.max(b)));
        if low < high {
            (self.low[i], self.high[i]) = (low, high);
        }
    }

    /// Updates the filtered speeds from positions with a hysteresis of one encoder count.
    fn update_speed(&mut self, q: &JointVec, dt: f64) {
        for i in 0..self.n {
            let filtered = self.filtered_q[i].max(q[i] - self.encoder_step[i]).min(q[i] + self.encoder_step[i]);
            let rate = (filtered - self.filtered_q[i]) / dt;
            self.speed[i] += (rate - self.speed[i]) * dt / (SPEED_FILTER + dt);
            self.filtered_q[i] = filtered;
        }
    }

    /// Returns the torques [N·m] that hold the arm at q with the payload of the model and the additional payload.
    fn holding_torque(&self, q: &JointVec) -> JointVec {
        let mut torques = holding_torque(&self.model, &self.masses, q);
        let [mass, moments @ ..] = self.options.payload_moments;
        if mass > 0.0 {
            let g = self.model.gravity_vector();
            let mut rows: Rows = [[0.0; MAX_JOINTS]; MAX_AXES];
            if let Ok(pose) = self.model.kinematics_into(&q[..self.n], Reference::WorldAligned, &mut rows) {
                let moments = rotate::<BaselineF64>(&pose.rotation, &moments);
                for (i, torque) in torques.iter_mut().enumerate().take(self.n) {
                    let linear = [rows[0][i], rows[1][i], rows[2][i]];
                    let angular = [rows[3][i], rows[4][i], rows[5][i]];
                    *torque -= mass * dot::<BaselineF64>(&g, &linear)
                        + dot::<BaselineF64>(&g, &cross::<BaselineF64>(&angular, &moments));
                }
            }
        }
        torques
    }
}
