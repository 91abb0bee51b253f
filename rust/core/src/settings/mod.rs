//! Everything the user can ask of the controller, validated once.

mod validate;

use crate::MAX_AXES;
use crate::error::{Error, Result};
use crate::task::axes::{Axis, Task, parse_axes};

/// Control law.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Law {
    /// The paper's equations (3)–(12): torque budgets per task axis.
    Paper,
    /// Force caps per task axis; the default.
    #[default]
    Cap,
    /// A spring and a damper per task axis, with force caps.
    Impedance,
}

impl Law {
    /// Whether strengths are forces at the tool, which needs `k_p`.
    pub(crate) fn by_force(self) -> bool {
        self != Self::Paper
    }
}

/// Whether yielding axes stay in the inverse kinematics of the stiff ones.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Follow {
    /// Yielding axes leave the solve and exert exactly their force; the default of law `cap`.
    Free,
    /// All axes stay in one solve; the default of law `paper`.
    Hold,
}

/// Rule of the laws `cap` and `impedance` for the joint torque limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LimitRule {
    /// What the law wants at this tick, plus a margin.
    #[default]
    Demand,
    /// The sum over all axes of what each may ask for.
    Sum,
}

/// Null-space projector.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Projector {
    /// `I − Jᵀ(JJᵀ + μ²I)⁻¹J` with μ = 0 away from singular poses.
    #[default]
    Exact,
    /// `I − J⁺J` with the damped J⁺, as printed in (4).
    Paper,
}

/// Where the gravity model is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GravityUse {
    /// In goals and limits.
    #[default]
    Both,
    /// Only as offset of the goals.
    Goal,
    /// Only in the limits.
    Limits,
    /// Nowhere: the paper.
    Off,
}

impl GravityUse {
    pub(crate) fn in_goal(self) -> bool {
        matches!(self, Self::Both | Self::Goal)
    }

    pub(crate) fn in_limits(self) -> bool {
        matches!(self, Self::Both | Self::Limits)
    }
}

/// Damping λ of the inverse.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Damping {
    /// From the arm: σ₀ = 2 × its median over 512 poses, λ_max = σ₀, λ₀ = 0.13 σ₀; rounded to two digits.
    #[default]
    Auto,
    /// λ everywhere.
    Fixed(f64),
    /// λ² = λ₀² + (1 − (σ/σ₀)²) λ_max² where σ < σ₀.
    Adaptive {
        /// λ away from singular poses.
        lambda_0: f64,
        /// σ below which damping grows.
        sigma_0: f64,
        /// What is added (in squares) at σ = 0.
        lambda_max: f64,
    },
}

/// Gain K_x [1/s] or K_q: one number, one per axis or joint, or a matrix (row-major).
#[derive(Debug, Clone, PartialEq)]
pub enum Gain {
    /// The same everywhere.
    Scalar(f64),
    /// A diagonal matrix.
    Diagonal(Vec<f64>),
    /// A full matrix, one inner vector a row.
    Matrix(Vec<Vec<f64>>),
}

impl Gain {
    /// Spreads the gain to an `n × n` matrix in arrays of capacity `N`.
    pub(crate) fn spread<const N: usize>(&self, key: &str, n: usize) -> Result<[[f64; N]; N]> {
        let mut out = [[0.0; N]; N];
        let wrong =
            |got: String| Error::Shape { what: key.into(), got, expected: format!("a number, ({n},) or ({n}, {n})") };
        match self {
            Self::Scalar(k) => (0..n.min(N)).for_each(|i| out[i][i] = *k),
            Self::Diagonal(d) if d.len() == n => d.iter().enumerate().for_each(|(i, k)| out[i][i] = *k),
            Self::Diagonal(d) => return Err(wrong(format!("({},)", d.len()))),
            Self::Matrix(m) if m.len() == n && m.iter().all(|row| row.len() == n) => {
                for (to, from) in out.iter_mut().zip(m) {
                    to[..n].copy_from_slice(from);
                }
            }
            Self::Matrix(m) => return Err(wrong(format!("({}, {})", m.len(), m.first().map_or(0, Vec::len)))),
        }
        Ok(out)
    }

    /// Every entry.
    pub(crate) fn values(&self) -> Vec<f64> {
        match self {
            Self::Scalar(k) => vec![*k],
            Self::Diagonal(d) => d.clone(),
            Self::Matrix(m) => m.iter().flatten().copied().collect(),
        }
    }

    /// The largest entry, used as the default step of the null-space motion.
    pub(crate) fn largest(&self) -> f64 {
        self.values().into_iter().fold(0.0, f64::max)
    }
}

