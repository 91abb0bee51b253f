//! Requests of Protocol 1.0 to the servos on a serial port, without the interpreter lock.
#![expect(unsafe_code, reason = "a descriptor that Python owns is borrowed for one call")]

use std::os::fd::BorrowedFd;
use std::time::{Duration, Instant};

use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::{Errno, read, write};

/// Number of bytes that one read discards, and largest number of such reads: a line that never rests is given up.
const CHUNK: usize = 256;
const MAX_DISCARDS: usize = 16;
/// Longest timeout [s].
const LONGEST: f64 = 60.0;
/// Number of bytes of a reply of Protocol 1.0 without data: two of the header, id, length, status and checksum.
const OVERHEAD: usize = 6;

#[doc = stub!(exchange)]
#[pyfunction]
pub(crate) fn exchange<'py>(
    py: Python<'py>,
    descriptor: i32,
    request: &Bound<'py, PyBytes>,
    ids: &Bound<'py, PyBytes>,
    size: usize,
    timeout: f64,
) -> PyResult<(Bound<'py, PyBytes>, bool)> {
    let (request, ids) = (request.as_bytes(), ids.as_bytes());
    let timeout = timeout.clamp(0.0, LONGEST);
    let timeout = Duration::from_secs_f64(timeout);
    let mut reply = vec![0; ids.len() * (OVERHEAD + size)];
    let result = py.detach(|| {
        if descriptor < 0 {
            return Err(Errno::BADF);
        }
        // SAFETY: the descriptor is not -1, and is used during this call only. A descriptor that Python closes meanwhile
        // makes the calls fail, or reach another file of the program, but breaks no memory.
        let port = unsafe { BorrowedFd::borrow_raw(descriptor) };
        transfer(port, request, ids, &mut reply, timeout)
    });
    let (received, is_wrong) = result.map_err(|errno| PyOSError::new_err((errno.raw_os_error(), "serial port")))?;
    let is_whole = received == reply.len() && !is_wrong;
    Ok((PyBytes::new(py, reply.get(..received).unwrap_or_default()), is_whole))
}

/// Discards what has arrived, sends the request and reads the reply; returns the number of bytes of the reply, and true
/// if a byte shows that the reply is not one packet of this size from each of the servos `ids`, which ends it.
fn transfer(
    port: BorrowedFd<'_>,
    request: &[u8],
    ids: &[u8],
    reply: &mut [u8],
    timeout: Duration,
) -> Result<(usize, bool), Errno> {
    let mut old = [0; CHUNK];
    let mut discards = 0;
    while discards < MAX_DISCARDS && wait(port, PollFlags::IN, Instant::now())? {
        input(port, &mut old)?;
        discards += 1;
    }
    let end = Instant::now() + timeout;
    let mut rest = request;
    while !rest.is_empty() {
        if !wait(port, PollFlags::OUT, end)? {
            return Err(Errno::TIMEDOUT);
        }
        let sent = match write(port, rest) {
            Err(Errno::AGAIN | Errno::INTR) => 0,
            result => result?,
        };
        rest = rest.get(sent..).unwrap_or_default();
    }
    // Silence ends the reply, and so does the time in which each servo may be silent once.
    let last = Instant::now() + timeout * u32::try_from(ids.len()).unwrap_or(u32::MAX);
    let mut received = 0;
    while received < reply.len() && wait(port, PollFlags::IN, last.min(Instant::now() + timeout))? {
        received += input(port, &mut reply[received..])?;
        let packets = reply[..received].chunks_exact(reply.len() / ids.len());
        let is_short = matches!(packets.remainder(), [_, _, _, size, rest @ ..] if rest.len() >= usize::from(*size));
        let is_wrong = |(packet, id): (&[u8], &u8)| {
            let sum = packet[2..].iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte));
            packet[..3] != [0xff, 0xff, *id] || usize::from(packet[3]) + 4 != packet.len() || sum != u8::MAX
        };
        if is_short || packets.zip(ids).any(is_wrong) {
            return Ok((received, true));
        }
    }
    Ok((received, false))
}

/// Waits until the port can be read or written, or has failed; returns false if that is not so at time `end`.
fn wait(port: BorrowedFd<'_>, flags: PollFlags, end: Instant) -> Result<bool, Errno> {
    loop {
        let left = end.saturating_duration_since(Instant::now());
        let timeout = Timespec::try_from(left).map_err(|_| Errno::INVAL)?;
        match poll(&mut [PollFd::from_borrowed_fd(port, flags)], Some(&timeout)) {
            Err(Errno::INTR) if left.is_zero() => return Ok(false),
            Err(Errno::INTR) => {}
            result => return Ok(result? > 0),
        }
    }
}

/// Reads what has arrived; an error at the end of the input: the port has vanished.
fn input(port: BorrowedFd<'_>, bytes: &mut [u8]) -> Result<usize, Errno> {
    match read(port, bytes) {
        Ok(0) => Err(Errno::IO),
        Err(Errno::INTR | Errno::AGAIN) => Ok(0),
        result => result,
    }
}
