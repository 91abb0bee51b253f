//! Groups of related settings.

use super::settings::{Damping, Follow, Gain, GravityUse, LimitRule, Projector};

/// Tracking of the target by the stiff axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracking {
    /// Gain K_x [1/s] of (5): a scalar, or one value per axis of the task.
    pub gain: Gain,
    /// Damping of the inverse.
    pub damping: Damping,
    /// Time constant T_f [s] of the velocity filter.
    pub velocity_filter: f64,
    /// Slew limit of the goals [rad/s]; ∞ for no limit.
    pub goal_slew: f64,
    /// Joint speed limit [rad/s] per joint; `None` for the model's.
    pub joint_speed: Option<Vec<f64>>,
    /// Rate [1/s] at which the goal of stiff axes integrates; 0 for no integration.
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

/// Null-space motion: motion of the joints that leaves the task unchanged.
#[derive(Debug, Clone, PartialEq)]
pub struct NullSpace {
    /// Rest posture [rad], one value per joint; `None` for q at reset.
    pub posture: Option<Vec<f64>>,
    /// Gain α of the null-space motion [1/s]; `None` for the tracking gain.
    pub gain: Option<f64>,
    /// Largest total torque of the null-space motion over all joints [N·m], `Σ k_p |null| ≤ τ₀`, and its budget under
    /// law `paper`; `None`: 2 if the arm is redundant for the task.
    pub max_torque: Option<f64>,
    /// Law `impedance`: stiffness of the null-space motion [N·m/rad], instead of `gain`; `None` to use `gain`.
    pub stiffness: Option<f64>,
    /// Speed limit of the null-space motion [rad/s per joint]; ∞ for no limit.
    pub max_speed: f64,
    /// Weight of the joint-limit cost `½ Σ ((q − mid)/half-range)²`.
    pub limit_avoidance: f64,
    /// Null-space projector.
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

/// Compensation of known servo properties by feed-forward and prediction.
#[derive(Debug, Clone, PartialEq)]
pub struct Compensation {
    /// Share b_f of the friction in the feed-forward.
    pub friction: f64,
    /// Share b_d of the damping in the feed-forward.
    pub damping: f64,
    /// Share b_p of the delay in the prediction.
    pub delay: f64,
}

impl Default for Compensation {
    fn default() -> Self {
        Self { friction: 0.9, damping: 0.8, delay: 0.9 }
    }
}

/// Joint torque limits sent to the servos.
#[derive(Debug, Clone, PartialEq)]
pub struct TorqueLimits {
    /// Margin m of the limits as a share of the usable torque (at least twice the friction).
    pub margin: f64,
    /// Minimum of the torque limits [N·m] per joint; `None` for the servos' friction.
    pub floor: Option<Vec<f64>>,
    /// Time [s] in which a limit may rise from zero to its ceiling; 0 for no bound.
    pub stiffening_time: f64,
    /// Largest force on a hand along the task's translations if the host dies [N]; `None` for no bound.
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
    /// Coupling of yielding axes in the solve; `None`: by law.
    pub follow: Option<Follow>,
    /// Rule for the limits (not law `paper`).
    pub limits: LimitRule,
    /// Horizon h [s] of the goal `q + h q̇`.
    pub horizon: f64,
    /// Gain K_q of (5), law `paper` only.
    pub kq: Gain,
    /// Law `paper`: weight of each joint in J⁺; `None` for 1.
    pub joint_weights: Option<Vec<f64>>,
    /// Weight of each joint in the posture cost; `None` for 1.
    pub posture_weights: Option<Vec<f64>>,
    /// Weight of the manipulability cost `−ln √det(JJᵀ)`.
    pub manipulability: f64,
    /// Places in which the gravity model is used, if enabled.
    pub gravity_use: GravityUse,
    /// Factor s_g on gravity in the limits.
    pub gravity_scale: f64,
    /// Speed v₀ [rad/s] at which the friction feed-forward saturates.
    pub friction_speed: f64,
    /// Half-width of the band around zero in which an axis that yields to one side switches sides, as a share of
    /// `soft_until`; `None`: 0.1, under law `paper` 0.
    pub direction_band: Option<f64>,
    /// Computes the compliance from the raw instead of the adapted deviation.
    pub raw_deviation: bool,
    /// Law `paper`: clamps each axis' step to its budget.
    pub budget_on_goal: bool,
    /// Law `paper`: largest lead of a goal [rad]; `None`: the lead that the limit can use (0.3 rad if `k_p` is
    /// unknown).
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
