//! Many configurations at once: eight in every number, pieces of them on every core.

use rayon::prelude::*;

use super::jacobian::turn_to_tool;
use super::{Frames, Masses, Reference};
use crate::error::{Error, Result};
use crate::model::{Chain, Model};
use crate::number::{Arithmetic, Instructions, Kernel, LANES, Machine, Wide};
use crate::pose::COORDINATE_BOUND;
use crate::threads::on_every_core;
use crate::{MAX_AXES, MAX_JOINTS};

/// Configurations that a thread takes at once; fewer are done by the caller's thread.
const PIECE: usize = 4096;

impl Model {
    /// Poses (`N` × 4 × 4, row-major) and Jacobians (`N` × 6 × n) of `N` configurations (`N` × n); either may be empty, and
    /// is then not made.
    ///
    /// # Errors
    /// As [`Model::forward_kinematics`], with the row of the first bad configuration; [`Error::Shape`] where lengths do
    /// not fit together. The results are then meaningless.
    pub fn kinematics_batch(
        &self,
        q: &[f64],
        reference: Reference,
        poses: &mut [f64],
        jacobians: &mut [f64],
    ) -> Result<()> {
        let (n, count) = (self.n(), self.count(q)?);
        let (pose, jacobian) = (if poses.is_empty() { 0 } else { 16 }, if jacobians.is_empty() { 0 } else { 6 * n });
        check("poses", poses, count * pose)?;
        check("jacobians", jacobians, count * jacobian)?;
        let chain = self.chain();
        self.pieces(q, [(poses, pose), (jacobians, jacobian)], |q, [poses, jacobians]| {
            Instructions::chosen().run(PosePiece { chain, q, reference, poses, jacobians });
        })
    }

    /// Torques (`N` × n) [N·m or N] that hold the arm and its payload at `N` configurations (`N` × n).
    ///
    /// # Errors
    /// As [`Model::kinematics_batch`].
    pub fn gravity_batch(&self, q: &[f64], torques: &mut [f64]) -> Result<()> {
        let (n, count) = (self.n(), self.count(q)?);
        check("torques", torques, count * n)?;
        let (chain, masses, gravity) = (self.chain(), self.chain().masses(self.payload()), self.gravity_vector());
        self.pieces(q, [(torques, n), (&mut [], 0)], |q, [torques, _]| {
            Instructions::chosen().run(GravityPiece { chain, masses: &masses, gravity: &gravity, q, torques });
        })
    }

    fn count(&self, q: &[f64]) -> Result<usize> {
        if q.len().is_multiple_of(self.n()) {
            Ok(q.len() / self.n())
        } else {
            Err(Error::length("Q", q.len(), self.n()))
        }
    }

    /// Checks and works through all configurations, piece by piece, each with its part of the results.
    fn pieces(
        &self,
        q: &[f64],
        outs: [(&mut [f64], usize); 2],
        work: impl Fn(&[f64], [&mut [f64]; 2]) + Sync,
    ) -> Result<()> {
        let n = self.n();
        let piece = |(q, outs): (&[f64], [&mut [f64]; 2])| {
            // Before the numbers leave the cache again.
            let fine = q.iter().fold(true, |fine, value| fine & (value.abs() <= COORDINATE_BOUND));
            if fine {
                work(q, outs);
            }
            fine
        };
        let [(first, one), (second, two)] = outs;
        let fine = if q.len() <= PIECE * n {
            piece((q, [first, second]))
        } else {
            let mut parts = Vec::with_capacity(q.len() / (PIECE * n) + 1);
            let (mut first, mut second) = (first, second);
            for q in q.chunks(PIECE * n) {
                let count = q.len() / n;
                let (a, b);
                (a, first) = first.split_at_mut(count * one);
                (b, second) = second.split_at_mut(count * two);
                parts.push((q, [a, b]));
            }
            on_every_core(|| parts.into_par_iter().map(piece).reduce(|| true, |a, b| a & b))?
        };
        if fine {
            return Ok(());
        }
        for (row, q) in q.chunks_exact(n).enumerate() {
            self.joint_vector(q).map_err(|error| error.in_row("Q", row))?;
        }
        Ok(())
    }
}

fn check(what: &str, values: &[f64], expected: usize) -> Result<()> {
    if values.len() == expected { Ok(()) } else { Err(Error::length(what, values.len(), expected)) }
}

