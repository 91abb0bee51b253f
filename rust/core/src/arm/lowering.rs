//! Descent of an arm: goals and torque limits, tick by tick, from measured positions.
//!
//! A position servo carries a weight by its lead, the distance from the joint to its goal. The lead is measured.
//! Stiffness, payload and friction are not, so the measured lead drives the descent. Goals start at their present values
//! and move toward the joints, in proportion to the lead:
//!
//! `goal ← goal + dt r u`, `u = −40/s (goal − q − ℓ*)`.
//!
//! So the arm descends its real potential, and transfers its weight to the object on which it comes to rest. A goal never
//! follows a joint upward. `ℓ* = ∓ 2 τ_f / k_p` lets a joint press downward with little more than its own friction. The
//! factor r keeps every point of the arm below the allowed speed and below the speed at which an impact on an object of
//! stiffness k exceeds the allowed force, `v √(k m)`, with m the effective mass of the point along its path. r decreases
//! further if the arm moves faster than its goals.
//!
//! If positions no longer arrive, a model of the arm replaces the measured one.

use std::collections::VecDeque;
use std::sync::Arc;

use super::{finite_joint_vector, holding_torque, padded};
use crate::controller::Command;
use crate::error::{Error, Result};
use crate::kinematics::{ArmGeometry, ArmPoints, GroupMasses, MAX_POINTS};
use crate::model::Model;
use crate::params::Servos;
use crate::{JointVec, MAX_JOINTS};

/// Ratio of holding torque to gravity torque.
pub const SUPPORT: f64 = 1.1;
/// Largest speed of the arm's points during a descent [m/s].
pub const DEFAULT_SPEED: f64 = 0.15;

/// Largest speed of any joint [rad/s], and lowest speed written to servos [rad/s]: some interpret 0 as no limit.
const MAX_JOINT_SPEED: f64 = 0.8;
const MIN_SPEED_LIMIT: f64 = 0.01;
/// Rates of the two descents [1/s], and the fade-in time [s].
const REST_RATE: f64 = 4.0;
const DOWN_RATE: f64 = 40.0;
const FADE_IN: f64 = 0.3;
/// Distance at which a joint counts as arrived at the rest pose [rad].
const ARRIVED: f64 = 0.02;
/// Least progress toward the rest pose [rad]; and the time without progress, or with goals and arm at a standstill,
/// after which a phase ends [s].
const MIN_PROGRESS: f64 = 0.01;
const STANDSTILL_TIME: f64 = 1.5;
/// Largest impact force [N] on an object of this stiffness [N/m], with an additional unknown load at the tool [kg]. For
/// arms of less reach than this [m], the force is reduced in proportion.
const IMPACT_FORCE: f64 = 10.0;
const OBJECT_STIFFNESS: f64 = 2e4;
const UNKNOWN_LOAD: f64 = 0.5;
const FULL_FORCE_REACH: f64 = 0.55;
/// Downward torque over friction, by the assumed stiffness; and the largest force of a joint's lowest point on an
/// object below it [N].
const PRESS_RATIO: f64 = 2.0;
const MAX_PRESS_FORCE: f64 = 1.5;
/// Gravity torque over friction at which the downward press reaches its full value.
const FULL_PRESS_RATIO: f64 = 0.5;
/// Time in which the limit of a sinking joint rises from zero to the servo's maximum [s].
const LIMIT_RISE_TIME: f64 = 0.1;
/// Time over which goals slow down if the arm moves faster than they do [s].
const SLOWDOWN_TIME: f64 = 0.2;
/// Increase of the lead from which on a joint is sinking [rad]; at least two counts.
const SINKING: f64 = 0.004;
/// Lead that counts as zero [rad]; and how long all leads must be below it before the limits fall [s].
const ZERO_LEAD: f64 = 0.003;
const SETTLING_TIME: f64 = 0.3;
/// Window over which the speed of the arm is measured [s].
const SPEED_WINDOW: f64 = 0.15;
/// Speed of the arm's points that counts as still, and above which the arm is sliding [m/s].
const STILL: f64 = 0.01;
const SLIDING: f64 = 0.04;
/// Time in which limits fall to zero [s]; the second applies if a joint has no position.
const RAMP_TIME: f64 = 1.0;
const BLIND_RAMP_TIME: f64 = 6.0;
/// After this long without any position the descent goes blind; a single joint that is silent for as long keeps its
/// goal [s].
const MAX_SILENCE: f64 = 0.2;
/// Longest descent before an arm with measured positions is released where it is [s].
const MAX_DURATION: f64 = 60.0;
/// Upper bound of the time between two ticks [s].
const MAX_TICK: f64 = 0.1;
/// Entries of the histories of positions and goals.
const HISTORY: usize = 256;

