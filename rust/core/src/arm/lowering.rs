//! Descent of an arm: goals and torque limits, tick by tick, from measured positions.
//!
//! A position servo holds a load by its lead, the distance goal − q from the joint to its goal. The lead is measured.
//! Stiffness, payload and friction are not, so the measured lead drives the descent. Goals start at their present
//! values and move toward the joints, in proportion to the lead:
//!
//! `goal ← goal + dt r u`, `u = −40/s (goal − q − ℓ*)`.
//!
//! So every joint moves in the direction in which its real load pulls it, until the object on which the arm comes to
//! rest carries the weight. The tool does not rise above its height at the start, and approaches it slowly.
//! `ℓ* = ∓ (2 τ_f + d |dq|) / k_p` lets a joint press downward with little more than its own friction and damping. The
//! factor r keeps the speed v of every point of the arm below the allowed speed, and the force of its impact on an
//! object of stiffness k, `v √(k m)`, below the allowed force; m is the effective mass of the point along its path. u
//! is first limited to what each joint alone may do. r decreases further if a point is measured above 110 % of its
//! allowed speed, and is 0 above 150 %.
//!
//! In the end the torque limits fall to zero. They rise again while the arm slides, and torque may be switched off only
//! after the arm has stood still with limits of zero.
//!
//! If positions no longer arrive, positions computed with the model of the arm replace them. A joint that alone has none
//! keeps its goal until the others have come to rest. Then it descends by the model, because its limit may not fall to
//! zero while it carries a load.

use std::collections::VecDeque;
use std::sync::Arc;

use super::{MAX_VALUE, MIN_STEP, finite_joint_vector, holding_torque, padded};
use crate::controller::Command;
use crate::error::{Error, Result};
use crate::kinematics::{ArmGeometry, ArmPoints, GroupMasses, MAX_POINTS};
use crate::model::Model;
use crate::params::{LimitType, Servos};
use crate::{JointVec, MAX_JOINTS};

/// Ratio of the least torque limit of a joint during a descent to its gravity torque.
pub const SUPPORT: f64 = 1.1;
/// Default of the largest speed of the arm's points during a descent [m/s].
pub const DEFAULT_SPEED: f64 = 0.15;

/// Largest speed of a joint's goal [rad/s].
const MAX_JOINT_SPEED: f64 = 0.8;
/// Lowest speed limit written to a servo [rad/s]; some servos interpret 0 as no limit.
const MIN_SPEED_LIMIT: f64 = 0.01;
/// Ratio of goal speed to the joint's distance from the rest pose [1/s].
const REST_RATE: f64 = 4.0;
/// Angle by which a joint may be ahead of the slowest one, which has the largest share of its way to the rest pose left
/// [rad]. The goal of a joint slows down on the way to this angle, stops there, and moves back beyond twice this angle.
const MAX_AHEAD: f64 = 0.03;
/// Lower bound on the way to the rest pose by which the distance left is divided to get its share [rad], or the longest
/// way of all joints if that is less. With a shorter way, a joint that its load pulls off its rest position would make
/// the others turn back.
const MIN_WAY: f64 = 0.2;
/// Time in which a joint that stands still on the way to the rest pose doubles its push [s].
const PUSH_GROWTH_TIME: f64 = 0.5;
/// Ratio of goal speed to the excess lead (see `excess_lead`) when descending without a rest pose [1/s].
const DOWN_RATE: f64 = 40.0;
/// Largest share of the excess lead by which a goal moves in one tick. Above 1, the goals of an arm on a slow line
/// would oscillate.
const MAX_GAIN: f64 = 0.8;
/// Time in which the goals' speed rises from zero at the start of a phase [s].
const FADE_IN: f64 = 0.2;
/// Largest distance of a joint from the rest pose at which the joint counts as arrived [rad].
const ARRIVED: f64 = 0.02;
/// Smallest decrease of the distance to the rest pose that counts as progress [rad].
const MIN_PROGRESS: f64 = 0.01;
/// Time without progress after which the motion toward the rest pose ends, and time at a standstill after which the
/// joints of a descending arm count as unloaded [s].
const STANDSTILL_TIME: f64 = 1.5;
/// Largest allowed force of an impact [N]; less for arms whose reach is below [`FULL_FORCE_REACH`].
const IMPACT_FORCE: f64 = 12.0;
/// Assumed stiffness of an object that the arm hits [N/m].
const OBJECT_STIFFNESS: f64 = 2e4;
/// Unknown load at the tool that the effective masses of the arm's points include [kg].
const UNKNOWN_LOAD: f64 = 0.5;
/// Reach above which the full impact force is allowed [m]; below, the force is proportional to the reach.
const FULL_FORCE_REACH: f64 = 0.7;
/// Ratio of the torque with which a joint presses downward to its friction.
const PRESS_RATIO: f64 = 2.0;
/// Largest force with which the lowest point that a joint moves presses downward [N].
const MAX_PRESS_FORCE: f64 = 1.5;
/// Ratio of gravity torque to friction above which a joint presses downward with the full torque of [`PRESS_RATIO`];
/// below, this torque is reduced in proportion to the ratio.
const FULL_PRESS_RATIO: f64 = 0.5;
/// Ratio of the largest speed at which the tool rises to its depth below its height at the start [1/s].
const RISE_RATE: f64 = 1.0;
/// Time in which a torque limit changes by the usable torque of its servo [s].
const LIMIT_CHANGE_TIME: f64 = 0.1;
/// Time constant with which goals slow down if the arm is too fast [s].
const SLOWDOWN_TIME: f64 = 0.2;
/// Ratio of measured to allowed speed above which goals slow down.
const BRAKE_START: f64 = 1.1;
/// Ratio of measured to allowed speed at which goals stop.
const BRAKE_END: f64 = 1.5;
/// Increase of the lead above which a joint counts as sinking [rad]; at least two encoder counts are required.
const SINKING: f64 = 0.004;
/// Largest increase of the torque limit of a sinking joint, as a multiple of the torque by which its servo resists the
/// increase of its lead.
const SINKING_GAIN: f64 = 4.0;
/// Speed above which a sinking joint has the multiple [`SINKING_GAIN`] [rad/s]. The multiple of a slower joint is less,
/// down to 1 at rest: more torque would throw the joint if its lead is larger than its load needs.
const FALLING_SPEED: f64 = 0.2;
/// Excess of the lead below which a joint counts as unloaded [rad]; 1.5 encoder counts if that is more.
const ZERO_LEAD: f64 = 0.003;
/// Time for which all joints must be unloaded before the press or the descent ends, and for which the arm must stand
/// without torque before torque is switched off [s].
const SETTLING_TIME: f64 = 0.2;
/// Window over which the speed of the arm is measured [s].
const SPEED_WINDOW: f64 = 0.15;
/// Speed of the arm's points below which the arm counts as still [m/s].
const STILL: f64 = 0.01;
/// Speed of the arm's points above which the arm counts as sliding: torque limits that fall rise again [m/s].
const SLIDING: f64 = 0.04;
/// Speed of the arm's points above which an arm whose torque limits fall is lowered further [m/s].
const FALLING: f64 = 0.06;
/// Time in which the torque limits fall to zero if all joints have positions [s].
const RAMP_TIME: f64 = 0.6;
/// Factors by which a servo may be stiffer or softer than assumed, for joints whose lead is larger than their torque
/// limit allows.
const STIFFER: f64 = 2.5;
const SOFTER: f64 = 2.0;
/// Speed at which a lead beyond the torque limit shrinks once its joint may sink [rad/s], and the longest time [s].
const SHRINK_SPEED: f64 = 0.15;
const SHRINK_TIME: f64 = 3.0;
/// Share of the torque limits that remains while the arm moves.
const LAST_SHARE: f64 = 0.05;
/// Time in which the torque limits fall to zero if a joint has no position [s].
const BLIND_RAMP_TIME: f64 = 6.0;
/// Time without a position after which a joint keeps its goal [s]. Once it has passed for all joints, positions of the
/// model replace the measured ones.
const MAX_SILENCE: f64 = 0.2;
/// Duration of a descent after which an arm with measured positions is released where it is, if it has stopped [s].
const MAX_DURATION: f64 = 30.0;
/// An arm has stopped if no point of it has moved by this distance [m] in [`STOPPED_TIME`]. On a line that loses most
/// readings, an arm takes longer than [`MAX_DURATION`], and must not be released on its way.
const STOPPED_DISTANCE: f64 = 0.02;
/// Time over which [`STOPPED_DISTANCE`] is measured [s].
const STOPPED_TIME: f64 = 10.0;
/// Upper bound on the time between two ticks [s]; a longer time counts as this one.
const MAX_TICK: f64 = 0.1;
/// Longest time for which goals and torque limits move in one tick [s]. A servo jumps to each goal, so a longer motion
/// would make the arm faster than allowed, and nothing is measured until the next tick.
const MAX_MOTION_TIME: f64 = 0.04;
/// Change of a position above which it is not rounding error [rad].
const MIN_CHANGE: f64 = 1e-6;
/// Largest angle of an encoder count that is inferred from changes of position [rad].
const MAX_ENCODER_STEP: f64 = 0.006;
/// Largest number of entries in a history of positions or goals.
const HISTORY: usize = 256;

