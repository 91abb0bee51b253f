//! Requests of Protocol 1.0 to the servos on a serial port, without the interpreter lock.
#![expect(unsafe_code, reason = "a descriptor that Python owns is borrowed for one call")]

use std::num::TryFromIntError;
use std::os::fd::BorrowedFd;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use pyo3::exceptions::{PyOSError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyList};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::{Errno, read, write};

/// Maximum number of bytes per read when received bytes are discarded before a request.
const CHUNK: usize = 256;
/// Maximum number of these reads; a noisy line may never be silent.
const MAX_DISCARDS: usize = 16;
/// Longest timeout [s].
const LONGEST: f64 = 60.0;
/// Number of bytes of a reply packet of Protocol 1.0 without data: header (2), id, length, status, checksum.
const OVERHEAD: usize = 6;

/// Instruction of Protocol 1.0 that reads registers of one servo.
const READ: u8 = 0x02;
/// Instruction of Feetech's extension of Protocol 1.0 that reads the same registers of several servos.
pub(crate) const SYNC_READ: u8 = 0x82;
/// Instruction of Protocol 1.0 that writes the same registers of several servos.
const SYNC_WRITE: u8 = 0x83;
/// Id that addresses all servos.
const BROADCAST: u8 = 0xfe;

/// Bytes that servos have sent in reply to a request.
#[derive(Debug)]
pub(crate) struct Replies {
    bytes: Vec<u8>,
    /// Length of a reply packet with the requested number of data bytes.
    packet_len: usize,
    /// True if each servo has sent a valid packet with the requested number of data bytes.
    pub(crate) is_complete: bool,
}

impl Replies {
    /// Returns data and status byte of each reply packet.
    pub(crate) fn packets(&self) -> impl Iterator<Item = (&[u8], u8)> {
        self.bytes.chunks_exact(self.packet_len).map(|packet| (&packet[OVERHEAD - 1..packet.len() - 1], packet[4]))
    }

    /// Returns a list with data and status byte of each reply; the received bytes if the replies are not complete.
    pub(crate) fn to_python<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        if !self.is_complete {
            return Ok(PyBytes::new(py, &self.bytes).into_any());
        }
        let replies = PyList::empty(py);
        for (data, status) in self.packets() {
            replies.append((PyBytes::new(py, data), status))?;
        }
        Ok(replies.into_any())
    }
}

#[doc = stub!(SerialPort)]
#[pyclass(module = "pliant._core", frozen)]
#[derive(Debug)]
pub(crate) struct SerialPort {
    /// Locked, because the number of a closed descriptor may be reused while a thread uses it.
    open: Mutex<Option<Open>>,
}

/// State of a port before `close`.
#[derive(Debug, Clone, Copy)]
struct Open {
    descriptor: i32,
    /// True if all servos have answered the last request: the port has then sent all bytes, and accepts a packet
    /// immediately.
    is_idle: bool,
}

#[pymethods]
impl SerialPort {
    #[new]
    fn new(descriptor: i32) -> Self {
        Self { open: Mutex::new(Some(Open { descriptor, is_idle: false })) }
    }

    #[doc = stub!(SerialPort.exchange)]
    #[expect(clippy::needless_pass_by_value, reason = "PyO3 passes extracted arguments by value")]
    fn exchange<'py>(
        &self,
        py: Python<'py>,
        instruction: u8,
        ids: Vec<u8>,
        block: [usize; 2],
        data: Option<Vec<Bound<'py, PyBytes>>>,
        timeout: f64,
    ) -> PyResult<Bound<'py, PyAny>> {
        let Some(rows) = data else {
            return read_registers(py, self, instruction, &ids, block, timeout)?.to_python(py);
        };
        if rows.iter().any(|row| row.as_bytes().len() != block[1]) {
            return Err(wrong_size());
        }
        let data: Vec<u8> = rows.iter().flat_map(PyBytesMethods::as_bytes).copied().collect();
        write_registers(py, self, &ids, block, &data, timeout)?;
        Ok(PyList::empty(py).into_any())
    }

    #[doc = stub!(SerialPort.close)]
    fn close(&self, py: Python<'_>) {
        py.detach(|| *self.lock() = None);
    }

    #[doc = stub!(SerialPort.closed)]
    #[getter]
    fn closed(&self, py: Python<'_>) -> bool {
        py.detach(|| self.lock().is_none())
    }
}

