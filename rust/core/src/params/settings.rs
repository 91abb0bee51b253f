//! Settings of the controller and of its control law.

use crate::MAX_AXES;
use crate::error::{Error, Result};
use crate::params::{Axis, Compensation, NullSpace, PaperOptions, Task, TorqueLimits, Tracking, parse_axes};

/// Control law.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Law {
    /// Equations (3) to (12) of the paper: a torque budget per task axis.
    Paper,
    /// A force cap per task axis; the default.
    #[default]
    Cap,
    /// A spring and a damper per task axis, with a force cap.
    Impedance,
}

/// Properties of a law that code outside the law depends on.
struct LawProperties {
    /// True if strengths are forces at the tool, which require a known `k_p`; false if they are torque budgets.
    by_force: bool,
    /// True if the law uses the springs and dampers of the axes.
    has_springs: bool,
    /// True if the delay bounds the gain K_x.
    bounds_gain: bool,
    /// Default of [`PaperOptions::follow`].
    follow: Follow,
}

impl Law {
    const fn properties(self) -> LawProperties {
        match self {
            Self::Paper => {
                LawProperties { by_force: false, has_springs: false, bounds_gain: false, follow: Follow::Hold }
            }
            Self::Cap => LawProperties { by_force: true, has_springs: false, bounds_gain: true, follow: Follow::Free },
            Self::Impedance => {
                LawProperties { by_force: true, has_springs: true, bounds_gain: false, follow: Follow::Free }
            }
        }
    }

    /// Returns true if strengths are forces at the tool, which require a known `k_p`.
    pub(crate) const fn by_force(self) -> bool {
        self.properties().by_force
    }

    /// Returns true if the law uses the springs and dampers of the axes.
    pub(crate) const fn has_springs(self) -> bool {
        self.properties().has_springs
    }

    /// Returns true if the delay bounds the gain K_x.
    pub(crate) const fn bounds_gain(self) -> bool {
        self.properties().bounds_gain
    }
}

/// Role of the yielding axes in the inverse kinematics.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Follow {
    /// The inverse kinematics leave out yielding axes, which exert exactly their force; the default of the laws `cap`
    /// and `impedance`.
    Free,
    /// The inverse kinematics contain all axes; the steps of yielding axes are clamped. The default of law `paper`.
    Hold,
}

/// Rule of the laws `cap` and `impedance` for the joint torque limits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum LimitRule {
    /// The torque that the law demands in this step, plus a margin.
    #[default]
    Demand,
    /// The sum of the largest torques that the axes can demand.
    Sum,
}

/// Choice of the projector into the null space of the task.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Projector {
    /// `I − Jᵀ(JJᵀ + μ²I)⁻¹J`, where μ is 0 except near singular poses.
    #[default]
    Exact,
    /// `I − J⁺J` with the damped pseudo-inverse J⁺: equation (4) of the paper.
    Paper,
}

/// Places in which the gravity model is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GravityUse {
    /// As offset of the goals and in the torque limits.
    #[default]
    Both,
    /// Only as offset of the goals.
    Goal,
    /// Only in the torque limits.
    Limits,
    /// Gravity is not compensated, as in the paper.
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

/// Damping λ of the inverse kinematics.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Damping {
    /// Derived from the arm: σ₀ is twice the median of the smallest singular value over 512 configurations, λ_max = σ₀,
    /// λ₀ = 0.13 σ₀, rounded to two digits.
    #[default]
    Auto,
    /// A constant damping λ.
    Fixed(f64),
    /// λ² = λ₀² + (1 − (σ/σ₀)²) λ_max² for a smallest singular value σ < σ₀, else λ₀².
    Adaptive {
        /// Damping λ away from singular poses.
        lambda_0: f64,
        /// Smallest singular value σ below which the damping increases.
        sigma_0: f64,
        /// Square root of the increase of λ² at σ = 0.
        lambda_max: f64,
    },
}

/// Gain K_x [1/s] or K_q: a scalar, one value per axis or joint, or a matrix (row-major).
#[derive(Debug, Clone, PartialEq)]
pub enum Gain {
    /// One value for all axes or joints.
    Scalar(f64),
    /// The diagonal of a matrix: one value per axis or joint.
    Diagonal(Vec<f64>),
    /// A full matrix, one inner vector per row.
    Matrix(Vec<Vec<f64>>),
}

impl Gain {
    /// Expands the gain to an `n × n` matrix in arrays of capacity `N`.
    pub(crate) fn expand<const N: usize>(&self, key: &str, n: usize) -> Result<[[f64; N]; N]> {
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

    /// Returns all values that the user has set.
    pub(crate) fn values(&self) -> Vec<f64> {
        match self {
            Self::Scalar(k) => vec![*k],
            Self::Diagonal(d) => d.clone(),
            Self::Matrix(m) => m.iter().flatten().copied().collect(),
        }
    }

    /// Returns the largest entry, at least 0: the default gain of the null-space motion.
    pub(crate) fn max_entry(&self) -> f64 {
        self.values().into_iter().fold(0.0, f64::max)
    }
}

/// All settings of a controller. Create them with [`Settings::default`] or a preset and change fields.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
    /// The controlled axes and their frame.
    pub task: Task,
    /// Settings of the axes x, y, z, roll, pitch, yaw.
    pub axes: [Axis; MAX_AXES],
    /// Control law.
    pub law: Law,
    /// Nominal control rate [Hz]; its period is the default `dt` of a step.
    pub rate: f64,
    /// Delay T_d [s] from the reading of the positions to the arrival of the goal.
    pub delay: f64,
    /// True to use the gravity model in goals and torque limits.
    pub gravity: bool,
    /// Linear and angular speed limits [m/s, rad/s] of the reference that the law tracks; ∞ for no limit. The tool may
    /// be faster for a short time after friction has held it back, and along soft axes near a singular pose: from 0.08
    /// m/s (0.3 rad/s) above the limit on, laws `cap` and `impedance` reduce the forces that accelerate it.
    pub max_tool_speed: [f64; 2],
    /// Linear and angular acceleration limits [m/s², rad/s²] of the reference that the law tracks.
    pub max_tool_acceleration: [f64; 2],
    /// True to accept an adaptation η above 0.95 although the stiffness `k_p` is not known.
    pub accept_high_adaptation: bool,
    /// Law `impedance`: true to accept stiffness and damping above the bounds that follow from rate and delay.
    pub accept_high_stiffness: bool,
    /// Settings of how the stiff axes track their target.
    pub tracking: Tracking,
    /// Settings of the motion of the joints that leaves the task unchanged.
    pub null_space: NullSpace,
    /// Shares of friction, damping and delay that are compensated.
    pub compensation: Compensation,
    /// Settings of the joint torque limits sent to the servos.
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
    /// Assigns `axis` to every axis that `key` names (see [`parse_axes`]).
    ///
    /// # Errors
    /// [`Error::Config`] for an invalid key.
    pub fn set_axes(&mut self, key: &str, axis: Axis) -> Result<()> {
        for (slot, on) in self.axes.iter_mut().zip(parse_axes("axes", key)?) {
            if on {
                *slot = axis;
            }
        }
        Ok(())
    }

    /// Returns `paper_options.follow`, or the law's default if it is not set.
    pub fn effective_follow(&self) -> Follow {
        self.paper_options.follow.unwrap_or(self.law.properties().follow)
    }

    /// Returns the places in which the gravity model is used; [`GravityUse::Off`] if `gravity` is false.
    pub fn gravity_use(&self) -> GravityUse {
        if self.gravity { self.paper_options.gravity_use } else { GravityUse::Off }
    }
}
