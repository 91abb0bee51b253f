//! Rare parts of a step: kept out of the hot code, and compiled once for all instruction sets.

use crate::command::host_loss::HostLoss;
use crate::command::torque_limit::Load;
use crate::controller::diagnostics::Record;
use crate::controller::step::Cycle;
use crate::math::rotation::{into_frame, out_of_frame};
use crate::math::simd::{Arithmetic, EveryJoint, Plain};
use crate::params::{LimitRule, Plan};
use crate::pose::Pose;
use crate::task::deviation_limit::{Kept, Pushed};
use crate::task::reference_governor::Governor;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Bounds the deviation of stiff axes by moving the reference, and sets its velocity along these axes to zero.
#[cold]
#[inline(never)]
pub(super) fn limit_deviation(plan: &Plan, pushed: &Pushed<'_>, governor: &mut Governor) -> Option<Kept> {
    let kept = pushed.keep(&plan.deviation_limits, &governor.pose())?;
    let mut velocity = into_frame::<Plain>(pushed.base_from_task, &governor.own_velocity());
    for (value, met) in velocity.iter_mut().zip(kept.met) {
        *value *= if met { 0.0 } else { kept.advance };
    }
    governor.put(kept.reference, out_of_frame(pushed.base_from_task, &velocity));
    Some(kept)
}

/// Missing share of the stiff axes' wrench at which the reference stops completely.
const STRAINED: f64 = 0.2;

/// Returns how much the reference is held back, 0 to 1, if the arm can exert this `share` of its stiff axes' wrench.
#[inline(always)]
pub(super) fn strain(share: f64) -> f64 {
    ((1.0 - share) / STRAINED).min(1.0)
}

/// Holds back a reference that runs ahead of an arm whose stiff axes are at their limits.
pub(super) struct Waiting<'a> {
    pub(super) plan: &'a Plan,
    /// Bounds of the tool, linear and angular: speed [m/s, rad/s] and acceleration [m/s², rad/s²].
    pub(super) bounds: [[f64; 2]; 2],
    pub(super) base_from_task: &'a [[f64; 3]; 3],
    /// Deviation of each row, times its stiffness share [m, rad].
    pub(super) lag: &'a AxisVec,
    /// Degree to which the reference is held back, 0 to 1.
    pub(super) strain: f64,
    pub(super) dt: f64,
}

impl Waiting<'_> {
    /// Takes back the lead over the arm that the reference has gained since `before`.
    #[cold]
    #[inline(never)]
    pub(super) fn of(&self, before: &Pose, governor: &mut Governor) {
        let mut lag = [0.0; MAX_AXES];
        for (&axis, &value) in self.plan.axes.iter().zip(self.lag) {
            lag[axis] = value;
        }
        governor.wait(before, &out_of_frame(self.base_from_task, &lag), self.strain, self.bounds, self.dt);
    }
}

impl Cycle<'_> {
    /// Returns the torque limits with which the arm pushes a hand with at most `most` [N] if the host dies now, from
    /// positions, goals, limits, gravity torques and their part in the limits.
    #[cold]
    #[inline(never)]
    pub(super) fn spare(
        &self,
        most: f64,
        [q, goal, limit]: [&JointVec; 3],
        [holding, in_limit]: [&JointVec; 2],
        base_from_task: [[f64; 3]; 3],
    ) -> JointVec {
        let (plan, nothing) = (self.plan, [0.0; MAX_JOINTS]);
        let (mut friction, mut base) = (nothing, nothing);
        for i in 0..plan.n {
            friction[i] = plan.servos.friction_at_rest(i, holding[i]);
            base[i] = (self.settings.paper_options.gravity_scale * in_limit[i].abs()).max(plan.floor[i]);
        }
        let dead = HostLoss {
            chain: self.chain,
            plan,
            masses: self.masses,
            gravity: *self.gravity,
            base_from_task,
            q,
            goal,
            limit,
            friction: &friction,
        };
        let by_demand = plan.law.by_force() && plan.limits == LimitRule::Demand;
        dead.spared(most, &base, if by_demand { &plan.margin } else { &nothing })
    }
}

/// Inputs of the sum rule, which few settings use.
pub(super) struct Asked {
    pub(super) rows: Rows,
    pub(super) gradient: JointVec,
    pub(super) damping: f64,
    pub(super) sigma: [f64; 2],
    pub(super) most: AxisVec,
    pub(super) gravity: EveryJoint,
    pub(super) feed_forward: EveryJoint,
}

impl Asked {
    #[cold]
    #[inline(never)]
    pub(super) fn sum(&self, plan: &Plan, gravity_scale: f64) -> JointVec {
        let record = Record {
            rows: self.rows,
            gradient: self.gradient,
            damping: self.damping,
            followed_sigma: plan.follows_sigma.then_some(self.sigma),
            ..Record::empty()
        };
        let null = record.shares(plan).null().map(|share| share * plan.null_torque);
        let nothing = EveryJoint::splat(0.0);
        let load = Load {
            gravity: self.gravity,
            feed_forward: self.feed_forward,
            task: nothing,
            offset: nothing,
            gravity_scale,
            margin: nothing,
        };
        load.sum(&self.rows, &self.most, &null)
    }
}