/// Phase of a descent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LoweringPhase {
    /// Moves toward the rest pose: the goals move at `u = 4/s (q_rest − q)`, after leads that are larger than the torque
    /// limits allow have been reduced.
    Rest,
    /// Descends until no joint holds a load.
    Down,
    /// Reduces the limits to zero, and waits until the arm stands still without torque.
    Ramp,
    /// The torque limits are zero; torque can be switched off.
    Done,
}

/// State of the arm when its descent begins; joint vectors have n entries.
#[derive(Debug, Clone, Copy)]
pub struct LoweringStart<'a> {
    /// Last good joint positions [rad].
    pub q: &'a [f64],
    /// Last goals sent [rad]; `None`: positions plus gravity torque divided by k_p.
    pub goal: Option<&'a [f64]>,
    /// Last torque limits sent [N·m], clamped to [0, usable torque]; `None`: 1.1 times the gravity torque plus
    /// [`torque_margin`].
    pub torque_limit: Option<&'a [f64]>,
    /// Joint positions toward which the arm moves before it descends [rad]; `None`: it descends at once.
    pub rest_q: Option<&'a [f64]>,
    /// Largest allowed speed of any point of the arm [m/s].
    pub speed: f64,
}

/// Returns the torque margin of each joint beyond its gravity torque [N·m]: the largest of 10 % of the usable
/// torque, twice the friction, and 30 % of the gravity torque.
pub fn torque_margin(servos: &Servos, gravity: &[f64]) -> Vec<f64> {
    let rows = servos.max_torque.iter().zip(&servos.friction).zip(gravity);
    rows.map(|((max_torque, friction), gravity)| margin(*max_torque, *friction, *gravity)).collect()
}

/// Returns the torque per speed of each joint's gears and, where the torque limit is a voltage, of its back-EMF
/// [N·m·s/rad].
fn damping(servos: &Servos) -> Vec<f64> {
    let no_load = servos.no_load_speed.as_deref().filter(|_| servos.limit_type == LimitType::Pwm);
    let back_emf = |i: usize| no_load.map_or(0.0, |speed| servos.max_torque[i] / speed[i]);
    servos.damping.iter().enumerate().map(|(i, gears)| gears + back_emf(i)).collect()
}

/// Returns the torque margin of one joint, as in [`torque_margin`] [N·m].
pub(super) fn margin(max_torque: f64, friction: f64, gravity: f64) -> f64 {
    (0.1 * max_torque).max(2.0 * friction).max(0.3 * gravity.abs())
}

