//! Everything the user can ask of the controller, validated once.

mod groups;
mod validate;

pub use groups::{Compensation, NullSpace, PaperOptions, TorqueLimits, Tracking};

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
    /// Nominal control rate [Hz]: the default `dt` of a step.
    pub rate: f64,
    /// Delay T_d [s] from reading to arrival of the goal.
    pub delay: f64,
    /// Whether the gravity model is used in goals and limits.
    pub gravity: bool,
    /// Speed of the target that the law sees [m/s, rad/s]; ∞ for none. A tool that friction let go late is faster for a while.
    pub max_tool_speed: [f64; 2],
    /// Acceleration of the tool's target [m/s², rad/s²].
    pub max_tool_acceleration: [f64; 2],
    /// Accept an adaptation η above what a known stiffness allows.
    pub accept_high_adaptation: bool,
    /// Law `impedance`: accept springs and dampers above what rate and delay allow.
    pub accept_high_stiffness: bool,
    /// How the stiff axes follow the target.
    pub tracking: Tracking,
    /// Motion of the joints that the task leaves free.
    pub null_space: NullSpace,
    /// Shares of friction, damping and delay that are fed forward.
    pub compensation: Compensation,
    /// Joint torque limits that go to the servos.
    pub torque_limits: TorqueLimits,
    /// Options for studies of the law.
    #[doc(hidden)]
    pub paper_options: PaperOptions,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            task: Task::default(),
            axes: [Axis::default(); MAX_AXES],
            law: Law::Cap,
            rate: 100.0,
            delay: 0.0,
            gravity: true,
            max_tool_speed: [0.25, 1.0],
            max_tool_acceleration: [1.0, 4.0],
            accept_high_adaptation: false,
            accept_high_stiffness: false,
            tracking: Tracking::default(),
            null_space: NullSpace::default(),
            compensation: Compensation::default(),
            torque_limits: TorqueLimits::default(),
            paper_options: PaperOptions::default(),
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
        self.paper_options.follow.unwrap_or(match self.law {
            Law::Cap | Law::Impedance => Follow::Free,
            Law::Paper => Follow::Hold,
        })
    }

    /// Where the gravity model is used.
    pub fn gravity_use(&self) -> GravityUse {
        if self.gravity { self.paper_options.gravity_use } else { GravityUse::Off }
    }
}
