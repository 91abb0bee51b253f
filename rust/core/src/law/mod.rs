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

use crate::law::friction::{Fed, Resistance};
use crate::law::nullspace::NullSpace;
use crate::law::singularity::Condition;
use crate::law::wrench::Wrench;
use crate::math::rows::{axes, times, transpose_times, wide};
use crate::math::simd::{Arithmetic, Axes, Joints, Lanes, Scalar};
use crate::params::{Law, Plan, Projector};
use crate::task::Seen;
use crate::task::demand::Wish;
use crate::{AxisVec, MAX_AXES};

/// Input of every law: one step at the predicted positions, with the rows of the task's axes.
///
/// Rows after the task's axes and lanes after the arm's joints are zero and stay zero.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tick<'a, J: Lanes> {
    pub(crate) plan: &'a Plan,
    pub(crate) horizon: f64,
    /// Task rows.
    pub(crate) rows: &'a [J; MAX_AXES],
    /// Task rows with translations divided by the arm's length.
    pub(crate) scaled_rows: &'a [J; MAX_AXES],
    pub(crate) condition: &'a Condition<Scalar<J>>,
    /// λ² of each row.
    pub(crate) damping: J::Axes,
    pub(crate) pacing: Pacing<J::Axes>,
    /// Demand of each axis.
    pub(crate) wish: &'a Wish<J::Axes>,
    /// Filtered joint velocity.
    pub(crate) velocity: J,
    /// Gradient of the null-space cost.
    pub(crate) gradient: J,
    /// Gravity in the goals.
    pub(crate) gravity: J,
    /// γ b_f, γ b_d and v₀ of the feed-forward.
    pub(crate) fed: Fed<Scalar<J>>,
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

impl<W: Axes> Pacing<W> {
    /// Returns the terms that give the tool the velocity and acceleration of its reference: `velocity` and its `change`
    /// per second, base axes, at the joint velocity `joints`.
    #[inline(always)]
    pub(crate) fn new<J: Joints<Axes = W>>(
        plan: &Plan,
        seen: &Seen<'_, J>,
        joints: J,
        velocity: &AxisVec,
        change: &AxisVec,
    ) -> Self
    where
        W: Axes<One: Arithmetic<Real = f64>>,
    {
        let pace = &plan.pace;
        let speed: W = plan.in_rows(&seen.base_from_task, velocity);
        let acceleration: W = plan.in_rows(&seen.base_from_task, change);
        let own: W = wide(&times(seen.rows, joints));
        let driven = W::constant(&pace.inertia) * W::clip(acceleration, W::constant(&pace.driven));
        let displacement = W::fma(W::constant(&pace.damping), speed - own, driven);
        Self { displacement, velocity: speed }
    }

    /// Zero terms, for a reference without its own velocity.
    #[inline(always)]
    pub(crate) fn none() -> Self {
        Self { displacement: W::splat(0.0), velocity: W::splat(0.0) }
    }
}

/// Output of a law.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Motion<J: Lanes> {
    /// Lead of the goals that moves the arm: of stiff axes; under law `paper` of all axes [rad].
    pub(crate) lead: J,
    /// Lead of the goals that exerts a force with or without motion: of soft axes [rad].
    pub(crate) force_lead: J,
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

/// Runs the law. Also returns the joint budgets τ^q of (11) if the law makes its limits from them.
#[inline(always)]
pub(crate) fn motion<J: Lanes>(tick: &Tick<'_, J>) -> (Motion<J>, Option<J>) {
    match tick.plan.law {
        Law::Cap => (cap::motion(tick), None),
        Law::Impedance => (impedance::motion(tick), None),
        Law::Paper => {
            let (motion, budget) = paper::motion(tick);
            (motion, Some(budget))
        }
    }
}

impl<J: Lanes> Tick<'_, J> {
    /// Returns the force [N, N·m] that keeps the stiff axes at the velocity of their reference, and the approximate
    /// joint speeds [rad/s] for it; `own` is the diagonal of C.
    #[inline(always)]
    pub(crate) fn paced(&self, own: J::Axes) -> (J::Axes, J) {
        let own = J::Axes::at_least(own, J::Axes::splat(f64::MIN_POSITIVE));
        let stiffness = (J::Axes::splat(1.0) - self.wish.softness) / own;
        let along = transpose_times(self.rows, &(stiffness * self.pacing.velocity).axes());
        (stiffness * self.pacing.displacement, along * J::load(&self.plan.servos.compliance))
    }

    /// Line 10; `ahead` [rad/s] is added to the joint velocity to give the direction of motion.
    #[inline(always)]
    pub(crate) fn resistance(&self, ahead: J) -> Resistance<J> {
        Resistance::new([self.velocity, self.velocity + ahead], &self.plan.servos, self.fed)
    }

    /// Returns the null-space projector of the settings.
    #[inline(always)]
    pub(crate) fn null_space(&self) -> NullSpace<'_, J> {
        let (plan, size) = (self.plan, (self.plan.k, self.plan.n));
        let weight = J::load(&plan.inverse_weight);
        match (plan.projector, &self.condition.factor) {
            (Projector::Paper, _) => NullSpace::new(self.rows, weight, &axes(self.damping), size),
            // With equal joint weights and μ = 0, reuse the factor that the singular value tracking computed.
            (Projector::Exact, Some(factor))
                if plan.law.by_force() && !J::One::less_anywhere(J::One::splat(0.0), self.condition.mu_squared) =>
            {
                NullSpace::of(self.scaled_rows, weight, factor, size)
            }
            (Projector::Exact, _) => {
                NullSpace::new(self.scaled_rows, weight, &[self.condition.mu_squared; MAX_AXES], size)
            }
        }
    }

    /// Line 9: `−α h N ∇cost` [rad], before any scaling.
    #[inline(always)]
    pub(crate) fn null_motion(&self) -> J {
        let step = self.plan.alpha * self.horizon;
        if step == 0.0 { J::splat(0.0) } else { self.null_space().project(self.gradient) * J::splat(-step) }
    }
}
