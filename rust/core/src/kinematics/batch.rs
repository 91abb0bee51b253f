//! Many configurations at once: as many in every number as a register holds, pieces of them on every core.

use rayon::prelude::*;

use super::jacobian::turn_to_tool;
use super::{Frames, Masses, Reference};
use crate::error::{Error, Result};
use crate::model::{Chain, Model};
use crate::number::{Arithmetic, Instructions, Kernel, LANES, Machine, Many, Packed};
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

/// One number per joint, or entry of a pose, from the rows of `values`, each `size` long: 0 behind the last. Where there are
/// fewer rows than configurations, the last one again.
#[inline(always)]
pub(crate) fn gather<A: Many>(values: &[f64], size: usize) -> [A; MAX_JOINTS] {
    let (mut out, last) = ([A::splat(0.0); MAX_JOINTS], (values.len() / size).saturating_sub(1));
    let mut from = 0;
    while from < size.min(MAX_JOINTS) {
        let mut rows = [[0.0; LANES]; LANES];
        for lane in 0..A::COUNT {
            let row = &values[lane.min(last) * size + from..];
            // What is read behind the row's end is not used.
            match row.first_chunk::<LANES>() {
                Some(row) => rows[lane] = *row,
                None => rows[lane][..row.len()].copy_from_slice(row),
            }
        }
        let columns = A::columns(&rows);
        for k in 0..LANES.min(size - from) {
            out[(from + k) & (MAX_JOINTS - 1)] = columns[k];
        }
        from += LANES;
    }
    out
}

/// Rows as long as poses and Jacobians are, on their way to memory.
pub(crate) struct Stage([[[f64; LANES]; LANES]; MAX_AXES * MAX_JOINTS / LANES]);

impl Stage {
    pub(crate) const fn new() -> Self {
        Self([[[0.0; LANES]; LANES]; MAX_AXES * MAX_JOINTS / LANES])
    }

    /// The first `size` numbers of the first `count` configurations into the rows of `out`; `numbers` come in whole eights.
    ///
    /// Behind these rows `out` may be overwritten: whoever goes on writes the next rows there.
    #[inline(always)]
    pub(crate) fn scatter<A: Many>(&mut self, numbers: &[A], size: usize, count: usize, out: &mut [f64]) {
        for (turned, eight) in self.0.iter_mut().zip(numbers.as_chunks::<LANES>().0).take(size.div_ceil(LANES)) {
            *turned = A::transpose(eight);
        }
        for (lane, row) in (0..count.min(A::COUNT)).zip((0..).step_by(size)) {
            for (turned, at) in self.0.iter().zip((0..size).step_by(LANES)) {
                let to = &mut out[row + at..];
                match to.first_chunk_mut::<LANES>() {
                    Some(to) => *to = turned[lane],
                    None => to.copy_from_slice(&turned[lane][..to.len()]),
                }
            }
        }
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
        let (zero, one, count) = (M::Many::splat(0.0), M::Many::splat(1.0), M::Many::COUNT);
        let mut rows = [[zero; MAX_JOINTS]; MAX_AXES];
        let mut flat = [zero; MAX_AXES * MAX_JOINTS];
        let (with_poses, with_jacobians) = (!self.poses.is_empty(), !self.jacobians.is_empty());
        let (mut stage, total) = (Stage::new(), self.q.len() / n);
        for from in (0..total).step_by(count) {
            let here = count.min(total - from);
            let tool = self.chain.kinematics_by::<M::Many>(&gather::<M::Many>(&self.q[n * from..], n), &mut rows);
            if with_poses {
                let (r, p) = (&tool.rotation, &tool.position);
                let mut numbers = [zero; 16];
                for i in 0..3 {
                    for c in 0..3 {
                        numbers[4 * i + c] = r[i][c];
                    }
                    numbers[4 * i + 3] = p[i];
                }
                numbers[15] = one;
                stage.scatter(&numbers, 16, here, &mut self.poses[16 * from..]);
            }
            if self.reference == Reference::Local {
                turn_to_tool::<M::Many>(&tool.rotation, &mut rows, n);
            }
            if with_jacobians {
                for r in 0..MAX_AXES {
                    for k in 0..n {
                        flat[r * n + k] = rows[r][k];
                    }
                }
                stage.scatter(&flat, 6 * n, here, &mut self.jacobians[6 * n * from..]);
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
        let (zero, count) = (M::Many::splat(0.0), M::Many::COUNT);
        let mut frames = Frames::filled(zero);
        let mut torques = [zero; MAX_JOINTS];
        let (mut stage, total) = (Stage::new(), self.q.len() / n);
        for from in (0..total).step_by(count) {
            let here = count.min(total - from);
            self.chain.forward_by::<M::Many>(&gather::<M::Many>(&self.q[n * from..], n), &mut frames);
            self.chain.gravity_by::<M::Many>(&frames, self.masses, self.gravity, &mut torques);
            stage.scatter(&torques, n, here, &mut self.torques[n * from..]);
        }
    }
}
