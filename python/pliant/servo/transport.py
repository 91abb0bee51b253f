"""Serial transport of servo packets: the interface `Transport` and its rustypot implementation.

Any object with the methods of `Transport` may replace rustypot (a vendor's SDK, a network bridge, a
test fake); `ServoBus(..., transport=...)` takes a function that opens such an object.
"""

from __future__ import annotations

import os
import signal
import struct
import sys
import threading
from contextlib import suppress
from glob import glob
from typing import TYPE_CHECKING, Any, Literal, Protocol

from pliant._core import ServoError

if sys.platform != "win32":
    import fcntl
    import termios

    from pliant._core import SerialPort

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from numpy.typing import ArrayLike

    from pliant.servo.models.base import Protocol as Wire

    #: Bytes and status byte of each servo.
    Answers = list[tuple[bytes, int]]
    #: Goals [rad], torque limits [N·m] and largest speeds [rad/s] of the joints (n,), and upper
    #: bound of the speeds [rad/s]: the last four arguments of `ServoCodec.encode`.
    Command = tuple[ArrayLike, ArrayLike, ArrayLike | None, float]

Reason = Literal["timeout", "corrupt", "stale", "refused", "late", "noisy", "gone"]


class BusError(ServoError):
    """Failure of one transaction.

    Attributes:
        reason: `timeout`: no or an incomplete reply; `corrupt`: an invalid reply; `stale`: a reply
            to an earlier request; `refused`: the servo rejected the request; `late`: nothing was
            sent, because the control cycle has no time left or a late reply could be mistaken for
            the reply; `noisy`: nothing was sent, because the line is never silent; `gone`: the port
            has vanished.
        id: Servo whose reply failed, if known.
    """

    def __init__(self, message: str, reason: Reason, id: int | None = None) -> None:
        """Store the message, the reason of the failure, and the id of the servo (None: unknown)."""
        super().__init__(message)
        self.reason: Reason = reason
        self.id = id

    def raise_if_gone(self) -> None:
        """Raise this error again if its reason is `gone`, because no servo can then be reached."""
        if self.reason == "gone":
            raise self


class Transport(Protocol):
    """Interface of one serial port with servos; every method may raise `BusError`.

    Data are bytes of the control table from `address` on. A status is the error byte of a reply.

    A transport may have the attribute `serial`, a `pliant._core.SerialPort` that sends a request
    and converts the replies in one call. It then also has `lost` and `broken`, as in
    `RustypotTransport`.
    """

    def read(self, id: int, address: int, size: int) -> tuple[bytes, int]:
        """Read `size` bytes of one servo from `address` on; return them and the status byte."""

    def write(self, id: int, address: int, data: bytes) -> int:
        """Write bytes to one servo from `address` on; return the status byte of its reply."""

    def sync_read(self, ids: Sequence[int], address: int, size: int) -> list[tuple[bytes, int]]:
        """Read one block of each servo with one request; return bytes and status byte of each.

        If one reply is missing, the whole request fails.
        """

    def sync_write(self, ids: Sequence[int], address: int, data: Sequence[bytes]) -> None:
        """Write `data[i]` to servo `ids[i]` from `address` on, in one packet without reply."""

    def ping(self, id: int) -> bool:
        """Return True if servo `id` answers a ping within the reply timeout."""

    def reboot(self, id: int) -> None:
        """Restart a servo, if the protocol supports it."""

    def set_timeout(self, seconds: float) -> None:
        """Set the reply timeout of the next calls [s]."""

    def close(self) -> None:
        """Close the serial port."""


#: Instructions of both protocols, and number of bytes of a reply without data of Protocol 1.0.
READ, SYNC_READ, SYNC_WRITE, OVERHEAD = 0x02, 0x82, 0x83, 6
#: Resolved paths of the ports that this program has open.
_OPEN: set[str] = set()


