//! Kinematics of many configurations: one configuration per SIMD lane, in chunks on all cores.

use rayon::prelude::*;

use super::jacobian::rotate_to_tool;
use super::{GroupMasses, JointFrames, Reference};
use crate::error::{Error, Result};
use crate::math::simd::{
    Isa, Kernel, LANES, NONTEMPORAL_MIN_BYTES, NonTemporalWriter, RealOps, SimdLevel, SimdVec, SoaLanes,
    with_nontemporal,
};
use crate::math::thread_pool::install;
use crate::model::{Chain, Model};
use crate::pose::COORDINATE_BOUND;
use crate::{MAX_AXES, MAX_JOINTS};

/// Number of configurations per chunk, the unit of work of a thread. A batch of at most one chunk runs on the caller's
/// thread.
const CHUNK: usize = 4096;

impl Model {
    /// Computes poses (`N` × 4 × 4, row-major) and Jacobians (`N` × 6 × n) of `N` configurations (`N` × n); an empty
    /// output is skipped.
    ///
    /// # Errors
    /// As [`Model::forward_kinematics`], with the row of the first invalid configuration; [`Error::Shape`] for
    /// inconsistent lengths. The outputs are then undefined.
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
        let nontemporal = size_of_val(poses) + size_of_val(jacobians) >= NONTEMPORAL_MIN_BYTES;
        self.for_each_chunk(q, [(poses, pose), (jacobians, jacobian)], |q, [poses, jacobians]| {
            // Outside the kernel, because a closure inside it would be compiled for the baseline instruction set.
            with_nontemporal(nontemporal, |writer| {
                SimdLevel::detect().dispatch(PoseChunk { chain, q, reference, writer, poses, jacobians });
            });
        })
    }

    /// Computes the gravity torques (`N` × n) [N·m or N] of the arm and its payload at `N` configurations (`N` × n).
    ///
    /// # Errors
    /// As [`Model::kinematics_batch`].
    pub fn gravity_batch(&self, q: &[f64], torques: &mut [f64]) -> Result<()> {
        let (n, count) = (self.n(), self.count(q)?);
        check("torques", torques, count * n)?;
        let (chain, masses, gravity) = (self.chain(), self.chain().masses(self.payload()), self.gravity_vector());
        self.for_each_chunk(q, [(torques, n), (&mut [], 0)], |q, [torques, _]| {
            SimdLevel::detect().dispatch(GravityChunk { chain, masses: &masses, gravity: &gravity, q, torques });
        })
    }

    fn count(&self, q: &[f64]) -> Result<usize> {
        if q.len().is_multiple_of(self.n()) { Ok(q.len() / self.n()) } else { Err(Error::rows("Q", q.len(), self.n())) }
    }

    /// Checks all configurations, and calls `work` for each chunk with the parts of the outputs that belong to it. Each
    /// output is given with its number of values per configuration.
    fn for_each_chunk(
        &self,
        q: &[f64],
        outs: [(&mut [f64], usize); 2],
        work: impl Fn(&[f64], [&mut [f64]; 2]) + Sync,
    ) -> Result<()> {
        let n = self.n();
        let chunk = |(q, outs): (&[f64], [&mut [f64]; 2])| {
            // Checked per chunk, so that the numbers are in the cache for `work`.
            let is_valid = q.iter().fold(true, |valid, value| valid & (value.abs() <= COORDINATE_BOUND));
            if is_valid {
                work(q, outs);
            }
            is_valid
        };
        let [(first, one), (second, two)] = outs;
        let is_valid = if q.len() <= CHUNK * n {
            chunk((q, [first, second]))
        } else {
            let mut parts = Vec::with_capacity(q.len() / (CHUNK * n) + 1);
            let (mut first, mut second) = (first, second);
            for q in q.chunks(CHUNK * n) {
                let count = q.len() / n;
                let (a, b);
                (a, first) = first.split_at_mut(count * one);
                (b, second) = second.split_at_mut(count * two);
                parts.push((q, [a, b]));
            }
            install(|| parts.into_par_iter().map(chunk).reduce(|| true, |a, b| a & b))?
        };
        if is_valid {
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

/// Loads one configuration per lane: consecutive rows of `values`, each of `size` ≤ 16 numbers. Entries after `size`
/// are undefined. If there are fewer rows than lanes, the last row is repeated.
#[inline(always)]
pub(crate) fn gather<A: SoaLanes>(values: &[f64], size: usize) -> [A; MAX_JOINTS] {
    let last;
    let mut rows = values;
    // A load of eight numbers may read past the end of its row; nothing follows the last row.
    if values.len() < A::COUNT * size + LANES {
        last = last_rows(values, size);
        rows = &last;
    }
    let mut out = [A::splat(0.0); MAX_JOINTS];
    let mut from = 0;
    while from < size.min(MAX_JOINTS) {
        let eight = A::load_transposed(&rows[from..], size);
        for k in 0..LANES {
            out[(from + k) & (MAX_JOINTS - 1)] = eight[k];
        }
        from += LANES;
    }
    out
}

/// Copies the last rows, which are fewer than a full load reads, and repeats the last one.
#[cold]
#[inline(never)]
fn last_rows(values: &[f64], size: usize) -> [f64; LANES * MAX_JOINTS + LANES] {
    let (mut out, last) = ([0.0; LANES * MAX_JOINTS + LANES], values.len().saturating_sub(size));
    for (row, out) in out.chunks_exact_mut(size).enumerate() {
        out.copy_from_slice(&values[last.min(row * size)..][..size]);
    }
    out
}

/// Stores one configuration per lane: its first `size` numbers become a row of `out`. The length of `numbers` must be a
/// multiple of eight.
///
/// May overwrite values of `out` after these rows; the caller writes the next rows there.
#[inline(always)]
pub(crate) fn scatter<A: SoaLanes>(numbers: &[A], size: usize, out: &mut [f64]) {
    if out.len() >= A::COUNT * size + LANES {
        return store_chunk::<A>(numbers, size, out);
    }
    let mut last = [0.0; LANES * MAX_JOINTS + LANES];
    store_chunk::<A>(numbers, size, &mut last);
    for (to, from) in out.iter_mut().zip(&last) {
        *to = *from;
    }
}

/// Stores as [`scatter`]; `out` has room for at least eight numbers after the last row.
#[inline(always)]
fn store_chunk<A: SoaLanes>(numbers: &[A], size: usize, out: &mut [f64]) {
    let (eights, mut from) = (numbers.as_chunks::<LANES>().0, size.div_ceil(LANES));
    // Last block first: storing eight numbers may overwrite the start of the next row, which is stored afterwards.
    while from > 0 {
        from -= 1;
        if let (Some(eight), Some(rows)) = (eights.get(from), out.get_mut(LANES * from..)) {
            A::store_transposed(eight, rows, size);
        }
    }
}

/// Copies the first `out.len()` numbers of `rows` to `out`, with non-temporal stores if there is a `writer`.
#[inline(always)]
fn write_rows<'a>(rows: &[f64], out: &'a mut [f64], writer: Option<&NonTemporalWriter<'a>>) {
    let rows = &rows[..out.len()];
    match writer {
        Some(stream) => stream.copy(rows, out),
        None => out.copy_from_slice(rows),
    }
}

/// Number of configurations whose results are collected in a buffer and then copied to the output in one block: storing
/// directly into the rows of several Jacobians would be too many write streams. A multiple of every lane count.
const STAGING_ROWS: usize = 8;

/// Inputs and output slices for the poses and Jacobians of one chunk of configurations.
struct PoseChunk<'a, 'out> {
    chain: &'a Chain,
    q: &'a [f64],
    reference: Reference,
    writer: Option<&'a NonTemporalWriter<'out>>,
    poses: &'out mut [f64],
    jacobians: &'out mut [f64],
}

impl Kernel for PoseChunk<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<M: Isa>(self) {
        let n = self.chain.n.clamp(1, MAX_JOINTS);
        let (zero, one) = (M::F64xN::splat(0.0), M::F64xN::splat(1.0));
        let mut rows = [[zero; MAX_JOINTS]; MAX_AXES];
        let mut flat = [zero; MAX_AXES * MAX_JOINTS];
        let (with_poses, with_jacobians) = (!self.poses.is_empty(), !self.jacobians.is_empty());
        let mut outs = (self.poses.chunks_mut(16 * STAGING_ROWS), self.jacobians.chunks_mut(6 * n * STAGING_ROWS));
        let (mut poses, mut jacobians) =
            ([0.0; 16 * STAGING_ROWS + LANES], [0.0; MAX_AXES * MAX_JOINTS * STAGING_ROWS + LANES]);
        let total = self.q.len() / n;
        for from in (0..total).step_by(STAGING_ROWS) {
            let here = STAGING_ROWS.min(total - from);
            for at in (0..here).step_by(M::F64xN::COUNT) {
                let q = gather::<M::F64xN>(&self.q[n * (from + at)..], n);
                let tool = self.chain.kinematics_by::<M::F64xN>(&q, &mut rows);
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
                    store_chunk::<M::F64xN>(&numbers, 16, &mut poses[16 * at..]);
                }
                if self.reference == Reference::Local {
                    rotate_to_tool::<M::F64xN>(&tool.rotation, &mut rows, n);
                }
                if with_jacobians {
                    for r in 0..MAX_AXES {
                        for k in 0..n {
                            flat[r * n + k] = rows[r][k];
                        }
                    }
                    store_chunk::<M::F64xN>(&flat, 6 * n, &mut jacobians[6 * n * at..]);
                }
            }
            if let Some(out) = outs.0.next() {
                write_rows(&poses, out, self.writer);
            }
            if let Some(out) = outs.1.next() {
                write_rows(&jacobians, out, self.writer);
            }
        }
    }
}

/// Inputs and output slice for the gravity torques of one chunk of configurations.
struct GravityChunk<'a> {
    chain: &'a Chain,
    masses: &'a GroupMasses,
    gravity: &'a [f64; 3],
    q: &'a [f64],
    torques: &'a mut [f64],
}

impl Kernel for GravityChunk<'_> {
    type Output = ();

    #[inline(always)]
    fn run<M: Isa>(self) {
        let n = self.chain.n.clamp(1, MAX_JOINTS);
        let zero = M::F64xN::splat(0.0);
        let mut frames = JointFrames::filled(zero);
        let mut torques = [zero; MAX_JOINTS];
        let total = self.q.len() / n;
        for from in (0..total).step_by(M::F64xN::COUNT) {
            self.chain.forward_by::<M::F64xN>(&gather::<M::F64xN>(&self.q[n * from..], n), &mut frames);
            self.chain.gravity_by::<M::F64xN>(&frames, self.masses, self.gravity, &mut torques);
            scatter::<M::F64xN>(&torques, n, &mut self.torques[n * from..]);
        }
    }
}
