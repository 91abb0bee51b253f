"""Scan of a serial port for servos at every baud rate, protocol and id; it writes no registers."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pliant._core import ServoError
from pliant.servo._port import latency_timer
from pliant.servo._transactions import NOISE_MESSAGE, wire_time
from pliant.servo.models import by_number
from pliant.servo.transport import BusError, RustypotTransport

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from pliant.servo.models.base import Protocol as Wire
    from pliant.servo.transport import Transport

#: Baud rates to try [bit/s], the most common first.
BAUDRATES = (1_000_000, 57_600, 115_200, 500_000, 2_000_000, 3_000_000, 4_000_000)
#: Ids in common use, which a scan tries by default.
USUAL = range(41)
#: All ids that both protocols allow.
ALL = range(253)
#: Margin of the short reply timeout for a busy host, added to wire time and adapter latency [s].
TIMEOUT_MARGIN = 0.005
#: Minimum of the long reply timeout, and of the silence before a request with that timeout [s].
#: Adapters delay replies by up to 16 ms.
LONG_TIMEOUT = 0.05
#: Number of preceding ids that are asked again when data arrive, as these may be a late reply.
IDS_TO_REPEAT = 12
#: Id that is assumed to have no servo; pings to it detect data on the line.
UNUSED_ID = 252
#: Number of pings that other data interrupt before the line counts as never silent.
MAX_PINGS = 20
#: Number of requests to an id whose replies are corrupt.
TRIES = 3
#: Longest response delay of a servo [s]: 500 µs is the makers' default, plus a margin.
MAX_RESPONSE_DELAY = 0.0006
SAME_ID_NOTE = (
    "broken answer: two servos on this id? Connect them one by one and give each its own with "
    "`pliant servos setup ARM --set-id OLD:NEW`; else a bad cable"
)
BAD_LINE_NOTE = (
    "broken answers from every id: an adapter that receives its own requests or adds bytes when it "
    "changes direction; noise; or another baud rate"
)
#: Addresses of the register Model Number by protocol; `p1`: of Dynamixel 1.0, then of Feetech.
MODEL_ADDRESSES = {"p1": (0, 3), "p2": (0,)}


@dataclass(frozen=True)
class ScannedServo:
    """Servo that answered a scan.

    Attributes:
        port: Path of the port.
        baudrate: Baud rate [bit/s].
        protocol: `p1` (Dynamixel 1.0 and Feetech) or `p2` (Dynamixel 2.0).
        id: Id on the bus.
        number: Model number; None if it could not be read.
        models: Names of the models with this number; Feetech's variants share one number.
        note: Description of an anomaly; empty otherwise.
    """

    port: str
    baudrate: int
    protocol: str
    id: int
    number: int | None = None
    models: tuple[str, ...] = ()
    note: str = ""


def scan(
    port: str,
    *,
    baudrates: Sequence[int] = BAUDRATES,
    ids: Iterable[int] = USUAL,
    transport: Callable[[str, int, Wire], Transport] = RustypotTransport,
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[ScannedServo, ...]:
    """Search a port for servos: read from every id, at every baud rate, in both protocols.

    Args:
        port: Path of the port; no other program may use it.
        baudrates: Baud rates to try [bit/s].
        ids: Ids to try.
        transport: Function ``(path, baudrate, protocol) -> Transport`` that opens the port.
        progress: Function that is called with a text before each step.

    Returns:
        Servos that answered.

    Raises:
        ServoError: The port cannot be opened, has vanished, or is never silent.
        ImportError: The extra `servo` is missing.
    """
    id_list = tuple(ids)
    latency = latency_timer(port) or 0.001
    servos: list[ScannedServo] = []
    for baudrate in baudrates:
        for protocol in ("p1", "p2"):
            progress(f"{port}, {baudrate} bit/s, Protocol {protocol[1]}.0")
            io = transport(port, baudrate, protocol)
            try:
                servos += _IdScan(io, port, baudrate, protocol, latency).run(id_list)
            finally:
                io.close()
    return tuple(servos)


class _IdScan:
    """Scan of the ids on an open port at one baud rate and protocol.

    Each id is first asked with a short reply timeout. When data arrive, they may be the late reply
    of an earlier id. The scan then waits until the line is silent, and asks the last ids again with
    a longer timeout, so that no reply is assigned to another id. If any servo answers, silent ids
    are asked a second time, because a busy host loses replies.
    """

    def __init__(
        self, io: Transport, port: str, baudrate: int, protocol: Wire, latency: float
    ) -> None:
        self._io, self._port, self._baudrate, self._protocol = io, port, baudrate, protocol
        wire = wire_time(
            protocol, "read", 1, 2, baudrate=baudrate, response_delay=MAX_RESPONSE_DELAY
        )
        self._short_timeout = wire + latency + TIMEOUT_MARGIN
        self._long_timeout = max(LONG_TIMEOUT, 3.0 * self._short_timeout)

    def run(self, ids: Sequence[int]) -> list[ScannedServo]:
        """Return the servos that answer, in the order of the ids.

        Raises:
            ServoError: The line is never silent, or every id has a corrupt reply.
        """
        self._is_silent = False
        if not self._wait_for_silence():
            raise ServoError(f"{self._port}: {NOISE_MESSAGE}")
        known: dict[int, ScannedServo | None] = {}
        for index, number in enumerate(ids):
            if number in known or not self._has_traffic(number):
                continue
            for candidate in ids[max(index - IDS_TO_REPEAT, 0) : index + 1]:
                if known.get(candidate) is None:
                    known[candidate] = self._identify(candidate)
        if any(known.values()):
            for number in ids:
                if number not in known:
                    known[number] = self._identify(number)
        servos = [servo for number in ids if (servo := known.get(number)) is not None]
        if len(servos) > 1 and all(servo.note == SAME_ID_NOTE for servo in servos):
            if len(servos) == len(ids):
                raise ServoError(f"{self._port}: {BAD_LINE_NOTE}; or this is no servo adapter")
            servos = [replace(servo, note=BAD_LINE_NOTE) for servo in servos]
        return servos

    def _has_traffic(self, number: int) -> bool:
        """Ask id `number` with the short reply timeout; return True if data have arrived."""
        self._io.set_timeout(self._short_timeout)
        try:
            self._io.read(number, MODEL_ADDRESSES[self._protocol][0], 2)
        except BusError as error:
            error.raise_if_gone()
            if error.reason == "timeout":
                return False
        self._is_silent = False
        return True

    def _identify(self, number: int) -> ScannedServo | None:
        """Return the servo that answers to id `number` within the long timeout; None: no reply.

        The request is a read, because the transport does not report a servo if the ping replies of
        two servos collide.
        """
        for _ in range(TRIES):
            self._wait_for_silence()
            try:
                self._io.read(number, MODEL_ADDRESSES[self._protocol][0], 2)
            except BusError as error:
                error.raise_if_gone()
                self._is_silent = error.reason == "timeout"
                if self._is_silent:
                    return None
                continue
            self._is_silent = False
            model, rows = _model(self._io, self._protocol, number)
            note = "" if rows else "not in the servo table"
            return self._result(number, note, model, rows)
        return self._result(number, SAME_ID_NOTE)

    def _result(
        self, number: int, note: str, model: int | None = None, rows: tuple[str, ...] = ()
    ) -> ScannedServo:
        return ScannedServo(self._port, self._baudrate, self._protocol, number, model, rows, note)

    def _wait_for_silence(self) -> bool:
        """Wait until the line is silent; return False if data still arrive after `MAX_PINGS`."""
        self._io.set_timeout(self._long_timeout)
        if self._is_silent:
            return True
        for _ in range(MAX_PINGS):
            start = time.perf_counter()
            try:
                self._io.ping(UNUSED_ID)
            except BusError as error:
                error.raise_if_gone()
            if time.perf_counter() - start >= self._long_timeout:
                self._is_silent = True
                return True
        return False


def _model(io: Transport, protocol: Wire, id: int) -> tuple[int | None, tuple[str, ...]]:
    """Return the model number of servo `id` and the names of the models with this number.

    Dynamixel and Feetech store the model number at different addresses, so both are tried.
    """
    number: int | None = None
    for address in MODEL_ADDRESSES[protocol]:
        try:
            data, _ = io.read(id, address, 2)
        except BusError as error:
            error.raise_if_gone()
            continue
        value = int.from_bytes(data, "little")
        number = value if number is None else number
        rows = [row for row in by_number(value) if row.family.protocol == protocol]
        rows = [row for row in rows if row.family.registers["model"].address == address]
        if rows:
            return value, tuple(row.name for row in rows)
    return number, ()