/// Phase of a descent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoweringPhase {
    /// Moves toward the rest pose, `u = 4/s (q_rest − q)`.
    Rest,
    /// Descends until no joint carries a load.
    Down,
    /// Reduces the limits to zero, and waits while anything moves.
    Ramp,
    /// The arm rests; torque can be switched off.
    Done,
}

/// State of the arm when its descent begins; joint vectors have n entries.
#[derive(Debug, Clone, Copy)]
pub struct LoweringStart<'a> {
    /// Last good joint positions [rad].
    pub q: &'a [f64],
    /// Last goals sent [rad]; `None`: holding goals by the servo table.
    pub goal: Option<&'a [f64]>,
    /// Last limits sent [N·m]; `None`: the weight and a margin.
    pub torque_limit: Option<&'a [f64]>,
    /// Rest pose [rad]; `None`: straight down.
    pub rest_q: Option<&'a [f64]>,
    /// Largest speed of any point of the arm [m/s].
    pub speed: f64,
}

/// Returns the torque margin (n) [N·m] of joints over their gravity torque (n) [N·m].
pub fn torque_margin(servos: &Servos, gravity: &[f64]) -> Vec<f64> {
    let rows = servos.max_torque.iter().zip(&servos.friction).zip(gravity);
    rows.map(|((max_torque, friction), gravity)| margin(*max_torque, *friction, *gravity)).collect()
}

fn margin(max_torque: f64, friction: f64, gravity: f64) -> f64 {
    (0.1 * max_torque).max(2.0 * friction).max(0.3 * gravity.abs())
}

/// Values of the recent past, oldest first.
#[derive(Debug, Clone)]
struct History(VecDeque<(f64, JointVec)>);

impl History {
    fn new(time: f64, value: &JointVec) -> Self {
        let mut entries = VecDeque::with_capacity(HISTORY);
        entries.push_back((time, *value));
        Self(entries)
    }

    fn push(&mut self, time: f64, value: &JointVec) {
        if self.0.len() == HISTORY {
            self.0.pop_front();
        }
        self.0.push_back((time, *value));
    }

    fn restart(&mut self, time: f64, value: &JointVec) {
        self.0.clear();
        self.0.push_back((time, *value));
    }

    /// Drops entries before the last one that is at least this old, keeping `least` entries.
    fn drop_before(&mut self, time: f64, least: usize) {
        while self.0.len() > least && self.0.get(1).is_some_and(|(next, _)| *next <= time + 1e-9) {
            self.0.pop_front();
        }
    }

    fn oldest(&self) -> (f64, JointVec) {
        self.0.front().copied().unwrap_or((0.0, [0.0; MAX_JOINTS]))
    }
}

/// One descent, from the present pose until the limits are zero.
#[derive(Debug, Clone)]
pub struct Lowering {
    model: Arc<Model>,
    points: Arc<ArmPoints>,
    masses: GroupMasses,
    n: usize,
    kp: JointVec,
    max_torque: JointVec,
    friction: JointVec,
    encoder_step: JointVec,
    lower: JointVec,
    upper: JointVec,
    up: [f64; 3],
    speed: f64,
    impact_force: f64,
    rest_q: Option<JointVec>,
    phase: LoweringPhase,
    blind: bool,
    q: JointVec,
    /// Time since the last position of each joint [s].
    silence: JointVec,
    goal: JointVec,
    torque_limit: JointVec,
    lead: JointVec,
    /// Least lead since a joint last sank [rad].
    least_lead: JointVec,
    /// Measured minus modelled lead, added to the modelled one while blind [rad].
    unmodelled_lead: JointVec,
    /// Lead at which a joint last moved freely toward the rest pose [rad].
    free_lead: JointVec,
    positions: History,
    goals: History,
    /// Time in this phase, time in all, time at rest, time without progress [s].
    phase_time: f64,
    time: f64,
    rest_time: f64,
    standstill: f64,
    /// Smallest distance to the rest pose so far [rad].
    nearest: f64,
    presses: bool,
    /// Requested over allowed speed, and the speed of the goals' fastest point [m/s].
    demand: f64,
    goal_speed: f64,
    slowdown: f64,
    /// Share of limits and leads that `Ramp` has left, and their values at its start.
    ramp: f64,
    ramp_limit: JointVec,
    ramp_lead: JointVec,
}

