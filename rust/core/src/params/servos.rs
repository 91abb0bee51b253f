//! Parameters of position servos, for the settings and for the control step.

use crate::error::{Error, Result};
use crate::{JointVec, MAX_JOINTS};

/// Smallest value of parameters that must be positive: keeps reciprocals finite.
const MIN: f64 = 1e-6;
/// Largest value of any parameter: keeps products finite.
const MAX: f64 = 1e9;

/// Quantity that a servo's torque limit register limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LimitType {
    /// Motor current, which limits the torque at any speed.
    #[default]
    Current,
    /// PWM duty: the available torque decreases with speed, so that back-EMF acts as a damping of
    /// `max_torque / no_load_speed`.
    Pwm,
}

/// Position servos of the `n` joints of a chain, base → tip. Units are N·m and rad; N and m for prismatic joints.
///
/// Each list has one entry per joint, or a single entry for all joints.
#[derive(Debug, Clone, PartialEq)]
pub struct Servos {
    /// Stiffness of the position loop, `k_p` [N·m/rad] > 0.
    pub kp: Vec<f64>,
    /// Usable torque at the present voltage [N·m] > 0; no torque limit exceeds it.
    pub max_torque: Vec<f64>,
    /// Dry (Coulomb) friction of gears and motor [N·m] ≥ 0.
    pub friction: Vec<f64>,
    /// Additional dry friction per N·m of load torque [1] ≥ 0, for gears whose friction increases with the load.
    pub load_friction: Vec<f64>,
    /// Stribeck friction [N·m] ≥ 0: additional dry friction at rest, which vanishes at high speed.
    pub stribeck: Vec<f64>,
    /// Stribeck friction per N·m of load torque [1] ≥ 0.
    pub load_stribeck: Vec<f64>,
    /// Speed at which a third of the Stribeck friction remains [rad/s] > 0.
    pub stribeck_speed: Vec<f64>,
    /// Viscous damping of gears and back-EMF [N·m·s/rad] ≥ 0; the torque limit does not bound its torque.
    pub damping: Vec<f64>,
    /// Derivative gain of the position loop [N·m·s/rad] ≥ 0; its torque counts toward the torque limit.
    pub kv: Vec<f64>,
    /// Rotor inertia at the joint [kg·m²] ≥ 0; used by the contact estimator, by `Lowering` and by simulators.
    pub armature: Vec<f64>,
    /// Angle of one encoder count [rad] ≥ 0; 0 to neglect it.
    pub encoder_step: Vec<f64>,
    /// Quantity that the servo's torque limit register limits.
    pub limit_type: LimitType,
    /// No-load speed [rad/s] > 0, required for [`LimitType::Pwm`].
    pub no_load_speed: Option<Vec<f64>>,
    /// True if `kp` is known within 10 %, by identification or measurement, and friction and damping are measured too. If
    /// false, half of their feed-forward is exerted only as far as a force of a yielding axis opposes the motion, or the
    /// reference of a stiff axis moves.
    pub stiffness_known: bool,
}

impl Servos {
    /// Creates servos with the given stiffness and usable torque, `stribeck_speed` 1 rad/s, and all other parameters 0
    /// or unset.
    pub fn new(kp: Vec<f64>, max_torque: Vec<f64>) -> Self {
        Self {
            kp,
            max_torque,
            friction: vec![0.0],
            load_friction: vec![0.0],
            stribeck: vec![0.0],
            load_stribeck: vec![0.0],
            stribeck_speed: vec![1.0],
            damping: vec![0.0],
            kv: vec![0.0],
            armature: vec![0.0],
            encoder_step: vec![0.0],
            limit_type: LimitType::Current,
            no_load_speed: None,
            stiffness_known: false,
        }
    }