class RustypotTransport:
    """Transport that uses rustypot: one port, one protocol.

    Dynamixel Protocol 1.0 and Feetech servos can share a port, because their framing is the same.
    Protocol 2.0 needs a separate port. The GIL is released during waits.

    Args:
        port: Path of the serial port.
        baudrate: Baud rate [bit/s].
        protocol: `p1` (Dynamixel 1.0 and Feetech) or `p2` (Dynamixel 2.0).
        timeout: Reply timeout [s].

    Attributes:
        serial: `SerialPort` of the core for packets of Protocol 1.0; None for Protocol 2.0, on
            Windows, and if the file descriptor is not known.

    Raises:
        ImportError: The extra `servo` is missing.
        ServoError: The port cannot be opened; the message gives cause and remedy.
    """

    def __init__(self, port: str, baudrate: int, protocol: Wire, timeout: float = 0.02) -> None:
        """Open the port so that no other program can use it."""
        try:
            import rustypot
        except ImportError as error:
            from pliant._extras import missing

            raise ImportError(missing("driving servos", "servo")) from error
        self.port, self.baudrate = port, baudrate
        self._timeout = timeout
        before = _descriptors(port)
        kind = rustypot.MxPyController if protocol == "p1" else rustypot.Xl430PyController
        try:
            self._io: Any = kind(port, baudrate, timeout)
        except (OSError, RuntimeError) as error:
            raise ServoError(_cannot_open(port, str(error))) from error
        # Resolve the path now: if the adapter is unplugged, its link is gone before `close`.
        self._path = os.path.realpath(port)
        _OPEN.add(self._path)
        self._descriptors = _descriptors(port) - before
        # Packets of Protocol 1.0 use the file descriptor of the port if it is known.
        is_known = protocol == "p1" and len(self._descriptors) == 1
        self.serial = SerialPort(*self._descriptors) if is_known else None

    def read(self, id: int, address: int, size: int) -> tuple[bytes, int]:
        """Read `size` bytes of one servo from `address` on; return them and the status byte."""
        if self.serial is not None:
            return self._exchange(READ, (id,), (address, size))[0]
        try:
            values, status = _wait_for(self._io.read_raw_data_with_error, id, address, size)
        except RuntimeError as error:
            raise self._failed(error, id) from error
        return bytes(values), int(status)

    def write(self, id: int, address: int, data: bytes) -> int:
        """Write bytes to one servo from `address` on; return the status byte of its reply."""
        try:
            return int(_wait_for(self._io.write_raw_data_with_error, id, address, list(data)))
        except RuntimeError as error:
            raise self._failed(error, id) from error

    def sync_read(self, ids: Sequence[int], address: int, size: int) -> list[tuple[bytes, int]]:
        """Read one block of each servo with one request; return bytes and status byte of each.

        If one reply is missing, the whole request fails.
        """
        if self.serial is not None:
            return self._exchange(SYNC_READ, ids, (address, size))
        try:
            answers = _wait_for(self._io.sync_read_raw_data_with_error, list(ids), address, size)
        except RuntimeError as error:
            raise self._failed(error, None) from error
        return [(bytes(values), int(status)) for values, status in answers]

    def sync_write(self, ids: Sequence[int], address: int, data: Sequence[bytes]) -> None:
        """Write `data[i]` to servo `ids[i]` from `address` on, in one packet without reply."""
        if self.serial is not None:
            self._exchange(SYNC_WRITE, ids, (address, len(data[0])), list(data))
            return
        try:
            self._io.sync_write_raw_data(list(ids), address, [list(item) for item in data])
        except RuntimeError as error:
            failed = self._failed(error, None)
            if failed.reason != "timeout" or len(self._descriptors) != 1:
                raise failed from error
            # The driver waits for a silent line before it sends, and noise can go on for ever. A
            # packet without a reply needs no silence, and torque off must not wait for it.
            (descriptor,) = self._descriptors
            try:
                os.write(descriptor, sync_write_packet(ids, address, data))
            except OSError:
                raise failed from error

    def ping(self, id: int) -> bool:
        """Return True if servo `id` answers a ping within the reply timeout."""
        try:
            return bool(_wait_for(self._io.ping, id))
        except RuntimeError as error:
            raise self._failed(error, id) from error

    def reboot(self, id: int) -> None:
        """Restart a servo; only Protocol 2.0 supports this."""
        try:
            _wait_for(self._io.reboot, id)
        except RuntimeError as error:
            raise self._failed(error, id) from error

    def set_timeout(self, seconds: float) -> None:
        """Set the reply timeout of the next calls [s]."""
        self._timeout = seconds
        self._io.set_timeout(seconds)

    def close(self) -> None:
        """Close the serial port."""
        if self.serial is not None:
            self.serial.close()
        _unlock(self._descriptors)
        self._io.close()
        _OPEN.discard(self._path)

    def _exchange(
        self,
        instruction: int,
        ids: Sequence[int],
        block: tuple[int, int],
        data: list[bytes] | None = None,
    ) -> Answers:
        """Make a request of Protocol 1.0; the arguments are those of `exchange`.

        The returned list ends with the first reply that has another number of data bytes.

        Raises:
            BusError: A reply is missing or corrupt, or the port is gone, or takes no bytes.
        """
        assert self.serial is not None, "the caller has checked it"
        try:
            found = self.serial.exchange(instruction, ids, block, data, self._timeout)
        except OSError as error:
            raise self.lost(error) from error
        return self.broken(found, ids, block[1]) if isinstance(found, bytes) else found

    def lost(self, error: OSError) -> BusError:
        """Return the `BusError` for an error of `serial`."""
        if isinstance(error, TimeoutError):
            return BusError(f"{self.port}: the request cannot be sent", "timeout")
        is_closed = self.serial is not None and self.serial.closed
        return self._gone("closed by another thread" if is_closed else str(error))

    def broken(self, found: bytes, ids: Sequence[int], size: int) -> Answers:
        """Return the replies among bytes that are not one valid reply of this size from each servo.

        The first reply with another number of data bytes is the last that is returned.

        Raises:
            BusError: A reply is missing or corrupt.
        """
        start = 0
        answers = []
        for id in ids:
            packet = found[start:]
            if not bytes((255, 255, id)).startswith(packet[:3]):
                raise BusError(f"{self.port}, id {id}: broken answer (header or id)", "corrupt", id)
            if len(packet) > OVERHEAD and packet[3] > size + 2:
                answers.append((packet[5 : OVERHEAD + size].ljust(size + 1), packet[4]))
                break
            if len(packet) < 4 or len(packet) < 4 + packet[3]:
                raise BusError(f"{self.port}, id {id}: no answer", "timeout", id)
            packet = packet[: 4 + packet[3]]
            if len(packet) < OVERHEAD or sum(packet[2:]) & 0xFF != 0xFF:
                raise BusError(f"{self.port}, id {id}: broken answer (checksum)", "corrupt", id)
            answers.append((packet[5:-1], packet[4]))
            if len(packet) != OVERHEAD + size:
                break
            start += len(packet)
        return answers

    def _gone(self, text: str) -> BusError:
        return BusError(
            f"{self.port} is gone ({text}): is the adapter still plugged in and powered?", "gone"
        )

    def _failed(self, error: RuntimeError, id: int | None) -> BusError:
        """Return the `BusError` for an error of rustypot, classified by its text."""
        text = str(error)
        if text.startswith("motor "):
            number, _, text = text.removeprefix("motor ").partition(": ")
            id = int(number) if number.isdigit() else id
        who = self.port if id is None else f"{self.port}, id {id}"
        lower = text.lower()
        if any(word in lower for word in _SILENT):
            return BusError(f"{who}: no answer", "timeout", id)
        if any(word in lower for word in _BROKEN):
            return BusError(f"{who}: broken answer ({text})", "corrupt", id)
        return self._gone(text)


