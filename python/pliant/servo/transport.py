"""The seam to the bus: eight calls, and rustypot's raw-address calls behind them.

Another transport (a vendor's SDK, a network bridge, a fake for tests) is any object with these
methods; `ServoBus(..., transport=...)` takes a function that opens one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, Protocol

from pliant import ServoError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant.servo.models.row import Protocol as Wire

Reason = Literal["timeout", "corrupt", "stale", "refused", "late", "noisy", "gone"]


class BusError(ServoError):
    """One transaction failed.

    Attributes:
        reason: `timeout`: no or no whole answer; `corrupt`: an answer that is none; `stale`: an
            answer to an earlier request; `refused`: the servo says it will not; `late`: nothing
            was sent, as the cycle has no time left; `noisy`: nothing was sent, as the line is never
            silent; `gone`: the port has vanished.
        id: The servo whose answer failed, where that is known.
    """

    def __init__(self, message: str, reason: Reason, id: int | None = None) -> None:
        """Say what failed, how, and where."""
        super().__init__(message)
        self.reason: Reason = reason
        self.id = id


class Transport(Protocol):
    """Requests and answers on one port; every call may raise `BusError`.

    Bytes go as they are in the control table. `status` is the error byte of the answer.
    """

    def read(self, id: int, address: int, size: int) -> tuple[bytes, int]:
        """Read bytes of one servo: (bytes, status)."""

    def write(self, id: int, address: int, data: bytes) -> int:
        """Write bytes of one servo, return the status of its answer."""

    def sync_read(self, ids: Sequence[int], address: int, size: int) -> list[tuple[bytes, int]]:
        """Read the same bytes of several servos with one request: all or nothing."""

    def sync_write(self, ids: Sequence[int], address: int, data: Sequence[bytes]) -> None:
        """Write the same registers of several servos with one packet; nobody answers."""

    def ping(self, id: int) -> bool:
        """Whether a servo answers."""

    def reboot(self, id: int) -> None:
        """Restart a servo, where the protocol can."""

    def set_timeout(self, seconds: float) -> None:
        """How long the next calls wait for an answer."""

    def close(self) -> None:
        """Let go of the port."""


class RustypotTransport:
    """rustypot's raw-address calls: one port, one protocol.

    One raw controller serves Dynamixel Protocol 1.0 and Feetech together, whose framing is the
    same; Protocol 2.0 needs a port of its own. The GIL is released while it waits.

    Args:
        port: Path of the serial port.
        baudrate: Bits per second.
        protocol: `p1` (with Feetech) or `p2`.
        timeout: How long to wait for an answer [s].

    Raises:
        ImportError: The extra `servo` is missing.
        ServoError: The port cannot be opened; the message says why and what to do.
    """

    def __init__(self, port: str, baudrate: int, protocol: Wire, timeout: float = 0.02) -> None:
        """Open the port, exclusively."""
        try:
            import rustypot
        except ImportError as error:
            from pliant.extras import missing

            raise ImportError(missing("driving servos", "servo")) from error
        self.port, self.baudrate = port, baudrate
        kind = rustypot.MxPyController if protocol == "p1" else rustypot.Xl430PyController
        try:
            self._io: Any = kind(port, baudrate, timeout)
        except (OSError, RuntimeError) as error:
            raise ServoError(_cannot_open(port, str(error))) from error

    def read(self, id: int, address: int, size: int) -> tuple[bytes, int]:
        """Read bytes of one servo: (bytes, status)."""
        try:
            values, status = self._io.read_raw_data_with_error(id, address, size)
        except RuntimeError as error:
            raise self._failed(error, id) from error
        return bytes(values), int(status)

    def write(self, id: int, address: int, data: bytes) -> int:
        """Write bytes of one servo, return the status of its answer."""
        try:
            return int(self._io.write_raw_data_with_error(id, address, list(data)))
        except RuntimeError as error:
            raise self._failed(error, id) from error

    def sync_read(self, ids: Sequence[int], address: int, size: int) -> list[tuple[bytes, int]]:
        """Read the same bytes of several servos with one request: all or nothing."""
        try:
            answers = self._io.sync_read_raw_data_with_error(list(ids), address, size)
        except RuntimeError as error:
            raise self._failed(error, None) from error
        return [(bytes(values), int(status)) for values, status in answers]

    def sync_write(self, ids: Sequence[int], address: int, data: Sequence[bytes]) -> None:
        """Write the same registers of several servos with one packet; nobody answers."""
        try:
            self._io.sync_write_raw_data(list(ids), address, [list(item) for item in data])
        except RuntimeError as error:
            raise self._failed(error, None) from error

    def ping(self, id: int) -> bool:
        """Whether a servo answers."""
        try:
            return bool(self._io.ping(id))
        except RuntimeError as error:
            raise self._failed(error, id) from error

    def reboot(self, id: int) -> None:
        """Restart a servo (Protocol 2.0)."""
        try:
            self._io.reboot(id)
        except RuntimeError as error:
            raise self._failed(error, id) from error

    def set_timeout(self, seconds: float) -> None:
        """How long the next calls wait for an answer."""
        self._io.set_timeout(seconds)

    def close(self) -> None:
        """Let go of the port."""
        self._io.close()

    def _failed(self, error: RuntimeError, id: int | None) -> BusError:
        """What rustypot's text says: its errors reach Python in no other form."""
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
        return BusError(
            f"{self.port} is gone ({text}): is the adapter still plugged in and powered?", "gone"
        )


_SILENT = ("timed out", "timeout")
_BROKEN = ("checksum", "parsing", "incorrect id")


def _cannot_open(port: str, text: str) -> str:
    """Why a port cannot be opened, and what to do."""
    lower = text.lower()
    if "permission" in lower or "access is denied" in lower:
        return (
            f"no permission to open {port}: join the group that owns it (sudo usermod -aG dialout "
            "$USER; on Arch uucp), log out and in again"
        )
    if "exclusive" in lower or "busy" in lower or "in use" in lower:
        return f"{port} is in use by another program: close it (a vendor's wizard, another run)"
    if "no such file" in lower or "not found" in lower or "no such device" in lower:
        there = ", ".join(serial_ports()) or "none: is the adapter plugged in?"
        return f"there is no port {port}; there are: {there}"
    if "typewriter" in lower or "inappropriate ioctl" in lower:
        return f"{port} is no serial port; there are: {', '.join(serial_ports()) or 'none'}"
    return f"cannot open {port}: {text}"


def serial_ports() -> tuple[str, ...]:
    """Serial ports of this machine, by stable name where there is one (Linux and macOS)."""
    from pathlib import Path

    found = sorted(str(p) for p in Path("/dev/serial/by-id").glob("*"))
    for pattern in ("ttyUSB*", "ttyACM*", "tty.usb*"):
        found += sorted(str(p) for p in Path("/dev").glob(pattern))
    return tuple(found)
