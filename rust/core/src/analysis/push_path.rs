//! Path of the arm under a push: the first position limit on it, the friction of the remaining joints there, and the
//! singular poses that it passes.

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

/// Number of steps on the path.
const STEPS: u8 = 15;

/// Damping on the path, as a share of the largest entry of `J K_p⁻¹ Jᵀ`: bounds the motion near singular poses.
const DAMPING: f64 = 1e-7;

/// Growth of the friction above which the adjacent steps are subdivided, and the number of parts.
const REFINE_RATIO: f64 = 1.5;
const PARTS: u8 = 8;

/// Damping of the friction, as a share of the largest singular value: at a singular pose the friction is large, not ∞.
const FRICTION_DAMPING: f64 = 1e-3;

/// Ratio of smallest to largest singular value below which the remaining joints cannot move an axis alone.
const SINGULAR: f64 = 1e-3;

/// The first position limit on the path along one axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointStop {
    /// Displacement of the axis at which it is met [m, rad]. Up to there the stop carries no part of a push.
    pub distance: f64,
    /// Index of the joint that meets it.
    pub joint: usize,
    /// Present distance of that joint from its limit [rad or m].
    pub margin: f64,
    /// Friction `Σ_i |J⁺_ij| τ_f,i` of the other joints along the axis at the stop [N, N·m]; ∞ if they cannot move the
    /// axis alone, so that the stop carries everything above the cap.
    pub friction: f64,
}

/// The path along one axis, 0.15 m or 0.4 rad, or up to the first stop.
#[derive(Debug, Clone, Copy)]
pub(super) struct PathResult {
    pub(super) stop: Option<JointStop>,
    /// Largest `Σ_i |J⁺_ij| τ_f,i` on the path [N, N·m].
    pub(super) friction: f64,
    /// σ_min at that point.
    pub(super) sigma: f64,
    /// Displacement at that point [m, rad].
    pub(super) at: f64,
}

/// Simulation of a push on an arm whose other axes keep their place.
pub(super) struct PushPath<'a> {
    pub(super) model: &'a Model,
    pub(super) params: &'a Params,
    pub(super) base_from_task: [[f64; 3]; 3],
    pub(super) q: &'a JointVec,
    /// Dry friction at rest [N·m].
    pub(super) friction: &'a JointVec,
}

impl PushPath<'_> {
    /// Simulates a push along one task axis, toward `sign`.
    ///
    /// The arm moves so that the servos' springs are stretched least, `dq = K_p⁻¹ Jᵀ C⁻¹ d`, as under line 8.
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

    /// Returns the point with the largest friction on a path of postures and displacements.
    fn max_friction_sample(&self, row: usize, samples: &[(JointVec, f64)], stop: Option<JointStop>) -> PathResult {
        let evaluate = |q: &JointVec, at: f64| {
            let rows = self.scaled(q);
            (self.friction_along(&rows, row), at, rows)
        };
        let all: Vec<_> = samples.iter().map(|(q, at)| evaluate(q, *at)).collect();
        let index = (0..all.len()).fold(0, |best, i| if all[i].0 > all[best].0 { i } else { best });
        let mut worst = all[index];
        // A step may pass over a singular pose: subdivide the adjacent steps.
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

    /// Returns the friction along `row` of all joints but one.
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

    /// `Σ_i |J⁺_ij| τ_f,i` of scaled rows [N, N·m].
    fn friction_along(&self, scaled: &Rows, row: usize) -> f64 {
        let (params, n, k) = (self.params, self.params.n, self.params.k);
        let size = scaled[..k].iter().flatten().map(|x| x * x).sum::<f64>();
        let inverse =
            pseudo_inverse(scaled, &[1.0; MAX_JOINTS], &[FRICTION_DAMPING * FRICTION_DAMPING * size; MAX_AXES]);
        (0..n).map(|i| inverse[row][i].abs() * self.friction[i]).sum::<f64>() * params.row_scale[row]
    }

    /// Returns the smallest and the largest singular value of scaled rows.
    fn sigma(&self, scaled: &Rows) -> [f64; 2] {
        let all = singular_values(&DMatrix::from_fn(self.params.k, self.params.n, |r, i| scaled[r][i]));
        [all.min(), all.max()]
    }
}
