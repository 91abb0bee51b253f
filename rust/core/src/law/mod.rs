//! From deviation to motion and force: lines 7–10 of the control step, one file per law.

pub(crate) mod activation;
pub(crate) mod cap;
pub(crate) mod friction;
pub(crate) mod impedance;
pub(crate) mod nullspace;
pub(crate) mod paper;
pub(crate) mod posture_fade;
pub(crate) mod redistribution;
pub(crate) mod scaling;
pub(crate) mod singularity;
pub(crate) mod wrench;

use crate::law::friction::{FrictionFeedForward, FrictionGains};
use crate::law::nullspace::NullSpace;
use crate::law::singularity::SingularityState;
use crate::law::wrench::Wrench;
use crate::math::rows::{mul, tr_mul};
use crate::math::simd::{JointVector, RealOps, Scalar, SingleArmJoints, TaskVector};
use crate::params::{Law, Params, Projector};
use crate::task::ArmState;
use crate::task::demand::AxisDemand;
use crate::{AxisVec, JointVec, MAX_AXES, Rows};

/// Input of every law: one step at the predicted positions, with the rows of the task's axes.
///
/// Rows after the task's axes and lanes after the arm's joints are zero and stay zero.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LawInput<'a, J: JointVector> {
    pub(crate) params: &'a Params,
    pub(crate) horizon: f64,
    /// Task rows.
    pub(crate) rows: &'a [J; MAX_AXES],
    /// Task rows with translations divided by the arm's length.
    pub(crate) scaled_rows: &'a [J; MAX_AXES],
    pub(crate) singularity: &'a SingularityState<Scalar<J>>,
    /// λ² of each row.
    pub(crate) damping: J::Axes,
    pub(crate) pacing: Pacing<J::Axes>,
    /// Demand of each axis.
    pub(crate) demand: &'a AxisDemand<J::Axes>,
    /// Filtered joint velocity.
    pub(crate) velocity: J,
    /// Gradient of the null-space cost.
    pub(crate) gradient: J,
    /// Gravity in the goals.
    pub(crate) gravity: J,
    /// γ b_f, γ b_d and v₀ of the feed-forward.
    pub(crate) friction_gains: FrictionGains<Scalar<J>>,
    /// Lead stored by the integrating goal [rad].
    pub(crate) integral: J,
}

/// Terms that give the stiff axes the velocity and the acceleration of their reference.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pacing<W> {
    /// Displacement on the servos' springs [m, rad].
    pub(crate) displacement: W,
    /// Velocity of the reference [m/s, rad/s].
    pub(crate) velocity: W,
}

impl<W: TaskVector> Pacing<W> {
    /// Returns the terms that give the tool the velocity and acceleration of its reference: `velocity` and its `change`
    /// per second, base axes, at the joint velocity `joints`.
    #[inline(always)]
    pub(crate) fn new<J: SingleArmJoints<Axes = W>>(
        params: &Params,
        arm: &ArmState<'_, J>,
        joints: J,
        velocity: &AxisVec,
        change: &AxisVec,
    ) -> Self
    where
        W: TaskVector<Elem: RealOps<Real = f64>>,
    {
        let pace = &params.pace;
        let speed: W = params.to_task_rows(&arm.base_from_task, velocity);
        let acceleration: W = params.to_task_rows(&arm.base_from_task, change);
        let tool_velocity: W = TaskVector::from_axes(&mul(arm.rows, joints));
        let driven = W::constant(&pace.inertia) * W::clamp_abs(acceleration, W::constant(&pace.driven));
        let displacement = W::fma(W::constant(&pace.damping), speed - tool_velocity, driven);
        Self { displacement, velocity: speed }
    }

    /// Zero terms, for a reference without its own velocity.
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        Self { displacement: W::splat(0.0), velocity: W::splat(0.0) }
    }
}

/// Output of a law.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LawOutput<J: JointVector> {
    /// Lead of the goals that moves the arm: of stiff axes; under law `paper` of all axes [rad].
    pub(crate) stiff_offset: J,
    /// Lead of the goals that exerts a force with or without motion: of soft axes [rad].
    pub(crate) soft_offset: J,
    /// Null-space part of the goals [rad].
    pub(crate) null: J,
    /// Wrench of the laws that are defined by forces [N, N·m].
    pub(crate) wrench: Wrench<J::Axes>,
    /// Factors by which null-space, soft and stiff part were scaled.
    pub(crate) factors: [Scalar<J>; 3],
    /// Friction and damping feed-forward [N·m].
    pub(crate) feed_forward: J,
    /// Factor ≤ 1 on the gain of the stiff axes, required by delay and pose.
    pub(crate) gain_factor: Scalar<J>,
}

