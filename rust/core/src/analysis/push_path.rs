//! Simulated push along one task axis: the first position limit that a joint reaches, and the point of largest joint
//! friction, which shows that the path passes near a singular pose.

use nalgebra::DMatrix;

use crate::command::host_loss::TRAVEL;
use crate::kinematics::JointFrames;
use crate::math::ldlt6::{Ldlt6, pseudo_inverse};
use crate::math::rows::{load_rows, store_rows, tr_mul, weighted_gram};
use crate::math::simd::{BaselineF64, JointVec16, JointVector};
use crate::math::svd::singular_values;
use crate::model::Model;
use crate::params::Params;
use crate::{JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Number of steps in which a push is simulated.
const STEPS: u8 = 15;

/// Damping of the simulated motion, relative to the largest diagonal entry of `J K_p⁻¹ Jᵀ`: bounds the joint motion
/// near singular poses.
const DAMPING: f64 = 1e-7;

/// Ratio of the largest friction on the path to that at its start above which the steps next to the largest are
/// subdivided, because a singular pose may lie between two samples.
const REFINE_RATIO: f64 = 1.5;

/// Number of parts into which such a step is subdivided.
const PARTS: u8 = 8;

/// Damping λ of the pseudo-inverse from which the friction is computed, relative to the Frobenius norm of the task
/// rows: at a singular pose the friction is large, not ∞.
const FRICTION_DAMPING: f64 = 1e-3;

/// Ratio of smallest to largest singular value of the task rows at or below which the joints count as unable to move
/// all task axes.
const SINGULAR: f64 = 1e-3;

/// First position limit that a joint reaches during a push along one task axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointStop {
    /// Displacement of the axis at which the joint reaches its limit [m, rad]; on a shorter push the stop carries no
    /// force.
    pub distance: f64,
    /// Index of the joint that reaches its limit.
    pub joint: usize,
    /// Distance of that joint from its limit at the start of the push [rad; m if prismatic]; 0 if it is beyond.
    pub margin: f64,
    /// Friction `Σ_i |J⁺_ij| τ_f,i` of the other joints along the axis at the stop [N, N·m]; ∞ if they cannot move all
    /// task axes, so that the stop carries all force beyond the strength of the axis.
    pub friction: f64,
}

/// Result of a push simulated along one axis by 0.15 m or 0.4 rad, or up to the first stop.
#[derive(Debug, Clone, Copy)]
pub(super) struct PathResult {
    /// First position limit that a joint reaches; `None` if no joint reaches one.
    pub(super) stop: Option<JointStop>,
    /// Largest friction along the axis on the path, `Σ_i |J⁺_ij| τ_f,i` [N, N·m].
    pub(super) friction: f64,
    /// Smallest singular value of the scaled task rows at the point of largest friction.
    pub(super) sigma: f64,
    /// Displacement of the axis at the point of largest friction [m, rad].
    pub(super) at: f64,
}

/// Simulates pushes along one task axis while the other task axes keep their positions.
pub(super) struct PushPath<'a> {
    pub(super) model: &'a Model,
    pub(super) params: &'a Params,
    pub(super) base_from_task: [[f64; 3]; 3],
    pub(super) q: &'a JointVec,
    /// Static dry friction of each joint [N·m].
    pub(super) friction: &'a JointVec,
}

