//! Non-temporal stores, which write results to memory without filling the caches.
#![cfg_attr(target_arch = "x86_64", expect(unsafe_code, reason = "stores that bypass the caches have no safe form"))]

use std::marker::PhantomData;

/// Results of at least this size [bytes] are written past the caches. A cached store would first read the line that it
/// overwrites, and evict data that is needed sooner.
pub(crate) const NONTEMPORAL_MIN_BYTES: usize = 1 << 25;

/// Writer with non-temporal stores; only [`with_nontemporal`] creates it. `'a` is invariant, so the destination stays
/// borrowed for all of `'a`.
pub(crate) struct NonTemporalWriter<'a>(PhantomData<fn(&'a ()) -> &'a ()>);

/// Guard that, when dropped, orders the copies of a [`NonTemporalWriter`] before all later stores.
struct Fence;

impl Drop for Fence {
    #[inline(always)]
    fn drop(&mut self) {
        #[cfg(test)]
        tests::FENCES.with(|count| count.set(count.get() + 1));
        // Miri does not support the fence instruction.
        #[cfg(all(target_arch = "x86_64", not(miri)))]
        // SAFETY: every x86-64 processor has the instruction.
        unsafe {
            std::arch::x86_64::_mm_sfence();
        }
    }
}

/// Runs `work` with a writer if `wanted`, else with `None`, and fences before returning or unwinding.
///
/// The fence is a local of this function: `work` gets only a reference to the writer, which cannot outlive the fence.
/// `'a` outlives this call, so other threads read the destination only after the fence.
#[inline(always)]
pub(crate) fn with_nontemporal<'a, T>(wanted: bool, work: impl FnOnce(Option<&NonTemporalWriter<'a>>) -> T) -> T {
    if !wanted {
        return work(None);
    }
    let (stream, _fence) = (NonTemporalWriter(PhantomData), Fence);
    work(Some(&stream))
}

#[expect(clippy::unused_self, reason = "a stream is the proof that a fence follows")]
impl<'a> NonTemporalWriter<'a> {
    /// Copies `from` to `to`, whole cache lines with non-temporal stores and the rest with ordinary ones.
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    pub(crate) fn copy(&self, from: &[f64], to: &'a mut [f64]) {
        use std::arch::x86_64::_mm_loadu_pd;
        // Miri does not support non-temporal stores; an aligned store has the same requirements.
        #[cfg(miri)]
        use std::arch::x86_64::_mm_store_pd as _mm_stream_pd;
        #[cfg(not(miri))]
        use std::arch::x86_64::_mm_stream_pd;
        /// Number of `f64` per cache line.
        const LINE: usize = 8;
        assert!(from.len() == to.len(), "each number has its place");
        let before = to.as_ptr().align_offset(64).min(to.len());
        let ((head, from), (first, to)) = (from.split_at(before), to.split_at_mut(before));
        first.copy_from_slice(head);
        let ((lines, rest), (places, last)) = (from.as_chunks::<LINE>(), to.as_chunks_mut::<LINE>());
        for (line, place) in lines.iter().zip(places) {
            for pair in 0..LINE / 2 {
                // SAFETY: every x86-64 processor has the instruction; source and destination have eight numbers, and
                // the first destination is aligned. `with_nontemporal` fences before `'a` ends, and until then `to` is
                // borrowed.
                unsafe { _mm_stream_pd(place.as_mut_ptr().add(2 * pair), _mm_loadu_pd(line.as_ptr().add(2 * pair))) };
            }
        }
        last.copy_from_slice(rest);
    }

    /// Copies `from` to `to` with ordinary stores, on architectures other than x86-64.
    #[cfg(not(target_arch = "x86_64"))]
    pub(crate) fn copy(&self, from: &[f64], to: &'a mut [f64]) {
        to.copy_from_slice(from);
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::panic::{AssertUnwindSafe, catch_unwind};

    use super::*;

    thread_local! {
        /// Number of fences that this thread has executed.
        pub(super) static FENCES: Cell<usize> = const { Cell::new(0) };
    }

    fn fences() -> usize {
        FENCES.with(Cell::get)
    }

    #[test]
    fn a_fence_follows_every_stream_even_after_a_panic() {
        let (from, mut to) = ([1.0; 32], [0.0; 32]);
        let before = fences();
        with_nontemporal(false, |stream| assert!(stream.is_none()));
        assert_eq!(fences(), before, "nothing was copied past the caches");
        with_nontemporal(true, |stream| stream.map(|stream| stream.copy(&from, &mut to)));
        assert_eq!(fences(), before + 1);
        let mut shorter = [0.0; 8];
        let failed = catch_unwind(AssertUnwindSafe(|| {
            with_nontemporal(true, |stream| stream.map(|stream| stream.copy(&from, &mut shorter)));
        }));
        assert!(failed.is_err());
        assert_eq!(fences(), before + 2);
    }

    #[test]
    fn copies_are_exact_at_every_alignment_and_length() {
        let from: Vec<f64> = (1..200).map(f64::from).collect();
        for first in 0..9 {
            for length in [0, 1, 7, 8, 9, 63, 150] {
                let mut to = vec![0.0; 200];
                let place = &mut to[first..first + length];
                with_nontemporal(true, |stream| stream.map(|stream| stream.copy(&from[..length], place)));
                assert!(to[..first].iter().chain(&to[first + length..]).all(|value| value.to_bits() == 0));
                assert!(to[first..].iter().zip(&from[..length]).all(|(a, b)| a.to_bits() == b.to_bits()));
            }
        }
    }
}
