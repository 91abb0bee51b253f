//! Results on their way to memory past the caches.
#![cfg_attr(target_arch = "x86_64", expect(unsafe_code, reason = "stores that bypass the caches have no safe form"))]

use std::marker::PhantomData;

/// Results [bytes] from which on they go past the caches: a cache would first read what they overwrite, and what they push out
/// of it is of more use than they are.
pub(crate) const PAST_THE_CACHES: usize = 1 << 25;

/// Copies past the caches. What it writes to stays borrowed until it is dropped, and then all threads see it: such stores are
/// ordered by a fence alone.
pub(crate) struct Stream<'a>(PhantomData<&'a mut [f64]>);

#[expect(clippy::unused_self, reason = "whoever copies holds what fences")]
impl<'a> Stream<'a> {
    pub(crate) fn new() -> Self {
        Self(PhantomData)
    }

    /// Copies in whole lines of the caches.
    #[cfg(target_arch = "x86_64")]
    #[inline(always)]
    pub(crate) fn copy(&self, from: &[f64], to: &'a mut [f64]) {
        use std::arch::x86_64::{_mm_loadu_pd, _mm_stream_pd};
        /// Numbers in a line of the cache.
        const LINE: usize = 8;
        assert!(from.len() == to.len(), "each number has its place");
        let before = to.as_ptr().align_offset(64).min(to.len());
        let ((head, from), (first, to)) = (from.split_at(before), to.split_at_mut(before));
        first.copy_from_slice(head);
        let ((lines, rest), (places, last)) = (from.as_chunks::<LINE>(), to.as_chunks_mut::<LINE>());
        for (line, place) in lines.iter().zip(places) {
            for pair in 0..LINE / 2 {
                // SAFETY: every x86-64 processor has the instruction; both have eight numbers, and the place of the first is
                // aligned. The fence follows when `self` goes, before which nobody else can read what is borrowed for `'a`.
                unsafe { _mm_stream_pd(place.as_mut_ptr().add(2 * pair), _mm_loadu_pd(line.as_ptr().add(2 * pair))) };
            }
        }
        last.copy_from_slice(rest);
    }

    /// Copies: nobody has written down how else on this architecture.
    #[cfg(not(target_arch = "x86_64"))]
    pub(crate) fn copy(&self, from: &[f64], to: &'a mut [f64]) {
        to.copy_from_slice(from);
    }
}

impl Drop for Stream<'_> {
    #[inline(always)]
    fn drop(&mut self) {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: every x86-64 processor has the instruction.
        unsafe {
            std::arch::x86_64::_mm_sfence();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_arrive_wherever_they_begin_and_end() {
        let from: Vec<f64> = (1..200).map(f64::from).collect();
        for first in 0..9 {
            for length in [0, 1, 7, 8, 9, 63, 150] {
                let mut to = vec![0.0; 200];
                Stream::new().copy(&from[..length], &mut to[first..first + length]);
                assert!(to[..first].iter().chain(&to[first + length..]).all(|value| value.to_bits() == 0));
                assert!(to[first..].iter().zip(&from[..length]).all(|(a, b)| a.to_bits() == b.to_bits()));
            }
        }
    }
}