def sync_write_packet(ids: Sequence[int], address: int, data: Sequence[bytes]) -> bytes:
    """Return the sync write of Protocol 2.0 that writes `data[i]` to servo `ids[i]`."""
    body = struct.pack("<BHH", SYNC_WRITE, address, len(data[0]))
    body += b"".join(bytes((id,)) + item for id, item in zip(ids, data, strict=True))
    # A header inside the packet is made unlike a header by one more 0xFD.
    body = body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    packet = b"\xff\xff\xfd\0\xfe" + struct.pack("<H", len(body) + 2) + body
    crc = 0
    for byte in packet:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x8005 if crc & 0x8000 else 0)) & 0xFFFF
    return packet + struct.pack("<H", crc)


#: Parts of rustypot's error texts for a missing reply, and for a corrupt reply.
_SILENT = ("timed out", "timeout")
_BROKEN = ("checksum", "parsing", "incorrect id")


def _cannot_open(port: str, text: str) -> str:
    """Return the message for a port that cannot be opened, with reason and remedy.

    `text` is the error message of rustypot.
    """
    lower = text.lower()
    if "permission" in lower or "access is denied" in lower:
        return (
            f"no permission to open {port}: join the group that owns it (sudo usermod -aG dialout "
            "$USER; on Arch uucp), log out and in again"
        )
    if "exclusive" in lower or "busy" in lower or "in use" in lower:
        if os.path.realpath(port) in _OPEN:
            return (
                f"{port} is in use by another arm or bus of this program: close() it, or end the "
                "program; two arms need two ports"
            )
        return (
            f"{port} is in use by another program: close it (a vendor's wizard, another run); a "
            "guardian that lowers the arm of an ended program takes less than a minute"
        )
    if "no such file" in lower or "not found" in lower or "no such device" in lower:
        there = ", ".join(serial_ports()) or "none: is the adapter plugged in?"
        return f"there is no port {port}; there are: {there}"
    if "typewriter" in lower or "inappropriate ioctl" in lower:
        return f"{port} is not a serial port; there are: {', '.join(serial_ports()) or 'none'}"
    return f"cannot open {port}: {text}"


