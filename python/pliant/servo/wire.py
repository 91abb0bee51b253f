"""Wire arithmetic: how long a transaction takes, and how long to wait for it.

Ten bits a byte. Packets without their data: Protocol 1.0 and Feetech 6 bytes (FF FF id length
instruction-or-error checksum), Protocol 2.0 10 for an instruction and 11 for a status.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pliant import ConfigError
from pliant.arguments import real

if TYPE_CHECKING:
    from pliant.servo.models.row import Protocol

BITS = 10
#: A servo's own time to answer with Return Delay 0 [s].
TURN = 30e-6
#: Longest that an answer may be waited for at least [s].
LONGEST_PATIENCE = 1.0
#: Bytes of a packet without its data: instruction and status.
OVERHEAD = {"p1": (6, 6), "p2": (10, 11)}
Kind = Literal["ping", "read", "write", "sync_read", "sync_write"]


def wire_bytes(protocol: Protocol, kind: Kind, servos: int, size: int) -> tuple[int, int]:
    """Bytes sent and bytes received by a transaction.

    Args:
        protocol: `p1` (Feetech too) or `p2`.
        kind: The instruction.
        servos: How many servos it addresses.
        size: Data bytes per servo.

    Returns:
        Bytes to the servos, bytes back. Byte stuffing of Protocol 2.0 is not counted.
    """
    ask, answer = OVERHEAD[protocol]
    address, length = (1, 1) if protocol == "p1" else (2, 2)
    if kind == "ping":
        return ask, answer + (0 if protocol == "p1" else 3)
    if kind == "read":
        return ask + address + length, answer + size
    if kind == "write":
        return ask + address + size, answer
    if kind == "sync_read":
        return ask + address + length + servos, servos * (answer + size)
    return ask + address + length + servos * (1 + size), 0


def wire_time(
    protocol: Protocol,
    kind: Kind,
    servos: int,
    size: int,
    *,
    baudrate: int,
    turn: float = TURN,
) -> float:
    """Time a transaction keeps the wire busy [s].

    Args:
        protocol: `p1` (Feetech too) or `p2`.
        kind: The instruction.
        servos: How many servos it addresses.
        size: Data bytes per servo.
        baudrate: Bits per second.
        turn: Time of a servo to answer [s]; Return Delay 250 is 500 µs.
    """
    sent, received = wire_bytes(protocol, kind, servos, size)
    answers = servos if kind == "sync_read" else int(received > 0)
    return (sent + received) * BITS / baudrate + answers * turn


def reply_timeout(wire: float, latency: float, cycle: float, patience: float = 0.010) -> float:
    """How long to wait for a reply [s].

    Twice the wire time, twice the adapter's latency timer and 5 ms for the host, at most three
    control cycles; but at least `patience`, whatever the cycle.
    """
    return max(patience, min(2.0 * wire + 2.0 * latency + 0.005, 3.0 * cycle))


def patient(patience: float) -> float:
    """Return a least time to wait for an answer [s] with which a silent bus is soon found out.

    Raises:
        ConfigError: It is no number, or not in (0, 1] s.
    """
    if not 0.0 < real(patience, "patience") <= LONGEST_PATIENCE:
        raise ConfigError(
            f"patience must be above 0 s and at most {LONGEST_PATIENCE:g} s, got {patience:g}: "
            "nothing else is sent while an answer is waited for"
        )
    return float(patience)