impl Lowering {
    /// Starts from the last good reading.
    ///
    /// # Errors
    /// [`Error::Shape`] if a vector does not have n entries; [`Error::OutOfRange`] for a number that is not finite or a
    /// speed that is not above 0; [`Error::Config`] if the servos do not fit the model.
    pub fn new(model: Arc<Model>, servos: &Servos, points: Arc<ArmPoints>, start: &LoweringStart<'_>) -> Result<Self> {
        let n = model.n();
        let servos = servos.for_joints(n)?;
        let q = finite_joint_vector("q", n, start.q)?;
        let goal = start.goal.map(|goal| finite_joint_vector("goal", n, goal)).transpose()?;
        let torque_limit = start.torque_limit.map(|limit| finite_joint_vector("limit", n, limit)).transpose()?;
        let rest_q = start.rest_q.map(|rest| finite_joint_vector("rest", n, rest)).transpose()?;
        if !(start.speed > 0.0 && start.speed.is_finite()) {
            return Err(Error::out_of_range("speed", start.speed, "(0, ∞) m/s"));
        }
        let gravity_vector = model.gravity_vector();
        let size = gravity_vector.iter().map(|g| g * g).sum::<f64>().sqrt();
        let up = if size > 0.0 { gravity_vector.map(|g| -g / size) } else { [0.0; 3] };
        let mut lowering = Self {
            n,
            kp: padded(&servos.kp, 1.0),
            max_torque: padded(&servos.max_torque, 0.0),
            friction: padded(&servos.friction, 0.0),
            encoder_step: padded(&servos.encoder_step, 0.0),
            lower: padded(model.lower(), f64::NEG_INFINITY),
            upper: padded(model.upper(), f64::INFINITY),
            up,
            speed: start.speed,
            impact_force: IMPACT_FORCE * (model.reach() / FULL_FORCE_REACH).min(1.0),
            rest_q,
            phase: if rest_q.is_some() { LoweringPhase::Rest } else { LoweringPhase::Down },
            blind: false,
            q,
            silence: [0.0; MAX_JOINTS],
            goal: q,
            torque_limit: [0.0; MAX_JOINTS],
            lead: [0.0; MAX_JOINTS],
            least_lead: [0.0; MAX_JOINTS],
            unmodelled_lead: [0.0; MAX_JOINTS],
            free_lead: [0.0; MAX_JOINTS],
            positions: History::new(0.0, &q),
            goals: History::new(0.0, &q),
            phase_time: 0.0,
            time: 0.0,
            rest_time: 0.0,
            standstill: 0.0,
            nearest: f64::INFINITY,
            presses: true,
            demand: 0.0,
            goal_speed: 0.0,
            slowdown: 1.0,
            ramp: 1.0,
            ramp_limit: [0.0; MAX_JOINTS],
            ramp_lead: [0.0; MAX_JOINTS],
            masses: model.chain().masses(model.payload()),
            model,
            points,
        };
        let gravity = lowering.gravity();
        let modelled: JointVec = std::array::from_fn(|i| gravity[i] / lowering.kp[i]);
        lowering.goal = goal.unwrap_or(std::array::from_fn(|i| q[i] + modelled[i]));
        let enough = std::array::from_fn(|i| {
            (SUPPORT * gravity[i].abs() + lowering.margin(i, gravity[i])).min(lowering.max_torque[i])
        });
        lowering.torque_limit = torque_limit.unwrap_or(enough);
        lowering.lead = std::array::from_fn(|i| lowering.goal[i] - q[i]);
        lowering.free_lead = lowering.lead;
        lowering.least_lead = lowering.lead.map(f64::abs);
        lowering.unmodelled_lead = std::array::from_fn(|i| lowering.lead[i] - modelled[i]);
        lowering.goals = History::new(0.0, &lowering.goal);
        lowering.ramp_limit = lowering.torque_limit;
        lowering.ramp_lead = lowering.least_lead;
        Ok(lowering)
    }

