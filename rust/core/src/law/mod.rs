//! From deviation to motion and force: lines 7–10 of the control step, one file per law.

pub mod activation;
pub(crate) mod cap;
pub(crate) mod feedforward;
pub(crate) mod impedance;
pub(crate) mod inverse;
pub(crate) mod nullspace;
pub(crate) mod paper;
pub(crate) mod singular;
pub(crate) mod svd;
pub(crate) mod takeover;
pub(crate) mod wrench;

use crate::law::feedforward::Resistance;
use crate::law::nullspace::{NullSpace, manipulability_gradient};
use crate::law::singular::Condition;
use crate::law::wrench::Wrench;
use crate::plan::Plan;
use crate::settings::{Law, Projector};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// What every law is given: one tick, rows of the task's axes, at the predicted positions.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tick<'a> {
    pub(crate) plan: &'a Plan,
    /// Rows and columns that are worked through: constants where this is compiled, so at least the task's axes and the
    /// arm's joints. What is beyond those is zero and stays zero.
    pub(crate) k: usize,
    pub(crate) n: usize,
    pub(crate) horizon: f64,
    /// Task rows.
    pub(crate) rows: &'a Rows,
    /// The same with translations divided by the arm's length.
    pub(crate) scaled_rows: &'a Rows,
    pub(crate) condition: &'a Condition,
    /// λ² of each row.
    pub(crate) damping: &'a AxisVec,
    /// Softness w of each row.
    pub(crate) softness: &'a AxisVec,
    /// Strength F of each row where it yields.
    pub(crate) strength: &'a AxisVec,
    /// Strength in force, w F + (1 − w) hold.
    pub(crate) most: &'a AxisVec,
    /// h (K_x ẽ + twist), within the limits of soft axes.
    pub(crate) step: &'a AxisVec,
    /// The same within all per-axis limits.
    pub(crate) bounded_step: &'a AxisVec,
    /// ẽ of each row.
    pub(crate) adapted: &'a AxisVec,
    /// Stiffness K of each row [N/m, N·m/rad] (law `impedance`).
    pub(crate) stiffness: &'a AxisVec,
    /// Its damping D [N·s/m, N·m·s/rad].
    pub(crate) viscosity: &'a AxisVec,
    /// Velocity of the target along each row.
    pub(crate) twist: &'a AxisVec,
    /// Filtered joint velocity.
    pub(crate) velocity: &'a JointVec,
    /// Gradient of the null-space cost.
    pub(crate) gradient: &'a JointVec,
    /// Gravity in the goals.
    pub(crate) gravity: &'a JointVec,
    pub(crate) resistance: &'a Resistance,
    /// Lead that the integrating goal has stored [rad].
    pub(crate) integral: &'a JointVec,
}

/// What a law hands to the command floor.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion {
    /// Lead of the goals that is to move the arm: that of stiff axes, under law `paper` of all [rad].
    pub(crate) lead: JointVec,
    /// Lead of the goals that is to exert a force, whether the arm moves or not: that of soft axes [rad].
    pub(crate) force_lead: JointVec,
    /// Null-space part of the goals [rad].
    pub(crate) null: JointVec,
    /// Wrench of the laws that speak of forces [N, N·m].
    pub(crate) wrench: Wrench,
    /// Factors by which null-space, soft and stiff part were scaled.
    pub(crate) factors: [f64; 3],
    /// Feed-forward of what the joints resist with [N·m].
    pub(crate) feed_forward: JointVec,
    /// Factor ≤ 1 on the gain of the stiff axes that delay and pose demand.
    pub(crate) gain_factor: f64,
}

/// Runs the law; the joint budgets τ^q of (11) come along where the law makes its limits from them.
#[inline(always)]
pub(crate) fn motion(tick: &Tick<'_>) -> (Motion, Option<JointVec>) {
    match tick.plan.law {
        Law::Cap => (cap::motion(tick), None),
        Law::Impedance => (impedance::motion(tick), None),
        Law::Paper => {
            let (motion, budget) = paper::motion(tick);
            (motion, Some(budget))
        }
    }
}

impl Tick<'_> {
    /// The null-space projector that the settings ask for.
    #[inline(always)]
    pub(crate) fn null_space(&self) -> NullSpace<'_> {
        let (plan, k, n) = (self.plan, self.k, self.n);
        let space = match plan.projector {
            Projector::Paper => NullSpace::new(self.rows, &plan.joint_weight, self.damping, k, n),
            Projector::Exact => match &self.condition.factor {
                // With joints that count alike and μ = 0 it is the matrix whose singular values were followed.
                Some(factor) if plan.law.by_force() && self.condition.mu_squared <= 0.0 => {
                    NullSpace::of(self.scaled_rows, &plan.joint_weight, factor, k, n)
                }
                _ => self.faded_null_space(),
            },
        };
        space.padded(plan.k, plan.n)
    }

    /// The exact projector where it cannot share a factor.
    #[inline(never)]
    fn faded_null_space(&self) -> NullSpace<'_> {
        let mut added = [0.0; MAX_AXES];
        added[..self.plan.k].fill(self.condition.mu_squared);
        NullSpace::new(self.scaled_rows, &self.plan.joint_weight, &added, self.k, self.n)
    }

    /// Line 9: `−α h N ∇cost` [rad], before any scaling.
    #[inline(always)]
    pub(crate) fn null_motion(&self) -> JointVec {
        let step = self.plan.alpha * self.horizon;
        if step == 0.0 {
            return [0.0; MAX_JOINTS];
        }
        let mut out = self.null_space().project(self.gradient);
        for i in 0..self.n.min(MAX_JOINTS) {
            out[i] *= -step;
        }
        out
    }
}

/// Gradient of the manipulability cost at the present rows, times its weight.
///
/// `world` is the 6 × n Jacobian in base axes; `p` its weights there, see [`manipulability_gradient`].
#[inline(never)]
pub(crate) fn weighted_manipulability(
    plan: &Plan,
    world: &Rows,
    scaled_rows: &Rows,
    base_from_task: &[[f64; 3]; 3],
    mu_squared: f64,
) -> JointVec {
    let ones = [1.0; MAX_JOINTS];
    let pinv = NullSpace::new(scaled_rows, &ones, &[mu_squared; MAX_AXES], plan.k, plan.n).pseudo_inverse();
    let mut p = [[0.0; MAX_JOINTS]; MAX_AXES];
    for (r, &axis) in plan.axes.iter().enumerate().take(MAX_AXES) {
        let (block, column) = if axis < 3 { (0, axis) } else { (3, axis - 3) };
        for (i, factors) in base_from_task.iter().enumerate() {
            let factor = factors[column % 3] * plan.row_scale[r];
            for j in 0..MAX_JOINTS {
                p[block + i][j] += factor * pinv[r][j];
            }
        }
    }
    let turning = matches!(plan.frame, crate::task::axes::Frame::Tool);
    manipulability_gradient(world, &p, turning, plan.n).map(|g| plan.cost.manipulability * g)
}
