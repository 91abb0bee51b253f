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

use crate::law::activation::Activation;
use crate::law::nullspace::{NullSpace, fade_squared, manipulability_gradient};
use crate::law::singular::SingularValues;
use crate::law::wrench::Wrench;
use crate::plan::Plan;
use crate::settings::{Law, Projector};
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// What every law is given: one tick, rows of the task's axes, at the predicted positions.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tick<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) horizon: f64,
    /// Task rows.
    pub(crate) rows: &'a Rows,
    /// The same with translations divided by the arm's length.
    pub(crate) scaled_rows: &'a Rows,
    pub(crate) singular: &'a SingularValues,
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
    pub(crate) feed_forward: &'a JointVec,
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
    /// Factor ≤ 1 on the gain of the stiff axes that delay and pose demand.
    pub(crate) gain_factor: f64,
}

/// Runs the law; the activation matrix comes along where the law makes its limits from it.
#[inline]
pub(crate) fn motion(tick: &Tick<'_>) -> (Motion, Option<Activation>) {
    match tick.plan.law {
        Law::Cap => (cap::motion(tick), None),
        Law::Impedance => (impedance::motion(tick), None),
        Law::Paper => {
            let (motion, shares) = paper::motion(tick);
            (motion, Some(shares))
        }
    }
}

impl Tick<'_> {
    /// The null-space projector that the settings ask for.
    #[inline]
    pub(crate) fn null_space(&self) -> NullSpace<'_> {
        let plan = self.plan;
        match plan.projector {
            Projector::Paper => NullSpace::new(self.rows, &plan.joint_weight, self.damping, plan.k, plan.n),
            Projector::Exact => {
                let mu_squared = fade_squared(self.singular.smallest, self.singular.largest);
                NullSpace::new(self.scaled_rows, &plan.joint_weight, &[mu_squared; MAX_AXES], plan.k, plan.n)
            }
        }
    }

    /// Line 9: `−α h N ∇cost` [rad], before any scaling.
    #[inline]
    pub(crate) fn null_motion(&self) -> JointVec {
        let step = self.plan.alpha * self.horizon;
        if step == 0.0 {
            return [0.0; MAX_JOINTS];
        }
        self.null_space().project(&self.gradient.map(|g| -step * g))
    }
}

/// Gradient of the manipulability cost at the present rows, times its weight.
///
/// `world` is the 6 × n Jacobian in base axes; `p` its weights there, see [`manipulability_gradient`].
pub(crate) fn weighted_manipulability(
    plan: &Plan,
    world: &Rows,
    scaled_rows: &Rows,
    base_from_task: &[[f64; 3]; 3],
    singular: &SingularValues,
) -> JointVec {
    let mu_squared = fade_squared(singular.smallest, singular.largest);
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