    /// Checks every value.
    ///
    /// # Errors
    /// [`Error::OutOfRange`] names field, index and bound; [`Error::Config`] for [`LimitType::Pwm`] without a no-load
    /// speed. Under [`LimitType::Current`] a given no-load speed is checked but has no effect.
    pub fn validate(&self) -> Result<()> {
        for (name, values, low) in self.fields() {
            for (i, &value) in values.iter().enumerate() {
                if !(value >= low && value <= MAX) {
                    let least = if low > 0.0 { format!("{low:e}") } else { "0".into() };
                    return Err(Error::out_of_range(
                        format!("servos.{name}[{i}]"),
                        value,
                        format!("[{least}, {MAX:e}]"),
                    ));
                }
            }
        }
        match (self.limit_type, &self.no_load_speed) {
            (LimitType::Pwm, None) => Err(Error::config(
                "servos.no_load_speed",
                "limit_type=\"pwm\" needs the no-load speed [rad/s] at the present voltage (it sets the back-EMF)",
            )),
            _ => Ok(()),
        }
    }

    /// Returns these servos with one entry for each of `n` joints.
    ///
    /// # Errors
    /// As [`Servos::validate`]; [`Error::Shape`] for a field with neither 1 nor `n` entries.
    pub fn for_joints(&self, n: usize) -> Result<Self> {
        self.validate()?;
        let expand = |name: &str, values: &[f64]| match values {
            [one] => Ok(vec![*one; n]),
            many if many.len() == n => Ok(many.to_vec()),
            other => Err(Error::Shape {
                what: format!("servos.{name}"),
                got: format!("({},)", other.len()),
                expected: format!("({n},) or a single number"),
            }),
        };
        Ok(Self {
            kp: expand("kp", &self.kp)?,
            max_torque: expand("max_torque", &self.max_torque)?,
            friction: expand("friction", &self.friction)?,
            load_friction: expand("load_friction", &self.load_friction)?,
            stribeck: expand("stribeck", &self.stribeck)?,
            load_stribeck: expand("load_stribeck", &self.load_stribeck)?,
            stribeck_speed: expand("stribeck_speed", &self.stribeck_speed)?,
            damping: expand("damping", &self.damping)?,
            kv: expand("kv", &self.kv)?,
            armature: expand("armature", &self.armature)?,
            encoder_step: expand("encoder_step", &self.encoder_step)?,
            no_load_speed: self.no_load_speed.as_deref().map(|w| expand("no_load_speed", w)).transpose()?,
            limit_type: self.limit_type,
            stiffness_known: self.stiffness_known,
        })
    }

    /// Returns the name, the values and the smallest valid value of every list.
    fn fields(&self) -> Vec<(&'static str, &[f64], f64)> {
        let mut fields: Vec<(&'static str, &[f64], f64)> = vec![
            ("kp", &self.kp, MIN),
            ("max_torque", &self.max_torque, MIN),
            ("friction", &self.friction, 0.0),
            ("load_friction", &self.load_friction, 0.0),
            ("stribeck", &self.stribeck, 0.0),
            ("load_stribeck", &self.load_stribeck, 0.0),
            ("stribeck_speed", &self.stribeck_speed, MIN),
            ("damping", &self.damping, 0.0),
            ("kv", &self.kv, 0.0),
            ("armature", &self.armature, 0.0),
            ("encoder_step", &self.encoder_step, 0.0),
        ];
        if let Some(speed) = &self.no_load_speed {
            fields.push(("no_load_speed", speed, MIN));
        }
        fields
    }
}

/// Gravity offset of the goals: gravity torque times `compliance`, plus `lead`.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GravityOffset {
    /// 1/k_g [rad/(N·m)].
    pub(crate) compliance: JointVec,
    /// Constant lead [rad].
    pub(crate) lead: JointVec,
}

