"""Fault injection on the bus: faults of given requests or replies, and seeded random faults."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from pliant._core import ConfigError
from pliant.emulator.packets import HEADER_2, STATUS, packet_1, packet_2

Kind = Literal["deaf", "lose", "late", "corrupt", "truncate", "wrong_id", "noise"]
KINDS: tuple[Kind, ...] = get_args(Kind)


@dataclass(slots=True)
class InjectedFault:
    """Fault of the next requests or replies, set by `Faults.inject`.

    Attributes:
        kind: Kind of fault.
        id: Id of the servo whose requests or replies are affected; None: any servo.
        count: Remaining number of requests or replies to affect.
        skip: Number of requests or replies to leave intact first.
        seconds: Delay of a `late` reply [s]; None delays it until the next request.
    """

    kind: Kind
    id: int | None
    count: int
    skip: int
    seconds: float | None

    def affects(self, id: int) -> bool:
        """Return True if the fault affects this request or reply of servo `id`.

        Each call counts as one request or reply, so it decreases `skip` or `count`.
        """
        if self.count <= 0 or (self.id is not None and self.id != id):
            return False
        if self.skip > 0:
            self.skip -= 1
            return False
        self.count -= 1
        return True


@dataclass(frozen=True, slots=True)
class ActiveFault:
    """Fault that affects one reply or request; `seconds` is the delay of a `late` reply."""

    kind: Kind
    seconds: float | None = None


class Faults:
    """Faults between servos and host.

    - `deaf`: the request does not reach the servo
    - `lose`: the reply does not reach the host
    - `late`: the reply is delayed, by default until just before the reply to the next request
    - `corrupt`: one bit of the reply is flipped
    - `truncate`: the end of the reply is missing
    - `wrong_id`: the reply has another id, with a valid checksum
    - `noise`: a few bytes of noise precede the reply

    Args:
        seed: Seed of the random faults; equal seeds and requests give equal faults.
        **shares: Share of transactions with each kind of random fault, by kind, in [0, 1]; a
            transaction has at most one random fault, on one of its replies.

    Raises:
        ConfigError: A kind is unknown, a share is outside [0, 1], or the shares exceed 1 in sum.
    """

    def __init__(self, *, seed: int = 0, **shares: float) -> None:
        self._rng = np.random.default_rng(seed)
        self._injected: list[InjectedFault] = []
        self.by_chance(**shares)

    def by_chance(self, **shares: float) -> None:
        """Set the share of transactions with each kind of random fault; other kinds do not occur.

        Raises:
            ConfigError: A kind is unknown, a share is outside [0, 1], or the shares exceed 1 in
                sum.
        """
        for kind, share in shares.items():
            _kind(kind)
            if not 0.0 <= share <= 1.0:
                raise ConfigError(f"share of {kind!r} must be in [0, 1], got {share!r}")
        if sum(shares.values()) > 1.0:
            raise ConfigError(f"shares add up to {sum(shares.values()):g}, more than 1")
        self._shares = {_kind(kind): share for kind, share in shares.items()}

    def inject(
        self,
        kind: str,
        id: int | None = None,
        *,
        count: int = 1,
        skip: int = 0,
        seconds: float | None = None,
    ) -> None:
        """Inject a fault into the next requests or replies.

        Args:
            kind: Kind of fault, as listed for the class `Faults`.
            id: The affected servo; None: any servo that replies (for `deaf`: that is addressed).
            count: Number of requests or replies to affect.
            skip: Number of requests or replies to leave intact first.
            seconds: Delay of a `late` reply [s]; None delays it until the next request.

        Raises:
            ConfigError: The kind is unknown, or `count` or `skip` is negative.
        """
        if count < 0 or skip < 0:
            raise ConfigError(f"count and skip must be at least 0, got {count} and {skip}")
        self._injected.append(InjectedFault(_kind(kind), id, count, skip, seconds))

    def clear(self) -> None:
        """Remove all injected and random faults."""
        self._injected.clear()
        self._shares.clear()

    def chance(self) -> Kind | None:
        """Return the kind of the random fault of the next transaction; None: no random fault."""
        if not self._shares:
            return None
        draw = self._rng.random()
        for kind, share in self._shares.items():
            draw -= share
            if draw < 0.0:
                return kind
        return None

    def pick(self, among: int) -> int:
        """Return a random index from 0 to `among` - 1: the reply with the random fault."""
        return int(self._rng.integers(among))

    def deaf(self, id: int) -> bool:
        """Return True if an injected fault keeps this request from servo `id`."""
        return self._take(id, ("deaf",)) is not None

    def reply_fault(self, id: int) -> ActiveFault | None:
        """Return the injected fault of the next reply of servo `id`; None: no fault."""
        return self._take(id, KINDS[1:])

    @property
    def injected(self) -> bool:
        """True if an injected fault may affect the next request or reply."""
        return bool(self._injected)

    def _take(self, id: int, kinds: tuple[Kind, ...]) -> ActiveFault | None:
        self._injected = [fault for fault in self._injected if fault.count > 0]
        for fault in self._injected:
            if fault.kind in kinds and fault.affects(id):
                return ActiveFault(fault.kind, fault.seconds)
        return None

    def damage(self, kind: Kind, packet: bytes) -> bytes:
        """Return the bytes of the reply `packet` after a fault; empty for `lose` and `late`."""
        rng = self._rng
        if kind == "corrupt":
            index, bit = int(rng.integers(len(packet))), 1 << int(rng.integers(8))
            return packet[:index] + bytes((packet[index] ^ bit,)) + packet[index + 1 :]
        if kind == "truncate":
            return packet[: int(rng.integers(1, len(packet)))]
        if kind == "noise":
            return rng.bytes(int(rng.integers(1, 12))) + packet
        if kind == "wrong_id":
            if packet.startswith(HEADER_2) and packet[7] == STATUS:
                return packet_2((packet[4] + 1) % 253, STATUS, packet[8:-2])
            return packet_1((packet[2] + 1) % 253, packet[4], packet[5:-1])
        return b""


def _kind(kind: str) -> Kind:
    for known in KINDS:
        if kind == known:
            return known
    raise ConfigError(f"no fault {kind!r}; there are {', '.join(KINDS)}")


def collide(first: bytes, second: bytes) -> bytes:
    """Return the bytes on the line if two servos send the replies `first` and `second` together.

    The line is low when either servo pulls it low, so the bits are combined with AND. The second
    servo is assumed to start one bit later.
    """
    bits = int.from_bytes(second, "little") << 1 | 1
    shifted = (bits & ((1 << 8 * len(second)) - 1)).to_bytes(len(second), "little")
    size = max(len(first), len(second))
    first_bits, second_bits = first.ljust(size, b"\xff"), shifted.ljust(size, b"\xff")
    return bytes(a & b for a, b in zip(first_bits, second_bits, strict=True))
