"""Simulated servo bus: encoders, delays, lost packets and outages."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from functools import partial
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
    """Encoders of all joints: they add noise to the true positions and round to whole counts.

    A random error of whole counts (flicker) can be added after rounding.
    """

    def __init__(
        self,
        n: int,
        *,
        encoder_step: ArrayLike,
        encoder_flicker: int,
        noise: ArrayLike,
        rng: np.random.Generator,
    ) -> None:
        """Store the parameters of the encoders of n joints.

        Args:
            n: Number of joints.
            encoder_step: Angle of one count [rad], scalar or (n,); 0 disables rounding.
            encoder_flicker: Random error of a reading [counts]: this number is added with
                probability 1/4, and subtracted with probability 1/4.
            noise: Standard deviation of white noise before rounding [rad], scalar or (n,).
            rng: Random generator for noise and flicker.

        Raises:
            ConfigError: A number is negative, or flicker is set without `encoder_step`.
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
        self._has_counts, self._has_noise = self.count > 0.0, bool(self._noise.any())
        self._grid = np.where(self._has_counts, self.count, 1.0)
        self._is_exact, self._is_rounded = not self._has_counts.any(), self._has_counts.all()

    def round(self, q: Array) -> Array:
        """Return q (n,) [rad] rounded to whole counts, as a servo stores positions and goals."""
        if self._is_exact:
            return q.copy()
        rounded = np.rint(q / self._grid) * self._grid
        return rounded if self._is_rounded else np.where(self._has_counts, rounded, q)

    def read(self, q: Array) -> Array:
        """Return the readings (n,) [rad] for the true positions q (n,) [rad]."""
        if self._has_noise:
            q = q + self._noise * self._rng.standard_normal(q.size)
        q = self.round(q)
        if self._flicker:
            q = q + self._flicker * self.count * self._rng.choice((-1.0, 0.0, 0.0, 1.0), q.size)
        return q


class DelayLine(Generic[T]):
    """Delay line for one direction of the bus: a fixed delay, and random losses.

    Time is counted in ticks, the calls of `Plant.advance`. Each tick delivers the item (command or
    reading) sent `delay` ticks ago. If that item was lost, the line repeats the last delivered one.
    """

    def __init__(self, first: T, *, delay: int, loss: float, rng: np.random.Generator) -> None:
        """Fill the line with the item `first`.

        Args:
            first: Item that the first ticks deliver.
            delay: Delay [ticks].
            loss: Probability that an item is lost.
            rng: Random generator for losses.
        """
        self._queue: deque[tuple[bool, T]] = deque([(True, first)] * delay)
        self._last = first
        self._loss = loss
        self._rng = rng
        self.fresh = True

    def shift(self, item: T | None, *, silent: bool = False) -> T:
        """Send an item, or None for no item, and return the item that arrives in this tick.

        If `silent` is True, the item is lost, as in an outage of the bus.
        """
        lost = silent or (self._loss > 0.0 and self._rng.random() < self._loss)
        self._queue.append(
            (item is not None and not lost, item if item is not None else self._last)
        )
        self.fresh, arrived = self._queue.popleft()
        if self.fresh:
            self._last = arrived
        return self._last


def is_whole(value: object) -> bool:
    """Return True if `value` is a whole number of at least 0."""
    return isinstance(value, (int, float, np.integer)) and bool(value >= 0 and value == value // 1)


def outage_times(value: Any) -> tuple[float, float] | None:
    """Validate and return the time span (from, to) of a bus outage [s], or None for no outage."""
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


def check_delays(value: tuple[int, int]) -> tuple[int, int]:
    """Validate and return the delays of the bus, of readings and of commands [ticks]."""
    try:
        read, write = value
    except (TypeError, ValueError):
        raise ConfigError(f"delay must be a pair of ticks (read, write), got {value!r}") from None
    if not (is_whole(read) and is_whole(write)):
        raise ConfigError(f"delay must be two whole numbers of ticks, at least 0, got {value!r}")
    return int(read), int(write)


def probability(value: float, name: str) -> float:
    """Validate and return a probability in [0, 1]; `name` is its name in the error message."""
    if isinstance(value, (str, bytes)) or np.ndim(value) or not 0.0 <= float(value) <= 1.0:
        raise ConfigError(f"{name} must be in [0, 1], got {value!r}")
    return float(value)


@dataclass(frozen=True)
class Command:
    """Goals and torque limits of one write.

    Attributes:
        goal: Goals of the chain's joints (n,) [rad].
        limit: Torque limits of the chain's joints (n,) [N·m].
        extra: Goal [rad] and torque limit [N·m] of each off-chain joint, by joint name.
    """

    goal: Array
    limit: Array
    extra: Mapping[str, tuple[float, float]]


class Bus:
    """Simulated bus: transports commands and readings with delay, loss and outages.

    Attributes:
        state: State that `Plant.read` returns in this tick.
        sent: Last command sent, even if the bus has lost it.
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
        """Validate and store the parameters of the bus, which `Plant` documents."""
        self._n, self._seed = n, seed
        self._delay, self._outage = check_delays(delay), outage_times(bus_outage)
        if not is_whole(seed):
            raise ConfigError(f"seed must be a whole number, at least 0, got {seed!r}")
        self._read_loss = probability(read_loss, "read_loss")
        self._write_loss = probability(write_loss, "write_loss")
        self._make_encoder = partial(
            Encoder, n, encoder_step=encoder_step, encoder_flicker=encoder_flicker, noise=noise
        )

    @property
    def write_delay(self) -> int:
        """Delay from a write to its arrival at the servos [ticks]."""
        return self._delay[1]

    def reset(self, first: Command, extra: Mapping[str, float]) -> None:
        """Restart the bus and its random generators.

        Args:
            first: Command that the servos have at the start.
            extra: Positions of the off-chain joints by name [rad].
        """
        seeds = np.random.SeedSequence(self._seed).spawn(3)
        encoding, reading, writing = (np.random.default_rng(seed) for seed in seeds)
        self._encoder = self._make_encoder(rng=encoding)
        self.sent = first
        self._pending: Command | None = None
        self._writes = DelayLine(first, delay=self._delay[1], loss=self._write_loss, rng=writing)
        self.state = State(self._encoder.round(first.goal), extra=extra)
        self._reads = DelayLine(self.state, delay=self._delay[0], loss=self._read_loss, rng=reading)

    def send(self, command: Command) -> None:
        """Send a command with the next tick; a second command in one tick replaces the first."""
        goal = self._encoder.round(command.goal)
        self.sent = self._pending = Command(goal, command.limit, command.extra)

    def deliver(self, time: float) -> Command:
        """Return the command that the servos follow in the tick that begins at `time` [s]."""
        command = self._writes.shift(self._pending, silent=self._is_silent(time))
        self._pending = None
        return command

    def sample(self, q: Array, extra: Mapping[str, float], time: float) -> None:
        """Send a reading of the positions at `time` [s], and set `state` to the arriving reading.

        Args:
            q: True positions of the chain's joints (n,) [rad].
            extra: Positions of the off-chain joints by name [rad].
            time: Time of the reading [s].
        """
        sent = State(self._encoder.read(q), time=time, extra=extra)
        arriving = self._reads.shift(sent, silent=self._is_silent(time))
        age = np.full(self._n, time - arriving.time)
        self.state = State(
            arriving.q.copy(), None, arriving.time, self._reads.fresh, arriving.extra, age
        )

    def _is_silent(self, time: float) -> bool:
        return self._outage is not None and self._outage[0] <= time < self._outage[1]
