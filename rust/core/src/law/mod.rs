//! Control laws, one file each: they compute joint motion and force from the deviation of each task axis.

pub(crate) mod activation;
pub(crate) mod cap;
pub(crate) mod friction;
pub(crate) mod impedance;
pub(crate) mod nullspace;
pub(crate) mod overspeed;
pub(crate) mod paper;
pub(crate) mod posture_fade;
pub(crate) mod redistribution;
pub(crate) mod scaling;
pub(crate) mod singularity;
pub(crate) mod wrench;

use crate::law::friction::{FrictionFeedForward, FrictionGains, OpposedMotion};
use crate::law::nullspace::NullSpace;
use crate::law::overspeed::Overspeed;
use crate::law::singularity::SingularityState;
use crate::law::wrench::{Wrench, WrenchLaw};
use crate::math::rows::{mul, tr_mul, weighted_gram};
use crate::math::simd::{F64x8, JointVector, RealOps};
use crate::params::{Features, Law, Params, Projector};
use crate::task::ArmState;
use crate::task::demand::AxisDemand;
use crate::{AxisVec, JointVec, MAX_AXES, Rows};

/// Input of a control law for one step, at the predicted joint positions; one row per task axis.
///
/// Rows after the last task axis and lanes after the last joint are zero.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LawInput<'a, J: JointVector> {
    pub(crate) params: &'a Params,
    /// Optional parts of the step; those of `params` or, in the plain step, constants.
    pub(crate) features: Features,
    /// Horizon h [s].
    pub(crate) horizon: f64,
    /// Jacobian rows of the task axes, in the task frame.
    pub(crate) rows: &'a [J; MAX_AXES],
    /// `rows` with translations divided by the arm's length scale, so that singular values have no unit.
    pub(crate) scaled_rows: &'a [J; MAX_AXES],
    pub(crate) singularity: &'a SingularityState,
    /// Squared damping λ² of each task row, in the units of that row.
    pub(crate) damping: J::Axes,
    /// Velocity and acceleration terms of the reference.
    pub(crate) pacing: Pacing<J::Axes>,
    /// Deviation, compliance and strength (largest force) of each task axis.
    pub(crate) demand: &'a AxisDemand<J::Axes>,
    /// Filtered joint velocity [rad/s].
    pub(crate) velocity: J,
    /// Gradient of the null-space cost.
    pub(crate) gradient: J,
    /// Gravity torque that the goals compensate [N·m]; 0 if the settings exclude it.
    pub(crate) gravity: J,
    /// Parameters of the friction and damping feed-forward.
    pub(crate) friction_gains: FrictionGains,
    /// Lead (goal − q) that the integrator has stored [rad]; 0 without integration.
    pub(crate) integral: J,
}

/// Terms that give the stiff axes the velocity and the acceleration of their reference, and bound the tool's speed.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pacing<W> {
    /// Displacement [m, rad] that, multiplied by the servos' stiffness along the axis, gives the force for damping and
    /// acceleration.
    pub(crate) displacement: W,
    /// Velocity of the reference [m/s, rad/s].
    pub(crate) velocity: W,
    /// Factors on the forces that would accelerate a tool that is too fast; `None` if the tool is slow enough.
    pub(crate) overspeed: Option<Overspeed<W>>,
}

impl<W: F64x8> Pacing<W> {
    /// Computes the terms from the reference's `velocity` [m/s, rad/s] and its `change` per second, both in base axes;
    /// `joints` is the joint velocity [rad/s].
    #[inline(always)]
    pub(crate) fn new<J: JointVector<Axes = W>>(
        params: &Params,
        features: Features,
        arm: &ArmState<'_, J>,
        joints: J,
        velocity: &AxisVec,
        change: &AxisVec,
    ) -> Self {
        let pace = &params.pace;
        let speed: W = params.to_task_rows(features, &arm.base_from_task, velocity);
        let acceleration: W = params.to_task_rows(features, &arm.base_from_task, change);
        let tool_velocity = W::from_axes(&mul(arm.rows, joints));
        let driven = W::from_array(&pace.inertia) * W::clamp_abs(acceleration, W::from_array(&pace.max_acceleration));
        let displacement = W::fma(W::from_array(&pace.damping), speed - tool_velocity, driven);
        let twist = if features.any_axes { mul(&arm.view.j_base, joints) } else { tool_velocity.to_axes() };
        let overspeed = Overspeed::new(&pace.overspeed, &twist, tool_velocity);
        Self { displacement, velocity: speed, overspeed }
    }

