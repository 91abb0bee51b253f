//! Stateless steps of several arms at once: each SIMD lane holds one arm.
//!
//! Rare cases (an invalid input, a joint at its limit) are left to single steps.

use crate::batch::{Batch, Targets};
use crate::command::goal::{Solution, register_speed};
use crate::command::torque_limit::finish;
use crate::kinematics::batch::{gather, scatter};
use crate::kinematics::velocity_filter::SPEED_BOUND;
use crate::law::friction::Fed;
use crate::law::paper::{is_printed, printed};
use crate::law::singularity::{Condition, row_damping};
use crate::law::{Pacing, Tick};
use crate::math::simd::{ABREAST, Arithmetic, Columns, Kernel, Lanes, Machine, Many, NEGLIGIBLE, Packed};
use crate::params::{GravityUse, Plan};
use crate::pose::Pose;
use crate::task::demand::Wish;
use crate::task::{Seen, pose_error_by};
use crate::{MAX_AXES, MAX_JOINTS};

/// One chunk of the rows of a batch.
pub(super) struct Abreast<'a> {
    pub(super) batch: &'a Batch<'a>,
    /// Index of the first row.
    pub(super) first: usize,
    /// Goals, torque limits, velocities.
    pub(super) outs: [&'a mut [f64]; 3],
}

/// Jacobians; the arms of a chunk share their memory one after another. The columns after the last joint stay 0.
type Jacobians<W> = [[W; MAX_JOINTS]; MAX_AXES];

/// Returns true if the settings and the arm allow interleaved steps.
pub(super) fn goes_abreast(plan: &Plan) -> bool {
    plan.n <= ABREAST && is_printed(plan) && plan.deviation_limits.is_empty() && plan.max_host_loss_force.is_none()
}

impl Kernel for Abreast<'_> {
    /// Rows that are left to single steps, the first in the lowest bit.
    type Output = u64;

    #[inline(always)]
    fn run<M: Machine>(mut self) -> u64 {
        let (n, mut left) = (self.batch.plan.n.clamp(1, ABREAST), 0);
        let (rows, count) = (self.outs[0].len() / n, M::Many::COUNT);
        let mut jacobians = [[M::Many::splat(0.0); MAX_JOINTS]; MAX_AXES];
        let mut from = 0;
        while from < rows {
            let sure = self.rows::<M::Many>(n, from, &mut jacobians).numbers();
            for lane in 0..count.min(rows - from) {
                left |= u64::from(sure[lane] == 0.0) << (from + lane);
            }
            from += count;
        }
        left
    }
}

