//! Where a push leads: until a joint meets its position limit, what the joints that are left make of it, and past which
//! singular pose.

use nalgebra::DMatrix;

use crate::command::host_loss::TRAVEL;
use crate::kinematics::Frames;
use crate::law::inverse::{Factor, load_rows, pseudo_inverse, rows_array, transpose_times, weighted_gram};
use crate::law::svd::singular_values;
use crate::model::Model;
use crate::number::{EveryJoint, Lanes, Plain};
use crate::plan::Plan;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Steps on the way.
const STEPS: u8 = 15;

/// Damping of the way, as a share of the largest entry of `J K_p⁻¹ Jᵀ`: a singular pose on it must not throw the arm.
const DAMPING: f64 = 1e-7;

/// Growth of what joints rub from which on the steps beside are looked at in so many parts.
const CLOSELY: f64 = 1.5;
const PARTS: u8 = 8;

/// Damping of what joints rub, as a share of the largest singular value or more: at a singular pose it is large, not ∞.
const BLUNT: f64 = 1e-3;

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

/// The way along one axis, 0.15 m or 0.4 rad, or as far as the first stop.
#[derive(Debug, Clone, Copy)]
pub(super) struct Push {
    pub(super) stop: Option<Stop>,
    /// `Σ_i |J⁺_ij| τ_f,i` where it is largest on the way [N, N·m].
    pub(super) friction: f64,
    /// σ_min there.
    pub(super) sigma: f64,
    /// Displacement there [m, rad].
    pub(super) at: f64,
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
    /// Follows a push along one task axis, toward `sign`.
    ///
    /// The arm goes where the servos' springs are stretched least, `dq = K_p⁻¹ Jᵀ C⁻¹ d`, as under line 8.
    pub(super) fn follow(&self, row: usize, sign: f64) -> Push {
        let (plan, n, k) = (self.plan, self.plan.n, self.plan.k);
        let travel = TRAVEL[usize::from(plan.rows[row].axis >= 3)];
        let (mut q, mut gone, mut stop) = (*self.q, 0.0, None);
        let mut trail = vec![(q, gone)];
        let compliance = EveryJoint::load(&plan.servos.compliance);
        let mut along = [0.0; MAX_AXES];
        along[row] = sign;
        for _ in 0..STEPS {
            let rows = load_rows(&self.rows(&q));
            let mut c = weighted_gram(&rows, compliance);
            let largest = (0..k).fold(0.0_f64, |most, r| most.max(c[r][r]));
            (0..k).for_each(|r| c[r][r] += DAMPING * largest);
            let way = transpose_times(&rows, &Factor::new::<Plain>(&c).solve::<Plain>(&along));
            let way = (way * compliance).array();
            let (mut step, mut met) = (travel / f64::from(STEPS), None);
            for i in 0..n {
                let room = if way[i] > 0.0 { plan.upper[i] - q[i] } else { q[i] - plan.lower[i] };
                if room.max(0.0) < step * way[i].abs() {
                    (step, met) = (room.max(0.0) / way[i].abs(), Some(i));
                }
            }
            (0..n).for_each(|i| q[i] += step * way[i]);
            gone += step;
            trail.push((q, gone));
            if let Some(joint) = met {
                let room = (q[joint] - self.q[joint]).abs();
                stop = Some(Stop { distance: gone, joint, room, friction: self.friction_without(&q, joint, row) });
                break;
            }
        }
        self.rubbed_most(row, &trail, stop)
    }

    /// The place on a trail of postures and displacements where the joints rub most.
    fn rubbed_most(&self, row: usize, trail: &[(JointVec, f64)], stop: Option<Stop>) -> Push {
        let seen = |q: &JointVec, at: f64| {
            let rows = self.scaled(q);
            (self.rubs(&rows, row), at, rows)
        };
        let all: Vec<_> = trail.iter().map(|(q, at)| seen(q, *at)).collect();
        let index = (0..all.len()).fold(0, |best, i| if all[i].0 > all[best].0 { i } else { best });
        let mut worst = all[index];
        // A step may pass over a singular pose: what lies beside is looked at more closely.
        if worst.0 > CLOSELY * all[0].0 {
            for pair in trail[index.saturating_sub(1)..(index + 2).min(trail.len())].windows(2) {
                let ((from, near), (to, far)) = (pair[0], pair[1]);
                for part in 1..PARTS {
                    let share = f64::from(part) / f64::from(PARTS);
                    let between = std::array::from_fn(|i| from[i] + share * (to[i] - from[i]));
                    let here = seen(&between, near + share * (far - near));
                    worst = if here.0 > worst.0 { here } else { worst };
                }
            }
        }
        let (friction, at, rows) = worst;
        Push { stop, friction, sigma: self.sigma(&rows)[0], at }
    }

    fn rows(&self, q: &JointVec) -> Rows {
        let (chain, mut frames) = (self.model.chain(), Frames::default());
        let mut world = [[0.0; MAX_JOINTS]; MAX_AXES];
        chain.forward(q, &mut frames);
        chain.jacobian(&frames, &mut world);
        crate::task::rows(&world, &self.base_from_task, &self.plan.axes)
    }

    fn scaled(&self, q: &JointVec) -> Rows {
        rows_array(&self.plan.scale_rows(&load_rows::<EveryJoint>(&self.rows(q))))
    }

    /// Friction along `row` of all joints but one.
    fn friction_without(&self, q: &JointVec, joint: usize, row: usize) -> f64 {
        let (plan, mut scaled) = (self.plan, self.scaled(q));
        for r in &mut scaled {
            r[joint] = 0.0;
        }
        let [smallest, largest] = self.sigma(&scaled);
        if plan.k > plan.n || smallest <= SINGULAR * largest { f64::INFINITY } else { self.rubs(&scaled, row) }
    }

    /// `Σ_i |J⁺_ij| τ_f,i` of scaled rows [N, N·m].
    fn rubs(&self, scaled: &Rows, row: usize) -> f64 {
        let (plan, n, k) = (self.plan, self.plan.n, self.plan.k);
        let size = scaled[..k].iter().flatten().map(|x| x * x).sum::<f64>();
        let inverse = pseudo_inverse(scaled, &[1.0; MAX_JOINTS], &[BLUNT * BLUNT * size; MAX_AXES]);
        (0..n).map(|i| inverse[row][i].abs() * self.friction[i]).sum::<f64>() * plan.row_scale[row]
    }

    /// The smallest and the largest singular value of scaled rows.
    fn sigma(&self, scaled: &Rows) -> [f64; 2] {
        let all = singular_values(&DMatrix::from_fn(self.plan.k, self.plan.n, |r, i| scaled[r][i]));
        [all.min(), all.max()]
    }
}