def _wait_for(request: Callable[..., Any], *arguments: Any) -> Any:
    """Return the result of a request of rustypot, during which no periodic timer runs.

    Each signal that interrupts this thread makes rustypot restart its wait for a reply, so with a
    periodic signal it would wait for ever. Signals interrupt the main thread only.
    """
    if sys.platform == "win32" or not signal.getitimer(signal.ITIMER_REAL)[1]:
        return request(*arguments)
    if threading.current_thread() is not threading.main_thread():
        return request(*arguments)
    rest, interval = signal.setitimer(signal.ITIMER_REAL, 0.0)
    try:
        return request(*arguments)
    finally:
        # A rest of 0 would stop the timer.
        signal.setitimer(signal.ITIMER_REAL, max(rest, 1e-6), interval)


def _descriptors(path: str) -> set[int]:
    """Return the file descriptors of this process that refer to the serial port `path`."""
    found = set()
    with suppress(OSError):
        device = os.stat(path).st_rdev
        for name in os.listdir("/dev/fd") if device else ():
            with suppress(OSError):
                if os.fstat(int(name)).st_rdev == device:
                    found.add(int(name))
    return found


def _unlock(descriptors: Iterable[int]) -> None:
    """Give up the exclusive use of a port before it is closed.

    A process that another thread is starting has copies of the descriptors until it runs its
    program, and would keep the port locked until then.
    """
    if sys.platform != "win32":
        for number in descriptors:
            with suppress(OSError):
                fcntl.ioctl(number, termios.TIOCNXCL)
                fcntl.flock(number, fcntl.LOCK_UN)


def drop_port(path: str) -> None:
    """Replace descriptors of the serial port `path` by the null device, in a forked process.

    A forked process shares the lock of the port, which would stay locked until both processes end.
    Closing through the driver could wait for a thread that does not exist after the fork.
    """
    for number in _descriptors(path):
        with suppress(OSError):
            null = os.open(os.devnull, os.O_RDWR)
            os.dup2(null, number, inheritable=False)
            os.close(null)


def serial_ports() -> tuple[str, ...]:
    """Return the serial ports of this machine, each once; on Linux by its stable name, if any."""
    if sys.platform == "win32":
        import winreg

        try:
            key = winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, r"HARDWARE\DEVICEMAP\SERIALCOMM")
        except FileNotFoundError:
            return ()
        with key:
            count = winreg.QueryInfoKey(key)[1]
            return tuple(sorted(str(winreg.EnumValue(key, i)[1]) for i in range(count)))
    found: dict[str, str] = {}
    for pattern in ("serial/by-id/*", "ttyUSB*", "ttyACM*", "tty.usb*"):
        for path in sorted(glob(f"/dev/{pattern}")):
            found.setdefault(os.path.realpath(path), path)
    return tuple(found.values())