/// Eight configurations from the rows of `q`; the last one again where there are fewer.
#[inline(always)]
fn gather<A: Wide>(q: &[f64], n: usize) -> [A::Real; MAX_JOINTS] {
    let mut columns = [[0.0; LANES]; MAX_JOINTS];
    let last = (q.len() / n).saturating_sub(1);
    for lane in 0..LANES {
        let row = &q[lane.min(last) * n..][..n];
        for k in 0..n {
            columns[k & (MAX_JOINTS - 1)][lane] = row[k];
        }
    }
    let mut out = [A::splat(0.0); MAX_JOINTS];
    for k in 0..n.min(MAX_JOINTS) {
        out[k] = A::of(&columns[k]);
    }
    out
}

/// The first `size` numbers of each configuration into the rows of `out`; `numbers` come in whole eights.
#[inline(always)]
fn scatter<A: Wide>(numbers: &[A::Real], size: usize, out: &mut [f64]) {
    let lanes = (out.len() / size).min(LANES);
    let mut from = 0;
    while from < size {
        let Some(eight) = numbers[from..].first_chunk::<LANES>() else { return };
        let turned = A::transpose(eight);
        let width = LANES.min(size - from);
        for lane in 0..lanes {
            let to = &mut out[lane * size + from..][..width];
            match to.first_chunk_mut::<LANES>() {
                Some(to) => *to = turned[lane],
                None => to.copy_from_slice(&turned[lane][..width]),
            }
        }
        from += LANES;
    }
}

/// Poses and Jacobians of a piece.
struct PosePiece<'a> {
    chain: &'a Chain,
    q: &'a [f64],
    reference: Reference,
    poses: &'a mut [f64],
    jacobians: &'a mut [f64],
}

impl Kernel for PosePiece<'_> {
    type Output = ();

    #[inline(always)]
    fn run<M: Machine>(self) {
        let n = self.chain.n.clamp(1, MAX_JOINTS);
        let (zero, one) = (M::Eight::splat(0.0), M::Eight::splat(1.0));
        let mut rows = [[zero; MAX_JOINTS]; MAX_AXES];
        let mut flat = [zero; MAX_AXES * MAX_JOINTS];
        let (with_poses, with_jacobians) = (!self.poses.is_empty(), !self.jacobians.is_empty());
        let (mut poses, mut jacobians) = (self.poses.chunks_mut(16 * LANES), self.jacobians.chunks_mut(6 * n * LANES));
        for q in self.q.chunks(n * LANES) {
            let tool = self.chain.kinematics_by::<M::Eight>(&gather::<M::Eight>(q, n), &mut rows);
            if let Some(out) = poses.next().filter(|_| with_poses) {
                let (r, p) = (&tool.rotation, &tool.position);
                let mut numbers = [zero; 16];
                for i in 0..3 {
                    for c in 0..3 {
                        numbers[4 * i + c] = r[i][c];
                    }
                    numbers[4 * i + 3] = p[i];
                }
                numbers[15] = one;
                scatter::<M::Eight>(&numbers, 16, out);
            }
            if self.reference == Reference::Local {
                turn_to_tool::<M::Eight>(&tool.rotation, &mut rows, n);
            }
            if let Some(out) = jacobians.next().filter(|_| with_jacobians) {
                for r in 0..MAX_AXES {
                    for k in 0..n {
                        flat[r * n + k] = rows[r][k];
                    }
                }
                scatter::<M::Eight>(&flat, 6 * n, out);
            }
        }
    }
}

/// Holding torques of a piece.
struct GravityPiece<'a> {
    chain: &'a Chain,
    masses: &'a Masses,
    gravity: &'a [f64; 3],
    q: &'a [f64],
    torques: &'a mut [f64],
}

impl Kernel for GravityPiece<'_> {
    type Output = ();

    #[inline(always)]
    fn run<M: Machine>(self) {
        let n = self.chain.n.clamp(1, MAX_JOINTS);
        let zero = M::Eight::splat(0.0);
        let mut frames = Frames::filled(zero);
        let mut torques = [zero; MAX_JOINTS];
        for (q, out) in self.q.chunks(n * LANES).zip(self.torques.chunks_mut(n * LANES)) {
            self.chain.forward_by::<M::Eight>(&gather::<M::Eight>(q, n), &mut frames);
            self.chain.gravity_by::<M::Eight>(&frames, self.masses, self.gravity, &mut torques);
            scatter::<M::Eight>(&torques, n, out);
        }
    }
}
