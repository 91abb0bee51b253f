"""The simulated bus: encoders, delays, losses and outages."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import numpy as np

from pliant._core import ConfigError
from pliant.drive import State
from pliant.sim._checks import per_joint

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike

    from pliant._typing import Array


T = TypeVar("T")


class Encoder:
    """Joint readings: noise, then rounding to counts, then flicker by whole counts."""

    def __init__(
        self,
        n: int,
        *,
        encoder_step: ArrayLike,
        encoder_flicker: int,
        noise: ArrayLike,
        rng: np.random.Generator,
    ) -> None:
        """Prepare the encoders of n joints.

        Args:
            n: Number of joints.
            encoder_step: One count [rad], scalar or (n,); 0 is continuous.
            encoder_flicker: Counts by which a reading toggles: the negative, 0, 0 or the positive
                number, with equal chance per joint and reading.
            noise: Standard deviation of white noise before rounding [rad], scalar or (n,).
            rng: Random generator.

        Raises:
            ConfigError: A number is negative, or a flicker is given without counts.
        """
        self.count = per_joint(encoder_step, n, "encoder_step", low=0.0)
        self._noise = per_joint(noise, n, "noise", low=0.0)
        if not is_whole(encoder_flicker):
            raise ConfigError(
                f"encoder_flicker must be a whole number of counts, at least 0, "
                f"got {encoder_flicker!r}"
            )
        if encoder_flicker and not np.any(self.count > 0.0):
            raise ConfigError(
                "encoder_flicker is in encoder counts: give encoder_step [rad] as well"
            )
        self._flicker = int(encoder_flicker)
        self._rng = rng
        self._grid = np.where(self.count > 0.0, self.count, 1.0)

    def round(self, q: Array) -> Array:
        """Return q (n,) [rad] on the grid of counts, as a servo stores readings and goals."""
        return np.where(self.count > 0.0, np.round(q / self._grid) * self._grid, q)

    def read(self, q: Array) -> Array:
        """Return the readings for the true q (n,) [rad]."""
        if self._noise.any():
            q = q + self._noise * self._rng.standard_normal(q.size)
        q = self.round(q)
        if self._flicker:
            q = q + self._flicker * self.count * self._rng.choice((-1.0, 0.0, 0.0, 1.0), q.size)
        return q


class DelayLine(Generic[T]):
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

    def shift(self, item: T | None, *, silent: bool = False) -> T:
        """Send one item (None: nothing in this tick) and return the item at the receiving end."""
        lost = silent or (self._loss > 0.0 and self._rng.random() < self._loss)
        self._queue.append(
            (item is not None and not lost, item if item is not None else self._last)
        )
        self.fresh, arrived = self._queue.popleft()
        if self.fresh:
            self._last = arrived
        return self._last


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
        raise ConfigError(
            f"bus_outage must be a pair of times (from, to) [s], got {value!r}"
        ) from None
    if not start <= end:
        raise ConfigError(f"bus_outage must begin before it ends, got {value!r} [s]")
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


@dataclass(frozen=True)
class Command:
    """One write on its way to the servos."""

    goal: Array
    limit: Array
    extra: Mapping[str, tuple[float, float]]


class Bus:
    """Carries orders and readings, each direction with its own delay, loss and random source.

    Attributes:
        state: State that a read returns in this tick.
        sent: The last order sent, whether or not it arrives.
    """

    def __init__(
        self,
        n: int,
        *,
        delay: tuple[int, int],
        encoder_step: ArrayLike,
        encoder_flicker: int,
        noise: ArrayLike,
        read_loss: float,
        write_loss: float,
        bus_outage: tuple[float, float] | None,
        seed: int,
    ) -> None:
        """Check the numbers; see `Plant` for their meaning."""
        self._n, self._delay, self._outage, self._seed = n, delays(delay), span(bus_outage), seed
        if not is_whole(seed):
            raise ConfigError(f"seed must be a whole number, at least 0, got {seed!r}")
        self._read_loss = share(read_loss, "read_loss")
        self._write_loss = share(write_loss, "write_loss")
        self._encoder_step, self._encoder_flicker = encoder_step, encoder_flicker
        self._noise = noise

    @property
    def write_delay(self) -> int:
        """Ticks from a write to the servos."""
        return self._delay[1]

    def reset(self, first: Command, extra: Mapping[str, float]) -> None:
        """Restart, with all random sources, as if `first` had always been the order."""
        seeds = np.random.SeedSequence(self._seed).spawn(3)
        encoding, reading, writing = (np.random.default_rng(seed) for seed in seeds)
        self._encoder = Encoder(
            self._n,
            encoder_step=self._encoder_step,
            encoder_flicker=self._encoder_flicker,
            noise=self._noise,
            rng=encoding,
        )
        self.sent = first
        self._pending: Command | None = None
        self._writes = DelayLine(first, delay=self._delay[1], loss=self._write_loss, rng=writing)
        self.state = State(self._encoder.round(first.goal), extra=extra)
        self._reads = DelayLine(self.state, delay=self._delay[0], loss=self._read_loss, rng=reading)

    def send(self, command: Command) -> None:
        """Put an order on the line; a second order in one tick replaces the first."""
        goal = self._encoder.round(command.goal)
        self.sent = self._pending = Command(goal, command.limit, command.extra)

    def deliver(self, time: float) -> Command:
        """Return the order in force in the tick that begins at `time` [s]."""
        command = self._writes.shift(self._pending, silent=self._is_silent(time))
        self._pending = None
        return command

    def sample(self, q: Array, extra: Mapping[str, float], time: float) -> None:
        """Sample the true q (n,) [rad] at `time` [s] and advance the read line by one tick."""
        now = State(self._encoder.read(q), time=time, extra=extra)
        old = self._reads.shift(now, silent=self._is_silent(time))
        age = np.full(self._n, time - old.time)
        self.state = State(old.q.copy(), None, old.time, self._reads.fresh, old.extra, age)

    def _is_silent(self, time: float) -> bool:
        return self._outage is not None and self._outage[0] <= time < self._outage[1]
