//! What the joints feel beside what is known, and how wrong that can be.

use crate::error::Result;
use crate::servos::Servos;
use crate::{JointVec, MAX_JOINTS};

/// Speed [rad/s] over which dry friction changes its side: v₀ of the feed-forward.
const FRICTION_SPEED: f64 = 0.05;

/// Least uncertainty of a joint's torque, as a share of the usable one: nothing is known better.
const LEAST: f64 = 1e-4;

/// The servos as an estimate needs them, spare entries neutral.
#[derive(Debug, Clone, Copy)]
pub(super) struct Joints {
    pub(super) n: usize,
    pub(super) kp: JointVec,
    pub(super) kv: JointVec,
    pub(super) friction: JointVec,
    /// Damping of gears and back-EMF, outside the limit.
    pub(super) gears: JointVec,
    /// Part of that which a measured load has in it already: the back-EMF of duty-limited servos.
    pub(super) back_emf: JointVec,
    pub(super) armature: JointVec,
    pub(super) count: JointVec,
    /// Least uncertainty [N·m].
    pub(super) least: JointVec,
}

impl Joints {
    pub(super) fn new(servos: &Servos, damping: &JointVec, n: usize) -> Result<Self> {
        let servos = servos.for_joints(n)?;
        let spread = |values: &[f64]| {
            let mut out = [0.0; MAX_JOINTS];
            out.iter_mut().zip(values).for_each(|(slot, value)| *slot = *value);
            out
        };
        let mut out = Self {
            n: n.min(MAX_JOINTS),
            kp: spread(&servos.kp),
            kv: spread(&servos.kv),
            friction: spread(&servos.friction),
            gears: [0.0; MAX_JOINTS],
            back_emf: [0.0; MAX_JOINTS],
            armature: spread(&servos.armature),
            count: spread(&servos.count),
            least: spread(&servos.torque).map(|torque| LEAST * torque),
        };
        let own = spread(&servos.damping);
        for i in 0..out.n {
            // The controller's sum is gears, the servo's own damping and back-EMF.
            out.gears[i] = damping[i] - out.kv[i];
            out.back_emf[i] = out.gears[i] - own[i];
        }
        Ok(out)
    }

    /// Torque of each servo [N·m], `clip(k_p (goal − q) − k_v v, ±limit)`, and whether the limit cut it.
    #[inline]
    pub(super) fn given(
        &self,
        goal: &JointVec,
        limit: &JointVec,
        q: &JointVec,
        v: &JointVec,
    ) -> (JointVec, [bool; MAX_JOINTS]) {
        let (mut out, mut saturated) = ([0.0; MAX_JOINTS], [false; MAX_JOINTS]);
        for i in 0..self.n {
            let wanted = self.kp[i] * (goal[i] - q[i]) - self.kv[i] * v[i];
            let most = limit[i].max(0.0);
            out[i] = wanted.clamp(-most, most);
            saturated[i] = wanted.abs() > most;
        }
        (out, saturated)
    }
}

/// How wrong the parts of a residual may be.
#[derive(Debug, Clone, Copy)]
pub(super) struct Errors {
    /// Shares of friction and damping, of the servos' torque, of gravity, of acceleration.
    pub(super) friction: f64,
    pub(super) given: f64,
    pub(super) gravity: f64,
    pub(super) inertia: f64,
}

/// One tick of all joints.
#[derive(Debug, Clone, Copy)]
pub(super) struct Balance<'a> {
    pub(super) joints: &'a Joints,
    /// Torque of the servos [N·m], and whether it was measured.
    pub(super) given: &'a JointVec,
    pub(super) measured: bool,
    pub(super) saturated: &'a [bool; MAX_JOINTS],
    pub(super) gravity: &'a JointVec,
    /// Torques that accelerate the arm [N·m].
    pub(super) inertia: &'a JointVec,
    /// Filtered velocity and how far it can be off [rad/s].
    pub(super) velocity: &'a JointVec,
    pub(super) velocity_error: &'a JointVec,
}

impl Balance<'_> {
    /// Residual `g + M q̈ + τ_f tanh(v/v₀) + d v − τ` [N·m]: what the surroundings add to each joint.
    #[inline]
    pub(super) fn residual(&self) -> JointVec {
        let (joints, v) = (self.joints, self.velocity);
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..joints.n {
            let dry = joints.friction[i] * (v[i] / FRICTION_SPEED).tanh();
            out[i] = self.gravity[i] + self.inertia[i] + dry + self.damping(i) * v[i] - self.given[i];
        }
        out
    }

    /// What friction, damping, velocity and encoder leave open of it [N·m].
    ///
    /// Dry friction of a joint that may be at rest is anywhere within ±τ_f (1 + share); of one that surely moves only
    /// its share is open.
    #[inline]
    pub(super) fn resistance_error(&self, errors: &Errors) -> JointVec {
        let joints = self.joints;
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..joints.n {
            let (speed, off) = (self.velocity[i].abs(), self.velocity_error[i]);
            let believed = (speed / FRICTION_SPEED).tanh();
            let sure = ((speed - off).max(0.0) / FRICTION_SPEED).tanh();
            let dry = joints.friction[i] * (1.0 + believed - 2.0 * sure + errors.friction);
            let viscous = self.damping(i) * (errors.friction * speed + off);
            // The velocity's error acts on the servo's own damping, the count on its lead, unless its limit decides.
            let lead = if self.measured || self.saturated[i] {
                0.0
            } else {
                joints.kp[i] * joints.count[i] + joints.kv[i] * off
            };
            out[i] = dry + viscous + lead + errors.inertia * self.inertia[i].abs() + joints.least[i];
        }
        out
    }

    #[inline]
    fn damping(&self, i: usize) -> f64 {
        self.joints.gears[i] - if self.measured { self.joints.back_emf[i] } else { 0.0 }
    }
}