    /// Phase of the descent.
    pub const fn phase(&self) -> LoweringPhase {
        self.phase
    }

    /// True if positions have been missing for so long that the model's replace them.
    pub const fn is_blind(&self) -> bool {
        self.blind
    }

    /// Computes goals, torque limits and speed limits of one tick; `None` if torque can be switched off.
    ///
    /// `q` (n) [rad] are the last positions, `fresh` (n) marks those that are new; NaN and infinities count as lost.
    /// `dt` is the time since the last tick [s], `age` the age of the goals that were in force when q was sampled [s].
    /// Speed limits [rad/s] are finite only while blind, so that a joint does not jump to a goal after lost packets.
    ///
    /// # Errors
    /// [`Error::Shape`] if `q` or `fresh` does not have n entries; nothing has changed.
    pub fn step(&mut self, q: &[f64], fresh: &[bool], dt: f64, age: f64) -> Result<Option<Command>> {
        for (name, len) in [("q", q.len()), ("ok", fresh.len())] {
            if len != self.n {
                return Err(Error::length(name, len, self.n));
            }
        }
        if self.phase == LoweringPhase::Done {
            return Ok(None);
        }
        // A NaN counts as 0.
        let dt = if dt > 0.0 { dt.min(MAX_TICK) } else { 0.0 };
        let mut good = [false; MAX_JOINTS];
        for i in 0..self.n {
            good[i] = fresh[i] && q[i].is_finite();
            self.silence[i] = if good[i] { 0.0 } else { self.silence[i] + dt };
        }
        self.phase_time += dt;
        self.time += dt;
        let mut speed_limit = [f64::INFINITY; MAX_JOINTS];
        if good.contains(&true) {
            for i in 0..self.n {
                self.q[i] = if good[i] { q[i] } else { self.q[i] };
            }
            if self.blind {
                self.resume_measured();
            }
            let goal = self.goal_before(age);
            for i in (0..self.n).filter(|i| good[*i]) {
                self.lead[i] = goal[i] - self.q[i];
            }
            self.advance(dt, &self.silence.map(|silence| silence > MAX_SILENCE), &mut speed_limit);
        } else if self.silence[..self.n].iter().all(|silence| *silence > MAX_SILENCE) {
            self.go_blind();
            self.advance(dt, &good, &mut speed_limit);
        }
        if self.phase == LoweringPhase::Done {
            return Ok(None);
        }
        Ok(Some(Command::new(self.n, self.goal, self.torque_limit, speed_limit)))
    }

    /// Updates goals and limits; joints without a position keep their goal.
    fn advance(&mut self, dt: f64, lost: &[bool; MAX_JOINTS], speed_limit: &mut JointVec) {
        let (here, gravity) = (self.points.evaluate(&self.q), self.gravity());
        self.positions.push(self.time, &self.q);
        self.positions.drop_before(self.time - SPEED_WINDOW, 2);
        let measured = here.velocity(&self.joint_speeds());
        let speeds: [f64; MAX_POINTS] = measured.map(|v| norm(&v));
        let fastest = speeds.iter().copied().fold(0.0, f64::max);
        let before = self.goal;
        self.goals.push(self.time, &before);
        if self.phase == LoweringPhase::Ramp {
            self.release(dt, fastest, lost);
        } else {
            let mut u =
                if self.phase == LoweringPhase::Rest { self.toward_rest(dt) } else { self.downward(&here, &gravity) };
            let mut idle = *lost;
            for i in 0..self.n {
                let blocked = self.is_outward(i, u[i]) || (lost[i] && !self.blind);
                idle[i] = idle[i] || blocked;
                u[i] = if blocked { 0.0 } else { u[i] };
            }
            if self.phase == LoweringPhase::Down {
                self.remove_rise(&here, &gravity, &mut u);
            }
            self.pace(&here, &mut u, &speeds, dt);
            for i in 0..self.n {
                self.goal[i] += dt * u[i];
            }
            if self.phase == LoweringPhase::Rest {
                self.limit_lead(&gravity, &u);
            }
            self.update_limit(dt, &gravity);
            self.change_phase(dt, &here, &gravity, &idle, fastest);
        }
        if self.blind {
            self.follow_model(&gravity);
            for i in 0..self.n {
                let rate = if dt > 0.0 { (self.goal[i] - before[i]).abs() / dt } else { 0.0 };
                speed_limit[i] = (1.25 * rate).max(MIN_SPEED_LIMIT);
            }
        }
    }

