//! Stateless steps of several arms at once: each SIMD lane holds one arm.
//!
//! Arms in rare cases (an invalid input, a joint at its limit) are left to the step for a single arm.

use crate::batch::{Batch, Targets};
use crate::command::goal::{JointTargets, profile_velocity};
use crate::command::torque_limit::bound_and_slew;
use crate::kinematics::batch::{gather, scatter};
use crate::kinematics::velocity_filter::SPEED_BOUND;
use crate::law::friction::FrictionGains;
use crate::law::paper::{is_published, published_motion};
use crate::law::singularity::{SingularityState, row_damping};
use crate::law::{LawInput, Pacing};
use crate::math::simd::{Isa, JointVector, Kernel, NEGLIGIBLE, RealOps, SOA_MAX_JOINTS, SimdVec, SoaLanes, SoaVec};
use crate::params::{GravityUse, Params};
use crate::pose::Pose;
use crate::task::demand::AxisDemand;
use crate::task::{ArmState, pose_error_by};
use crate::{MAX_AXES, MAX_JOINTS};

/// Step of one chunk of arms of a batch.
pub(super) struct SoaStep<'a> {
    pub(super) batch: &'a Batch<'a>,
    /// Index of the first arm of the chunk in the batch.
    pub(super) first: usize,
    /// Goals [rad], torque limits [N·m] and speeds [rad/s] of the chunk, one row per arm.
    pub(super) outs: [&'a mut [f64]; 3],
}

/// Jacobians of one register of arms, in memory that the next registers reuse. Columns after the last joint stay 0.
type Jacobians<W> = [[W; MAX_JOINTS]; MAX_AXES];

/// Returns true if the settings and the arm allow steps with one arm per SIMD lane.
pub(super) fn supports_soa(params: &Params) -> bool {
    params.n <= SOA_MAX_JOINTS
        && is_published(params)
        && params.deviation_limits.is_empty()
        && params.max_host_loss_force.is_none()
}

impl Kernel for SoaStep<'_> {
    /// Mask of the arms that are left to the step for a single arm; the lowest bit is the first arm of the chunk.
    type Output = u64;

    #[inline(always)]
    fn run<M: Isa>(mut self) -> u64 {
        let (n, mut pending) = (self.batch.params.n.clamp(1, SOA_MAX_JOINTS), 0);
        let (rows, count) = (self.outs[0].len() / n, M::F64xN::COUNT);
        let mut jacobians = [[M::F64xN::splat(0.0); MAX_JOINTS]; MAX_AXES];
        let mut from = 0;
        while from < rows {
            let valid = self.rows::<M::F64xN>(n, from, &mut jacobians).to_array();
            for lane in 0..count.min(rows - from) {
                pending |= u64::from(valid[lane] == 0.0) << (from + lane);
            }
            from += count;
        }
        pending
    }
}