impl SerialPort {
    /// Locks the port. The interpreter lock must be released, because a thread that holds this lock may wait for it.
    fn lock(&self) -> MutexGuard<'_, Option<Open>> {
        self.open.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Requests the registers `block` (address, size) of the servos `ids`, and returns the replies. Releases the
/// interpreter lock.
pub(crate) fn read_registers(
    py: Python<'_>,
    port: &SerialPort,
    instruction: u8,
    ids: &[u8],
    block: [usize; 2],
    timeout: f64,
) -> PyResult<Replies> {
    let block = bytes(block)?;
    let id = if instruction == READ { ids.first().copied().unwrap_or(BROADCAST) } else { BROADCAST };
    let mut request = vec![0xff, 0xff, id, 0, instruction, block[0], block[1]];
    if instruction == SYNC_READ {
        request.extend_from_slice(ids);
    }
    send_request(py, port, request, ids, block[1], timeout)
}

/// Writes the registers `block` (address, size) of the servos `ids` with one packet, which has no reply. `data` has the
/// bytes of one servo after the other. Releases the interpreter lock.
pub(crate) fn write_registers(
    py: Python<'_>,
    port: &SerialPort,
    ids: &[u8],
    block: [usize; 2],
    data: &[u8],
    timeout: f64,
) -> PyResult<()> {
    if data.len() != ids.len() * block[1] {
        return Err(wrong_size());
    }
    let header = bytes(block)?;
    let mut request = vec![0xff, 0xff, BROADCAST, 0, SYNC_WRITE, header[0], header[1]];
    for (id, row) in ids.iter().zip(data.chunks(block[1].max(1))) {
        request.push(*id);
        request.extend_from_slice(row);
    }
    send_request(py, port, request, &[], header[1], timeout).map(|_| ())
}

fn wrong_size() -> PyErr {
    PyValueError::new_err("data has one row of the size of the block for each id")
}

/// Returns address and size of a block as bytes.
fn bytes([address, size]: [usize; 2]) -> PyResult<[u8; 2]> {
    Ok([u8::try_from(address).map_err(too_large)?, u8::try_from(size).map_err(too_large)?])
}

fn too_large(_: TryFromIntError) -> PyErr {
    PyValueError::new_err("ids, addresses and sizes of Protocol 1.0 are bytes")
}

/// Completes a request packet with length and checksum, sends it without the interpreter lock, and returns the replies
/// of the servos `ids` with `size` data bytes each.
fn send_request(
    py: Python<'_>,
    port: &SerialPort,
    mut request: Vec<u8>,
    ids: &[u8],
    size: u8,
    timeout: f64,
) -> PyResult<Replies> {
    request[3] = u8::try_from(request.len() - 3).map_err(too_large)?;
    request.push(!request[2..].iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte)));
    let timeout = Duration::from_secs_f64(timeout.clamp(0.0, LONGEST));
    let packet_len = OVERHEAD + usize::from(size);
    let mut bytes = vec![0; ids.len() * packet_len];
    let result = py.detach(|| {
        let mut open = port.lock();
        let open = open.as_mut().filter(|open| open.descriptor >= 0).ok_or(Errno::BADF)?;
        let is_idle = std::mem::take(&mut open.is_idle);
        // SAFETY: the descriptor is not -1, and is used during this call only. A descriptor that Python closes
        // meanwhile makes the calls fail, or reach another file of the program, but breaks no memory.
        let port = unsafe { BorrowedFd::borrow_raw(open.descriptor) };
        let (received, is_wrong) = write_and_read(port, &request, ids, &mut bytes, timeout, is_idle)?;
        open.is_idle = !ids.is_empty() && received == bytes.len() && !is_wrong;
        Ok((received, is_wrong))
    });
    let (received, is_wrong) =
        result.map_err(|errno: Errno| PyOSError::new_err((errno.raw_os_error(), "serial port")))?;
    let is_complete = received == bytes.len() && !is_wrong;
    bytes.truncate(received);
    Ok(Replies { bytes, packet_len, is_complete })
}

/// Writes the request and reads the replies into `reply`, whose length is that of the expected packets: one of each
/// servo in `ids`, in this order. If replies are expected, discards bytes that were received before. Reading ends early
/// at a packet that is invalid, too short or from another servo. Returns the number of bytes read, and true if reading
/// ended for this reason. Does not wait for an idle port before a packet without a reply.
fn write_and_read(
    port: BorrowedFd<'_>,
    request: &[u8],
    ids: &[u8],
    reply: &mut [u8],
    timeout: Duration,
    is_idle: bool,
) -> Result<(usize, bool), Errno> {
    let mut old = [0; CHUNK];
    let mut discards = if reply.is_empty() { MAX_DISCARDS } else { 0 };
    let end = Instant::now() + timeout;
    let mut rest = request;
    let mut takes_packet = is_idle && reply.is_empty();
    while !rest.is_empty() {
        let may_discard = discards < MAX_DISCARDS && rest.len() == request.len();
        let flags = if may_discard { PollFlags::IN | PollFlags::OUT } else { PollFlags::OUT };
        let ready = if takes_packet { flags } else { wait(port, flags, end)? };
        takes_packet = false;
        if ready.is_empty() {
            return Err(Errno::TIMEDOUT);
        }
        if may_discard && ready.contains(PollFlags::IN) {
            input(port, &mut old)?;
            discards += 1;
            continue;
        }
        let sent = match write(port, rest) {
            Err(Errno::AGAIN | Errno::INTR) => 0,
            result => result?,
        };
        rest = rest.get(sent..).unwrap_or_default();
    }
    // Reading ends after `timeout` without a byte, and in any case after `timeout` for each servo.
    let last = Instant::now() + timeout * u32::try_from(ids.len()).unwrap_or(u32::MAX);
    let mut received = 0;
    while received < reply.len() && !wait(port, PollFlags::IN, last.min(Instant::now() + timeout))?.is_empty() {
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

/// Waits until the port is ready for reading or writing (`flags`), or has failed; returns what it is ready for, empty if
/// nothing happens before `end`.
fn wait(port: BorrowedFd<'_>, flags: PollFlags, end: Instant) -> Result<PollFlags, Errno> {
    loop {
        let remaining = end.saturating_duration_since(Instant::now());
        let timeout = Timespec::try_from(remaining).map_err(|_| Errno::INVAL)?;
        let mut descriptors = [PollFd::from_borrowed_fd(port, flags)];
        match poll(&mut descriptors, Some(&timeout)) {
            Err(Errno::INTR) if remaining.is_zero() => return Ok(PollFlags::empty()),
            Err(Errno::INTR) => {}
            result => return result.map(|_| descriptors[0].revents()),
        }
    }
}

/// Reads the bytes that have arrived; an error at the end of the input, because the port has then vanished.
fn input(port: BorrowedFd<'_>, bytes: &mut [u8]) -> Result<usize, Errno> {
    match read(port, bytes) {
        Ok(0) => Err(Errno::IO),
        Err(Errno::INTR | Errno::AGAIN) => Ok(0),
        result => result,
    }
}
