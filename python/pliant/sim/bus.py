"""The bus between controller and servos: rounded readings, delays, losses, outages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError
from pliant.drive import State
from pliant.sim.imperfections import Encoder, Line, delays, is_whole, share, span
from pliant.sim.state import Order

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    Array = NDArray[np.float64]


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
        count: ArrayLike,
        flicker: int,
        noise: ArrayLike,
        read_loss: float,
        write_loss: float,
        silent: tuple[float, float] | None,
        seed: int,
    ) -> None:
        """Check the numbers; see `Plant` for their meaning."""
        self._n, self._delay, self._silent, self._seed = n, delays(delay), span(silent), seed
        if not is_whole(seed):
            raise ConfigError(f"seed must be a whole number, at least 0, got {seed!r}")
        self._read_loss = share(read_loss, "read_loss")
        self._write_loss = share(write_loss, "write_loss")
        self._count, self._flicker, self._noise = count, flicker, noise

    @property
    def write_delay(self) -> int:
        """Ticks from a write to the servos."""
        return self._delay[1]

    def reset(self, first: Order, extra: Mapping[str, float]) -> None:
        """Restart, with all random sources, as if `first` had always been the order."""
        seeds = np.random.SeedSequence(self._seed).spawn(3)
        encoding, reading, writing = (np.random.default_rng(seed) for seed in seeds)
        self._encoder = Encoder(
            self._n, count=self._count, flicker=self._flicker, noise=self._noise, rng=encoding
        )
        self.sent = first
        self._pending: Order | None = None
        self._writes = Line(first, delay=self._delay[1], loss=self._write_loss, rng=writing)
        self.state = State(self._encoder.round(first.goal), extra=extra)
        self._reads = Line(self.state, delay=self._delay[0], loss=self._read_loss, rng=reading)

    def send(self, order: Order) -> None:
        """Put an order on the line; a second order in one tick replaces the first."""
        goal = self._encoder.round(order.goal)
        self.sent = self._pending = Order(goal, order.limit, order.extra)

    def deliver(self, time: float) -> Order:
        """Return the order in force in the tick that begins at `time` [s]."""
        order = self._writes.pass_on(self._pending, silent=self._is_silent(time))
        self._pending = None
        return order

    def sample(self, q: Array, extra: Mapping[str, float], time: float) -> None:
        """Sample the true q (n,) [rad] at `time` [s] and advance the read line by one tick."""
        now = State(self._encoder.read(q), time=time, extra=extra)
        old = self._reads.pass_on(now, silent=self._is_silent(time))
        age = np.full(self._n, time - old.time)
        self.state = State(old.q.copy(), None, old.time, self._reads.fresh, old.extra, age)

    def _is_silent(self, time: float) -> bool:
        return self._silent is not None and self._silent[0] <= time < self._silent[1]