/// All settings of a controller. Make one with [`Settings::default`] or a preset and change fields.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// Controlled axes and their frame.
    pub task: Task,
    /// What is asked of x, y, z, roll, pitch, yaw.
    pub axes: [Axis; MAX_AXES],
    /// Control law.
    pub law: Law,
    /// Whether yielding axes stay in the solve; `None`: by law.
    pub follow: Option<Follow>,
    /// Rule for the limits (not law `paper`).
    pub limits: LimitRule,
    /// Null-space projector.
    pub projector: Projector,
    /// Gain K_x [1/s] of (5).
    pub kx: Gain,
    /// Horizon h [s] of the goal `q + h q̇`.
    pub horizon: f64,
    /// Gain K_q of (5), law `paper` only.
    pub kq: Gain,
    /// Step α of the null-space motion [1/s]; `None`: as K_x.
    pub alpha: Option<f64>,
    /// Nominal control rate [Hz]: the default `dt` of a step.
    pub rate: f64,
    /// Damping of the inverse.
    pub damping: Damping,
    /// Rest posture [rad], one per joint; `None`: q at reset.
    pub posture: Option<Vec<f64>>,
    /// Weight of each joint in the posture cost; `None`: 1.
    pub posture_weights: Option<Vec<f64>>,
    /// Weight of the joint-limit cost `½ Σ ((q − mid)/half-range)²`.
    pub limit_avoidance: f64,
    /// Weight of the manipulability cost `−ln √det(JJᵀ)`.
    pub manipulability: f64,
    /// Most the null-space motion may ask of all joints together [N·m], `Σ k_p |null| ≤ τ₀`, and its budget under law
    /// `paper`; `None`: 2 where the arm is redundant for the task.
    pub null_torque: Option<f64>,
    /// Law `impedance`: stiffness of the null-space motion [N·m/rad], in place of `alpha`; `None`: as `alpha` has it.
    pub null_stiffness: Option<f64>,
    /// Speed limit of the null-space motion [rad/s per joint]; ∞ for none.
    pub null_speed: f64,
    /// Where the gravity model is used.
    pub gravity: GravityUse,
    /// Factor s_g on gravity in the limits.
    pub gravity_scale: f64,
    /// Share b_f of the friction that is fed forward.
    pub friction_share: f64,
    /// Share b_d of the damping that is fed forward.
    pub damping_share: f64,
    /// Share b_p of the delay that is predicted over.
    pub prediction_share: f64,
    /// Speed v₀ [rad/s] at which the friction feed-forward saturates.
    pub friction_speed: f64,
    /// Time constant T_f [s] of the velocity filter.
    pub velocity_filter: f64,
    /// Delay T_d [s] from reading to arrival of the goal.
    pub delay: f64,
    /// Slew limit of the goals [rad/s]; ∞ for none.
    pub goal_slew: f64,
    /// Time [s] in which a limit may rise from zero to its ceiling; 0 for no limit.
    pub stiffening_time: f64,
    /// Speed of the target that the law sees [m/s, rad/s]; ∞ for none. A tool that friction let go late is faster for a while.
    pub max_tool_speed: [f64; 2],
    /// Acceleration of the tool's target [m/s², rad/s²].
    pub max_tool_acceleration: [f64; 2],
    /// Joint speed limit [rad/s] per joint; `None`: the model's.
    pub joint_speed: Option<Vec<f64>>,
    /// Floor of the torque limits [N·m] per joint; `None`: the servos' friction.
    pub floor: Option<Vec<f64>>,
    /// Margin m of the limits as a share of the usable torque (at least twice the friction).
    pub margin: f64,
    /// Most that a hand shall meet along the task's translations if the host dies [N]; `None`: whatever it is.
    pub max_host_loss_force: Option<f64>,
    /// Half-width of the band around zero in which an axis that yields to one side changes over, as a share of `soft_until`;
    /// `None`: 0.1, under law `paper` 0.
    pub direction_band: Option<f64>,
    /// Compliance from the raw instead of the adapted deviation.
    pub raw_deviation: bool,
    /// Law `paper`: clamp each axis' step to what its budget can do.
    pub budget_on_goal: bool,
    /// Law `paper`: weight of each joint in J⁺; `None`: 1.
    pub joint_weights: Option<Vec<f64>>,
    /// Law `paper`: how far a goal may lead [rad]; `None`: what the limit can use (0.3 rad where `k_p` is unknown).
    pub lead_limit: Option<f64>,
    /// Rate [1/s] at which the goal of stiff axes integrates; 0 for none.
    pub integrate: f64,
    /// Risks taken by name: `"eta"`, `"stiffness"`.
    pub accept: Vec<String>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            task: Task::default(),
            axes: [Axis::default(); MAX_AXES],
            law: Law::Cap,
            follow: None,
            limits: LimitRule::Demand,
            projector: Projector::Exact,
            kx: Gain::Scalar(4.0),
            horizon: 0.25,
            kq: Gain::Scalar(1.0),
            alpha: None,
            rate: 100.0,
            damping: Damping::Auto,
            posture: None,
            posture_weights: None,
            limit_avoidance: 0.0,
            manipulability: 0.0,
            null_torque: None,
            null_stiffness: None,
            null_speed: f64::INFINITY,
            gravity: GravityUse::Both,
            gravity_scale: 1.1,
            friction_share: 0.9,
            damping_share: 0.8,
            prediction_share: 0.9,
            friction_speed: 0.05,
            velocity_filter: 0.02,
            delay: 0.0,
            goal_slew: 1.0,
            stiffening_time: 0.2,
            max_tool_speed: [0.25, 1.0],
            max_tool_acceleration: [1.0, 4.0],
            joint_speed: None,
            floor: None,
            margin: 0.1,
            max_host_loss_force: None,
            direction_band: None,
            raw_deviation: false,
            budget_on_goal: false,
            joint_weights: None,
            lead_limit: None,
            integrate: 0.0,
            accept: Vec::new(),
        }
    }
}

impl Settings {
    /// Sets the axes that `key` names (see [`parse_axes`]).
    ///
    /// # Errors
    /// [`Error::Config`] for a key that is not understood.
    pub fn set_axes(&mut self, key: &str, axis: Axis) -> Result<()> {
        for (slot, on) in self.axes.iter_mut().zip(parse_axes("axes", key)?) {
            if on {
                *slot = axis;
            }
        }
        Ok(())
    }

    /// The follow mode in force.
    pub fn effective_follow(&self) -> Follow {
        self.follow.unwrap_or(match self.law {
            Law::Cap | Law::Impedance => Follow::Free,
            Law::Paper => Follow::Hold,
        })
    }
}
