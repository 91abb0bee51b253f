//! Responsibility (6), (7), activation (10) and the joint torque limits of (11).

use nalgebra::DMatrix;

use crate::law::nullspace::JointSquare;
use crate::{AxisVec, JointVec, MAX_AXES, MAX_JOINTS, Rows};

/// Size of `N∇g` [rad] below which the null column turns into the row norms of `N`.
const GRADIENT_THRESHOLD: f64 = 1e-3;

/// Activation matrix, transposed: row r holds the shares of task axis r, the last row those of the null-space motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Activation {
    pub(crate) task: Rows,
    pub(crate) null: JointVec,
}

/// (10): the columns of `|J⁺|`, each divided by its sum.
///
/// The size of Δx in (6) cancels, which also settles the 0/0 of an axis at rest. `null_space` is `N` and the gradient
/// of the null-space cost; `None` where the arm is not redundant, which leaves the null column zero.
pub(crate) fn activation(
    pinv_transposed: &Rows,
    null_space: Option<(&JointSquare, &JointVec)>,
    k: usize,
    n: usize,
) -> Activation {
    let mut task = [[0.0; MAX_JOINTS]; MAX_AXES];
    for (row, source) in task.iter_mut().zip(pinv_transposed).take(k) {
        *row = shares(&source.map(f64::abs), n);
    }
    let null = null_space.map_or([0.0; MAX_JOINTS], |(projector, gradient)| null_column(projector, gradient, n));
    Activation { task, null }
}

/// (6), (7): `|J⁺ diag(Δx)|` and `|α N∇g|`, the shares of [`activation`] before they are divided by their sums.
pub(crate) fn responsibility(
    pinv_transposed: &Rows,
    dx: &AxisVec,
    (projector, gradient): (&JointSquare, &JointVec),
    alpha: f64,
    k: usize,
    n: usize,
) -> Activation {
    let mut task = [[0.0; MAX_JOINTS]; MAX_AXES];
    for (row, (source, speed)) in task.iter_mut().zip(pinv_transposed.iter().zip(dx)).take(k) {
        *row = source.map(|value| (value * speed).abs());
    }
    let mut null = [0.0; MAX_JOINTS];
    for (share, row) in null.iter_mut().zip(projector).take(n) {
        *share = (alpha * (0..n.min(MAX_JOINTS)).map(|j| row[j] * gradient[j]).sum::<f64>()).abs();
    }
    Activation { task, null }
}

/// Shares of the joints in the null-space motion: `|N∇g|`, blended into the row norms of `N` where it vanishes.
fn null_column(projector: &JointSquare, gradient: &JointVec, n: usize) -> JointVec {
    let n = n.min(MAX_JOINTS);
    let (mut motion, mut norms) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
    for i in 0..n {
        let row = &projector[i];
        motion[i] = (0..n).map(|j| row[j] * gradient[j]).sum::<f64>().abs();
        norms[i] = (0..n).map(|j| row[j] * row[j]).sum::<f64>().sqrt();
    }
    let size: f64 = motion.iter().sum();
    let blend = ((size - GRADIENT_THRESHOLD) / GRADIENT_THRESHOLD).clamp(0.0, 1.0);
    let (motion, norms) = (shares(&motion, n), shares(&norms, n));
    let mut out = [0.0; MAX_JOINTS];
    for i in 0..n {
        out[i] = blend * motion[i] + (1.0 - blend) * norms[i];
    }
    out
}

fn shares(sizes: &JointVec, n: usize) -> JointVec {
    let sum: f64 = sizes.iter().take(n).sum();
    if sum > 0.0 { sizes.map(|value| value / sum) } else { [0.0; MAX_JOINTS] }
}

impl Activation {
    /// As an n × (k + 1) matrix, the null-space column last.
    pub(crate) fn matrix(&self, k: usize, n: usize) -> DMatrix<f64> {
        DMatrix::from_fn(n, k + 1, |i, r| if r < k { self.task[r][i] } else { self.null[i] })
    }

    /// (11): `τ^q = A τ^x` [N·m], the null-space torque last.
    pub(crate) fn distribute(&self, strength: &AxisVec, null_torque: f64, k: usize) -> JointVec {
        let mut out = self.null.map(|share| share * null_torque);
        for r in 0..k.min(MAX_AXES) {
            for i in 0..MAX_JOINTS {
                out[i] += self.task[r][i] * strength[r];
            }
        }
        out
    }
}