/// Joint vectors of the recent past with their times [s], oldest first.
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

    /// Drops the oldest entry while the next one is not later than `time`, but keeps at least `least` entries.
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
    /// Torque per speed of gears and back-EMF [N·m·s/rad].
    damping: JointVec,
    /// Assumed encoder count, or the smallest change of position that was observed if that is more [rad].
    encoder_step: JointVec,
    assumed_step: JointVec,
    /// Smallest change between two positions so far [rad]; infinite while there was none.
    least_change: JointVec,
    lower: JointVec,
    upper: JointVec,
    up: [f64; 3],
    speed: f64,
    impact_force: f64,
    rest_q: Option<JointVec>,
    /// Positions at which the way to the rest pose begins [rad].
    rest_start: JointVec,
    phase: LoweringPhase,
    blind: bool,
    /// True for a joint that has sent no position since its goals were last computed without positions.
    behind: [bool; MAX_JOINTS],
    /// True for a joint without positions that descends by the model after the others have come to rest.
    modelled: [bool; MAX_JOINTS],
    q: JointVec,
    /// Time since the last position of each joint [s].
    silence: JointVec,
    goal: JointVec,
    torque_limit: JointVec,
    /// 1.1 times the gravity torque plus [`torque_margin`], at the last update of the limits [N·m].
    holding_torque: JointVec,
    lead: JointVec,
    /// |lead| at the last update of the limits [rad].
    lead_size: JointVec,
    /// Smallest recent |lead| [rad], but at least |lead| − 2 [`SINKING`].
    least_lead: JointVec,
    /// Last measured minus modelled lead [rad]; added to the modelled lead while no positions arrive.
    unmodelled_lead: JointVec,
    /// Filtered lead with which a joint last moved freely toward the rest pose [rad]; the lead beyond it is its push.
    free_lead: JointVec,
    /// Increase of the largest push for a joint that stands still on the way to the rest pose [rad].
    extra_push: JointVec,
    /// Position at the start of this phase of each joint whose servo is saturated, k_p |lead| above the torque limit
    /// [rad]; `None` for the other joints, and once the joint sinks or its lead is within the limit.
    saturated_at: [Option<f64>; MAX_JOINTS],
    positions: History,
    goals: History,
    /// Height of the tool at the start of the descent, along `up` in base axes [m].
    start_height: f64,
    /// Time since the start of this phase [s].
    phase_time: f64,
    /// Time since the start of the descent [s].
    time: f64,
    /// Time [s] and positions [rad] since which no point has moved by [`STOPPED_DISTANCE`].
    compared: (f64, JointVec),
    /// True if no point has moved by [`STOPPED_DISTANCE`] for [`STOPPED_TIME`].
    has_stopped: bool,
    /// Time since the last tick in which goals or limits were updated, at most [`MAX_TICK`] [s].
    waited: f64,
    /// Time for which all joints have been unloaded and the arm calm; later, for which it has stood without torque [s].
    rest_time: f64,
    /// Time without progress toward the rest pose; later, time at a standstill [s].
    standstill: f64,
    /// Smallest distance to the rest pose so far, that of the farthest joint [rad].
    nearest: f64,
    /// Smallest share of the way to the rest pose left so far, that of the slowest joint.
    least_left: f64,
    /// True while joints press downward with more than their friction.
    presses: bool,
    /// Largest ratio of requested to allowed speed of the arm's points.
    demand: f64,
    /// Speed of the fastest point if the arm follows its goals [m/s].
    goal_speed: f64,
    /// Factor (0 to 1) on the goals' speed that brakes an arm that is too fast.
    slowdown: f64,
    /// Share (1 to 0) of torque limits and leads that remains while they are reduced to zero.
    ramp: f64,
    /// Torque limits at the start of the present phase [N·m].
    ramp_limit: JointVec,
    /// |goal − q| at the start of the present phase [rad].
    ramp_lead: JointVec,
}

