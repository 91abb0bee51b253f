//! What the joints feel beside what is known, and how wrong that can be.

use crate::error::Result;
use crate::kinematics::JointMatrix;
use crate::servos::{ServoArrays, Servos};
use crate::{JointVec, MAX_JOINTS};

/// Least uncertainty of a joint's torque, as a share of the usable one: nothing is known better.
const LEAST: f64 = 1e-4;

/// The servos as an estimate needs them, spare entries neutral.
#[derive(Debug, Clone, Copy)]
pub(super) struct Joints {
    pub(super) n: usize,
    pub(super) kp: JointVec,
    pub(super) kv: JointVec,
    /// What friction goes by.
    pub(super) servos: ServoArrays,
    /// Damping of gears and back-EMF, outside the limit.
    pub(super) gears: JointVec,
    /// Part of that which a measured load has in it already: the back-EMF of duty-limited servos.
    pub(super) back_emf: JointVec,
    pub(super) armature: JointVec,
    pub(super) count: JointVec,
    /// Usable torque [N·m].
    pub(super) usable: JointVec,
}

impl Joints {
    pub(super) fn new(servos: &Servos, arrays: &ServoArrays, n: usize) -> Result<Self> {
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
            servos: *arrays,
            gears: [0.0; MAX_JOINTS],
            back_emf: [0.0; MAX_JOINTS],
            armature: spread(&servos.armature),
            count: spread(&servos.encoder_step),
            usable: spread(&servos.max_torque),
        };
        let own = spread(&servos.damping);
        for i in 0..out.n {
            // The controller's sum is gears, the servo's own damping and back-EMF.
            out.gears[i] = arrays.damping[i] - out.kv[i];
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
    /// Mass matrix of the links [kg·m²]; rotors come on top.
    pub(super) mass: &'a JointMatrix,
    /// Filtered velocity, and how far it can be off [rad/s].
    pub(super) velocity: &'a JointVec,
    pub(super) velocity_error: &'a JointVec,
    /// Acceleration behind the low-pass [rad/s²].
    pub(super) acceleration: &'a JointVec,
    pub(super) noise: &'a Noise,
    /// v₀ of the feed-forward [rad/s]: speed over which dry friction changes its side.
    pub(super) friction_speed: f64,
}

/// Standard deviations of what encoder counts do; independent from joint to joint.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Noise {
    /// Of the mean reading behind the low-pass [rad].
    pub(super) reading: JointVec,
    /// Of the velocity [rad/s].
    pub(super) velocity: JointVec,
    /// Of the acceleration [rad/s²].
    pub(super) acceleration: JointVec,
}

impl Balance<'_> {
    /// `g − τ` but for the servos' own damping [N·m]: what positions say.
    #[inline]
    pub(super) fn held(&self) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..self.joints.n {
            out[i] = self.gravity[i] - self.given[i] - self.own_damping(i) * self.velocity[i];
        }
        out
    }

    /// `τ_f tanh(v/v₀) + d v` with the servos' own damping [N·m]: what velocities say.
    #[inline]
    pub(super) fn resisted(&self) -> JointVec {
        let (joints, v) = (self.joints, self.velocity);
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..joints.n {
            let dry = self.friction(i) * (v[i] / self.friction_speed).tanh();
            out[i] = dry + (self.damping(i) + self.own_damping(i)) * v[i];
        }
        out
    }

    /// `M q̈` [N·m].
    #[inline]
    pub(super) fn accelerating(&self) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..self.joints.n {
            out[i] = self.joints.armature[i] * self.acceleration[i];
            for j in 0..self.joints.n {
                out[i] += self.mass[i][j] * self.acceleration[j];
            }
        }
        out
    }

    /// What friction, damping, velocity and acceleration leave open [N·m].
    ///
    /// Dry friction of a joint that may be at rest is anywhere within ±τ_f (1 + share); of one that surely moves only
    /// its share is open.
    #[inline]
    pub(super) fn resistance_error(&self, errors: &Errors) -> JointVec {
        let (joints, accelerating) = (self.joints, self.accelerating());
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..joints.n {
            let (speed, off) = (self.velocity[i].abs(), self.velocity_error[i]);
            let believed = (speed / self.friction_speed).tanh();
            let sure = ((speed - off).max(0.0) / self.friction_speed).tanh();
            let (moving, rest) = (self.friction(i), joints.servos.friction_at_rest(i, self.given[i]));
            let share = errors.friction * (sure * moving + (1.0 - sure) * rest);
            let dry = rest * (1.0 + believed - 2.0 * sure) + share;
            let viscous = errors.friction * self.damping(i) * speed;
            out[i] = dry + viscous + errors.inertia * accelerating[i].abs() + LEAST * joints.usable[i];
        }
        out
    }

    /// Noise that is each joint's own: through the lead, and through damping [N·m].
    #[inline]
    pub(super) fn own_noise(&self) -> JointVec {
        let (joints, noise) = (self.joints, self.noise);
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..joints.n {
            let lead = if self.measured || self.saturated[i] { 0.0 } else { joints.kp[i] * noise.reading[i] };
            let moving = (self.damping(i) + self.own_damping(i)) * noise.velocity[i];
            out[i] = (lead * lead + moving * moving).sqrt();
        }
        out
    }

    /// Noise that one joint's acceleration brings into all: column j is `M_j σ_j` [N·m].
    #[inline]
    pub(super) fn shared_noise(&self) -> JointMatrix {
        let mut out = [[0.0; MAX_JOINTS]; MAX_JOINTS];
        for i in 0..self.joints.n {
            for j in 0..self.joints.n {
                let rotor = if i == j { self.joints.armature[i] } else { 0.0 };
                out[i][j] = (self.mass[i][j] + rotor) * self.noise.acceleration[j];
            }
        }
        out
    }

    /// Dry friction at this speed under this torque [N·m]: that of the feed-forward.
    #[inline]
    fn friction(&self, i: usize) -> f64 {
        let servos = &self.joints.servos;
        let x = self.velocity[i].abs() * servos.stribeck_slowness[i];
        let at_rest = 1.0 / (1.0 + x + x * x);
        let loaded = servos.load_friction[i] + at_rest * servos.load_stribeck[i];
        servos.friction[i] + at_rest * servos.stribeck[i] + loaded * self.given[i].abs()
    }

    /// The servo's own damping where it is known to act inside the torque [N·m·s/rad].
    #[inline]
    fn own_damping(&self, i: usize) -> f64 {
        if self.measured || self.saturated[i] { 0.0 } else { self.joints.kv[i] }
    }

    #[inline]
    fn damping(&self, i: usize) -> f64 {
        self.joints.gears[i] - if self.measured { self.joints.back_emf[i] } else { 0.0 }
    }
}
