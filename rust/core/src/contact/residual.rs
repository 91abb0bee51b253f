//! Residual torques of the joints and their error bounds.

use crate::error::Result;
use crate::math::rows::{JointMatrix, pad};
use crate::params::{ServoArrays, Servos};
use crate::{JointVec, MAX_JOINTS};

/// Smallest uncertainty of a joint's torque, as a share of the usable torque.
const MIN_UNCERTAINTY: f64 = 1e-4;

/// Servo parameters of the estimator, neutral values in the padding.
#[derive(Debug, Clone, Copy)]
pub(super) struct ServoModel {
    pub(super) n: usize,
    pub(super) kp: JointVec,
    pub(super) kv: JointVec,
    /// Friction parameters.
    pub(super) servos: ServoArrays,
    /// Damping of gears and back-EMF, not subject to the torque limit.
    pub(super) gear_damping: JointVec,
    /// Part of `gear_damping` that a measured load already includes: the back-EMF of duty-limited servos.
    pub(super) back_emf: JointVec,
    pub(super) armature: JointVec,
    pub(super) count: JointVec,
    /// Usable torque [N·m].
    pub(super) max_torque: JointVec,
}

impl ServoModel {
    pub(super) fn new(servos: &Servos, arrays: &ServoArrays, n: usize) -> Result<Self> {
        let servos = servos.for_joints(n)?;
        let mut out = Self {
            n: n.min(MAX_JOINTS),
            kp: pad(&servos.kp, 0.0),
            kv: pad(&servos.kv, 0.0),
            servos: *arrays,
            gear_damping: [0.0; MAX_JOINTS],
            back_emf: [0.0; MAX_JOINTS],
            armature: pad(&servos.armature, 0.0),
            count: pad(&servos.encoder_step, 0.0),
            max_torque: pad(&servos.max_torque, 0.0),
        };
        let servo_damping: JointVec = pad(&servos.damping, 0.0);
        for i in 0..out.n {
            // The controller's damping is the sum of gears, the servo's own damping and back-EMF.
            out.gear_damping[i] = arrays.damping[i] - out.kv[i];
            out.back_emf[i] = out.gear_damping[i] - servo_damping[i];
        }
        Ok(out)
    }

    /// Returns the torque of each servo [N·m], `clip(k_p (goal − q) − k_v v, ±limit)`, and whether it is at the limit.
    #[inline]
    pub(super) fn servo_torque(
        &self,
        goal: &JointVec,
        limit: &JointVec,
        q: &JointVec,
        v: &JointVec,
    ) -> (JointVec, [bool; MAX_JOINTS]) {
        let (mut out, mut saturated) = ([0.0; MAX_JOINTS], [false; MAX_JOINTS]);
        for i in 0..self.n {
            let wanted = self.kp[i] * (goal[i] - q[i]) - self.kv[i] * v[i];
            let max = limit[i].max(0.0);
            out[i] = wanted.clamp(-max, max);
            saturated[i] = wanted.abs() > max;
        }
        (out, saturated)
    }
}

/// Relative errors of the parts of a residual.
#[derive(Debug, Clone, Copy)]
pub(super) struct ModelErrors {
    /// Errors of friction and damping, of the servos' torque, of gravity, of acceleration.
    pub(super) friction: f64,
    pub(super) servo_torque: f64,
    pub(super) gravity: f64,
    pub(super) inertia: f64,
}

/// Torque balance of all joints at one reading.
#[derive(Debug, Clone, Copy)]
pub(super) struct Balance<'a> {
    pub(super) joints: &'a ServoModel,
    /// Torque of the servos [N·m], and whether it was measured.
    pub(super) servo_torque: &'a JointVec,
    pub(super) measured: bool,
    pub(super) saturated: &'a [bool; MAX_JOINTS],
    pub(super) gravity: &'a JointVec,
    /// Mass matrix of the links [kg·m²]; rotor inertia is added.
    pub(super) mass: &'a JointMatrix,
    /// Filtered velocity, and its error bound [rad/s].
    pub(super) velocity: &'a JointVec,
    pub(super) velocity_error: &'a JointVec,
    /// Low-passed acceleration [rad/s²].
    pub(super) acceleration: &'a JointVec,
    pub(super) noise: &'a Noise,
    /// v₀ of the feed-forward [rad/s]: speed scale of the sign change of dry friction.
    pub(super) friction_speed: f64,
}