impl Lowering {
    /// Starts a descent from the last good reading.
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
            damping: padded(&damping(&servos), 0.0),
            encoder_step: padded(&servos.encoder_step, 0.0),
            assumed_step: padded(&servos.encoder_step, 0.0),
            least_change: [f64::INFINITY; MAX_JOINTS],
            lower: padded(model.lower(), f64::NEG_INFINITY),
            upper: padded(model.upper(), f64::INFINITY),
            up,
            speed: start.speed,
            impact_force: IMPACT_FORCE * (model.reach() / FULL_FORCE_REACH).min(1.0),
            rest_q,
            rest_start: q,
            phase: if rest_q.is_some() { LoweringPhase::Rest } else { LoweringPhase::Down },
            blind: false,
            behind: [false; MAX_JOINTS],
            modelled: [false; MAX_JOINTS],
            q,
            silence: [0.0; MAX_JOINTS],
            goal: q,
            torque_limit: [0.0; MAX_JOINTS],
            holding_torque: [f64::INFINITY; MAX_JOINTS],
            lead: [0.0; MAX_JOINTS],
            lead_size: [0.0; MAX_JOINTS],
            least_lead: [0.0; MAX_JOINTS],
            unmodelled_lead: [0.0; MAX_JOINTS],
            free_lead: [0.0; MAX_JOINTS],
            extra_push: [0.0; MAX_JOINTS],
            saturated_at: [None; MAX_JOINTS],
            positions: History::new(0.0, &q),
            goals: History::new(0.0, &q),
            start_height: points.evaluate(&q).tool_height(&up),
            phase_time: 0.0,
            time: 0.0,
            compared: (0.0, q),
            has_stopped: false,
            waited: 0.0,
            rest_time: 0.0,
            standstill: 0.0,
            nearest: f64::INFINITY,
            least_left: 1.0,
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
        for (limit, max_torque) in lowering.torque_limit.iter_mut().zip(&lowering.max_torque) {
            *limit = limit.clamp(0.0, *max_torque);
        }
        lowering.lead = std::array::from_fn(|i| lowering.goal[i] - q[i]);
        lowering.free_lead = lowering.lead;
        lowering.saturated_at = std::array::from_fn(|i| {
            let is_saturated = lowering.kp[i] * lowering.lead[i].abs() > lowering.torque_limit[i];
            (lowering.phase == LoweringPhase::Rest && is_saturated).then_some(q[i])
        });
        lowering.lead_size = lowering.lead.map(f64::abs);
        lowering.least_lead = lowering.lead_size;
        lowering.unmodelled_lead = std::array::from_fn(|i| lowering.lead[i] - modelled[i]);
        lowering.goals = History::new(0.0, &lowering.goal);
        lowering.ramp_limit = lowering.torque_limit;
        lowering.ramp_lead = lowering.least_lead;
        Ok(lowering)
    }

    /// Returns the phase of the descent.
    pub const fn phase(&self) -> LoweringPhase {
        self.phase
    }

    /// Returns true if positions of the model replace the measured ones, because no joint has had one for 0.2 s.
    pub const fn is_blind(&self) -> bool {
        self.blind
    }

    /// Ends the motion toward the rest pose: the arm descends from where it is.
    pub fn skip_rest(&mut self) {
        if self.phase == LoweringPhase::Rest {
            self.saturated_at = [None; MAX_JOINTS];
            self.presses = true;
            self.start_height = self.points.evaluate(&self.q).tool_height(&self.up);
            self.enter(LoweringPhase::Down);
        }
    }

    /// Takes over the marked `joints`, whose servos had not answered before: `q` are their positions [rad], `goal` [rad]
    /// and `torque_limit` [N·m] those in their servos. Other entries are ignored. The present phase begins again, or
    /// [`LoweringPhase::Down`] where limits were falling.
    ///
    /// The other joints keep the state of this descent: after a time without positions, their goals may be far from
    /// where the arm is, until [`Self::step`] has their positions.
    ///
    /// # Errors
    /// [`Error::Shape`] if a vector does not have n entries; [`Error::OutOfRange`] for a number that is not finite. The
    /// state is then unchanged.
    pub fn take_over(&mut self, joints: &[bool], q: &[f64], goal: &[f64], torque_limit: &[f64]) -> Result<()> {
        if joints.len() != self.n {
            return Err(Error::length("joints", joints.len(), self.n));
        }
        let q = finite_joint_vector("q", self.n, q)?;
        let goal = finite_joint_vector("goal", self.n, goal)?;
        let torque_limit = finite_joint_vector("limit", self.n, torque_limit)?;
        for i in (0..self.n).filter(|i| joints[*i]) {
            self.q[i] = q[i];
            self.goal[i] = goal[i];
            self.torque_limit[i] = torque_limit[i].clamp(0.0, self.max_torque[i]);
            self.holding_torque[i] = f64::INFINITY;
            (self.silence[i], self.extra_push[i]) = (0.0, 0.0);
            (self.behind[i], self.modelled[i]) = (false, false);
        }
        let phase = if self.phase == LoweringPhase::Rest { LoweringPhase::Rest } else { LoweringPhase::Down };
        let gravity = self.gravity();
        for i in (0..self.n).filter(|i| joints[*i]) {
            let lead = self.goal[i] - self.q[i];
            (self.lead[i], self.free_lead[i]) = (lead, lead);
            (self.lead_size[i], self.least_lead[i]) = (lead.abs(), lead.abs());
            self.unmodelled_lead[i] = lead - gravity[i] / self.kp[i];
            let is_saturated = self.kp[i] * lead.abs() > self.torque_limit[i];
            self.saturated_at[i] = (phase == LoweringPhase::Rest && is_saturated).then_some(self.q[i]);
            self.rest_start[i] = self.q[i];
        }
        self.positions.restart(self.time, &self.q);
        self.goals.restart(self.time, &self.goal);
        (self.nearest, self.least_left) = (f64::INFINITY, 1.0);
        (self.compared, self.has_stopped) = ((self.time, self.q), false);
        self.presses = true;
        self.enter(phase);
        Ok(())
    }

    /// Computes goals, torque limits and speed limits of one tick; `None` if torque can be switched off.
    ///
    /// `q` are the last positions of the n joints [rad], `fresh` marks those that are new; NaN and |q| > 10⁶ rad count
    /// as lost. `dt` is the time since the last tick [s], `age` the age of the goals that were in force when q was
    /// sampled [s]. Speed limits [rad/s] are finite for joints whose goals were computed without positions, until they
    /// have a position again, so that a joint that missed packets does not jump to a later goal.
    ///
    /// # Errors
    /// [`Error::Shape`] if `q` or `fresh` does not have n entries; the state is then unchanged.
    pub fn step(&mut self, q: &[f64], fresh: &[bool], dt: f64, age: f64) -> Result<Option<Command>> {
        for (name, len) in [("q", q.len()), ("ok", fresh.len())] {
            if len != self.n {
                return Err(Error::length(name, len, self.n));
            }
        }
        if self.phase == LoweringPhase::Done {
            return Ok(None);
        }
        // A NaN or negative time counts as 0.
        let dt = if dt > 0.0 { dt.min(MAX_TICK) } else { 0.0 };
        let mut good = [false; MAX_JOINTS];
        for i in 0..self.n {
            good[i] = fresh[i] && q[i].abs() <= MAX_VALUE;
            self.silence[i] = if good[i] { 0.0 } else { self.silence[i] + dt };
        }
        self.phase_time += dt;
        self.time += dt;
        self.waited = (self.waited + dt).min(MAX_TICK);
        let mut speed_limit = [f64::INFINITY; MAX_JOINTS];
        if good.contains(&true) {
            for i in (0..self.n).filter(|i| good[*i]) {
                if !self.behind[i] {
                    self.observe_step(i, (q[i] - self.q[i]).abs());
                }
                self.q[i] = q[i];
            }
            self.resume_measured(&good);
            let goal = self.goal_before(age);
            for i in (0..self.n).filter(|i| good[*i]) {
                self.lead[i] = goal[i] - self.q[i];
            }
            let lost = std::array::from_fn(|i| self.silence[i] > MAX_SILENCE && !self.modelled[i]);
            self.advance(dt, &lost, &mut speed_limit);
        } else if self.silence[..self.n].iter().all(|silence| *silence > MAX_SILENCE) {
            self.go_blind();
            self.advance(dt, &good, &mut speed_limit);
        }
        if self.phase == LoweringPhase::Done {
            return Ok(None);
        }
        Ok(Some(Command::new(self.n, self.goal, self.torque_limit, speed_limit)))
    }

    /// Updates the encoder count of joint i from a change of its position [rad]; counts may be coarser than assumed.
    fn observe_step(&mut self, i: usize, change: f64) {
        if change > MIN_CHANGE && change < self.least_change[i] {
            self.least_change[i] = change;
            self.encoder_step[i] = self.assumed_step[i].max(change.min(MAX_ENCODER_STEP));
        }
    }

    /// Updates goals and torque limits for one tick; a `lost` joint keeps its goal while others have positions.
    ///
    /// Goals move for the time `dt` of one tick, at most [`MAX_MOTION_TIME`], also after ticks without positions, or
    /// they would jump. Timers, such as that of a standstill, advance by all of the time that has passed.
    fn advance(&mut self, dt: f64, lost: &[bool; MAX_JOINTS], speed_limit: &mut JointVec) {
        let (here, gravity) = (self.points.evaluate(&self.q), self.gravity());
        let dt = dt.min(MAX_MOTION_TIME);
        for i in (0..self.n).filter(|i| self.silence[*i] == 0.0) {
            self.unmodelled_lead[i] = self.lead[i] - gravity[i] / self.kp[i];
        }
        let elapsed = std::mem::take(&mut self.waited);
        self.positions.push(self.time, &self.q);
        self.positions.drop_before(self.time - SPEED_WINDOW, 2);
        let measured = here.velocity(&self.joint_velocities());
        let speeds: [f64; MAX_POINTS] = measured.map(|v| norm(&v));
        let fastest = speeds.iter().copied().fold(0.0, f64::max);
        self.note_motion(&here);
        let before = self.goal;
        self.goals.push(self.time, &before);
        if self.phase == LoweringPhase::Ramp {
            self.release(elapsed, fastest, lost);
        } else if self.phase == LoweringPhase::Rest && self.saturated_at.iter().any(Option::is_some) {
            self.shrink_leads(dt, &gravity, lost);
            self.update_limit(dt, &gravity);
        } else {
            let mut u = if self.phase == LoweringPhase::Rest {
                self.toward_rest(elapsed)
            } else {
                self.downward(dt, &here, &gravity)
            };
            // Without positions, a servo may be the only one that receives goals, and its joint alone could lift the tool.
            let waits = self.blind && self.phase == LoweringPhase::Rest;
            let mut idle = *lost;
            for i in 0..self.n {
                let blocked = waits || self.is_outward(i, u[i]) || (lost[i] && !self.blind);
                idle[i] = idle[i] || blocked;
                u[i] = if blocked { 0.0 } else { u[i] };
            }
            if self.phase == LoweringPhase::Down {
                self.limit_joint_speeds(&here, &mut u);
                self.remove_rise(&here, &gravity, &mut u);
            }
            self.pace(&here, &mut u, &speeds, dt);
            for i in 0..self.n {
                self.goal[i] += dt * u[i];
            }
            if self.phase == LoweringPhase::Rest {
                self.limit_lead(dt, &gravity, &u);
            }
            self.update_limit(dt, &gravity);
            self.change_phase(elapsed, &here, &gravity, lost, &idle, fastest);
        }
        for i in 0..self.n {
            if self.blind || self.modelled[i] {
                self.follow_model(i, gravity[i]);
                let rate = if dt > 0.0 { (self.goal[i] - before[i]).abs() / dt } else { 0.0 };
                speed_limit[i] = (1.25 * rate).max(MIN_SPEED_LIMIT);
            } else if self.behind[i] {
                speed_limit[i] = MIN_SPEED_LIMIT;
            }
        }
    }

    /// Returns the goal velocities of the phase `Down` [rad/s], before they are scaled to the allowed speed.
    fn downward(&self, dt: f64, here: &ArmGeometry, gravity: &JointVec) -> JointVec {
        let load = self.excess_lead(here, gravity);
        let rate = DOWN_RATE.min(MAX_GAIN / dt.max(MIN_STEP));
        std::array::from_fn(|i| {
            let half = 0.25 * self.encoder_step[i];
            -rate * (load[i] - clip(load[i], half))
        })
    }

    /// Returns lead − ℓ* [rad], with ℓ* the lead of a joint that presses lightly downward; ℓ* = 0 without press.
    fn excess_lead(&self, here: &ArmGeometry, gravity: &JointVec) -> JointVec {
        let (lever, speed) = (here.lowest_lever(&self.up), self.joint_velocities());
        // A servo that sends no positions may receive no goals either; the weight on the other joints then differs from
        // the model's.
        let only_modelled = self.modelled.contains(&true);
        std::array::from_fn(|i| {
            let mut press = 0.0;
            if self.presses && (self.modelled[i] || !only_modelled) {
                press = (PRESS_RATIO * self.friction[i]).min(MAX_PRESS_FORCE * lever[i]);
                // Add the torque that damping absorbs: it does not press on an object.
                press += self.damping[i] * (-sign(gravity[i]) * speed[i]).max(0.0);
            }
            let clear = (FULL_PRESS_RATIO * self.friction[i]).max(1e-9);
            self.lead[i] + press / self.kp[i] * (gravity[i] / clear).clamp(-1.0, 1.0)
        })
    }

    /// Returns the goals [rad] that were in force `age` [s] ago, when the present positions were sampled.
    fn goal_before(&mut self, age: f64) -> JointVec {
        self.goals.drop_before(self.time - age.max(0.0), 1);
        self.goals.oldest().1
    }

    /// Returns the goal velocities toward the rest pose [rad/s], and measures the time without progress.
    fn toward_rest(&mut self, dt: f64) -> JointVec {
        let rest = self.rest_q.unwrap_or(self.q);
        let away: JointVec = std::array::from_fn(|i| rest[i] - self.q[i]);
        let distance = away.iter().fold(0.0, |max: f64, away| max.max(away.abs()));
        if distance < self.nearest - MIN_PROGRESS {
            (self.nearest, self.standstill) = (distance, 0.0);
        } else {
            self.standstill += dt;
        }
        // A joint whose load is too heavy stands still. If the others moved on, they might lift the tool, so all joints stay
        // near the straight line from the start to the rest pose.
        let way: JointVec = std::array::from_fn(|i| (rest[i] - self.rest_start[i]).abs().max(ARRIVED));
        let min_way = way.iter().copied().fold(0.0, f64::max).min(MIN_WAY);
        let left: JointVec = std::array::from_fn(|i| {
            let share = ((away[i].abs() - ARRIVED) / way[i].max(min_way)).clamp(0.0, 1.0);
            if self.is_outward(i, away[i]) { 0.0 } else { share }
        });
        // A joint that is moved away from the rest pose, as by a hand, must not make the others move back with it.
        self.least_left = left.iter().copied().fold(0.0, f64::max).min(self.least_left);
        std::array::from_fn(|i| {
            // A joint with a short way does not wait: it would first move away from its rest position.
            let ahead = if way[i] < min_way { 0.0 } else { (self.least_left - left[i]) * way[i] / MAX_AHEAD };
            // `pace` scales all joints alike: a fast return would leave no speed to the joint that the others wait for.
            let back = MAX_AHEAD * (ahead - 2.0).max(0.0);
            REST_RATE * (away[i] * (1.0 - ahead).max(0.0) - sign(away[i]) * back.min(away[i].abs()))
        })
    }

    /// Shrinks each lead that is larger than the torque limit allows until the joint sinks, before the arm moves toward
    /// the rest pose; the other joints keep their goals.
    ///
    /// A program that ended while torque came on leaves such leads. On the way to the rest pose these joints would stay
    /// where they are while the others move, which may lift the arm.
    fn shrink_leads(&mut self, dt: f64, gravity: &JointVec, lost: &[bool; MAX_JOINTS]) {
        for i in (0..self.n).filter(|i| !lost[*i]) {
            let Some(start) = self.saturated_at[i] else { continue };
            let (lead, largest) = (self.goal[i] - self.q[i], self.torque_limit[i] / self.kp[i]);
            let sunk = (start - self.q[i]) * sign(gravity[i]) > SINKING.max(2.0 * self.encoder_step[i]);
            if sunk || lead.abs() <= largest / STIFFER {
                self.saturated_at[i] = None;
                // Friction carries a part of the weight of a joint that begins to sink.
                let friction = if sunk { sign(gravity[i]) * self.friction[i] / self.kp[i] } else { 0.0 };
                self.free_lead[i] = lead + friction;
                // The torque is below the limit now, so `update_limit` may raise the limit as for a joint that moves.
                self.holding_torque[i] = self.torque_limit[i];
                continue;
            }
            let speed = if lead.abs() > SOFTER * largest { MAX_JOINT_SPEED } else { SHRINK_SPEED };
            self.goal[i] -= clip(lead, speed * dt);
        }
        if self.phase_time > SHRINK_TIME {
            for i in 0..self.n {
                if self.saturated_at[i].take().is_some() {
                    self.free_lead[i] = self.goal[i] - self.q[i];
                }
            }
        }
        if self.saturated_at.iter().all(Option::is_none) {
            (self.phase_time, self.rest_start, self.least_left) = (0.0, self.q, 1.0);
        }
    }

    /// Keeps each lead within the torque margin of the lead with which the joint last moved freely; for a joint that
    /// stands still with it, within up to twice the margin.
    fn limit_lead(&mut self, dt: f64, gravity: &JointVec, u: &JointVec) {
        let speed = self.joint_velocities();
        for i in 0..self.n {
            let margin = self.margin(i, gravity[i]) / self.kp[i];
            let lead = self.goal[i] - self.q[i];
            if speed[i].abs() > 0.3 * u[i].abs() {
                self.free_lead[i] += 0.2 * (lead - self.free_lead[i]);
                self.extra_push[i] -= 0.2 * self.extra_push[i];
            } else if (lead - self.free_lead[i]) * sign(u[i]) >= margin + self.extra_push[i] {
                self.extra_push[i] = (self.extra_push[i] + margin * dt / PUSH_GROWTH_TIME).min(margin);
            }
            let push = margin + self.extra_push[i];
            // If the load of a joint at its torque limit ends suddenly, the joint must not jump far.
            let largest = SOFTER * self.max_torque[i] / self.kp[i];
            let lead = lead.max(self.free_lead[i] - push).min(self.free_lead[i] + push);
            self.goal[i] = self.q[i] + clip(lead, largest);
        }
    }

    /// Returns true if joint i is at a position limit and the velocity u moves it outward.
    fn is_outward(&self, i: usize, u: f64) -> bool {
        (u < 0.0 && self.q[i] <= self.lower[i]) || (u > 0.0 && self.q[i] >= self.upper[i])
    }

    /// Removes from the goal velocities u [rad/s] the part that raises the tool toward its height at the start.
    fn remove_rise(&self, here: &ArmGeometry, gravity: &JointVec, u: &mut JointVec) {
        let load = self.excess_lead(here, gravity);
        let presses: [bool; MAX_JOINTS] =
            std::array::from_fn(|i| load[i] * sign(gravity[i]) < -0.5 * self.encoder_step[i]);
        let mut rise = here.tool_rise(&self.up);
        for i in 0..self.n {
            // A joint that presses on an object does not lift the tool when it presses less.
            if !self.blind && !self.modelled[i] && presses[i] && u[i] * gravity[i] > 0.0 {
                rise[i] = 0.0;
            }
        }
        // The model may place the tool lower than an object lets it go.
        let is_measured = !self.blind && !self.modelled.contains(&true);
        let depth = if is_measured { self.start_height - here.tool_height(&self.up) } else { 0.0 };
        let max_climb = (RISE_RATE * depth).max(0.0);
        let climb = dot(&rise, u) - max_climb;
        if climb <= 0.0 {
            return;
        }
        let soft: JointVec = std::array::from_fn(|i| if u[i] == 0.0 { 0.0 } else { rise[i] / self.kp[i] });
        let gain = climb / dot(&rise, &soft).max(1e-9);
        for i in 0..self.n {
            u[i] -= soft[i] * gain;
            // A joint that already presses enough must not press more to keep the tool down.
            if presses[i] && u[i] * gravity[i] < 0.0 {
                u[i] = 0.0;
            }
        }
        let climb = dot(&rise, u) - max_climb;
        if climb > 0.0 {
            let lift: f64 = (0..self.n).map(|i| (rise[i] * u[i]).max(0.0)).sum();
            for (u, rise) in u.iter_mut().zip(&rise) {
                if rise * *u > 0.0 {
                    *u *= 1.0 - climb / lift;
                }
            }
        }
    }

    /// Returns the largest allowed speed of each point along its velocity [m/s]; see the module's formula.
    fn max_speeds(&self, here: &ArmGeometry, velocity: &[[f64; 3]; MAX_POINTS]) -> [f64; MAX_POINTS] {
        let mass = here.effective_mass(velocity, UNKNOWN_LOAD);
        mass.map(|mass| self.speed.min(self.impact_force / (OBJECT_STIFFNESS * mass).sqrt().max(1e-9)))
    }

    /// Limits each goal velocity of u [rad/s] to the allowed speed of the points that this joint alone moves.
    ///
    /// Without this limit, a soft servo, whose lead is large, would leave no share of the speed to a stiff one.
    fn limit_joint_speeds(&self, here: &ArmGeometry, u: &mut JointVec) {
        let max = self.max_speeds(here, &here.velocity(u));
        for i in 0..self.n {
            let alone = here.jacobian().iter().zip(&max).map(|(rows, max)| norm(&rows.map(|row| row[i])) / max);
            let demand = u[i].abs() * alone.fold(0.0, f64::max);
            u[i] /= demand.max(1.0);
        }
    }

    /// Scales the goal velocities u [rad/s] down to the allowed speed; `speeds` are the measured speeds of the arm's
    /// points [m/s].
    fn pace(&mut self, here: &ArmGeometry, u: &mut JointVec, speeds: &[f64; MAX_POINTS], dt: f64) {
        let velocity = here.velocity(u);
        let max_speeds = self.max_speeds(here, &velocity);
        let (mut fastest, mut demand, mut measured) = (0.0_f64, 0.0_f64, 0.0_f64);
        for ((velocity, max), seen) in velocity.iter().zip(&max_speeds).zip(speeds) {
            let speed = norm(velocity);
            fastest = fastest.max(speed);
            demand = demand.max(speed / max);
            measured = measured.max(seen / max);
        }
        self.demand = demand;
        let joint_speed = u.iter().fold(0.0, |max: f64, u| max.max(u.abs()));
        let mut scale = 1.0_f64.min(1.0 / demand.max(1e-9)).min(MAX_JOINT_SPEED / joint_speed.max(1e-9));
        scale *= (self.phase_time / FADE_IN).min(1.0);
        // If the arm comes near its allowed speed, slow the goals down so that the servos brake it.
        let allowed = ((BRAKE_END - measured) / (BRAKE_END - BRAKE_START)).clamp(0.0, 1.0);
        self.slowdown += (dt / SLOWDOWN_TIME).min(1.0) * (allowed - self.slowdown);
        scale *= self.slowdown;
        self.goal_speed = scale * fastest;
        for u in u.iter_mut() {
            *u *= scale;
        }
    }

    /// Reduces each torque limit to what the joint's lead (goal − q) and gravity torque need; raises the limit of a joint
    /// that sinks.
    fn update_limit(&mut self, dt: f64, gravity: &JointVec) {
        let speed = self.joint_velocities();
        for i in 0..self.n {
            let (size, weight) = (self.lead[i].abs(), gravity[i].abs());
            let sinks = size > self.least_lead[i] + SINKING.max(2.0 * self.encoder_step[i]);
            self.least_lead[i] = self.least_lead[i].max(size - 2.0 * SINKING).min(size);
            let margin = self.margin(i, gravity[i]);
            let enough = (SUPPORT * weight).max(self.kp[i] * size) + margin;
            // The limit grows with the weight, or the joint would sink until its lead has grown.
            let growth = (SUPPORT * weight + margin - self.holding_torque[i]).max(0.0);
            self.holding_torque[i] = SUPPORT * weight + margin;
            let change = self.max_torque[i] * dt / LIMIT_CHANGE_TIME;
            let sunk = (size - self.lead_size[i]).max(0.0);
            self.lead_size[i] = size;
            // A lead that is larger than the limit allows, as from a program that ended while torque came on, would
            // lift the joint if the limit rose. It shrinks first.
            let is_limited = self.kp[i] * size > self.torque_limit[i];
            let floor = (SUPPORT * weight).min(if is_limited { self.torque_limit[i] } else { f64::INFINITY });
            let limit = if sinks {
                let gain = 1.0 + (SINKING_GAIN - 1.0) * (speed[i].abs() / FALLING_SPEED).min(1.0);
                self.torque_limit[i] + (gain * self.kp[i] * sunk).min(change)
            } else {
                (self.torque_limit[i] + growth).min(enough).max(self.torque_limit[i] - change).max(floor)
            };
            self.torque_limit[i] = limit.min(self.max_torque[i]);
        }
    }

    /// Enters the next phase if this one is over; `fastest` is the largest measured speed of a point of the arm
    /// [m/s].
    fn change_phase(
        &mut self,
        dt: f64,
        here: &ArmGeometry,
        gravity: &JointVec,
        lost: &[bool; MAX_JOINTS],
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
        // Count down instead of restarting: encoder noise moves the goals for single ticks.
        self.standstill = (self.standstill + if stands { dt } else { -dt }).max(0.0);
        let light =
            (0..self.n).all(|i| idle[i] || load[i] * sign(gravity[i]) < ZERO_LEAD.max(1.5 * self.encoder_step[i]));
        let light = light || self.standstill > STANDSTILL_TIME;
        let calm = if self.presses { self.demand < 0.5 && fastest < SLIDING } else { fastest < STILL };
        self.rest_time = (self.rest_time + if light && calm { dt } else { -dt }).max(0.0);
        if self.is_late() || (self.rest_time > SETTLING_TIME && !self.presses) {
            if !self.blind && lost.contains(&true) {
                self.model_lost(lost);
            } else {
                self.enter(LoweringPhase::Ramp);
            }
        } else if self.rest_time > SETTLING_TIME {
            // Stop pressing and check again with a smaller speed limit: the press itself may have moved the arm.
            (self.presses, self.rest_time) = (false, 0.0);
        }
    }

    /// Updates `has_stopped` and the positions with which the next ones are compared.
    fn note_motion(&mut self, here: &ArmGeometry) {
        if self.blind {
            return;
        }
        let (since, q) = self.compared;
        let motion: JointVec = std::array::from_fn(|i| self.q[i] - q[i]);
        // Compare in every tick: an arm that a hand moves to and fro may be back after `STOPPED_TIME`.
        if here.velocity(&motion).iter().any(|motion| norm(motion) >= STOPPED_DISTANCE) {
            (self.compared, self.has_stopped) = ((self.time, self.q), false);
        } else if self.time - since >= STOPPED_TIME {
            self.has_stopped = true;
        }
    }

    /// Returns true if the descent has taken its longest time and the arm has stopped. Returns false while the model
    /// predicts positions instead of measured ones, because the real arm may still hang.
    fn is_late(&self) -> bool {
        self.time > MAX_DURATION && self.has_stopped && !self.blind
    }

    /// Reduces leads and torque limits to zero, brakes an arm that slides, and descends again if it falls.
    fn release(&mut self, dt: f64, fastest: f64, lost: &[bool; MAX_JOINTS]) {
        let late = self.is_late();
        if fastest > FALLING && !late {
            // Keep the goals near: rising limits would throw the joints back to goals above the falling arm.
            self.keep_goals_near(lost);
            self.enter(LoweringPhase::Down);
            return;
        }
        let is_measured = !self.blind && !self.modelled.contains(&true) && !lost.contains(&true);
        let duration = if is_measured { RAMP_TIME } else { BLIND_RAMP_TIME };
        // Limits rise again while the arm slides faster than `SLIDING`: they brake it.
        let pace = if late { 1.0 } else { ((SLIDING - fastest) / (SLIDING - STILL)).clamp(-3.0, 1.0) };
        let least = if fastest < STILL || late { 0.0 } else { LAST_SHARE.min(self.ramp) };
        self.ramp = (self.ramp - dt.min(MAX_MOTION_TIME) / duration * pace).max(least).min(1.0);
        for i in 0..self.n {
            self.torque_limit[i] = self.ramp * self.ramp_limit[i];
        }
        // The limit brakes an arm that slides. Goals stay near it, so that it does not jump back later.
        self.keep_goals_near(lost);
        // The arm must stand still without torque before torque is switched off.
        let stands = self.ramp <= 0.0 && fastest < STILL;
        self.rest_time = if stands { self.rest_time + dt } else { 0.0 };
        if self.ramp <= 0.0 && (late || self.rest_time > SETTLING_TIME) {
            self.phase = LoweringPhase::Done;
        }
    }

    /// Bounds the leads of joints with positions by the present share of those at the start of the ramp.
    fn keep_goals_near(&mut self, lost: &[bool; MAX_JOINTS]) {
        for i in (0..self.n).filter(|i| !lost[*i]) {
            let max = self.ramp * self.ramp_lead[i].max(self.ramp_limit[i] / self.kp[i]);
            self.goal[i] = self.q[i] + clip(self.goal[i] - self.q[i], max);
        }
    }

    /// Returns the mean joint velocities over [`SPEED_WINDOW`] [rad/s]; the first encoder count of motion is ignored.
    fn joint_velocities(&self) -> JointVec {
        let (began, q) = self.positions.oldest();
        let duration = self.positions.0.back().map_or(0.0, |(time, _)| time - began);
        std::array::from_fn(|i| {
            let moved = self.q[i] - q[i];
            let moved = moved - clip(moved, self.encoder_step[i]);
            if duration > 0.0 { moved / duration.max(MIN_STEP) } else { 0.0 }
        })
    }

    /// Enters a phase and resets its timers.
    fn enter(&mut self, phase: LoweringPhase) {
        self.phase = phase;
        (self.phase_time, self.rest_time, self.standstill) = (0.0, 0.0, 0.0);
        (self.ramp, self.ramp_limit) = (1.0, self.torque_limit);
        self.ramp_lead = std::array::from_fn(|i| (self.goal[i] - self.q[i]).abs());
    }

    /// Returns the gravity torques of the model at the present positions, measured or modelled [N·m].
    fn gravity(&self) -> JointVec {
        holding_torque(&self.model, &self.masses, &self.q)
    }

    fn margin(&self, i: usize, gravity: f64) -> f64 {
        margin(self.max_torque[i], self.friction[i], gravity)
    }

    /// Starts to use positions of the model in place of the measured ones.
    fn go_blind(&mut self) {
        if !self.blind {
            self.blind = true;
            (self.behind, self.modelled) = ([true; MAX_JOINTS], [false; MAX_JOINTS]);
        }
    }

    /// Lets the `lost` joints descend by the model; the others have come to rest.
    fn model_lost(&mut self, lost: &[bool; MAX_JOINTS]) {
        for i in (0..self.n).filter(|i| lost[*i]) {
            (self.modelled[i], self.behind[i]) = (true, true);
        }
        (self.compared, self.has_stopped) = ((self.time, self.q), false);
        self.presses = true;
        self.enter(LoweringPhase::Down);
    }

    /// Sets the position of joint i to the one at which the modelled servo holds the torque `gravity` [N·m] with its
    /// present goal.
    fn follow_model(&mut self, i: usize, gravity: f64) {
        self.lead[i] = gravity / self.kp[i] + self.unmodelled_lead[i];
        self.q[i] = (self.goal[i] - self.lead[i]).max(self.lower[i]).min(self.upper[i]);
    }

    /// Returns to measured positions after [`Self::go_blind`]; moves the goal of each joint that has one again to its
    /// position, because it may be far from that of the model.
    fn resume_measured(&mut self, good: &[bool; MAX_JOINTS]) {
        let back: [bool; MAX_JOINTS] = std::array::from_fn(|i| self.behind[i] && good[i]);
        if !back.contains(&true) {
            return;
        }
        self.blind = false;
        for (modelled, good) in self.modelled.iter_mut().zip(good) {
            *modelled &= !good;
        }
        self.positions.restart(self.time, &self.q);
        let gravity = self.gravity();
        for i in (0..self.n).filter(|i| back[*i]) {
            self.behind[i] = false;
            // While the limits fall, `release` keeps the goals near the positions.
            if self.phase != LoweringPhase::Ramp {
                self.goal[i] = self.q[i] + gravity[i] / self.kp[i] + self.unmodelled_lead[i];
            }
        }
        // The servos may not have received the goals of the time without positions, and the arm may not have moved.
        self.goals.restart(self.time, &self.goal);
        // A height from positions of the model may be one that the tool never had.
        if !self.behind.contains(&true) {
            let height = self.points.evaluate(&self.q).tool_height(&self.up);
            self.start_height = self.start_height.min(height);
        }
        (self.nearest, self.standstill, self.least_left) = (f64::INFINITY, 0.0, 1.0);
    }
}

fn dot(a: &JointVec, b: &JointVec) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(v: &[f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Returns x clamped to ±bound.
fn clip(x: f64, bound: f64) -> f64 {
    x.max(-bound).min(bound)
}

/// Returns the sign of x; 0 for 0.
fn sign(x: f64) -> f64 {
    if x == 0.0 { 0.0 } else { x.signum() }
}
