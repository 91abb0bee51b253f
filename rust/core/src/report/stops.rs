//! How far a push leads until a joint meets its position limit, and what the joints that are left make of it.

use nalgebra::DMatrix;

use crate::command::dead_host::TRAVEL;
use crate::kinematics::Frames;
use crate::law::inverse::{Cholesky, pseudo_inverse, transpose_times, weighted_gram};
use crate::law::svd::singular_values;
use crate::model::Model;
use crate::plan::Plan;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Steps on the way.
const STEPS: u8 = 15;

/// Damping of the way, as a share of the largest entry of `J K_p⁻¹ Jᵀ`: a singular pose on it must not throw the arm.
const DAMPING: f64 = 1e-7;

/// Smallest over largest singular value below which the joints that are left cannot move an axis alone.
const SINGULAR: f64 = 1e-3;

/// The first position limit on the way along one axis.
#[derive(Debug, Clone, Copy)]
pub(super) struct Stop {
    /// Displacement at which it is met [m, rad].
    pub(super) distance: f64,
    /// The joint that meets it.
    pub(super) joint: usize,
    /// How far it is from there now [rad or m].
    pub(super) room: f64,
    /// `Σ_i |J⁺_ij| τ_f,i` of the joints that are left, there [N, N·m]; ∞ where they cannot move the axis alone.
    pub(super) friction: f64,
}

/// Where a hand leads an arm whose other axes keep their place.
pub(super) struct Way<'a> {
    pub(super) model: &'a Model,
    pub(super) plan: &'a Plan,
    pub(super) base_from_task: [[f64; 3]; 3],
    pub(super) q: &'a JointVec,
    /// Dry friction at rest [N·m].
    pub(super) friction: &'a JointVec,
}

impl Way<'_> {
    /// The first stop on 0.15 m or 0.4 rad along one task axis, toward `sign`.
    ///
    /// The arm goes where the servos' springs are stretched least, `dq = K_p⁻¹ Jᵀ C⁻¹ d`, as under line 8.
    pub(super) fn first_stop(&self, row: usize, sign: f64) -> Option<Stop> {
        let (plan, n, k) = (self.plan, self.plan.n, self.plan.k);
        let travel = TRAVEL[usize::from(plan.rows[row].axis >= 3)];
        let (mut q, mut gone) = (*self.q, 0.0);
        let mut along = [0.0; MAX_AXES];
        along[row] = sign;
        for _ in 0..STEPS {
            let rows = self.rows(&q);
            let mut c = weighted_gram(&rows, &plan.servos.compliance, k, n);
            let most = (0..k).fold(0.0_f64, |most, r| most.max(c[r][r]));
            (0..k).for_each(|r| c[r][r] += DAMPING * most);
            let mut way = transpose_times(&rows, &Cholesky::new(&c, k).solve(&along), k, n);
            (0..n).for_each(|i| way[i] *= plan.servos.compliance[i]);
            let (mut step, mut met) = (travel / f64::from(STEPS), None);
            for i in 0..n {
                let room = if way[i] > 0.0 { plan.upper[i] - q[i] } else { q[i] - plan.lower[i] };
                if room.max(0.0) < step * way[i].abs() {
                    (step, met) = (room.max(0.0) / way[i].abs(), Some(i));
                }
            }
            (0..n).for_each(|i| q[i] += step * way[i]);
            gone += step;
            if let Some(joint) = met {
                let room = (q[joint] - self.q[joint]).abs();
                return Some(Stop { distance: gone, joint, room, friction: self.friction_without(&q, joint, row) });
            }
        }
        None
    }

    fn rows(&self, q: &JointVec) -> Rows {
        let (chain, mut frames) = (self.model.chain(), Frames::default());
        let mut world = [[0.0; MAX_JOINTS]; MAX_AXES];
        chain.forward(q, &mut frames);
        chain.jacobian(&frames, &mut world);
        crate::task::rows(&world, &self.base_from_task, &self.plan.axes, self.plan.n)
    }

    /// Friction along `row` of all joints but one.
    fn friction_without(&self, q: &JointVec, joint: usize, row: usize) -> f64 {
        let (plan, n, k) = (self.plan, self.plan.n, self.plan.k);
        let mut scaled = plan.scale_rows(&self.rows(q), n);
        for r in &mut scaled {
            r[joint] = 0.0;
        }
        let sigma = singular_values(&DMatrix::from_fn(k, n, |r, i| scaled[r][i]));
        let (largest, smallest) = (sigma.max(), if k > n { 0.0 } else { sigma.min() });
        if smallest <= SINGULAR * largest {
            return f64::INFINITY;
        }
        let inverse = pseudo_inverse(&scaled, &[1.0; MAX_JOINTS], &[0.0; MAX_AXES], k, n);
        (0..n).map(|i| inverse[row][i].abs() * self.friction[i]).sum::<f64>() * plan.row_scale[row]
    }
}
