"""Duration of transactions on the wire, and reply timeouts.

One byte takes ten bits. Packets without data have 6 bytes in Protocol 1.0 and Feetech (FF FF id
length instruction-or-error checksum); in Protocol 2.0, 10 for an instruction and 11 for a status.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from pliant._core import ConfigError
from pliant._validation import real

if TYPE_CHECKING:
    from pliant.servo.models.row import Protocol

BITS = 10
#: Response delay of a servo with Return Delay 0 [s].
TURN = 30e-6
#: Largest minimum reply timeout (`patience`) [s].
LONGEST_PATIENCE = 1.0
#: Bytes of a packet without data: instruction and status.
OVERHEAD = {"p1": (6, 6), "p2": (10, 11)}
Kind = Literal["ping", "read", "write", "sync_read", "sync_write"]


def wire_bytes(protocol: Protocol, kind: Kind, servos: int, size: int) -> tuple[int, int]:
    """Return the bytes sent and received in a transaction.

    Args:
        protocol: `p1` (Feetech too) or `p2`.
        kind: The instruction.
        servos: Number of addressed servos.
        size: Data bytes per servo.

    Returns:
        Bytes to the servos, and bytes back. Byte stuffing of Protocol 2.0 is not counted.
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
    """Return the time for which a transaction occupies the wire [s].

    Args:
        protocol: `p1` (Feetech too) or `p2`.
        kind: The instruction.
        servos: Number of addressed servos.
        size: Data bytes per servo.
        baudrate: Bits per second.
        turn: Response delay of a servo [s]; Return Delay 250 is 500 µs.
    """
    sent, received = wire_bytes(protocol, kind, servos, size)
    answers = servos if kind == "sync_read" else int(received > 0)
    return (sent + received) * BITS / baudrate + answers * turn


def reply_timeout(wire: float, latency: float, cycle: float, patience: float = 0.010) -> float:
    """Return the reply timeout [s].

    It is twice the wire time, plus twice the adapter's latency timer, plus 5 ms for the host; at
    most three control cycles, but at least `patience`.
    """
    return max(patience, min(2.0 * wire + 2.0 * latency + 0.005, 3.0 * cycle))


def patient(patience: float) -> float:
    """Return a checked minimum reply timeout [s]; the bound makes a silent bus known soon.

    Raises:
        ConfigError: Not a number, or not in (0, 1] s.
    """
    if not 0.0 < real(patience, "patience") <= LONGEST_PATIENCE:
        raise ConfigError(
            f"patience must be above 0 s and at most {LONGEST_PATIENCE:g} s, got {patience:g}: "
            "nothing else is sent while an answer is waited for"
        )
    return float(patience)