/// Servo parameters of the control step, one entry per joint; the padding contains neutral values.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ServoArrays {
    /// True if `k_p` is known; otherwise `kp` is 1.
    pub(crate) has_kp: bool,
    /// Stiffness of the position loop [N·m/rad].
    pub(crate) kp: JointVec,
    /// 1 / `kp` [rad/(N·m)].
    pub(crate) compliance: JointVec,
    /// Mean k̄ of `kp` over the joints [N·m/rad].
    pub(crate) kp_mean: f64,
    /// Usable torque, the ceiling of the torque limits [N·m]; ∞ if unknown.
    pub(crate) torque: JointVec,
    /// Dry friction [N·m].
    pub(crate) friction: JointVec,
    /// Additional dry friction per N·m of load torque [1].
    pub(crate) load_friction: JointVec,
    /// Stribeck friction [N·m]: additional dry friction at rest.
    pub(crate) stribeck: JointVec,
    /// Stribeck friction per N·m of load torque [1].
    pub(crate) load_stribeck: JointVec,
    /// Reciprocal of the speed at which a third of the Stribeck friction remains [s/rad]; 0 without servos.
    pub(crate) inv_stribeck_speed: JointVec,
    /// Viscous damping of gears and back-EMF, plus the derivative gain [N·m·s/rad].
    pub(crate) damping: JointVec,
    /// Viscous damping of gears and back-EMF [N·m·s/rad], which the torque limit does not bound.
    pub(crate) drag: JointVec,
    /// Rotor inertia at the joint [kg·m²].
    pub(crate) armature: JointVec,
    /// Angle of one encoder count [rad].
    pub(crate) encoder_step: JointVec,
    /// True if friction and damping are estimates, which may be twice the true values.
    pub(crate) estimated: bool,
}

impl ServoArrays {
    /// Returns true if every joint has `d/k_p ≥ 0.04 s`. The stiff axes may then be three times as stiff as the servos.
    pub(crate) fn well_damped(&self, n: usize) -> bool {
        (0..n.min(MAX_JOINTS)).all(|i| self.damping[i] * self.compliance[i] >= 0.04)
    }

    /// Returns the lead (goal − q) [rad] at which the servo of joint `i` exerts its full torque; 0 if `k_p` is unknown.
    pub(crate) fn lead_at_full_torque(&self, i: usize) -> f64 {
        if self.has_kp { self.torque[i] * self.compliance[i] } else { 0.0 }
    }

    /// Returns the static friction of joint `i` under the load `torque` [N·m].
    pub(crate) fn friction_at_rest(&self, i: usize, torque: f64) -> f64 {
        self.friction[i] + self.stribeck[i] + (self.load_friction[i] + self.load_stribeck[i]) * torque.abs()
    }

    /// Returns the gravity offset of an arm at rest at `q` with these `goal`s [rad] and the torques `holding` [N·m].
    ///
    /// The compliance 1/k_g is `(goal − q) / holding`, clamped so that k_g is 0.3 to 3 times the configured `k_p`. A
    /// joint whose |holding| is at most three times its friction, or three times the servo torque of one encoder count,
    /// keeps the configured 1/`k_p`. The rest of `goal − q` is the constant lead, which 10 times this friction or
    /// torque bounds.
    pub(crate) fn gravity_offset(&self, n: usize, q: &JointVec, goal: &JointVec, holding: &JointVec) -> GravityOffset {
        let mut offset = GravityOffset { compliance: self.compliance, lead: [0.0; MAX_JOINTS] };
        for i in 0..n {
            let (lead, configured) = (goal[i] - q[i], self.compliance[i]);
            let resolution = self.friction[i].max(self.kp[i] * self.encoder_step[i]);
            if holding[i].abs() > 3.0 * resolution {
                offset.compliance[i] = (lead / holding[i]).clamp(configured / 3.0, configured / 0.3);
            }
            let bound = 10.0 * resolution * configured;
            offset.lead[i] = (lead - offset.compliance[i] * holding[i]).clamp(-bound, bound);
        }
        offset
    }