impl Abreast<'_> {
    /// Steps one register of rows, beginning at `from`; returns 0 for rows that are left to single steps, else 1.
    #[inline(always)]
    fn rows<W: Many>(&mut self, n: usize, from: usize, jacobians: &mut Jacobians<W>) -> W {
        let Batch { plan, settings, model, masses, gravity, input, .. } = *self.batch;
        let (row, nothing, mut sure) = (self.first + from, W::splat(0.0), W::splat(1.0));
        let mut q = gather::<W>(&input.q[n * row..], n);
        for i in 0..n {
            sure = W::if_less(W::splat(plan.readable[0][i]), q[i], sure, nothing);
            sure = W::if_less(q[i], W::splat(plan.readable[1][i]), sure, nothing);
        }
        for i in 0..ABREAST {
            q[i] = if i < n { without_negligible(q[i]) } else { nothing };
        }
        let mut velocity = Columns::<W, ABREAST>::splat(0.0);
        if let Some(dq) = input.dq {
            let mut dq = gather::<W>(&dq[n * row..], n);
            for i in 0..ABREAST {
                sure = if i < n { W::if_less(W::abs(dq[i]), W::splat(SPEED_BOUND), sure, nothing) } else { sure };
                dq[i] = if i < n { without_negligible(dq[i]) } else { nothing };
            }
            velocity = Columns::of_joints(&dq);
        }
        let target = self.targets(row, &mut sure);

        let view =
            model.chain().look_abreast(&q, masses, gravity, settings.gravity_use() != GravityUse::Off, jacobians);
        let (q, mut turned) = (Columns::<W, ABREAST>::of_joints(&q), None);
        let seen = Seen::new(plan, settings, q, &view, &mut turned);
        let error = pose_error_by::<W>(&seen.view.tool, &target);
        let wish = Wish::new(plan, settings, plan.in_rows(&seen.base_from_task, &error), Columns::splat(0.0));
        let rest = plan.rest.as_ref().map_or(q, Columns::load);
        let (lambda, integral) = (W::splat(plan.damping.lambda_0), Columns::splat(0.0));
        let condition = Condition { damping: lambda * lambda, mu_squared: nothing, factor: None, gamma: W::splat(1.0) };
        let tick = Tick {
            plan,
            horizon: settings.paper_options.horizon,
            rows: seen.rows,
            scaled_rows: seen.rows, // the published law uses unscaled rows only
            condition: &condition,
            damping: row_damping::<Columns<W, ABREAST>>(plan, &condition),
            pacing: Pacing::none(), // stateless steps have no reference velocity
            wish: &wish,
            velocity,
            gradient: plan.cost.gradient(q, rest, 1.0),
            gravity: seen.gravity_in_goal,
            fed: Fed::new::<W>(settings, condition.gamma),
            integral,
        };
        let (motion, budget) = printed(&tick);
        let solution = Solution::new(plan, &tick, &seen, (motion, None));
        let wanted = solution.load(plan, settings, (q, integral), &seen, &wish).budget(budget);
        let load = |values| Columns::<W, ABREAST>::load(values);
        let limit = finish(wanted, None, load(&plan.floor), load(&plan.servos.torque), Columns::splat(0.0));
        let goal = solution.goal(plan, settings, limit);
        let speed = register_speed(
            &seen.view.world,
            settings.max_tool_speed,
            settings.tracking.goal_slew,
            load(&plan.joint_speed),
        );

        let (moving, goals, limits) = (solution.moving.numbers(), goal.numbers(), limit.numbers());
        for i in 0..n {
            sure = W::if_less(W::splat(plan.upper[i]), moving[i], nothing, sure);
            sure = W::if_less(moving[i], W::splat(plan.lower[i]), nothing, sure);
            sure = W::if_less(W::abs(goals[i]) + W::abs(limits[i]), W::splat(f64::INFINITY), sure, nothing);
        }
        let [a, b, c] = &mut self.outs;
        scatter::<W>(&goals, n, &mut a[n * from..]);
        scatter::<W>(&limits, n, &mut b[n * from..]);
        scatter::<W>(&speed.numbers(), n, &mut c[n * from..]);
        sure
    }

    /// Loads the targets of the arms beginning at `row`; sets `sure` to 0 for targets that may be invalid.
    #[inline(always)]
    fn targets<W: Many>(&self, row: usize, sure: &mut W) -> Pose<W> {
        let (nothing, one) = (W::splat(0.0), W::splat(1.0));
        let mut target = Pose { rotation: [[nothing; 3]; 3], position: [nothing; 3] };
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
                    *sure = W::if_less(W::abs(off), W::splat(1e-9), *sure, nothing);
                }
                *sure = target.if_sure::<W>(&self.batch.plan.target_region, *sure);
            }
            Targets::Positions(values) => {
                let p = gather::<W>(&values[3 * row..], 3);
                for i in 0..3 {
                    target.rotation[i][i] = one;
                    target.position[i] = p[i];
                }
                *sure = target.if_sure::<W>(&self.batch.plan.target_region, *sure);
            }
        }
        target
    }
}

/// Flushes a negligibly small position to 0, as a single step does.
#[inline(always)]
fn without_negligible<W: Many>(value: W) -> W {
    W::if_less(W::abs(value), W::splat(NEGLIGIBLE), W::splat(0.0), value)
}