    /// Returns zero terms, for a reference without a velocity.
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        Self { displacement: W::splat(0.0), velocity: W::splat(0.0), overspeed: None }
    }
}

/// Output of a control law for one step. A lead is a goal minus the predicted position.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LawOutput<J: JointVector> {
    /// Lead that moves the stiff axes [rad]; under law `paper` that of all axes.
    pub(crate) stiff_offset: J,
    /// Lead that exerts the force of the soft axes, whether or not the arm moves [rad].
    pub(crate) soft_offset: J,
    /// Null-space part of the goals [rad].
    pub(crate) null: J,
    /// Wrench that the leads exert [N, N·m]; 0 under law `paper`.
    pub(crate) wrench: Wrench<J::Axes>,
    /// Joint torques `Jᵀ wrench` [N·m].
    pub(crate) torque: J,
    /// Factors, 0 to 1, on the null-space, the soft and the stiff part, which keep them within torque and speed limits.
    pub(crate) factors: [f64; 3],
    /// Friction and damping feed-forward [N·m].
    pub(crate) feed_forward: J,
    /// Factor ≤ 1 on the gain of the stiff axes, required by delay and pose.
    pub(crate) gain_factor: f64,
}

/// A control law, which [`with_law`] selects. [`solve`] computes its step: that of law `paper`, or one from the wrench of
/// a [`WrenchLaw`](wrench::WrenchLaw).
pub(crate) trait ControlLaw {
    /// Returns the force [N, N·m] with which an arm at rest would oppose a push if its axis had no force cap; ∞ for a
    /// law that is not defined by forces.
    fn force_at(push: &AxisPush<'_>) -> f64;

    /// Returns the factor ≤ 1 on the gain of the stiff axes; `last` is the factor of the last step.
    fn gain_factor(params: &Params, last: f64) -> f64 {
        let _ = last;
        params.gain_scale
    }

    /// Returns the factor ≤ 1 on the dampers of the settings, for the task rows of the last step.
    fn damping_factor(_params: &Params, _rows: &Rows) -> f64 {
        1.0
    }
}

/// Evaluates `$value` with `$type` as the type of the law `$law`.
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

/// Runs the law of the settings. Returns the leads and the wrench of one step and, under law `paper` only, the joint
/// torque budgets τ^q of equation (11) of the paper.
#[inline(always)]
pub(crate) fn solve<J: JointVector>(input: &LawInput<'_, J>) -> (LawOutput<J>, Option<J>) {
    let law = input.features.law;
    if law == Law::Paper {
        let (output, budget) = paper::solve(input);
        return (output, Some(budget));
    }
    // One call for all laws that compute a wrench: the code is large, and compiled for each instruction set.
    let compliance = weighted_gram(input.rows, J::load(&input.params.servos.compliance));
    let demand = match law {
        Law::Impedance => impedance::Impedance::wrench(input, &compliance),
        // Law `paper` has returned above; this arm includes it only because a match must be exhaustive.
        Law::Cap | Law::Paper => cap::Cap::wrench(input, &compliance),
    };
    (input.joint_offsets(&demand), None)
}

/// Returns the factor ≤ 1 on the gain of the stiff axes under the law of the settings; `last` is the factor of the last
/// step.
pub(crate) fn gain_factor(params: &Params, last: f64) -> f64 {
    with_law!(params.law, L => L::gain_factor(params, last))
}

/// Returns the factor ≤ 1 on the dampers of the settings, for the task rows of the last step.
pub(crate) fn damping_factor(params: &Params, rows: &Rows) -> f64 {
    with_law!(params.law, L => L::damping_factor(params, rows))
}

/// A push along one task axis on an arm at rest.
#[derive(Debug, Clone, Copy)]
pub(crate) struct AxisPush<'a> {
    pub(crate) params: &'a Params,
    /// Horizon h [s].
    pub(crate) horizon: f64,
    /// Row of the axis in the task.
    pub(crate) row: usize,
    /// Side toward which the axis is pushed: 0 for −, 1 for +.
    pub(crate) side: usize,
    /// Jacobian row of the axis.
    pub(crate) j_row: &'a JointVec,
    /// Damping of the row, `λ²/k̄`, with the servos' mean stiffness k̄.
    pub(crate) damping: f64,
    /// Factor ≤ 1 on the stiffness at the last step.
    pub(crate) gain_factor: f64,
    /// Share 1 − η w of the deviation that the target adaptation leaves.
    pub(crate) share: f64,
    /// Deviation e = target − tool [m, rad].
    pub(crate) deviation: f64,
}

