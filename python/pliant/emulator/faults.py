"""Fault injection: ordered faults and random ones, seeded."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from pliant._core import ConfigError
from pliant.emulator.packets import HEADER_2, STATUS, packet_1, packet_2

Kind = Literal["deaf", "lose", "late", "corrupt", "truncate", "wrong_id", "noise"]
KINDS: tuple[Kind, ...] = get_args(Kind)


@dataclass(slots=True)
class Order:
    """An ordered fault.

    Attributes:
        kind: Kind of fault.
        id: Servo whose replies (or requests) are affected, None for any.
        count: Remaining repetitions.
        skip: Opportunities to skip first.
        seconds: Delay, for `late`; None is until the next request.
    """

    kind: Kind
    id: int | None
    count: int
    skip: int
    seconds: float | None

    def strikes(self, id: int) -> bool:
        """Return True if it acts now, on this servo."""
        if self.count <= 0 or (self.id is not None and self.id != id):
            return False
        if self.skip > 0:
            self.skip -= 1
            return False
        self.count -= 1
        return True


@dataclass(frozen=True, slots=True)
class Blow:
    """A fault that affects one reply or request."""

    kind: Kind
    seconds: float | None = None


class Faults:
    """Faults between servos and host.

    - `deaf`: the request does not reach the servo
    - `lose`: the reply does not reach the host
    - `late`: the reply arrives later, by default just before that to the next request
    - `corrupt`: one bit of the reply is flipped
    - `truncate`: the reply breaks off
    - `wrong_id`: the reply has another id, with a valid checksum
    - `noise`: a few bytes of noise precede the reply

    Args:
        seed: Seed of the random faults; equal seeds and requests give equal faults.
        **shares: Share of transactions with each kind of random fault, by name; a transaction has
            at most one, on one of its replies.

    Raises:
        ConfigError: An unknown kind, or shares that are not in [0, 1] together.
    """

    def __init__(self, *, seed: int = 0, **shares: float) -> None:
        self._rng = np.random.default_rng(seed)
        self._orders: list[Order] = []
        self.by_chance(**shares)

    def by_chance(self, **shares: float) -> None:
        """Set the share of transactions with each kind of random fault; other kinds do not occur.

        Raises:
            ConfigError: An unknown kind, or shares that are not in [0, 1] together.
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
        """Order a fault for the next opportunities.

        Args:
            kind: See the table of the class.
            id: The servo; None: the next one that replies (or is addressed).
            count: Number of faults.
            skip: Number of opportunities to skip first.
            seconds: Delay of a `late` reply; None: until the next request.

        Raises:
            ConfigError: An unknown kind, or a count or skip below 0.
        """
        if count < 0 or skip < 0:
            raise ConfigError(f"count and skip must be at least 0, got {count} and {skip}")
        self._orders.append(Order(_kind(kind), id, count, skip, seconds))

    def clear(self) -> None:
        """Remove all pending orders and all shares."""
        self._orders.clear()
        self._shares.clear()

    def chance(self) -> Kind | None:
        """Draw the random fault of this transaction."""
        if not self._shares:
            return None
        draw = self._rng.random()
        for kind, share in self._shares.items():
            draw -= share
            if draw < 0.0:
                return kind
        return None

    def pick(self, among: int) -> int:
        """Choose one of so many replies."""
        return int(self._rng.integers(among))

    def deaf(self, id: int) -> bool:
        """Return True if an ordered fault keeps a request from this servo."""
        return self._struck(id, ("deaf",)) is not None

    def strike(self, id: int) -> Blow | None:
        """Return the ordered fault of this servo's reply."""
        return self._struck(id, KINDS[1:])

    def _struck(self, id: int, kinds: tuple[Kind, ...]) -> Blow | None:
        self._orders = [order for order in self._orders if order.count > 0]
        for order in self._orders:
            if order.kind in kinds and order.strikes(id):
                return Blow(order.kind, order.seconds)
        return None

    def spoil(self, kind: Kind, packet: bytes) -> bytes:
        """Return the damaged reply."""
        rng = self._rng
        if kind == "corrupt":
            at, bit = int(rng.integers(len(packet))), 1 << int(rng.integers(8))
            return packet[:at] + bytes((packet[at] ^ bit,)) + packet[at + 1 :]
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
    """Return the bytes on the line when two servos send at once.

    The line is low when either pulls it low; the second sends one bit later, so the headers agree
    and the rest does not.
    """
    late = int.from_bytes(second, "little") << 1 | 1
    shifted = (late & ((1 << 8 * len(second)) - 1)).to_bytes(len(second), "little")
    size = max(len(first), len(second))
    one, two = first.ljust(size, b"\xff"), shifted.ljust(size, b"\xff")
    return bytes(a & b for a, b in zip(one, two, strict=True))
