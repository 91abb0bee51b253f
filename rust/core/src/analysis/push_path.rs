//! Simulated push along one task axis: the first position limit that a joint reaches, and the point of largest joint
//! friction, which shows that the path passes near a singular pose.

use nalgebra::DMatrix;

use crate::command::host_loss::TRAVEL;
use crate::kinematics::Reference;
use crate::math::ldlt6::{Ldlt6, factor_gram};
use crate::math::rows::{load_rows, tr_mul, weighted_gram};
use crate::math::simd::{BaselineF64, JointVec16, JointVector, RealOps, SimdLevel};
use crate::math::svd::singular_values;
use crate::model::Model;
use crate::params::Params;
use crate::task::rows_in;
use crate::{JointVec, MAX_AXES, MAX_JOINTS};

/// Number of steps in which a push is simulated.
const STEPS: u8 = 15;

/// Damping that bounds the simulated joint motion near singular poses, relative to the largest diagonal entry of `J
/// K_p⁻¹ Jᵀ`.
const DAMPING: f64 = 1e-7;

/// A singular pose may lie between two samples. If the largest friction on the path exceeds this factor times the
/// friction at its start, the steps on both sides of it are subdivided.
const REFINE_RATIO: f64 = 1.5;

/// Number of parts into which a step is subdivided.
const PARTS: u8 = 8;

/// Damping λ, relative to the Frobenius norm of the task rows, of the pseudo-inverse from which the friction is
/// computed. With it, the friction at a singular pose is large, but finite.
const FRICTION_DAMPING: f64 = 1e-3;

/// If the ratio of the smallest to the largest singular value of the task rows is not above this, the joints count as
/// unable to move all task axes.
const SINGULAR: f64 = 1e-3;

/// First position limit that a joint reaches during a push along one task axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointStop {
    /// Displacement of the axis at which the joint reaches its limit [m, rad]. Beyond it the stop carries part of the
    /// push.
    pub distance: f64,
    /// Index of the joint that reaches its limit.
    pub joint: usize,
    /// Distance of that joint from its limit at the start of the push [rad; m if prismatic]; 0 if it is beyond.
    pub margin: f64,
    /// Friction `Σ_i |J⁺_ij| τ_f,i` of the other joints along the axis at the stop [N, N·m]; ∞ if they cannot move all
    /// task axes. The stop then carries all force beyond the strength of the axis.
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

/// One point on the path of a push.
#[derive(Debug, Clone, Copy)]
struct Sample {
    /// Joint positions [rad].
    q: JointVec,
    /// Displacement of the axis [m, rad].
    distance: f64,
    /// Task rows, with translations divided by the arm's length.
    scaled: TaskRows,
    /// Friction along the axis [N, N·m].
    friction: f64,
}

/// Six rows over the joints, zeros after the last task axis.
type TaskRows = [JointVec16; MAX_AXES];

