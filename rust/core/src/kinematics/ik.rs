//! Inverse kinematics: pose → joint positions; not used by the control step.
//!
//! Damped least squares, `dq = Jᵀ (J Jᵀ + μ I)⁻¹ e` with `μ = ½|e|² + ε`: far from the target the damping bounds the
//! steps at singular poses, near it the method approaches Newton's (Sugihara, T-RO 2011). If a joint at
//! its limit would move outward, the step is solved again without this joint. A search that stalls restarts from fixed
//! seeds.

use std::fmt;

use nalgebra::{Matrix6, Rotation3, UnitQuaternion, Vector6};

use super::forward::JointFrames;
use crate::error::{Error, Result};
use crate::math::halton;
use crate::model::Model;
use crate::pose::Pose;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Options of [`Model::inverse_kinematics`].
#[derive(Debug, Clone, PartialEq)]
pub struct IkOptions {
    /// Axes of the base (x, y, z, then rotations about them) along which the tool must match the target; the others are
    /// free.
    pub axes: [bool; 6],
    /// Position error [m] up to which a result counts as converged.
    pub position_tolerance: f64,
    /// Rotation error [rad] up to which a result counts as converged.
    pub rotation_tolerance: f64,
    /// Maximum number of iterations per start.
    pub max_iterations: usize,
    /// Number of restarts after `q0`, each from a fixed seed inside the limits.
    pub restarts: usize,
}

impl Default for IkOptions {
    fn default() -> Self {
        Self { axes: [true; 6], position_tolerance: 1e-8, rotation_tolerance: 1e-8, max_iterations: 100, restarts: 8 }
    }
}

/// Reason why a search ended.
#[derive(Debug, Clone, PartialEq)]
pub enum IkStatus {
    /// Position and rotation error are within their tolerances.
    Converged,
    /// Not converged: the target is farther from the first joint than the arm reaches.
    OutOfReach {
        /// Distance from the first joint's origin to the target [m].
        distance: f64,
        /// Largest distance that the arm reaches, [`Model::reach`] [m].
        reach: f64,
    },
    /// Not converged: the closest result has joints at their limits.
    JointLimit {
        /// Names of the joints at their limits.
        joints: Vec<String>,
    },
    /// Not converged for another reason: a local minimum, or the iterations ran out.
    Stalled,
}

impl fmt::Display for IkStatus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Converged => f.write_str("converged"),
            Self::OutOfReach { distance, reach } => {
                write!(f, "out of reach: {distance:.3} m from the first joint, the arm reaches {reach:.3} m")
            }
            Self::JointLimit { joints } => write!(f, "joint limits in the way: {}", joints.join(", ")),
            Self::Stalled => f.write_str("stalled: no closer pose found from any start"),
        }
    }
}

/// Closest joint positions that the search found, and their errors.
#[derive(Debug, Clone, PartialEq)]
pub struct IkResult {
    /// Position of each joint [rad or m], inside the limits.
    pub q: Vec<f64>,
    /// True if position and rotation error are within their tolerances.
    pub converged: bool,
    /// Total number of iterations, over all starts.
    pub iterations: usize,
    /// Distance to the target along the selected axes [m].
    pub position_error: f64,
    /// Rotation angle to the target about the selected axes [rad].
    pub rotation_error: f64,
    /// Reason why the search ended.
    pub reason: IkStatus,
}