    /// Joint velocities of the descent [rad/s], before the speed limit.
    fn downward(&self, here: &ArmGeometry, gravity: &JointVec) -> JointVec {
        let load = self.excess_lead(here, gravity);
        std::array::from_fn(|i| {
            let half = 0.5 * self.encoder_step[i];
            -DOWN_RATE * (load[i] - clip(load[i], half))
        })
    }

    /// Lead minus that of a lightly pressing joint [rad].
    fn excess_lead(&self, here: &ArmGeometry, gravity: &JointVec) -> JointVec {
        let lever = here.lowest_lever(&self.up);
        std::array::from_fn(|i| {
            let press =
                if self.presses { (PRESS_RATIO * self.friction[i]).min(MAX_PRESS_FORCE * lever[i]) } else { 0.0 };
            let clear = (FULL_PRESS_RATIO * self.friction[i]).max(1e-9);
            self.lead[i] + press / self.kp[i] * (gravity[i] / clear).clamp(-1.0, 1.0)
        })
    }

    /// Goals in force when the present positions were sampled [rad].
    fn goal_before(&mut self, age: f64) -> JointVec {
        self.goals.drop_before(self.time - age.max(0.0), 1);
        self.goals.oldest().1
    }

    /// Joint velocities toward the rest pose [rad/s].
    fn toward_rest(&mut self, dt: f64) -> JointVec {
        let rest = self.rest_q.unwrap_or(self.q);
        let away: JointVec = std::array::from_fn(|i| rest[i] - self.q[i]);
        let distance = away.iter().fold(0.0, |max: f64, away| max.max(away.abs()));
        if distance < self.nearest - MIN_PROGRESS {
            (self.nearest, self.standstill) = (distance, 0.0);
        } else {
            self.standstill += dt;
        }
        away.map(|away| REST_RATE * away)
    }

    /// Keeps goals within a margin of the lead at which joints last moved freely.
    fn limit_lead(&mut self, gravity: &JointVec, u: &JointVec) {
        let speed = self.joint_speeds();
        for i in 0..self.n {
            let push = self.margin(i, gravity[i]) / self.kp[i];
            let lead = self.goal[i] - self.q[i];
            if speed[i].abs() > 0.3 * u[i].abs() {
                self.free_lead[i] += 0.2 * (lead - self.free_lead[i]);
            }
            self.goal[i] = self.q[i] + lead.max(self.free_lead[i] - push).min(self.free_lead[i] + push);
        }
    }

    /// True if a joint is at a position limit and u moves it outward.
    fn is_outward(&self, i: usize, u: f64) -> bool {
        (u < 0.0 && self.q[i] <= self.lower[i]) || (u > 0.0 && self.q[i] >= self.upper[i])
    }

    /// Removes from u [rad/s] the part that raises the tool.
    fn remove_rise(&self, here: &ArmGeometry, gravity: &JointVec, u: &mut JointVec) {
        let rise = here.tool_rise(&self.up);
        let climb = dot(&rise, u);
        if climb <= 0.0 {
            return;
        }
        let soft: JointVec = std::array::from_fn(|i| if u[i] == 0.0 { 0.0 } else { rise[i] / self.kp[i] });
        let gain = climb / dot(&rise, &soft).max(1e-9);
        // A joint that already presses enough must not press more to keep the tool down.
        let load = self.excess_lead(here, gravity);
        for i in 0..self.n {
            u[i] -= soft[i] * gain;
            let presses = load[i] * sign(gravity[i]) < -0.5 * self.encoder_step[i];
            if presses && u[i] * gravity[i] < 0.0 {
                u[i] = 0.0;
            }
        }
        let climb = dot(&rise, u);
        if climb > 0.0 {
            let lift: f64 = (0..self.n).map(|i| (rise[i] * u[i]).max(0.0)).sum();
            for (u, rise) in u.iter_mut().zip(&rise) {
                if rise * *u > 0.0 {
                    *u *= 1.0 - climb / lift;
                }
            }
        }
    }