/// A control law: what differs between the laws. One file each; the step is compiled for every law, and [`with_law`]
/// selects one.
pub(crate) trait ControlLaw {
    /// Returns offsets and forces of one step; and, of a law whose torque limits follow from them, the joint budgets τ^q
    /// of (11).
    fn solve<J: JointVector>(input: &LawInput<'_, J>) -> (LawOutput<J>, Option<J>);

    /// Returns the force [N, N·m] that answers a displacement of the arm at rest, before its bound by the strength; ∞ for
    /// a law that is not defined by forces.
    fn force_at(push: &AxisPush<'_>) -> f64;

    /// Returns the factor ≤ 1 on the gain of the stiff axes; `last` is that of the last step.
    fn gain_factor(params: &Params, last: f64) -> f64 {
        let _ = last;
        params.gain_scale
    }

    /// Returns the factor ≤ 1 on the dampers in the settings, for the task rows of the last step.
    fn damping_factor(_params: &Params, _rows: &Rows) -> f64 {
        1.0
    }
}

/// Evaluates an expression for the type of a law: the only place that lists the laws.
macro_rules! with_law {
    ($law:expr, $type:ident => $value:expr) => {
        match $law {
            Law::Cap => {
                type $type = cap::Cap;
                $value
            }
            Law::Impedance => {
                type $type = impedance::Impedance;
                $value
            }
            Law::Paper => {
                type $type = paper::Paper;
                $value
            }
        }
    };
}

/// Runs the law of the settings, see [`ControlLaw::solve`].
#[inline(always)]
pub(crate) fn solve<J: JointVector>(input: &LawInput<'_, J>) -> (LawOutput<J>, Option<J>) {
    with_law!(input.params.law, L => L::solve(input))
}

/// See [`ControlLaw::gain_factor`].
pub(crate) fn gain_factor(params: &Params, last: f64) -> f64 {
    with_law!(params.law, L => L::gain_factor(params, last))
}

/// See [`ControlLaw::damping_factor`].
pub(crate) fn damping_factor(params: &Params, rows: &Rows) -> f64 {
    with_law!(params.law, L => L::damping_factor(params, rows))
}

/// A push along one task axis of an arm at rest.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AxisPush<'a> {
    pub(crate) params: &'a Params,
    /// h [s].
    pub(crate) horizon: f64,
    /// Index of the axis among the task rows; side toward which it is pushed.
    pub(crate) row: usize,
    pub(crate) side: usize,
    /// Its task row.
    pub(crate) j_row: &'a JointVec,
    /// λ²/k̄ of the row.
    pub(crate) damping: f64,
    /// Factor on the stiffness at the last step.
    pub(crate) gain_factor: f64,
    /// 1 − η w.
    pub(crate) share: f64,
    /// Deviation e [m, rad].
    pub(crate) deviation: f64,
}

impl AxisPush<'_> {
    /// See [`ControlLaw::force_at`].
    pub(crate) fn force(&self) -> f64 {
        with_law!(self.params.law, L => L::force_at(self))
    }
}

impl<J: JointVector> LawInput<'_, J> {
    /// Returns the force [N, N·m] that keeps the stiff axes at the velocity of their reference, and the approximate
    /// joint speeds [rad/s] for it; `c_diagonal` is the diagonal of C.
    #[inline(always)]
    pub(crate) fn pacing_force(&self, c_diagonal: J::Axes) -> (J::Axes, J) {
        let c_diagonal = J::Axes::max(c_diagonal, J::Axes::splat(f64::MIN_POSITIVE));
        let stiffness = (J::Axes::splat(1.0) - self.demand.softness) / c_diagonal;
        let along = tr_mul(self.rows, &(stiffness * self.pacing.velocity).to_axes());
        (stiffness * self.pacing.displacement, along * J::load(&self.params.servos.compliance))
    }

    /// Line 10; `ahead` [rad/s] is added to the joint velocity to give the direction of motion.
    #[inline(always)]
    pub(crate) fn friction(&self, ahead: J) -> FrictionFeedForward<J> {
        FrictionFeedForward::new([self.velocity, self.velocity + ahead], &self.params.servos, self.friction_gains)
    }

    /// Returns the null-space projector of the settings.
    #[inline(always)]
    pub(crate) fn null_space(&self) -> NullSpace<'_, J> {
        let (params, size) = (self.params, (self.params.k, self.params.n));
        let weight = J::load(&params.joint_weight_inv);
        match (params.projector, &self.singularity.factor) {
            (Projector::Paper, _) => NullSpace::new(self.rows, weight, &TaskVector::to_axes(self.damping), size),
            // With equal joint weights and μ = 0, reuse the factor that the singular value tracking computed.
            (Projector::Exact, Some(factor))
                if params.law.by_force() && !J::Elem::any_lt(J::Elem::splat(0.0), self.singularity.mu_squared) =>
            {
                NullSpace::of(self.scaled_rows, weight, factor, size)
            }
            (Projector::Exact, _) => {
                NullSpace::new(self.scaled_rows, weight, &[self.singularity.mu_squared; MAX_AXES], size)
            }
        }
    }

    /// Line 9: `−α h N ∇cost` [rad], before any scaling.
    #[inline(always)]
    pub(crate) fn null_motion(&self) -> J {
        let step = self.params.alpha * self.horizon;
        if step == 0.0 { J::splat(0.0) } else { self.null_space().project(self.gradient) * J::splat(-step) }
    }
}
