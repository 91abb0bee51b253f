"""Who is on a serial port: every baud rate, both framings, id by id. Reads only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pliant.servo.models import by_number
from pliant.servo.transport import BusError, RustypotTransport

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from pliant.servo.models.row import Protocol as Wire
    from pliant.servo.transport import Transport

#: Speeds that servos are found at [bit/s], the usual ones first.
BAUDRATES = (1_000_000, 57_600, 115_200, 500_000, 2_000_000, 3_000_000, 4_000_000)
#: Ids that makers and builders use; a deep scan asks all.
USUAL = range(41)
ALL = range(253)
#: How long one id is waited for [s].
PATIENCE = 0.004
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
        ServoError: The port cannot be opened, or vanished.
        ImportError: The extra `servo` is missing.
    """
    asked = tuple(ids)
    found: list[Seen] = []
    for baudrate in baudrates:
        for protocol in ("p1", "p2"):
            progress(f"{port}, {baudrate} bit/s, Protocol {protocol[1]}.0")
            io = transport(port, baudrate, protocol)
            try:
                io.set_timeout(PATIENCE)
                answers = (_ask(io, port, baudrate, protocol, number) for number in asked)
                found += [seen for seen in answers if seen is not None]
            finally:
                io.close()
    return tuple(found)


def _ask(io: Transport, port: str, baudrate: int, protocol: Wire, id: int) -> Seen | None:
    """Whether somebody answers to an id, and who it is.

    Read rather than pinged: to a ping, two servos that answer at once are as good as none.
    """
    try:
        io.read(id, MODEL_AT[protocol][0], 2)
    except BusError as error:
        if error.reason == "gone":
            raise
        if error.reason not in {"corrupt", "stale"}:
            return None
        note = (
            "broken answer: two servos on this id? Connect them one by one and give each its own "
            "with `pliant setup`; else a bad cable"
        )
        return Seen(port, baudrate, protocol, id, note=note)
    number, models = _model(io, protocol, id)
    note = "" if models else "not in the servo table"
    return Seen(port, baudrate, protocol, id, number, models, note)


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