    /// Scales u [rad/s] down to the allowed speed; `speeds` are the measured ones of the points [m/s].
    fn pace(&mut self, here: &ArmGeometry, u: &mut JointVec, speeds: &[f64; MAX_POINTS], dt: f64) {
        let velocity = here.velocity(u);
        let mass = here.effective_mass(&velocity);
        let (mut fastest, mut demand, mut measured) = (0.0_f64, 0.0_f64, 0.0_f64);
        for ((velocity, mass), seen) in velocity.iter().zip(&mass).zip(speeds) {
            let max = self.speed.min(self.impact_force / (OBJECT_STIFFNESS * (mass + UNKNOWN_LOAD)).sqrt());
            let speed = norm(velocity);
            fastest = fastest.max(speed);
            demand = demand.max(speed / max);
            measured = measured.max(seen / max);
        }
        self.demand = demand;
        let joint_speed = u.iter().fold(0.0, |max: f64, u| max.max(u.abs()));
        let mut scale = 1.0_f64.min(1.0 / demand.max(1e-9)).min(MAX_JOINT_SPEED / joint_speed.max(1e-9));
        scale *= (self.phase_time / FADE_IN).min(1.0);
        // If the arm moves faster than its goals, slow the goals down so that the servos brake it.
        let allowed = (2.2 - 2.0 * measured).clamp(0.0, 1.0);
        self.slowdown += (dt / SLOWDOWN_TIME).min(1.0) * (allowed - self.slowdown);
        scale *= self.slowdown;
        self.goal_speed = scale * fastest;
        for u in u.iter_mut() {
            *u *= scale;
        }
    }

    /// Updates the torque limits to fit the lead; they rise fast for a sinking joint.
    fn update_limit(&mut self, dt: f64, gravity: &JointVec) {
        for i in 0..self.n {
            let (size, weight) = (self.lead[i].abs(), gravity[i].abs());
            let sinks = size > self.least_lead[i] + SINKING.max(2.0 * self.encoder_step[i]);
            self.least_lead[i] = self.least_lead[i].max(size - 2.0 * SINKING).min(size);
            let enough = (SUPPORT * weight).max(self.kp[i] * size) + self.margin(i, gravity[i]);
            let change = self.max_torque[i] * dt / LIMIT_RISE_TIME;
            let limit = if sinks {
                self.torque_limit[i] + change
            } else {
                self.torque_limit[i].min(enough).max(self.torque_limit[i] - change).max(SUPPORT * weight)
            };
            self.torque_limit[i] = limit.min(self.max_torque[i]);
        }
    }

    /// Enters the next phase if this one is over; `fastest` is the measured speed of the points [m/s].
    fn change_phase(
        &mut self,
        dt: f64,
        here: &ArmGeometry,
        gravity: &JointVec,
        idle: &[bool; MAX_JOINTS],
        fastest: f64,
    ) {
        if self.phase == LoweringPhase::Rest {
            if self.nearest < ARRIVED || self.standstill > STANDSTILL_TIME {
                self.enter(LoweringPhase::Down);
            }
            return;
        }
        let load = self.excess_lead(here, gravity);
        let stands = fastest < STILL && self.goal_speed < STILL / 2.0;
        // Encoder flicker makes goals tremble; the timer tolerates this on average.
        self.standstill = (self.standstill + if stands { dt } else { -dt }).max(0.0);
        let light =
            (0..self.n).all(|i| idle[i] || load[i] * sign(gravity[i]) < ZERO_LEAD.max(1.5 * self.encoder_step[i]));
        let light = light || self.standstill > STANDSTILL_TIME;
        let calm = if self.presses { self.demand < 0.5 && fastest < SLIDING } else { fastest < STILL };
        self.rest_time = if light && calm { self.rest_time + dt } else { 0.0 };
        if self.is_late() || (self.rest_time > SETTLING_TIME && !self.presses) {
            self.enter(LoweringPhase::Ramp);
        } else if self.rest_time > SETTLING_TIME {
            // Stop pressing and check again: only the press may have moved the arm.
            (self.presses, self.rest_time) = (false, 0.0);
        }
    }