impl Model {
    /// Searches for joint positions that bring the tool to `target`, starting from the positions `q0` [rad or m].
    ///
    /// The result lies inside the position limits; `q0` is clamped to them first. Continuous joints are not wrapped.
    /// Deterministic. A search that does not converge is not an error: see `converged` and `reason`.
    ///
    /// # Errors
    /// [`Error::Shape`] and [`Error::OutOfRange`] for `q0`; as [`Pose::validate`] for `target`; [`Error::Config`] for
    /// invalid options.
    ///
    /// ```
    /// # use pliant_core::{IkOptions, Model, ModelOptions};
    /// # fn main() -> pliant_core::Result<()> {
    /// # let options = ModelOptions { tip: Some("tool".into()), ..ModelOptions::default() };
    /// # let model = std::sync::Arc::new(Model::from_urdf_str(include_str!("../../robots/arm7.urdf"), &options)?);
    /// let q0 = [-0.13, -0.60, 0.72, -1.74, 0.93, 0.68, -0.17]; // [rad]
    /// let mut target = model.forward_kinematics(&q0)?;
    /// target.position[1] += 0.05; // [m]
    /// let found = model.inverse_kinematics(&target, &q0, &IkOptions::default())?;
    /// assert!(found.converged, "{}", found.reason);
    /// # Ok(())
    /// # }
    /// ```
    pub fn inverse_kinematics(&self, target: &Pose, q0: &[f64], options: &IkOptions) -> Result<IkResult> {
        let q0 = self.joint_vector(q0)?;
        target.validate()?;
        options.validate()?;
        let search = IkSolver { model: self, target, options, target_rotation: quaternion(target) };
        let mut best = search.solve_from(search.clamp_to_limits(&q0));
        let mut iterations = best.iterations;
        for restart in 1..=options.restarts {
            if best.converged(options) {
                break;
            }
            let found = search.solve_from(search.restart_seed(restart));
            iterations += found.iterations;
            if found.error.norm_squared() < best.error.norm_squared() {
                best = found;
            }
        }
        let converged = best.converged(options);
        let reason = if converged { IkStatus::Converged } else { search.failure_reason(&best) };
        Ok(IkResult {
            q: best.q[..self.n().min(MAX_JOINTS)].to_vec(),
            converged,
            iterations,
            position_error: best.position_error(),
            rotation_error: best.rotation_error(),
            reason,
        })
    }
}

impl IkOptions {
    fn validate(&self) -> Result<()> {
        for (key, value) in
            [("position_tolerance", self.position_tolerance), ("rotation_tolerance", self.rotation_tolerance)]
        {
            if !(value >= 1e-12 && value.is_finite()) {
                return Err(Error::config(
                    key,
                    format!("is {value}; must be finite and at least 1e-12, which rounding allows"),
                ));
            }
        }
        if self.max_iterations == 0 {
            return Err(Error::config("max_iterations", "is 0; must be at least 1"));
        }
        if self.axes == [false; 6] {
            return Err(Error::config("axes", "none is selected; set at least one"));
        }
        Ok(())
    }
}

struct IkSolver<'a> {
    model: &'a Model,
    target: &'a Pose,
    target_rotation: UnitQuaternion<f64>,
    options: &'a IkOptions,
}

/// Closest result of the search from one start.
struct IkIterate {
    q: JointVec,
    /// Deviation from the target on the selected axes [m, rad]; 0 on the others.
    error: Vector6<f64>,
    iterations: usize,
}

impl IkIterate {
    fn position_error(&self) -> f64 {
        self.error.fixed_rows::<3>(0).norm()
    }

    fn rotation_error(&self) -> f64 {
        self.error.fixed_rows::<3>(3).norm()
    }

    fn converged(&self, options: &IkOptions) -> bool {
        self.position_error() <= options.position_tolerance && self.rotation_error() <= options.rotation_tolerance
    }
}

/// Largest step of one joint in one iteration [rad or m], since the linear model holds for small steps only.
const LARGEST_STEP: f64 = 0.5;

/// Number of iterations without a 10 % reduction of the error after which the search from one start stops.
const PATIENCE: usize = 20;