/// Simulates pushes along one task axis while the other task axes keep their positions.
pub(super) struct PushPath<'a> {
    pub(super) simd_level: SimdLevel,
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
        let mut rows: TaskRows = self.rows(&q);
        let mut samples = Vec::with_capacity(usize::from(STEPS) + 1);
        samples.push(self.sample(&q, distance, &rows, row));
        let compliance = JointVec16::load(&params.servos.compliance);
        let mut along = [0.0; MAX_AXES];
        along[row] = sign;
        for _ in 0..STEPS {
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
            rows = self.rows(&q);
            samples.push(self.sample(&q, distance, &rows, row));
            if let Some(joint) = result {
                let margin = (q[joint] - self.q[joint]).abs();
                stop = Some(JointStop { distance, joint, margin, friction: self.friction_without(&rows, joint, row) });
                break;
            }
        }
        let worst = self.max_friction_sample(row, &samples);
        PathResult { stop, friction: worst.friction, sigma: self.sigma(&worst.scaled)[0], at: worst.distance }
    }

    /// Returns the point of the path with the largest friction along axis `row`.
    fn max_friction_sample(&self, row: usize, samples: &[Sample]) -> Sample {
        let index =
            (0..samples.len()).fold(0, |best, i| if samples[i].friction > samples[best].friction { i } else { best });
        let mut worst = samples[index];
        // A singular pose may lie between two samples: subdivide the steps next to the largest friction.
        if worst.friction > REFINE_RATIO * samples[0].friction {
            for pair in samples[index.saturating_sub(1)..(index + 2).min(samples.len())].windows(2) {
                let (from, to) = (&pair[0], &pair[1]);
                for part in 1..PARTS {
                    let share = f64::from(part) / f64::from(PARTS);
                    let between = std::array::from_fn(|i| from.q[i] + share * (to.q[i] - from.q[i]));
                    let distance = from.distance + share * (to.distance - from.distance);
                    let here = self.sample(&between, distance, &self.rows(&between), row);
                    worst = if here.friction > worst.friction { here } else { worst };
                }
            }
        }
        worst
    }

    /// Returns the sample of a push along axis `row` at the joint positions `q` with these task rows.
    fn sample(&self, q: &JointVec, distance: f64, rows: &TaskRows, row: usize) -> Sample {
        let scaled = self.params.scale_rows(rows);
        Sample { q: *q, distance, scaled, friction: self.friction_along(&scaled, row) }
    }

    /// Returns the Jacobian rows of the task axes at `q`, before `Params::scale_rows`.
    fn rows(&self, q: &JointVec) -> TaskRows {
        let mut j_base = [[0.0; MAX_JOINTS]; MAX_AXES];
        self.model.chain().pose_and_rows(self.simd_level, q, Reference::WorldAligned, &mut j_base);
        let (params, mut storage) = (self.params, None);
        *rows_in(&params.frame, &load_rows(&j_base), &self.base_from_task, &params.axes, &mut storage)
    }

    /// Returns the friction along axis `row` of all joints except `joint` [N, N·m]; ∞ if these cannot move all task
    /// axes.
    fn friction_without(&self, rows: &TaskRows, joint: usize, row: usize) -> f64 {
        let params = self.params;
        let mut others = [1.0; MAX_JOINTS];
        others[joint] = 0.0;
        let others = JointVec16::load(&others);
        let scaled = params.scale_rows(rows).map(|row| row * others);
        let [smallest, largest] = self.sigma(&scaled);
        if params.k > params.n || smallest <= SINGULAR * largest {
            f64::INFINITY
        } else {
            self.friction_along(&scaled, row)
        }
    }

    /// Returns the friction along axis `row`, `Σ_i |J⁺_ij| τ_f,i` [N, N·m], from the scaled task rows.
    fn friction_along(&self, scaled: &TaskRows, row: usize) -> f64 {
        let size = scaled.iter().fold(JointVec16::splat(0.0), |sum, row| JointVec16::fma(*row, *row, sum)).sum();
        let damping = [FRICTION_DAMPING * FRICTION_DAMPING * size; MAX_AXES];
        let mut along = [0.0; MAX_AXES];
        along[row] = 1.0;
        // Solve for column `row` of J⁺ = Jᵀ (J Jᵀ + δ²)⁻¹ only.
        let column = factor_gram(scaled, JointVec16::splat(1.0), &damping).solve::<BaselineF64>(&along);
        let felt = JointVec16::abs(tr_mul(scaled, &column)) * JointVec16::load(self.friction);
        felt.sum() * self.params.row_scale[row]
    }

    /// Returns the smallest and the largest singular value of the scaled task rows.
    fn sigma(&self, scaled: &TaskRows) -> [f64; 2] {
        let scaled = scaled.map(JointVector::to_joints);
        let all = singular_values(&DMatrix::from_fn(self.params.k, self.params.n, |r, i| scaled[r][i]));
        [all.min(), all.max()]
    }
}
