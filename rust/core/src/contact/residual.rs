//! Residual torques of the joints and their error bounds.

use crate::error::Result;
use crate::math::rows::{JointMatrix, pad};
use crate::params::{ServoArrays, Servos};
use crate::{JointVec, MAX_JOINTS};

/// Ratio of the smallest uncertainty of a joint's torque to its usable torque.
const MIN_UNCERTAINTY: f64 = 1e-4;

/// Servo parameters of the estimator.
#[derive(Debug, Clone, Copy)]
pub(super) struct ServoModel {
    pub(super) n: usize,
    pub(super) kp: JointVec,
    pub(super) kv: JointVec,
    /// Servo parameters of the controller, used for friction.
    pub(super) servos: ServoArrays,
    /// Damping of gears and back-EMF [N·m·s/rad], which the torque limit does not bound.
    pub(super) gear_damping: JointVec,
    /// Back-EMF of servos that limit the PWM duty cycle [N·m·s/rad]: a part of `gear_damping` that a measured load
    /// already includes.
    pub(super) back_emf: JointVec,
    pub(super) armature: JointVec,
    pub(super) encoder_step: JointVec,
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
            encoder_step: pad(&servos.encoder_step, 0.0),
            max_torque: pad(&servos.max_torque, 0.0),
        };
        let servo_damping: JointVec = pad(&servos.damping, 0.0);
        for i in 0..out.n {
            // The controller's damping is the sum of gear damping, derivative gain k_v and back-EMF.
            out.gear_damping[i] = arrays.damping[i] - out.kv[i];
            out.back_emf[i] = out.gear_damping[i] - servo_damping[i];
        }
        Ok(out)
    }

    /// Returns the torque of each servo, `clip(k_p (goal − q) − k_v v, ±limit)` [N·m], and true where it is clipped.
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

/// Relative errors of the terms of the torque balance, as fractions.
#[derive(Debug, Clone, Copy)]
pub(super) struct ModelErrors {
    /// Error of friction and damping.
    pub(super) friction: f64,
    /// Error of the servos' torques.
    pub(super) servo_torque: f64,
    /// Error of the gravity torques.
    pub(super) gravity: f64,
    /// Error of the acceleration torques.
    pub(super) inertia: f64,
}

/// Torque balance of all joints at one reading.
#[derive(Debug, Clone, Copy)]
pub(super) struct Balance<'a> {
    pub(super) joints: &'a ServoModel,
    /// Torque of the servos [N·m].
    pub(super) servo_torque: &'a JointVec,
    /// True if `servo_torque` was measured, false if it was computed from goal, position and limit.
    pub(super) measured: bool,
    pub(super) saturated: &'a [bool; MAX_JOINTS],
    pub(super) gravity: &'a JointVec,
    /// Mass matrix of the links without the rotors' inertia [kg·m²].
    pub(super) mass: &'a JointMatrix,
    /// Filtered velocity [rad/s].
    pub(super) velocity: &'a JointVec,
    /// Bound on the error of `velocity` [rad/s].
    pub(super) velocity_error: &'a JointVec,
    /// Low-passed acceleration [rad/s²].
    pub(super) acceleration: &'a JointVec,
    pub(super) noise: &'a Noise,
    /// Speed v₀ [rad/s] in the dry friction `τ_f tanh(v/v₀)`.
    pub(super) friction_speed: f64,
}

/// Standard deviations of the noise caused by encoder quantization, which is independent between joints.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Noise {
    /// Noise of the low-passed mean of two readings [rad].
    pub(super) reading: JointVec,
    /// Noise of the velocity [rad/s].
    pub(super) velocity: JointVec,
    /// Noise of the acceleration [rad/s²].
    pub(super) acceleration: JointVec,
}

impl Balance<'_> {
    /// Returns the part of the residual that depends on positions [N·m]: `g − τ` without the damping `−k_v v` in τ.
    #[inline]
    pub(super) fn static_residual(&self) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..self.joints.n {
            out[i] = self.gravity[i] - self.servo_torque[i] - self.own_damping(i) * self.velocity[i];
        }
        out
    }

    /// Returns the smoothed sign of each velocity, `tanh(v/v₀)`.
    #[inline]
    pub(super) fn direction(&self) -> JointVec {
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..self.joints.n {
            out[i] = (self.velocity[i] / self.friction_speed).tanh();
        }
        out
    }

    /// Returns the part of the residual that depends on velocities [N·m]: `τ_f tanh(v/v₀) + (d + k_v) v`.
    #[inline]
    pub(super) fn friction_torque(&self, direction: &JointVec) -> JointVec {
        let (joints, v) = (self.joints, self.velocity);
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..joints.n {
            let dry = self.friction(i) * direction[i];
            out[i] = dry + (self.damping(i) + self.own_damping(i)) * v[i];
        }
        out
    }

    /// Returns the acceleration torques `M q̈` [N·m], including those of the rotors.
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

    /// Returns the bound on the error caused by friction, damping, velocity and acceleration [N·m].
    ///
    /// With the relative error ε of friction: the dry friction of a joint that may be at rest is unknown within ±τ_f (1
    /// + ε); that of a joint that certainly moves, within ±ε τ_f.
    #[inline]
    pub(super) fn friction_error(
        &self,
        errors: &ModelErrors,
        direction: &JointVec,
        inertial_torque: &JointVec,
    ) -> JointVec {
        let joints = self.joints;
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..joints.n {
            let (speed, speed_error) = (self.velocity[i].abs(), self.velocity_error[i]);
            let estimated_sign = direction[i].abs();
            let certain_sign = ((speed - speed_error).max(0.0) / self.friction_speed).tanh();
            let (moving, rest) = (self.friction(i), joints.servos.friction_at_rest(i, self.servo_torque[i]));
            let share = errors.friction * (certain_sign * moving + (1.0 - certain_sign) * rest);
            let dry = rest * (1.0 + estimated_sign - 2.0 * certain_sign) + share;
            let viscous = errors.friction * self.damping(i) * speed;
            out[i] = dry + viscous + errors.inertia * inertial_torque[i].abs() + MIN_UNCERTAINTY * joints.max_torque[i];
        }
        out
    }

    /// Returns the standard deviation [N·m] of the torque noise that is independent between joints: noise of the
    /// position times k_p, and noise of the velocity times damping.
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

    /// Returns the torque noise [N·m] in all joints that the acceleration noise σ_j of each joint j causes: column j is
    /// `M_j σ_j`.
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

    /// Returns the dry friction [N·m] of joint i at its present speed and servo torque, by the same model as the
    /// feed-forward of the controller.
    #[inline]
    fn friction(&self, i: usize) -> f64 {
        let servos = &self.joints.servos;
        let x = self.velocity[i].abs() * servos.inv_stribeck_speed[i];
        let at_rest = 1.0 / (1.0 + x + x * x);
        let loaded = servos.load_friction[i] + at_rest * servos.load_stribeck[i];
        servos.friction[i] + at_rest * servos.stribeck[i] + loaded * self.servo_torque[i].abs()
    }

    /// Returns k_v [N·m·s/rad] if the torque was computed and not clipped, so that it contains −k_v v; otherwise 0.
    #[inline]
    fn own_damping(&self, i: usize) -> f64 {
        if self.measured || self.saturated[i] { 0.0 } else { self.joints.kv[i] }
    }

    #[inline]
    fn damping(&self, i: usize) -> f64 {
        self.joints.gear_damping[i] - if self.measured { self.joints.back_emf[i] } else { 0.0 }
    }
}
