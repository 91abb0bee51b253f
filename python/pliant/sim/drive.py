"""Simulated arm behind the servo-bus interface: `SimDrive` and its clock."""

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
    """Clock of the simulation; waiting runs the physics, as fast as possible or in real time.

    In real time the simulated time follows the system clock, also while the program is busy.

    Attributes:
        period: Control period of the plant [s], the resolution of this clock.
        real_time: True if the time follows the system clock.
        on_tick: Function that is called after every simulated control period, for records; None:
            no call.
    """

    def __init__(self, plant: Plant, real_time: bool) -> None:
        """Start the clock at the plant's present time."""
        self.plant, self.period = plant, plant.period
        self.on_tick: Callable[[], object] | None = None
        self.real_time = real_time
        self._lock = RLock()
        self._wall = MonotonicClock() if real_time else None
        self._offset = plant.time - (self._wall.now() if self._wall else 0.0)

    def now(self) -> float:
        """Return the time since the plant's reset [s]."""
        return self.plant.time if self._wall is None else self._wall.now() + self._offset

    def wait_until(self, deadline: float) -> None:
        """Run the physics until the time `deadline` [s]; in real time, also wait until then."""
        if self._wall is None:
            while self.plant.time < deadline - 1e-9:
                self._advance()
        else:
            self._wall.wait_until(deadline - self._offset)
            self.catch_up()

    def catch_up(self) -> None:
        """Run the physics up to the present time; no effect unless in real time."""
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
    """A `pliant.sim.Plant` with the interface of a servo bus (`Drive`), for an `Arm`.

    In all vectors (N,), the joints off the chain (grippers) come after those of the chain. A
    simulated servo with torque off has a torque limit of zero.

    Attributes:
        plant: The simulation, with its true state.
        clock: Simulated time.
        names: Names of the N joints: the chain, then the off-chain joints with a servo.
        servos: Servo parameters, one entry per name.
        latency: Delay from a write to its effect [s].
        counters: Number of reads, lost reads and writes so far.
    """

    def __init__(
        self, plant: Plant, *, servos: Servos | None = None, real_time: bool = False
    ) -> None:
        """Wrap a plant in its present state, with torque on.

        Args:
            plant: The simulated arm.
            servos: Servo parameters of the chain that the controller assumes, n entries. None: the
                plant's table, without `kp_scale` and the other scales.
            real_time: True runs the simulation in real time.
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
        """Mask (N,) of the joints with torque on."""
        return self._on.copy()

    @property
    def orders(self) -> tuple[Array, Array]:
        """Goals (N,) [rad] and torque limits (N,) [N·m] of the last write.

        They are NaN for off-chain joints, and before the first write.
        """
        unknown = np.full(len(self.names), np.nan)
        if not self.counters["writes"]:
            return unknown, unknown
        sent, off_chain = self.plant.sent, np.full(len(self._extra), np.nan)
        return np.concatenate((sent.goal, off_chain)), np.concatenate((sent.limit, off_chain))

    def open(self) -> None:
        """Do nothing: there is no connection to open."""

    def close(self) -> None:
        """Do nothing: there is no connection to close."""

    def read(self) -> JointReadings:
        """Return the readings that the simulated bus delivers at present."""
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
        """Switch torque of all joints on, with goals (N,) [rad] and torque limits (N,) [N·m]."""
        self._on[:] = True
        self.write(goal, limit)

    def disable(self, names: Sequence[str]) -> None:
        """Switch the torque of the joints `names` off.

        Other joints with torque hold their present positions with their full torque.
        """
        self._on &= ~np.isin(self.names, list(names))
        state = self.plant.read()
        position = np.concatenate((state.q, [state.extra[name] for name in self._extra]))
        self.write(position, np.where(self._on, self.servos.max_torque, 0.0))

    def watchdog(self, seconds: float) -> None:
        """Do nothing: simulated servos have no watchdog and hold their last goal and limit."""