    /// True after the longest descent. No timeout while blind: the model's arm comes to rest, a real one may still hang.
    fn is_late(&self) -> bool {
        self.time > MAX_DURATION && !self.blind
    }

    /// Reduces leads and limits to zero while the arm is still.
    fn release(&mut self, dt: f64, fastest: f64, lost: &[bool; MAX_JOINTS]) {
        let late = self.is_late();
        if fastest > SLIDING && !late {
            self.enter(LoweringPhase::Down);
            return;
        }
        if fastest < STILL || late {
            let duration = if self.blind || lost.contains(&true) { BLIND_RAMP_TIME } else { RAMP_TIME };
            self.ramp = (self.ramp - dt / duration).max(0.0);
        }
        for i in 0..self.n {
            self.torque_limit[i] = self.ramp * self.ramp_limit[i];
            // Keep goals near a sliding arm; otherwise it would jump back once limits rise again.
            let max = self.ramp * self.ramp_lead[i];
            if !lost[i] {
                self.goal[i] = self.q[i] + clip(self.goal[i] - self.q[i], max);
            }
        }
        if self.ramp <= 0.0 {
            self.phase = LoweringPhase::Done;
        }
    }

    /// Mean joint velocities over the window, without one count of flicker [rad/s].
    fn joint_speeds(&self) -> JointVec {
        let (began, q) = self.positions.oldest();
        let duration = self.positions.0.back().map_or(0.0, |(time, _)| time - began);
        std::array::from_fn(|i| {
            let moved = self.q[i] - q[i];
            let moved = moved - clip(moved, self.encoder_step[i]);
            if duration > 0.0 { moved / duration } else { 0.0 }
        })
    }

    /// Enters a phase and resets its timers.
    fn enter(&mut self, phase: LoweringPhase) {
        self.phase = phase;
        (self.phase_time, self.rest_time, self.standstill) = (0.0, 0.0, 0.0);
        (self.ramp, self.ramp_limit) = (1.0, self.torque_limit);
        self.ramp_lead = std::array::from_fn(|i| (self.goal[i] - self.q[i]).abs());
    }

    /// Torques that hold the arm at the last good positions, by the model [N·m].
    fn gravity(&self) -> JointVec {
        holding_torque(&self.model, &self.masses, &self.q)
    }

    fn margin(&self, i: usize, gravity: f64) -> f64 {
        margin(self.max_torque[i], self.friction[i], gravity)
    }

    /// Starts to use the model's positions in place of the measured ones.
    fn go_blind(&mut self) {
        if !self.blind {
            self.blind = true;
            let gravity = self.gravity();
            self.unmodelled_lead = std::array::from_fn(|i| self.goal[i] - self.q[i] - gravity[i] / self.kp[i]);
        }
    }

    /// Moves the model's arm to the positions that its goals hold.
    fn follow_model(&mut self, gravity: &JointVec) {
        for i in 0..self.n {
            self.lead[i] = gravity[i] / self.kp[i] + self.unmodelled_lead[i];
            self.q[i] = (self.goal[i] - self.lead[i]).max(self.lower[i]).min(self.upper[i]);
        }
    }

    /// Continues from the measured positions; they may be far from the model's.
    fn resume_measured(&mut self) {
        self.blind = false;
        let gravity = self.gravity();
        for i in 0..self.n {
            self.goal[i] = self.q[i] + gravity[i] / self.kp[i] + self.unmodelled_lead[i];
        }
        self.positions.restart(self.time, &self.q);
        if self.phase == LoweringPhase::Ramp {
            self.enter(LoweringPhase::Down);
        }
    }
}

fn dot(a: &JointVec, b: &JointVec) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(v: &[f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// x within ±bound.
fn clip(x: f64, bound: f64) -> f64 {
    x.max(-bound).min(bound)
}

/// Sign of x; 0 for 0.
fn sign(x: f64) -> f64 {
    if x == 0.0 { 0.0 } else { x.signum() }
}
