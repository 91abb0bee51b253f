"""`SimDrive`, the simulated arm as a drive; its clock runs the physics during waits."""

from __future__ import annotations

from threading import RLock
from typing import TYPE_CHECKING

import numpy as np

from pliant._servo_tables import join, spread
from pliant.drive import JointReadings, MonotonicClock, ServoStatus

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pliant._core import Servos
    from pliant._typing import Array, Mask
    from pliant.sim import Plant


class SimClock:
    """Simulated time: a wait runs the physics, either as fast as possible or in real time.

    In real time the physics follows the machine's clock. If a program is late, its arm has moved on
    in the meantime.

    Attributes:
        period: Control period of the plant [s], the resolution of this clock.
        real_time: True if the time follows the machine's clock.
        on_tick: Called after every period of physics, for records.
    """

    def __init__(self, plant: Plant, real_time: bool) -> None:
        """Start at the plant's present time."""
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
        """In real time, run the physics up to the present."""
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

    Off-chain joints follow those of the chain. A simulated servo with torque off has a limit of
    zero.

    Attributes:
        plant: The simulation, with its true state.
        clock: Simulated time.
        names: The chain's joints, then the off-chain joints with a servo.
        servos: One entry per name.
        latency: From a write to its effect [s].
        counters: Number of reads, lost reads and writes so far.
    """

    def __init__(
        self, plant: Plant, *, servos: Servos | None = None, real_time: bool = False
    ) -> None:
        """Wrap a plant as it stands, with its torque on.

        Args:
            plant: The simulated arm.
            servos: Servo table of the chain that the arm uses, n entries. None: the plant's table,
                without its scales. The plant's true servo parameters are never returned.
            real_time: True to run simulated time in real time.
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
    def enabled(self) -> Mask:
        """Mask of the joints with torque on (N,)."""
        return self._on.copy()

    @property
    def orders(self) -> tuple[Array, Array]:
        """Last goals (N,) [rad] and limits (N,) [N·m]; NaN off the chain and before a write."""
        unknown = np.full(len(self.names), np.nan)
        if not self.counters["writes"]:
            return unknown, unknown
        sent, off = self.plant.sent, np.full(len(self._extra), np.nan)
        return np.concatenate((sent.goal, off)), np.concatenate((sent.limit, off))

    def open(self) -> None:
        """Do nothing: there is no connection to open."""

    def close(self) -> None:
        """Do nothing: there is no connection to close."""

    def read(self) -> JointReadings:
        """Return a sample from the simulated bus."""
        self.clock.catch_up()
        state = self.plant.read()
        self.counters["reads"] += 1
        self.counters["lost reads"] += not state.fresh
        position = np.concatenate((state.q, [state.extra[name] for name in self._extra]))
        return JointReadings(position, np.full(position.size, state.fresh), state.time)

    def write(self, goal: Array, limit: Array, velocity: Array | None = None) -> None:
        """Send goals (N,) [rad] and limits (N,) [N·m]; joints with torque off stay off.

        Simulated servos have no speed register: `velocity` is ignored.
        """
        self.clock.catch_up()
        n = self.plant.n
        limit = np.where(self._on, limit, 0.0)
        pairs = zip(goal[n:].tolist(), limit[n:].tolist(), strict=True)
        self.plant.write(goal[:n], limit[:n], dict(zip(self._extra, pairs, strict=True)))
        self.counters["writes"] += 1

    def poll_status(self) -> ServoStatus | None:
        """Return None: simulated servos report neither voltage nor temperature."""
        return None

    def enable(self, goal: Array, limit: Array) -> None:
        """Switch torque on, with limit and goal in the same write."""
        self._on[:] = True
        self.write(goal, limit)

    def disable(self, names: Sequence[str]) -> None:
        """Switch torque off."""
        self._on &= ~np.isin(self.names, list(names))
        state = self.plant.read()
        position = np.concatenate((state.q, [state.extra[name] for name in self._extra]))
        self.write(position, np.where(self._on, self.servos.max_torque, 0.0))

    def watchdog(self, seconds: float) -> None:
        """Do nothing: simulated servos keep their last order indefinitely."""