impl SoaStep<'_> {
    /// Steps one register of arms, beginning at arm `from` of the chunk; returns 0 in the lanes of arms that are left
    /// to the step for a single arm, otherwise 1.
    #[inline(always)]
    fn rows<W: SoaLanes>(&mut self, n: usize, from: usize, jacobians: &mut Jacobians<W>) -> W {
        let Batch { params, settings, model, masses, gravity, input, .. } = *self.batch;
        let (row, zero, mut valid) = (self.first + from, W::splat(0.0), W::splat(1.0));
        let mut q = gather::<W>(&input.q[n * row..], n);
        for i in 0..n {
            valid = W::select_lt(W::splat(params.q_plausible[0][i]), q[i], valid, zero);
            valid = W::select_lt(q[i], W::splat(params.q_plausible[1][i]), valid, zero);
        }
        for i in 0..SOA_MAX_JOINTS {
            q[i] = if i < n { flush_subnormals(q[i]) } else { zero };
        }
        let mut velocity = SoaVec::<W, SOA_MAX_JOINTS>::splat(0.0);
        if let Some(dq) = input.dq {
            let mut dq = gather::<W>(&dq[n * row..], n);
            for i in 0..SOA_MAX_JOINTS {
                valid = if i < n { W::select_lt(W::abs(dq[i]), W::splat(SPEED_BOUND), valid, zero) } else { valid };
                dq[i] = if i < n { flush_subnormals(dq[i]) } else { zero };
            }
            velocity = SoaVec::from_joints(&dq);
        }
        let target = self.targets(row, &mut valid);

        let view =
            model.chain().evaluate_soa(&q, masses, gravity, settings.gravity_use() != GravityUse::Off, jacobians);
        let (q, mut turned) = (SoaVec::<W, SOA_MAX_JOINTS>::from_joints(&q), None);
        let arm = ArmState::new(params, settings, q, &view, &mut turned);
        let error = pose_error_by::<W>(&arm.view.tool, &target);
        let demand =
            AxisDemand::new(params, settings, params.to_task_rows(&arm.base_from_task, &error), SoaVec::splat(0.0));
        let rest = params.posture.as_ref().map_or(q, SoaVec::load);
        let (lambda, integral) = (W::splat(params.damping.lambda_0), SoaVec::splat(0.0));
        let singularity =
            SingularityState { damping: lambda * lambda, mu_squared: zero, factor: None, gamma: W::splat(1.0) };
        let input = LawInput {
            params,
            horizon: settings.paper_options.horizon,
            rows: arm.rows,
            scaled_rows: arm.rows, // the published law uses unscaled rows only
            singularity: &singularity,
            damping: row_damping::<SoaVec<W, SOA_MAX_JOINTS>>(params, &singularity),
            pacing: Pacing::zero(), // stateless steps have no reference velocity
            demand: &demand,
            velocity,
            gradient: params.cost.gradient(q, rest, 1.0),
            gravity: arm.gravity_in_goal,
            friction_gains: FrictionGains::new::<W>(settings, singularity.gamma),
            integral,
        };
        let (motion, budget) = published_motion(&input);
        let solution = JointTargets::new(params, &input, &arm, (motion, None));
        let wanted = solution.limit_terms(params, settings, (q, integral), &arm, &demand).budget(budget);
        let load = |values| SoaVec::<W, SOA_MAX_JOINTS>::load(values);
        let limit = bound_and_slew(
            wanted,
            None,
            load(&params.min_torque_limit),
            load(&params.servos.torque),
            SoaVec::splat(0.0),
        );
        let goal = solution.goal(params, settings, limit);
        let speed = profile_velocity(
            &arm.view.j_base,
            settings.max_tool_speed,
            settings.tracking.goal_slew,
            load(&params.joint_speed),
        );

        let (q_goal, goals, limits) = (solution.q_goal.to_array(), goal.to_array(), limit.to_array());
        for i in 0..n {
            valid = W::select_lt(W::splat(params.upper[i]), q_goal[i], zero, valid);
            valid = W::select_lt(q_goal[i], W::splat(params.lower[i]), zero, valid);
            valid = W::select_lt(W::abs(goals[i]) + W::abs(limits[i]), W::splat(f64::INFINITY), valid, zero);
        }
        let [a, b, c] = &mut self.outs;
        scatter::<W>(&goals, n, &mut a[n * from..]);
        scatter::<W>(&limits, n, &mut b[n * from..]);
        scatter::<W>(&speed.to_array(), n, &mut c[n * from..]);
        valid
    }

    /// Returns the targets of the arms from `row` on; sets `valid` to 0 in the lanes of targets that may be invalid.
    #[inline(always)]
    fn targets<W: SoaLanes>(&self, row: usize, valid: &mut W) -> Pose<W> {
        let (zero, one) = (W::splat(0.0), W::splat(1.0));
        let mut target = Pose { rotation: [[zero; 3]; 3], position: [zero; 3] };
        match self.batch.input.targets {
            Targets::One(pose) => {
                for i in 0..3 {
                    for j in 0..3 {
                        target.rotation[i][j] = W::splat(pose.rotation[i][j]);
                    }
                    target.position[i] = W::splat(pose.position[i]);
                }
            }
            Targets::Poses(values) => {
                let m = gather::<W>(&values[16 * row..], 16);
                for i in 0..3 {
                    target.rotation[i] = [m[4 * i], m[4 * i + 1], m[4 * i + 2]];
                    target.position[i] = m[4 * i + 3];
                }
                for off in [m[12], m[13], m[14], m[15] - one] {
                    *valid = W::select_lt(W::abs(off), W::splat(1e-9), *valid, zero);
                }
                *valid = target.mask_valid::<W>(&self.batch.params.target_region, *valid);
            }
            Targets::Positions(values) => {
                let p = gather::<W>(&values[3 * row..], 3);
                for i in 0..3 {
                    target.rotation[i][i] = one;
                    target.position[i] = p[i];
                }
                *valid = target.mask_valid::<W>(&self.batch.params.target_region, *valid);
            }
        }
        target
    }
}

/// Replaces a negligibly small number by 0, as the step for a single arm does.
#[inline(always)]
fn flush_subnormals<W: SoaLanes>(value: W) -> W {
    W::select_lt(W::abs(value), W::splat(NEGLIGIBLE), W::splat(0.0), value)
}
