"""Who is on a serial port: every baud rate, both framings, id by id. Reads only."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pliant import ServoError
from pliant.servo.guard import NOISY
from pliant.servo.models import by_number
from pliant.servo.port import latency_timer
from pliant.servo.transport import BusError, RustypotTransport
from pliant.servo.wire import wire_time

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from pliant.servo.models.row import Protocol as Wire
    from pliant.servo.transport import Transport

#: Speeds that servos are found at [bit/s], the usual ones first.
BAUDRATES = (1_000_000, 57_600, 115_200, 500_000, 2_000_000, 3_000_000, 4_000_000)
#: Ids that makers and builders use; a deep scan asks all.
USUAL = range(41)
ALL = range(253)
#: Beyond the wire and the adapter, an id is waited for so long [s]: a servo's longest return delay,
#: and a host that is busy elsewhere.
PATIENCE = 0.005
#: How long an id is waited for where an answer may be late, and how long the line must be silent
#: before it is asked: an adapter that holds answers back for 16 ms, and a busy host [s].
CAREFUL = 0.05
#: So many ids before one with a late or broken answer are asked again.
BEFORE = 12
#: An id that nobody has, to listen behind; how often it is listened, and how often an id is asked
#: whose answer is broken.
NOBODY, LISTENS, TRIES = 252, 20, 3
#: A servo's longest time to begin its answer [s]: the makers' default is 500 µs.
SLOWEST_TURN = 0.0006
TWO = (
    "broken answer: two servos on this id? Connect them one by one and give each its own with "
    "`pliant servos setup ARM --set-id OLD:NEW`; else a bad cable"
)
EVERYBODY = (
    "broken answers from every id: an adapter that hears its own requests or adds bytes when it "
    "turns the line round; noise; or another baud rate"
)
#: Where the model number stands: Dynamixel, Feetech.
MODEL_AT = {"p1": (0, 3), "p2": (0,)}


@dataclass(frozen=True)
class Seen:
    """A servo that answered.

    Attributes:
        port: Path of the port.
        baudrate: [bit/s]
        protocol: `p1` (Feetech too) or `p2`.
        id: On the bus.
        number: Model number; None where it could not be read.
        models: Table rows with that number; Feetech's variants share one.
        note: What is odd about it; empty otherwise.
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
) -> tuple[Seen, ...]:
    """Ask every id at every baud rate, in both framings.

    Args:
        port: Path of the port; it must be free.
        baudrates: Speeds to try [bit/s].
        ids: Ids to try.
        transport: Opens the port: ``(path, baudrate, protocol) -> Transport``.
        progress: Told what is tried next.

    Returns:
        Who answered.

    Raises:
        ServoError: The port cannot be opened, or vanished, or is never silent.
        ImportError: The extra `servo` is missing.
    """
    asked = tuple(ids)
    held_back = latency_timer(port) or 0.001
    found: list[Seen] = []
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
    """Ids asked one by one on an open port, with nobody's answer taken for another's.

    Each id gets the time that an answer should take. As soon as anything comes back, also for an id
    before, the line is listened to until it is silent, and the ids of the last moments are asked
    again with time to spare. Where servos answer, silent ids are asked a second time: a host that
    was busy elsewhere loses answers.
    """

    def __init__(
        self, io: Transport, port: str, baudrate: int, protocol: Wire, held_back: float
    ) -> None:
        self._io, self._port, self._baudrate, self._protocol = io, port, baudrate, protocol
        wire = wire_time(protocol, "read", 1, 2, baudrate=baudrate, turn=SLOWEST_TURN)
        self._quick = wire + held_back + PATIENCE
        self._careful = max(CAREFUL, 3.0 * self._quick)

    def ask_all(self, ids: Sequence[int]) -> list[Seen]:
        """Who answers, in the order of the ids.

        Raises:
            ServoError: The line is never silent.
        """
        self._is_silent = False
        if not self._listen():
            raise ServoError(f"{self._port}: {NOISY}")
        known: dict[int, Seen | None] = {}
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
        found = [seen for number in ids if (seen := known.get(number)) is not None]
        if len(found) > 1 and all(seen.note == TWO for seen in found):
            found = [replace(seen, note=EVERYBODY) for seen in found]
        return found

    def _stirs(self, number: int) -> bool:
        """Whether anything comes back at all."""
        self._io.set_timeout(self._quick)
        try:
            self._io.read(number, MODEL_AT[self._protocol][0], 2)
        except BusError as error:
            _pass_on(error)
            if error.reason == "timeout":
                return False
        self._is_silent = False
        return True

    def _ask(self, number: int) -> Seen | None:
        """Whether somebody answers to an id, and who it is, with time to spare.

        Read rather than pinged: to a ping, two servos that answer at once are as good as none.
        """
        for _ in range(TRIES):
            self._listen()
            try:
                self._io.read(number, MODEL_AT[self._protocol][0], 2)
            except BusError as error:
                _pass_on(error)
                self._is_silent = error.reason == "timeout"
                if self._is_silent:
                    return None
                continue
            self._is_silent = False
            model, rows = _model(self._io, self._protocol, number)
            note = "" if rows else "not in the servo table"
            return self._seen(number, note, model, rows)
        return self._seen(number, TWO)

    def _seen(
        self, number: int, note: str, model: int | None = None, rows: tuple[str, ...] = ()
    ) -> Seen:
        return Seen(self._port, self._baudrate, self._protocol, number, model, rows, note)

    def _listen(self) -> bool:
        """Wait until the line is silent, but not for ever; say whether it is."""
        self._io.set_timeout(self._careful)
        if self._is_silent:
            return True
        for _ in range(LISTENS):
            before = time.perf_counter()
            try:
                self._io.ping(NOBODY)
            except BusError as error:
                _pass_on(error)
            if time.perf_counter() - before >= self._careful:
                self._is_silent = True
                return True
        return False


def _pass_on(error: BusError) -> None:
    """Raise what no next id can change."""
    if error.reason == "gone":
        raise error


def _model(io: Transport, protocol: Wire, id: int) -> tuple[int | None, tuple[str, ...]]:
    """Model number and rows; a Feetech servo has its firmware where a Dynamixel has its model."""
    number: int | None = None
    for address in MODEL_AT[protocol]:
        try:
            data, _ = io.read(id, address, 2)
        except BusError as error:
            if error.reason == "gone":
                raise
            continue
        value = int.from_bytes(data, "little")
        number = value if number is None else number
        rows = [row for row in by_number(value) if row.family.protocol == protocol]
        rows = [row for row in rows if row.family.registers["model"].address == address]
        if rows:
            return value, tuple(row.name for row in rows)
    return number, ()
