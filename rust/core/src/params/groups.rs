//! Groups of settings: tracking, null space, compensation, torque limits, options of the paper.

use super::settings::{Damping, Follow, Gain, GravityUse, LimitRule, Projector};

/// Settings of how the stiff axes track their target.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracking {
    /// Gain K_x [1/s], equation (5) of the paper: a scalar, one value per axis of the task, or a matrix.
    pub gain: Gain,
    /// Damping of the inverse kinematics near singular poses.
    pub damping: Damping,
    /// Time constant T_f [s] of the filter of the joint velocity.
    pub velocity_filter: f64,
    /// Speed limit of the joint goals [rad/s]; ∞ for no limit.
    pub goal_slew: f64,
    /// Speed limit [rad/s] of each joint; `None` for the model's limits.
    pub joint_speed: Option<Vec<f64>>,
    /// Rate [1/s] of the integral action: the lead (goal − q) of the stiff axes accumulates in the goal; 0 for none.
    pub integrate: f64,
}

impl Default for Tracking {
    fn default() -> Self {
        Self {
            gain: Gain::Scalar(4.0),
            damping: Damping::Auto,
            velocity_filter: 0.02,
            goal_slew: 1.0,
            joint_speed: None,
            integrate: 0.0,
        }
    }
}

/// Settings of the null-space motion, the motion of the joints that leaves the task unchanged.
#[derive(Debug, Clone, PartialEq)]
pub struct NullSpace {
    /// Rest posture [rad], one value per joint; `None` for the joint positions at reset.
    pub posture: Option<Vec<f64>>,
    /// Gain α of the null-space motion [1/s]; `None` for the largest entry of the tracking gain.
    pub gain: Option<f64>,
    /// Largest torque τ₀ of the null-space motion, summed over all joints [N·m]; under law `paper` its torque budget.
    /// `None`: 2 if the arm is redundant for the task, else 0.
    pub max_torque: Option<f64>,
    /// Law `impedance`: stiffness of the null-space motion [N·m/rad], which replaces `gain`; `None` to use `gain`.
    pub stiffness: Option<f64>,
    /// Speed limit of the null-space motion of each joint [rad/s]; ∞ for no limit.
    pub max_speed: f64,
    /// Weight of the joint-limit cost `½ Σ ((q − mid)/half-range)²`; 0 for none.
    pub limit_avoidance: f64,
    /// Projector into the null space of the task.
    pub projector: Projector,
}

impl Default for NullSpace {
    fn default() -> Self {
        Self {
            posture: None,
            gain: None,
            max_torque: None,
            stiffness: None,
            max_speed: f64::INFINITY,
            limit_avoidance: 0.0,
            projector: Projector::Exact,
        }
    }
}

/// Shares of friction, damping and delay that feed-forward and prediction compensate.
#[derive(Debug, Clone, PartialEq)]
pub struct Compensation {
    /// Share b_f of the servos' dry friction that is fed forward, 0 to 1.
    pub friction: f64,
    /// Share b_d of the servos' damping that is fed forward, 0 to 1.
    pub damping: f64,
    /// Share b_p of the delay over which positions are predicted, 0 to 1.
    pub delay: f64,
}

impl Default for Compensation {
    fn default() -> Self {
        Self { friction: 0.9, damping: 0.8, delay: 0.9 }
    }
}

/// Settings of the joint torque limits that are sent to the servos.
#[derive(Debug, Clone, PartialEq)]
pub struct TorqueLimits {
    /// Margin of the limits above the law's demand, as a share of the usable torque; at least twice the friction.
    pub margin: f64,
    /// Minimum torque limit of each joint [N·m]; `None` for the servos' friction.
    pub floor: Option<Vec<f64>>,
    /// Shortest time [s] in which a limit may rise from zero to the usable torque; 0 for no bound.
    pub stiffening_time: f64,
    /// Largest force [N] that a hand may meet along the task's translations if the host stops; `None` for no bound.
    pub max_host_loss_force: Option<f64>,
}

impl Default for TorqueLimits {
    fn default() -> Self {
        Self { margin: 0.1, floor: None, stiffening_time: 0.2, max_host_loss_force: None }
    }
}

/// Options of the published law and its variants, for studies; not needed to run an arm.
#[derive(Debug, Clone, PartialEq)]
pub struct PaperOptions {
    /// Role of yielding axes in the inverse kinematics; `None` for the law's default.
    pub follow: Option<Follow>,
    /// Rule for the joint torque limits under the laws `cap` and `impedance`.
    pub limits: LimitRule,
    /// Horizon h [s] of the goal `q + h q̇`.
    pub horizon: f64,
    /// Gain K_q, equation (5) of the paper; law `paper` only.
    pub kq: Gain,
    /// Law `paper`: weight of each joint in J⁺; `None` for 1 on all joints.
    pub joint_weights: Option<Vec<f64>>,
    /// Weight of each joint in the posture cost; `None` for 1 on all joints.
    pub posture_weights: Option<Vec<f64>>,
    /// Weight of the manipulability cost `−ln √det(JJᵀ)`; 0 for none.
    pub manipulability: f64,
    /// Places in which the gravity model is used, if [`Settings::gravity`](super::Settings::gravity) is set.
    pub gravity_use: GravityUse,
    /// Factor s_g on the gravity torques in the torque limits, > 1 for a margin over the model.
    pub gravity_scale: f64,
    /// Speed v₀ [rad/s] at which the friction feed-forward saturates.
    pub friction_speed: f64,
    /// Half-width of a band around deviation zero, as a share of `soft_until`; `None`: 0.1, or 0 under law `paper`. In
    /// the band, an axis whose two sides have different parameters blends between them.
    pub direction_band: Option<f64>,
    /// True to compute the compliance from the raw deviation; false: from the adapted deviation.
    pub raw_deviation: bool,
    /// Law `paper`: true to clamp the step of each axis to its torque budget.
    pub budget_on_goal: bool,
    /// Law `paper`: largest lead (goal − q) [rad]. `None`: slightly more than the lead at which the servo reaches its
    /// torque limit; 0.3 rad if `k_p` is unknown.
    pub lead_limit: Option<f64>,
}

impl Default for PaperOptions {
    fn default() -> Self {
        Self {
            follow: None,
            limits: LimitRule::Demand,
            horizon: 0.25,
            kq: Gain::Scalar(1.0),
            joint_weights: None,
            posture_weights: None,
            manipulability: 0.0,
            gravity_use: GravityUse::Both,
            gravity_scale: 1.1,
            friction_speed: 0.05,
            direction_band: None,
            raw_deviation: false,
            budget_on_goal: false,
            lead_limit: None,
        }
    }
}