impl PushPath<'_> {
    /// Simulates a push along task axis `row` toward `sign` (±1).
    ///
    /// The joints move so that the springs of the servos store the least energy: `dq = K_p⁻¹ Jᵀ C⁻¹ d` with the unit
    /// displacement d and `C = J K_p⁻¹ Jᵀ`.
    pub(super) fn simulate(&self, row: usize, sign: f64) -> PathResult {
        let (params, n, k) = (self.params, self.params.n, self.params.k);
        let travel = TRAVEL[usize::from(params.per_axis[row].axis >= 3)];
        let (mut q, mut distance, mut stop) = (*self.q, 0.0, None);
        let mut samples = vec![(q, distance)];
        let compliance = JointVec16::load(&params.servos.compliance);
        let mut along = [0.0; MAX_AXES];
        along[row] = sign;
        for _ in 0..STEPS {
            let rows = load_rows(&self.rows(&q));
            let mut c = weighted_gram(&rows, compliance);
            let largest = (0..k).fold(0.0_f64, |max, r| max.max(c[r][r]));
            (0..k).for_each(|r| c[r][r] += DAMPING * largest);
            let direction = tr_mul(&rows, &Ldlt6::new::<BaselineF64>(&c).solve::<BaselineF64>(&along));
            let direction = (direction * compliance).to_joints();
            let (mut step, mut result) = (travel / f64::from(STEPS), None);
            for i in 0..n {
                let margin = if direction[i] > 0.0 { params.upper[i] - q[i] } else { q[i] - params.lower[i] };
                if margin.max(0.0) < step * direction[i].abs() {
                    (step, result) = (margin.max(0.0) / direction[i].abs(), Some(i));
                }
            }
            (0..n).for_each(|i| q[i] += step * direction[i]);
            distance += step;
            samples.push((q, distance));
            if let Some(joint) = result {
                let margin = (q[joint] - self.q[joint]).abs();
                stop = Some(JointStop { distance, joint, margin, friction: self.friction_without(&q, joint, row) });
                break;
            }
        }
        self.max_friction_sample(row, &samples, stop)
    }

    /// Returns the point of largest friction along axis `row`. A sample holds the joint positions [rad] and the
    /// displacement of the axis [m, rad].
    fn max_friction_sample(&self, row: usize, samples: &[(JointVec, f64)], stop: Option<JointStop>) -> PathResult {
        let evaluate = |q: &JointVec, at: f64| {
            let rows = self.scaled(q);
            (self.friction_along(&rows, row), at, rows)
        };
        let all: Vec<_> = samples.iter().map(|(q, at)| evaluate(q, *at)).collect();
        let index = (0..all.len()).fold(0, |best, i| if all[i].0 > all[best].0 { i } else { best });
        let mut worst = all[index];
        // A singular pose may lie between two samples: subdivide the steps next to the largest friction.
        if worst.0 > REFINE_RATIO * all[0].0 {
            for pair in samples[index.saturating_sub(1)..(index + 2).min(samples.len())].windows(2) {
                let ((from, near), (to, far)) = (pair[0], pair[1]);
                for part in 1..PARTS {
                    let share = f64::from(part) / f64::from(PARTS);
                    let between = std::array::from_fn(|i| from[i] + share * (to[i] - from[i]));
                    let here = evaluate(&between, near + share * (far - near));
                    worst = if here.0 > worst.0 { here } else { worst };
                }
            }
        }
        let (friction, at, rows) = worst;
        PathResult { stop, friction, sigma: self.sigma(&rows)[0], at }
    }

    fn rows(&self, q: &JointVec) -> Rows {
        let (chain, mut frames) = (self.model.chain(), JointFrames::default());
        let mut j_base = [[0.0; MAX_JOINTS]; MAX_AXES];
        chain.forward(q, &mut frames);
        chain.jacobian(&frames, &mut j_base);
        crate::kinematics::task_rows(&j_base, &self.base_from_task, &self.params.axes)
    }

    fn scaled(&self, q: &JointVec) -> Rows {
        store_rows(&self.params.scale_rows(&load_rows::<JointVec16>(&self.rows(q))))
    }

    /// Returns the friction along axis `row` of all joints except `joint` [N, N·m]; ∞ if these cannot move all task
    /// axes.
    fn friction_without(&self, q: &JointVec, joint: usize, row: usize) -> f64 {
        let (params, mut scaled) = (self.params, self.scaled(q));
        for r in &mut scaled {
            r[joint] = 0.0;
        }
        let [smallest, largest] = self.sigma(&scaled);
        if params.k > params.n || smallest <= SINGULAR * largest {
            f64::INFINITY
        } else {
            self.friction_along(&scaled, row)
        }
    }

    /// Returns the friction along axis `row`, `Σ_i |J⁺_ij| τ_f,i` [N, N·m], from the scaled task rows.
    fn friction_along(&self, scaled: &Rows, row: usize) -> f64 {
        let (params, n, k) = (self.params, self.params.n, self.params.k);
        let size = scaled[..k].iter().flatten().map(|x| x * x).sum::<f64>();
        let inverse =
            pseudo_inverse(scaled, &[1.0; MAX_JOINTS], &[FRICTION_DAMPING * FRICTION_DAMPING * size; MAX_AXES]);
        (0..n).map(|i| inverse[row][i].abs() * self.friction[i]).sum::<f64>() * params.row_scale[row]
    }

    /// Returns the smallest and the largest singular value of the scaled task rows.
    fn sigma(&self, scaled: &Rows) -> [f64; 2] {
        let all = singular_values(&DMatrix::from_fn(self.params.k, self.params.n, |r, i| scaled[r][i]));
        [all.min(), all.max()]
    }
}
