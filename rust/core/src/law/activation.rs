//! Responsibility (6), (7), activation (10) and the joint torque limits of (11).

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