impl AxisPush<'_> {
    /// Returns the force [N, N·m] that would oppose the push without a force cap, under the law of the settings; ∞ for
    /// a law that is not defined by forces.
    pub(crate) fn force(&self) -> f64 {
        with_law!(self.params.law, L => L::force_at(self))
    }
}

impl<J: JointVector> LawInput<'_, J> {
    /// Returns the force [N, N·m] that keeps the stiff axes at the velocity of their reference, and the approximate
    /// joint speeds [rad/s] at that velocity; `c_diagonal` is the diagonal of `C = J K_p⁻¹ Jᵀ`.
    ///
    /// An axis that the joints hardly move has the stiffness k̄/λ² instead of 1/C_jj: as C_jj vanishes, the torque of a
    /// joint would grow without bound.
    #[inline(always)]
    pub(crate) fn pacing_force(&self, c_diagonal: J::Axes) -> (J::Axes, J) {
        let damping = J::Axes::max(self.params.per_stiffness(self.damping), J::Axes::splat(f64::MIN_POSITIVE));
        let stiffness = (J::Axes::splat(1.0) - self.demand.softness) / J::Axes::max(c_diagonal, damping);
        let along = tr_mul(self.rows, &(stiffness * self.pacing.velocity).to_axes());
        (stiffness * self.pacing.displacement, along * J::load(&self.params.servos.compliance))
    }

    /// Returns the feed-forward of friction and damping. The direction of friction is that of the joint velocity plus
    /// `ahead` [rad/s], because a joint at rest has no direction.
    #[inline(always)]
    pub(crate) fn friction(&self, ahead: J) -> FrictionFeedForward<J> {
        FrictionFeedForward::new([self.velocity, self.velocity + ahead], &self.params.servos, self.friction_gains)
    }

    /// Returns the motion at the joint velocity plus `ahead` [rad/s], the joint speeds at the velocity of the reference,
    /// and the power of the law along each axis; `soft` is the wrench of the yielding axes [N, N·m].
    #[inline(always)]
    pub(crate) fn opposed_motion(&self, ahead: J, soft: J::Axes) -> OpposedMotion<J> {
        let (joints, demand) = (self.velocity + ahead, self.demand);
        let axes = J::Axes::from_axes(&mul(self.rows, joints));
        let hold = demand.max_strength - demand.softness * demand.strength;
        OpposedMotion {
            joints,
            axes,
            row_scale: J::Axes::from_axes(&self.params.row_scale),
            power: J::Axes::fma(J::Axes::abs(soft), J::Axes::abs(axes), hold * J::Axes::abs(self.pacing.velocity)),
        }
    }

    /// Returns the null-space projector that the settings select.
    #[inline(always)]
    pub(crate) fn null_space(&self) -> NullSpace<'_, J> {
        let (params, size) = (self.params, (self.params.k, self.params.n));
        let weight = J::load(&params.joint_weight_inv);
        let mu_squared = self.singularity.mu_squared;
        let (rows, added) = match params.projector {
            Projector::Paper => (self.rows, self.damping.to_axes()),
            Projector::Exact => (self.scaled_rows, [mu_squared; MAX_AXES]),
        };
        match &self.singularity.factor {
            // With joint weights 1 and μ = 0, reuse the factor that the singular value tracking computed.
            Some(factor) if params.projector == Projector::Exact && !(params.has_joint_weights || mu_squared > 0.0) => {
                NullSpace::of(rows, weight, factor, size)
            }
            _ => NullSpace::new(rows, weight, &added, size),
        }
    }

    /// Returns the null-space motion `−α h N ∇cost` [rad], before it is scaled to torque and speed limits: gain α,
    /// horizon h, projector N. With a `stiffness` κ, returns `−κ K_p⁻¹ N ∇cost`, whose torque does no work on the task.
    #[inline(always)]
    pub(crate) fn null_motion(&self, stiffness: Option<f64>) -> J {
        let step = stiffness.unwrap_or(self.params.alpha * self.horizon);
        if step == 0.0 {
            return J::splat(0.0);
        }
        let motion = self.null_space().project(self.gradient) * J::splat(-step);
        if stiffness.is_some() { motion * J::load(&self.params.servos.compliance) } else { motion }
    }
}
