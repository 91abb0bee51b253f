"""The simulated arm as a drive, with a clock of its own: its time passes when somebody waits."""

from __future__ import annotations

from threading import RLock
from typing import TYPE_CHECKING

import numpy as np

from pliant.arm.drive import Health, MonotonicClock, Sample
from pliant.arm.tables import join, spread

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from pliant import Servos
    from pliant.sim import Plant

    Array = NDArray[np.float64]


class SimClock:
    """Simulated time: waiting runs the physics, as fast as it goes or as fast as life.

    In real time the physics follows the machine's clock, and a program that dawdles finds that its
    arm has gone on without it.

    Attributes:
        period: Control period of the plant [s], the grain of this time.
        real_time: Whether it passes by itself.
        on_tick: Called after every period of physics, for records.
    """

    def __init__(self, plant: Plant, real_time: bool) -> None:
        """Start where the plant is."""
        self.plant, self.period = plant, plant.period
        self.on_tick: Callable[[], object] | None = None
        self.real_time = real_time
        self._lock = RLock()
        self._wall = MonotonicClock() if real_time else None
        self._offset = plant.time - (self._wall.now() if self._wall else 0.0)

    def now(self) -> float:
        """Time since the plant's reset [s]."""
        return self.plant.time if self._wall is None else self._wall.now() + self._offset

    def wait_until(self, deadline: float) -> None:
        """Run the physics until `deadline` [s]."""
        if self._wall is None:
            while self.plant.time < deadline - 1e-9:
                self._advance()
        else:
            self._wall.wait_until(deadline - self._offset)
            self.catch_up()

    def catch_up(self) -> None:
        """In real time, let the physics come up to the present."""
        if self._wall is None:
            return
        with self._lock:
            while self.plant.time + self.period <= self.now():
                self._advance()

    def _advance(self) -> None:
        self.plant.advance()
        if self.on_tick is not None:
            self.on_tick()


class SimDrive:
    """A `pliant.sim.Plant` behind the interface of a bus of servos.

    Off-chain joints follow those of the chain. A simulated servo without torque has a limit of
    zero.

    Attributes:
        plant: The simulation, with the truth.
        clock: Simulated time.
        names: The chain's joints, then those beside it that have a servo.
        servos: One entry per name.
        latency: From a write to its effect [s].
        counters: Writes and readings lost so far.
    """

    def __init__(
        self, plant: Plant, *, servos: Servos | None = None, real_time: bool = False
    ) -> None:
        """Wrap a plant as it stands, with its torque on.

        Args:
            plant: The simulated arm.
            servos: Servos of the chain that the arm believes to have, n entries; None: those of the
                plant's table, without its scales. The plant's true servos are never handed out.
            real_time: Let simulated time be real time.
        """
        self.plant = plant
        self.clock = SimClock(plant, real_time)
        self._extra = tuple(plant.read().extra)
        self.names = (*plant.model.joint_names, *self._extra)
        chain = plant.table if servos is None else spread(servos, plant.n)
        self.servos = join(chain, [plant.extra_tables[name] for name in self._extra])
        self.latency = plant.write_delay
        self.counters: dict[str, int] = {"reads": 0, "lost reads": 0, "writes": 0}
        self._on = np.ones(len(self.names), dtype=bool)

    @property
    def enabled(self) -> NDArray[np.bool_]:
        """Which joints have torque (N,)."""
        return self._on.copy()

    @property
    def orders(self) -> tuple[Array, Array]:
        """Goals (N,) [rad] and limits (N,) [N·m] last sent to the chain; NaN before the first."""
        unknown = np.full(len(self.names), np.nan)
        if not self.counters["writes"]:
            return unknown, unknown
        sent, off = self.plant.sent, np.full(len(self._extra), np.nan)
        return np.concatenate((sent.goal, off)), np.concatenate((sent.limit, off))

    def open(self) -> None:
        """Nothing to connect."""

    def close(self) -> None:
        """Nothing to let go of."""

    def read(self) -> Sample:
        """What the simulated bus reports."""
        self.clock.catch_up()
        state = self.plant.read()
        self.counters["reads"] += 1
        self.counters["lost reads"] += not state.fresh
        position = np.concatenate((state.q, [state.extra[name] for name in self._extra]))
        return Sample(position, np.full(position.size, state.fresh), state.time)

    def write(self, goal: Array, limit: Array, velocity: Array | None = None) -> None:
        """Send goals (N,) [rad] and limits (N,) [N·m]; joints without torque stay without.

        Simulated servos have no speed register: `velocity` is left out.
        """
        self.clock.catch_up()
        n = self.plant.n
        limit = np.where(self._on, limit, 0.0)
        pairs = zip(goal[n:].tolist(), limit[n:].tolist(), strict=True)
        self.plant.write(goal[:n], limit[:n], dict(zip(self._extra, pairs, strict=True)))
        self.counters["writes"] += 1

    def slow(self) -> Health | None:
        """Simulated servos have neither voltage nor heat."""
        return None

    def enable(self, goal: Array, limit: Array) -> None:
        """Torque on, limit and goal in the same write."""
        self._on[:] = True
        self.write(goal, limit)

    def disable(self, names: Sequence[str]) -> None:
        """Torque off."""
        self._on &= ~np.isin(self.names, list(names))
        state = self.plant.read()
        position = np.concatenate((state.q, [state.extra[name] for name in self._extra]))
        self.write(position, np.where(self._on, self.servos.max_torque, 0.0))

    def watchdog(self, seconds: float) -> None:
        """Simulated servos keep their last order for ever."""
