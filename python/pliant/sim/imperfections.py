"""Imperfections of real servos and of their bus.

All are off by default, and repeatable by seed.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from pliant._core import ConfigError
from pliant.sim.gains import per_joint

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

T = TypeVar("T")


@dataclass(frozen=True, kw_only=True)
class Overload:
    """Overload protection of a servo: cuts the torque until reset if it is too large for too long.

    Attributes:
        threshold: Share of the usable torque that counts as overload, in (0, 1].
        seconds: Longest overload without a trip [s].
        remains: Share of the usable torque left afterwards (0: none, as Dynamixels; 0.2: STS3215).
    """

    threshold: float = 0.95
    seconds: float = 3.0
    remains: float = 0.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not 0.0 < self.threshold <= 1.0:
            raise ConfigError(f"Overload.threshold must be in (0, 1], got {self.threshold:g}")
        if not self.seconds >= 0.0:
            raise ConfigError(f"Overload.seconds must be at least 0 s, got {self.seconds:g}")
        if not 0.0 <= self.remains <= 1.0:
            raise ConfigError(f"Overload.remains must be in [0, 1], got {self.remains:g}")


class Encoder:
    """Joint readings: noise, then rounding to counts, then flicker by whole counts."""

    def __init__(
        self, n: int, *, count: ArrayLike, flicker: int, noise: ArrayLike, rng: np.random.Generator
    ) -> None:
        """Prepare the encoders of n joints.

        Args:
            n: Number of joints.
            count: One count [rad], scalar or (n,); 0 is continuous.
            flicker: Counts by which a reading toggles: -flicker, 0, 0, +flicker with equal chance
                per joint and reading.
            noise: Standard deviation of white noise before rounding [rad], scalar or (n,).
            rng: Random generator.

        Raises:
            ConfigError: A number is negative, or a flicker is given without counts.
        """
        self.count = per_joint(count, n, "count", low=0.0)
        self._noise = per_joint(noise, n, "noise", low=0.0)
        if not is_whole(flicker):
            raise ConfigError(
                f"flicker must be a whole number of counts, at least 0, got {flicker!r}"
            )
        if flicker and not np.any(self.count > 0.0):
            raise ConfigError("flicker is in encoder counts: give count [rad] as well")
        self._flicker = int(flicker)
        self._rng = rng
        self._grid = np.where(self.count > 0.0, self.count, 1.0)

    def round(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return q (n,) [rad] on the grid of counts, as a servo stores readings and goals."""
        return np.where(self.count > 0.0, np.round(q / self._grid) * self._grid, q)

    def read(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the readings for the true q (n,) [rad]."""
        if self._noise.any():
            q = q + self._noise * self._rng.standard_normal(q.size)
        q = self.round(q)
        if self._flicker:
            q = q + self._flicker * self.count * self._rng.choice((-1.0, 0.0, 0.0, 1.0), q.size)
        return q


class Line(Generic[T]):
    """One direction of the bus: a fixed delay in ticks, and losses.

    Each tick delivers the item sent `delay` ticks ago. If that item was lost, the last delivered
    item is repeated.
    """

    def __init__(self, first: T, *, delay: int, loss: float, rng: np.random.Generator) -> None:
        """Fill the line with `first`, as if it had always been sent."""
        self._queue: deque[tuple[bool, T]] = deque([(True, first)] * delay)
        self._last = first
        self._loss = loss
        self._rng = rng
        self.fresh = True

    def pass_on(self, item: T | None, *, silent: bool = False) -> T:
        """Send one item (None: nothing in this tick) and return the item at the receiving end."""
        lost = silent or (self._loss > 0.0 and self._rng.random() < self._loss)
        self._queue.append(
            (item is not None and not lost, item if item is not None else self._last)
        )
        self.fresh, arrived = self._queue.popleft()
        if self.fresh:
            self._last = arrived
        return self._last


class Latch:
    """Overload time of each joint, and the joints that have cut their torque."""

    def __init__(self, n: int, rule: Overload | None) -> None:
        """Start with no joint tripped."""
        self._rule = rule
        self._seconds = np.zeros(n)
        self.tripped = np.zeros(n, dtype=bool)

    def limit(
        self,
        limit: NDArray[np.float64],
        torque: NDArray[np.float64],
        usable: NDArray[np.float64],
        period: float,
    ) -> NDArray[np.float64]:
        """Return the limits (n,) [N·m] in force after a period with this mean torque."""
        if self._rule is None:
            return limit
        over = np.abs(torque) >= self._rule.threshold * usable - 1e-9
        self._seconds = np.where(over, self._seconds + period, 0.0)
        self.tripped |= self._seconds > self._rule.seconds
        return np.where(self.tripped, np.minimum(limit, self._rule.remains * usable), limit)


def is_whole(value: object) -> bool:
    """Return True for a whole number >= 0."""
    return isinstance(value, (int, float, np.integer)) and bool(value >= 0 and value == value // 1)


def span(value: Any) -> tuple[float, float] | None:
    """Check a time span (from, to) [s]; None means never."""
    if value is None:
        return None
    try:
        start, end = (float(x) for x in value)
    except (TypeError, ValueError):
        raise ConfigError(f"silent must be a pair of times (from, to) [s], got {value!r}") from None
    if not start <= end:
        raise ConfigError(f"silent must begin before it ends, got {value!r} [s]")
    return start, end


def delays(value: tuple[int, int]) -> tuple[int, int]:
    """Check a pair of read and write delays in ticks."""
    try:
        read, write = value
    except (TypeError, ValueError):
        raise ConfigError(f"delay must be a pair of ticks (read, write), got {value!r}") from None
    if not (is_whole(read) and is_whole(write)):
        raise ConfigError(f"delay must be two whole numbers of ticks, at least 0, got {value!r}")
    return int(read), int(write)


def share(value: float, name: str) -> float:
    """Check a probability."""
    if isinstance(value, (str, bytes)) or np.ndim(value) or not 0.0 <= float(value) <= 1.0:
        raise ConfigError(f"{name} must be in [0, 1], got {value!r}")
    return float(value)