    /// Creates the arrays from the result of [`Servos::for_joints`]. Without servos, the usable torques are the effort
    /// limits of the model.
    pub(crate) fn new(n: usize, servos: Option<&Servos>, effort: &[Option<f64>]) -> Self {
        let mut arrays = Self {
            has_kp: servos.is_some(),
            kp: [1.0; MAX_JOINTS],
            compliance: [1.0; MAX_JOINTS],
            kp_mean: 1.0,
            torque: [f64::INFINITY; MAX_JOINTS],
            friction: [0.0; MAX_JOINTS],
            load_friction: [0.0; MAX_JOINTS],
            stribeck: [0.0; MAX_JOINTS],
            load_stribeck: [0.0; MAX_JOINTS],
            inv_stribeck_speed: [0.0; MAX_JOINTS],
            damping: [0.0; MAX_JOINTS],
            drag: [0.0; MAX_JOINTS],
            armature: [0.0; MAX_JOINTS],
            encoder_step: [0.0; MAX_JOINTS],
            estimated: servos.is_some_and(|servos| !servos.stiffness_known),
        };
        let Some(servos) = servos else {
            for (ceiling, effort) in arrays.torque.iter_mut().zip(effort) {
                *ceiling = effort.unwrap_or(f64::INFINITY);
            }
            return arrays;
        };
        for i in 0..n.min(MAX_JOINTS) {
            arrays.kp[i] = servos.kp[i];
            arrays.compliance[i] = 1.0 / servos.kp[i];
            arrays.torque[i] = servos.max_torque[i];
            arrays.friction[i] = servos.friction[i];
            arrays.load_friction[i] = servos.load_friction[i];
            arrays.stribeck[i] = servos.stribeck[i];
            arrays.load_stribeck[i] = servos.load_stribeck[i];
            arrays.inv_stribeck_speed[i] = 1.0 / servos.stribeck_speed[i];
            let back_emf = match (servos.limit_type, &servos.no_load_speed) {
                (LimitType::Pwm, Some(speed)) => servos.max_torque[i] / speed[i],
                _ => 0.0,
            };
            arrays.drag[i] = servos.damping[i] + back_emf;
            arrays.damping[i] = arrays.drag[i] + servos.kv[i];
            arrays.armature[i] = servos.armature[i];
            arrays.encoder_step[i] = servos.encoder_step[i];
        }
        arrays.kp_mean = servos.kp.iter().sum::<f64>() / servos.kp.len() as f64;
        arrays
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_single_number_applies_to_every_joint() {
        let servos = Servos::new(vec![100.0], vec![5.0, 6.0]).for_joints(2).unwrap();
        assert_eq!(servos.kp, [100.0, 100.0]);
        assert_eq!(servos.max_torque, [5.0, 6.0]);
    }

    #[test]
    fn wrong_values_are_named() {
        let error = Servos::new(vec![100.0, 0.0], vec![5.0]).for_joints(2).unwrap_err().to_string();
        assert_eq!(error, "servos.kp[1] = 0 is outside [1e-6, 1e9]");
        let error = Servos::new(vec![100.0; 3], vec![5.0]).for_joints(2).unwrap_err().to_string();
        assert_eq!(error, "servos.kp has shape (3,), expected (2,) or a single number");
        let duty = Servos { limit_type: LimitType::Pwm, ..Servos::new(vec![100.0], vec![5.0]) };
        assert!(duty.validate().unwrap_err().to_string().contains("no-load speed"));
    }

    #[test]
    fn back_emf_of_a_duty_limit_is_damping() {
        let servos = Servos {
            limit_type: LimitType::Pwm,
            no_load_speed: Some(vec![10.0]),
            damping: vec![0.2],
            kv: vec![0.3],
            ..Servos::new(vec![100.0], vec![5.0])
        };
        let arrays = ServoArrays::new(1, Some(&servos.for_joints(1).unwrap()), &[]);
        assert!((arrays.damping[0] - 1.0).abs() < 1e-15);
    }
}