/// Standard deviations caused by encoder quantization; independent between joints.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Noise {
    /// Low-passed mean reading [rad].
    pub(super) reading: JointVec,
    /// Velocity [rad/s].
    pub(super) velocity: JointVec,
    /// Acceleration [rad/s²].
    pub(super) acceleration: JointVec,
}

impl Balance<'_> {
    /// `g − τ` without the servos' own damping [N·m]: the part that depends on positions.
    #[inline]
    pub(super) fn static_residual(&self) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..self.joints.n {
            out[i] = self.gravity[i] - self.servo_torque[i] - self.own_damping(i) * self.velocity[i];
        }
        out
    }

    /// `τ_f tanh(v/v₀) + d v` with the servos' own damping [N·m]: the part that depends on velocities.
    #[inline]
    pub(super) fn friction_torque(&self) -> JointVec {
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
    pub(super) fn inertial_torque(&self) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..self.joints.n {
            out[i] = self.joints.armature[i] * self.acceleration[i];
            for j in 0..self.joints.n {
                out[i] += self.mass[i][j] * self.acceleration[j];
            }
        }
        out
    }

    /// Returns the uncertainty from friction, damping, velocity and acceleration [N·m].
    ///
    /// Dry friction of a joint that may be at rest lies anywhere within ±τ_f (1 + share). Of a joint that certainly
    /// moves only its share is uncertain.
    #[inline]
    pub(super) fn friction_error(&self, errors: &ModelErrors) -> JointVec {
        let (joints, inertial_torque) = (self.joints, self.inertial_torque());
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..joints.n {
            let (speed, off) = (self.velocity[i].abs(), self.velocity_error[i]);
            let believed = (speed / self.friction_speed).tanh();
            let sure = ((speed - off).max(0.0) / self.friction_speed).tanh();
            let (moving, rest) = (self.friction(i), joints.servos.friction_at_rest(i, self.servo_torque[i]));
            let share = errors.friction * (sure * moving + (1.0 - sure) * rest);
            let dry = rest * (1.0 + believed - 2.0 * sure) + share;
            let viscous = errors.friction * self.damping(i) * speed;
            out[i] = dry + viscous + errors.inertia * inertial_torque[i].abs() + MIN_UNCERTAINTY * joints.max_torque[i];
        }
        out
    }

    /// Returns the noise that is independent per joint: through the lead, and through damping [N·m].
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

    /// Returns the noise that the acceleration of one joint causes in all joints: column j is `M_j σ_j` [N·m].
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

    /// Returns the dry friction at this speed and torque [N·m], by the model of the feed-forward.
    #[inline]
    fn friction(&self, i: usize) -> f64 {
        let servos = &self.joints.servos;
        let x = self.velocity[i].abs() * servos.inv_stribeck_speed[i];
        let at_rest = 1.0 / (1.0 + x + x * x);
        let loaded = servos.load_friction[i] + at_rest * servos.load_stribeck[i];
        servos.friction[i] + at_rest * servos.stribeck[i] + loaded * self.servo_torque[i].abs()
    }

    /// Returns the servo's own damping if it is known to be part of the torque [N·m·s/rad].
    #[inline]
    fn own_damping(&self, i: usize) -> f64 {
        if self.measured || self.saturated[i] { 0.0 } else { self.joints.kv[i] }
    }

    #[inline]
    fn damping(&self, i: usize) -> f64 {
        self.joints.gear_damping[i] - if self.measured { self.joints.back_emf[i] } else { 0.0 }
    }
}
