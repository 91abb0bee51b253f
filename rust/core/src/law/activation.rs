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

/// (10): the columns of `|J⁺|`, each divided by its sum, and the null-space column.
///
/// The size of Δx in (6) cancels, which also settles the 0/0 of an axis at rest.
#[inline(always)]
pub(crate) fn activation(pinv_transposed: &Rows, null: JointVec, k: usize, n: usize) -> Activation {
    let mut task = [[0.0; MAX_JOINTS]; MAX_AXES];
    for r in 0..k.min(MAX_AXES) {
        task[r] = shares(&sizes(&pinv_transposed[r], n), n);
    }
    Activation { task, null }
}

/// (6), (7): `|J⁺ diag(Δx)|` and `|α N∇g|`, the shares of [`activation`] before they are divided by their sums.
pub(crate) fn responsibility(
    pinv_transposed: &Rows,
    dx: &AxisVec,
    null_motion: &JointVec,
    alpha: f64,
    k: usize,
) -> Activation {
    let mut task = [[0.0; MAX_JOINTS]; MAX_AXES];
    for (row, (source, speed)) in task.iter_mut().zip(pinv_transposed.iter().zip(dx)).take(k) {
        *row = source.map(|value| (value * speed).abs());
    }
    Activation { task, null: null_motion.map(|motion| (alpha * motion).abs()) }
}

/// Shares of the joints in the null-space motion `N∇g`: its sizes, blended into the row norms of `N` where it vanishes.
///
/// `projector` is asked only there: forming N costs more than all the rest.
#[inline(always)]
pub(crate) fn null_column(motion: &JointVec, projector: impl FnOnce() -> JointSquare, n: usize) -> JointVec {
    let motion = sizes(motion, n);
    let size: f64 = motion.iter().take(n).sum();
    let blend = ((size - GRADIENT_THRESHOLD) / GRADIENT_THRESHOLD).clamp(0.0, 1.0);
    let motion = shares(&motion, n);
    if blend >= 1.0 {
        return motion;
    }
    blended(&motion, blend, &projector(), n)
}

#[cold]
fn blended(motion: &JointVec, blend: f64, projector: &JointSquare, n: usize) -> JointVec {
    let norms = projector.map(|row| row.iter().take(n).map(|x| x * x).sum::<f64>().sqrt());
    let norms = shares(&norms, n);
    let mut out = [0.0; MAX_JOINTS];
    for i in 0..n.min(MAX_JOINTS) {
        out[i] = blend * motion[i] + (1.0 - blend) * norms[i];
    }
    out
}

/// `M v` of an n × n matrix.
pub(crate) fn product(m: &JointSquare, v: &JointVec, n: usize) -> JointVec {
    m.map(|row| row.iter().zip(v).take(n).map(|(a, b)| a * b).sum())
}

#[inline(always)]
fn sizes(values: &JointVec, n: usize) -> JointVec {
    let mut out = [0.0; MAX_JOINTS];
    for i in 0..n.min(MAX_JOINTS) {
        out[i] = values[i].abs();
    }
    out
}

#[inline(always)]
fn shares(sizes: &JointVec, n: usize) -> JointVec {
    let n = n.min(MAX_JOINTS);
    let sum: f64 = sizes[..n].iter().sum();
    // One over a denormal sum is infinite, and infinity times a joint at rest is not a number.
    let factor = 1.0 / sum.max(f64::MIN_POSITIVE);
    let mut out = [0.0; MAX_JOINTS];
    for i in 0..n {
        out[i] = factor * sizes[i];
    }
    out
}

impl Activation {
    /// As an n × (k + 1) matrix, the null-space column last.
    pub(crate) fn matrix(&self, k: usize, n: usize) -> DMatrix<f64> {
        DMatrix::from_fn(n, k + 1, |i, r| if r < k { self.task[r][i] } else { self.null[i] })
    }

    /// (11): `τ^q = A τ^x` [N·m], the null-space torque last.
    #[inline(always)]
    pub(crate) fn distribute(&self, strength: &AxisVec, null_torque: f64, k: usize, n: usize) -> JointVec {
        let n = n.min(MAX_JOINTS);
        let mut out = [0.0; MAX_JOINTS];
        for i in 0..n {
            out[i] = self.null[i] * null_torque;
        }
        for r in 0..k.min(MAX_AXES) {
            for i in 0..n {
                out[i] += self.task[r][i] * strength[r];
            }
        }
        out
    }
}