impl IkSolver<'_> {
    fn solve_from(&self, start: JointVec) -> IkIterate {
        let chain = self.model.chain();
        let (mut frames, mut rows) = (JointFrames::default(), [[0.0; MAX_JOINTS]; MAX_AXES]);
        let mut q = start;
        chain.forward(&q, &mut frames);
        let mut found = IkIterate { q, error: self.error(&frames.tool), iterations: 0 };
        let (mut milestone, mut since) = (found.error.norm(), 0);
        while found.iterations < self.options.max_iterations && !found.converged(self.options) && since < PATIENCE {
            chain.jacobian(&frames, &mut rows);
            let error = self.error(&frames.tool);
            let Some(step) = self.step(&q, &rows, &error) else { break };
            for (x, dx) in q.iter_mut().zip(&step) {
                *x += dx;
            }
            q = self.clamp_to_limits(&q);
            chain.forward(&q, &mut frames);
            found.iterations += 1;
            let error = self.error(&frames.tool);
            if error.norm_squared() < found.error.norm_squared() {
                (found.q, found.error) = (q, error);
            }
            if found.error.norm() < 0.9 * milestone {
                (milestone, since) = (found.error.norm(), 0);
            } else {
                since += 1;
            }
        }
        found
    }

    /// Returns the deviation from the target on the selected axes [m, rad]; 0 on the others.
    fn error(&self, tool: &Pose) -> Vector6<f64> {
        let rotation = (self.target_rotation * quaternion(tool).inverse()).scaled_axis();
        let (p, d) = (&tool.position, &self.target.position);
        let error = Vector6::new(d[0] - p[0], d[1] - p[1], d[2] - p[2], rotation[0], rotation[1], rotation[2]);
        Vector6::from_fn(|i, _| if self.options.axes[i] { error[i] } else { 0.0 })
    }

    /// Returns one damped step; a joint at a limit does not move outward. `None` if no joint can move.
    fn step(&self, q: &JointVec, rows: &Rows, error: &Vector6<f64>) -> Option<JointVec> {
        let n = self.model.n().min(MAX_JOINTS);
        let mut free = [true; MAX_JOINTS];
        let damping = 0.5 * error.norm_squared() + 1e-14;
        let solve = |free: &[bool; MAX_JOINTS]| {
            let column =
                |k: usize| Vector6::from_fn(|i, _| if self.options.axes[i] && free[k] { rows[i][k] } else { 0.0 });
            let mut square = Matrix6::identity() * damping;
            for k in 0..n {
                square += column(k) * column(k).transpose();
            }
            let wrench = square.cholesky()?.solve(error);
            let mut step = [0.0; MAX_JOINTS];
            for (k, dq) in step.iter_mut().enumerate().take(n) {
                *dq = column(k).dot(&wrench);
            }
            Some(step)
        };
        for _ in 0..=n {
            let step = solve(&free)?;
            let outward = |k: usize| {
                (step[k] > 0.0 && q[k] >= self.model.upper()[k]) || (step[k] < 0.0 && q[k] <= self.model.lower()[k])
            };
            let blocked: Vec<usize> = (0..n).filter(|&k| outward(k)).collect();
            if blocked.is_empty() {
                let largest = step.iter().fold(0.0_f64, |a, b| a.max(b.abs()));
                if largest < 1e-14 {
                    return None;
                }
                let scale = (LARGEST_STEP / largest).min(1.0);
                return Some(step.map(|dq| dq * scale));
            }
            for k in blocked {
                free[k] = false;
            }
        }
        None
    }

    fn clamp_to_limits(&self, q: &JointVec) -> JointVec {
        let mut q = *q;
        for ((x, lower), upper) in q.iter_mut().zip(self.model.lower()).zip(self.model.upper()) {
            *x = x.max(*lower).min(*upper);
        }
        q
    }

    /// Returns the `index`-th Halton point of the joint ranges; for continuous joints within ±π.
    fn restart_seed(&self, index: usize) -> JointVec {
        halton::joints(self.model.lower(), self.model.upper(), u32::try_from(index).unwrap_or(u32::MAX))
    }

    fn failure_reason(&self, found: &IkIterate) -> IkStatus {
        let mut frames = JointFrames::default();
        self.model.chain().forward(&found.q, &mut frames);
        let distance = nalgebra::Vector3::from(crate::math::spatial::sub::<crate::math::simd::BaselineF64>(
            &self.target.position,
            &frames.origin[0],
        ))
        .norm();
        let reach = self.model.reach();
        if self.options.axes[..3] == [true; 3] && distance > reach {
            return IkStatus::OutOfReach { distance, reach };
        }
        let near = |x: f64, limit: f64| (x - limit).abs() <= 1e-9;
        let at_limit =
            |k: &usize| near(found.q[*k], self.model.lower()[*k]) || near(found.q[*k], self.model.upper()[*k]);
        let names = self.model.joint_names();
        let joints: Vec<String> = (0..self.model.n()).filter(at_limit).map(|k| names[k].clone()).collect();
        if joints.is_empty() { IkStatus::Stalled } else { IkStatus::JointLimit { joints } }
    }
}

fn quaternion(pose: &Pose) -> UnitQuaternion<f64> {
    let r = &pose.rotation;
    let matrix = nalgebra::Matrix3::from_fn(|i, j| r[i][j]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(matrix))
}
