//! Many configurations at once: as many in every number as a register holds, pieces of them on every core.

use rayon::prelude::*;

use super::jacobian::turn_to_tool;
use super::{Frames, Masses, Reference};
use crate::error::{Error, Result};
use crate::model::{Chain, Model};
use crate::number::{Arithmetic, Instructions, Kernel, LANES, Machine, Many, PAST_THE_CACHES, Packed, settle, stream};
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
        let past_the_caches = size_of_val(poses) + size_of_val(jacobians) >= PAST_THE_CACHES;
        self.pieces(q, [(poses, pose), (jacobians, jacobian)], |q, [poses, jacobians]| {
            Instructions::chosen().run(PosePiece { chain, q, reference, past_the_caches, poses, jacobians });
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

/// One number per joint, or entry of a pose, from the rows of `values`, each `size` long; anything behind the last. Where
/// there are fewer rows than configurations, the last one again.
#[inline(always)]
pub(crate) fn gather<A: Many>(values: &[f64], size: usize) -> [A; MAX_JOINTS] {
    let last;
    let mut rows = values;
    // Registers are filled whole: behind the end of a row with the next one.
    if values.len() < A::COUNT * size + LANES {
        last = last_rows(values, size);
        rows = &last;
    }
    let mut out = [A::splat(0.0); MAX_JOINTS];
    let mut from = 0;
    while from < size.min(MAX_JOINTS) {
        let eight = A::from_rows(&rows[from..], size);
        for k in 0..LANES {
            out[(from + k) & (MAX_JOINTS - 1)] = eight[k];
        }
        from += LANES;
    }
    out
}

/// The last rows, and the very last one again and again.
#[cold]
#[inline(never)]
fn last_rows(values: &[f64], size: usize) -> [f64; LANES * MAX_JOINTS + LANES] {
    let (mut out, last) = ([0.0; LANES * MAX_JOINTS + LANES], values.len().saturating_sub(size));
    for (row, out) in out.chunks_exact_mut(size).enumerate() {
        out.copy_from_slice(&values[last.min(row * size)..][..size]);
    }
    out
}

/// Rows on their way to memory, eight numbers less than `N` in all: as many may hang over the end of the last one.
pub(crate) struct Stage<const N: usize>([f64; N]);

impl<const N: usize> Stage<N> {
    pub(crate) const fn new() -> Self {
        Self([0.0; N])
    }

    /// The first `size` numbers of as many configurations as a register holds, the first of them into row `at`, then whole
    /// rows; `numbers` come in whole eights.
    #[inline(always)]
    pub(crate) fn put<A: Many>(&mut self, numbers: &[A], size: usize, at: usize) {
        let (eights, mut from) = (numbers.as_chunks::<LANES>().0, size.div_ceil(LANES));
        // From behind: what hangs over the end of a row is the place of the next one's beginning.
        while from > 0 {
            from -= 1;
            if let (Some(eight), Some(rows)) = (eights.get(from), self.0.get_mut(size * at + LANES * from..)) {
                A::into_rows(eight, rows, size);
            }
        }
    }

    /// The first rows to memory, past the caches where there are too many.
    #[inline(always)]
    pub(crate) fn write(&self, out: &mut [f64], past_the_caches: bool) {
        let rows = &self.0[..out.len()];
        if past_the_caches { stream(rows, out) } else { out.copy_from_slice(rows) }
    }
}

/// Configurations whose results are staged together, a multiple of what any register holds.
const STAGED: usize = 16;

/// Poses and Jacobians of a piece.
struct PosePiece<'a> {
    chain: &'a Chain,
    q: &'a [f64],
    reference: Reference,
    past_the_caches: bool,
    poses: &'a mut [f64],
    jacobians: &'a mut [f64],
}

impl Kernel for PosePiece<'_> {
    type Output = ();

    #[inline(always)]
    fn run<M: Machine>(self) {
        let n = self.chain.n.clamp(1, MAX_JOINTS);
        let (zero, one) = (M::Many::splat(0.0), M::Many::splat(1.0));
        let mut rows = [[zero; MAX_JOINTS]; MAX_AXES];
        let mut flat = [zero; MAX_AXES * MAX_JOINTS];
        let (with_poses, with_jacobians) = (!self.poses.is_empty(), !self.jacobians.is_empty());
        let mut poses = Stage::<{ 16 * STAGED + LANES }>::new();
        let mut jacobians = Stage::<{ MAX_AXES * MAX_JOINTS * STAGED + LANES }>::new();
        let total = self.q.len() / n;
        for from in (0..total).step_by(STAGED) {
            let here = STAGED.min(total - from);
            for at in (0..here).step_by(M::Many::COUNT) {
                let q = gather::<M::Many>(&self.q[n * (from + at)..], n);
                let tool = self.chain.kinematics_by::<M::Many>(&q, &mut rows);
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
                    poses.put(&numbers, 16, at);
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
                    jacobians.put(&flat, 6 * n, at);
                }
            }
            if with_poses {
                poses.write(&mut self.poses[16 * from..][..16 * here], self.past_the_caches);
            }
            if with_jacobians {
                jacobians.write(&mut self.jacobians[6 * n * from..][..6 * n * here], self.past_the_caches);
            }
        }
        if self.past_the_caches {
            settle();
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
        let zero = M::Many::splat(0.0);
        let mut frames = Frames::filled(zero);
        let mut torques = [zero; MAX_JOINTS];
        let mut stage = Stage::<{ MAX_JOINTS * STAGED + LANES }>::new();
        let total = self.q.len() / n;
        for from in (0..total).step_by(STAGED) {
            let here = STAGED.min(total - from);
            for at in (0..here).step_by(M::Many::COUNT) {
                self.chain.forward_by::<M::Many>(&gather::<M::Many>(&self.q[n * (from + at)..], n), &mut frames);
                self.chain.gravity_by::<M::Many>(&frames, self.masses, self.gravity, &mut torques);
                stage.put(&torques, n, at);
            }
            stage.write(&mut self.torques[n * from..][..n * here], false);
        }
    }
}
