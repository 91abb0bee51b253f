"""Scan of a serial port: every baud rate, both protocols, id by id. Reads only."""

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
#: Ids that a scan tries by default: those in common use.
USUAL = range(41)
ALL = range(253)
#: Reply timeout in addition to wire and adapter [s]: the longest return delay of a servo, and a
#: busy host.
PATIENCE = 0.005
#: Reply timeout if a reply may be late, and silence of the line before such a request [s]: an
#: adapter that holds replies back for 16 ms, and a busy host.
CAREFUL = 0.05
#: After a late or broken reply, the scan asks this number of preceding ids again.
BEFORE = 12
#: `UNUSED_ID`: id without a servo, for listening. `LISTENS`: number of listens until the line
#: counts as never silent. `TRIES`: number of requests to an id whose replies are broken.
UNUSED_ID, LISTENS, TRIES = 252, 20, 3
#: Longest response delay of a servo [s]: the makers' default is 500 µs.
SLOWEST_TURN = 0.0006
TWO = (
    "broken answer: two servos on this id? Connect them one by one and give each its own with "
    "`pliant servos setup ARM --set-id OLD:NEW`; else a bad cable"
)
EVERYBODY = (
    "broken answers from every id: an adapter that hears its own requests or adds bytes when it "
    "turns the line round; noise; or another baud rate"
)
#: Address of the model number: Dynamixel, Feetech.
MODEL_AT = {"p1": (0, 3), "p2": (0,)}


@dataclass(frozen=True)
class ScannedServo:
    """A servo that answered.

    Attributes:
        port: Path of the port.
        baudrate: [bit/s]
        protocol: `p1` (Feetech too) or `p2`.
        id: Id on the bus.
        number: Model number; None if it could not be read.
        models: Table rows with this number; Feetech's variants share one.
        note: Anomaly; empty otherwise.
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
    """Ask every id at every baud rate, in both framings.

    Args:
        port: Path of the port; it must be free.
        baudrates: Speeds to try [bit/s].
        ids: Ids to try.
        transport: Opens the port: ``(path, baudrate, protocol) -> Transport``.
        progress: Called with a text before each step.

    Returns:
        Servos that answered.

    Raises:
        ServoError: The port cannot be opened, has vanished, or is never silent.
        ImportError: The extra `servo` is missing.
    """
    asked = tuple(ids)
    held_back = latency_timer(port) or 0.001
    found: list[ScannedServo] = []
    for baudrate in baudrates:
        for protocol in ("p1", "p2"):
            progress(f"{port}, {baudrate} bit/s, Protocol {protocol[1]}.0")
            io = transport(port, baudrate, protocol)
            try:
                found += _Asking(io, port, baudrate, protocol, held_back).ask_all(asked)
            finally:
                io.close()
    return tuple(found)


class _Asking:
    """Scan of the ids on an open port, which assigns late replies to no other id.

    Each id gets the normal reply time. As soon as any data arrive, even late data of an earlier id,
    the scan listens until the line is silent, and asks the last ids again with a longer timeout.
    If any servo answers, silent ids are asked a second time, because a busy host loses replies.
    """

    def __init__(
        self, io: Transport, port: str, baudrate: int, protocol: Wire, held_back: float
    ) -> None:
        self._io, self._port, self._baudrate, self._protocol = io, port, baudrate, protocol
        wire = wire_time(protocol, "read", 1, 2, baudrate=baudrate, response_delay=SLOWEST_TURN)
        self._quick = wire + held_back + PATIENCE
        self._careful = max(CAREFUL, 3.0 * self._quick)

    def ask_all(self, ids: Sequence[int]) -> list[ScannedServo]:
        """Return the servos that answer, in the order of the ids.

        Raises:
            ServoError: The line is never silent.
        """
        self._is_silent = False
        if not self._listen():
            raise ServoError(f"{self._port}: {NOISE_MESSAGE}")
        known: dict[int, ScannedServo | None] = {}
        for place, number in enumerate(ids):
            if number in known or not self._stirs(number):
                continue
            for again in ids[max(place - BEFORE, 0) : place + 1]:
                if known.get(again) is None:
                    known[again] = self._ask(again)
        if any(known.values()):
            for number in ids:
                if number not in known:
                    known[number] = self._ask(number)
        found = [servo for number in ids if (servo := known.get(number)) is not None]
        if len(found) > 1 and all(servo.note == TWO for servo in found):
            found = [replace(servo, note=EVERYBODY) for servo in found]
        return found

    def _stirs(self, number: int) -> bool:
        """Send a request to an id; return True if any data arrive."""
        self._io.set_timeout(self._quick)
        try:
            self._io.read(number, MODEL_AT[self._protocol][0], 2)
        except BusError as error:
            error.raise_if_gone()
            if error.reason == "timeout":
                return False
        self._is_silent = False
        return True

    def _ask(self, number: int) -> ScannedServo | None:
        """Return the servo that answers to an id, with a longer timeout; None: no answer.

        It is read, not pinged: if two servos answer a ping at once, it looks like no answer.
        """
        for _ in range(TRIES):
            self._listen()
            try:
                self._io.read(number, MODEL_AT[self._protocol][0], 2)
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
        return self._result(number, TWO)

    def _result(
        self, number: int, note: str, model: int | None = None, rows: tuple[str, ...] = ()
    ) -> ScannedServo:
        return ScannedServo(self._port, self._baudrate, self._protocol, number, model, rows, note)

    def _listen(self) -> bool:
        """Wait until the line is silent, for a limited time; return True if it is."""
        self._io.set_timeout(self._careful)
        if self._is_silent:
            return True
        for _ in range(LISTENS):
            before = time.perf_counter()
            try:
                self._io.ping(UNUSED_ID)
            except BusError as error:
                error.raise_if_gone()
            if time.perf_counter() - before >= self._careful:
                self._is_silent = True
                return True
        return False


def _model(io: Transport, protocol: Wire, id: int) -> tuple[int | None, tuple[str, ...]]:
    """Return model number and table rows; Feetech has firmware where Dynamixel has the model."""
    number: int | None = None
    for address in MODEL_AT[protocol]:
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
