"""One cycle of an arm: plausibility of readings, and checks and bounds of commands."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import OutOfRangeError, ServoError, ServoTimeoutError
from pliant.arm.belief import Belief
from pliant.arm.budget import Meter
from pliant.arm.checks import vector
from pliant.arm.lowering import SUPPORT, margin
from pliant.arm.roster import Roster
from pliant.arm.shortfall import Shortfall
from pliant.drive import MonotonicClock, State

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

    from pliant._core import Model
    from pliant.arm.budget import Budget
    from pliant.drive import Clock, Drive, ServoStatus

    Array = NDArray[np.float64]

#: Time over which limits rise to the requested values after torque on or after a silence [s].
EASE = 0.5
#: Largest distance of a goal outside the position limits; farther goals are rejected [rad].
FAR = 1.0


class Cycle:
    """Read and write all joints of a drive, with the checks that apply to every cycle.

    Attributes:
        servos: Servos of the chain, n entries.
        goal, limit: Goals [rad] and limits [N·m] last sent to the chain (n,).
        orders: Last goal and limit of each joint off the chain.
        meter: Thermal model of the servos.
        belief: Last plausible positions.
    """

    def __init__(self, model: Model, drive: Drive, budget: Budget) -> None:
        """Match joints to servos; no reading is available yet."""
        self.model, self.drive = model, drive
        self.clock: Clock = getattr(drive, "clock", None) or MonotonicClock()
        self.roster = Roster(model, drive)
        self.servos = self.roster.servos(drive)
        size = len(self.roster.names)
        self._kp, self._usable = _row(drive.servos.kp, size), _row(drive.servos.max_torque, size)
        self.meter = Meter(budget, self._usable, getattr(drive, "stall_current", None))
        self.belief = Belief(self.roster.fastest(model))
        self._shortfall = Shortfall(model, self.servos)
        self.goal, self.limit = np.zeros(model.n), np.zeros(model.n)
        self.orders: dict[str, tuple[float, float]] = {}
        self._eased: float = -np.inf
        self._least: Array | float = 0.0
        self._used: float | None = None
        self._sent: tuple[Array, Array] | None = None
        self._voltage = np.full(size, np.nan)
        self._trouble: dict[str, tuple[str, ...]] = {}
        self._rows: dict[str, Array | None] = {}
        self._watchdog = 0.0
        # Time of the last bus access, and of the last position received.
        self._spoke = self._heard = self.clock.now()

    # Reading.

    def sample(self) -> NDArray[np.bool_]:
        """Take a reading; return a mask (n,) of the chain's joints that have a new position.

        Raises:
            ServoError: The connection is gone.
        """
        self._wake()
        try:
            sample = self.drive.read()
        except ServoTimeoutError:
            self._heat(None)
            return np.zeros(self.model.n, dtype=bool)
        finally:
            self._spoke = self.clock.now()
        if np.any(sample.ok):
            silence, self._heard = self.clock.now() - self._heard, self.clock.now()
            if self._watchdog and silence > 0.5 * self._watchdog:
                self._rearm()
        ok = self.belief.take(sample)
        chain = self.roster.chain
        self._rows = {
            "dq": None if sample.velocity is None else sample.velocity[chain],
            "load": None if sample.load is None else sample.load[chain],
            "current": None if sample.current is None else sample.current[chain],
        }
        self._heat(sample.load)
        heard: NDArray[np.bool_] = ok[chain]
        return heard

    def state(self, ok: NDArray[np.bool_]) -> State:
        """Return the present state; `ok` (n,) marks joints read in the last sample."""
        belief, chain = self.belief, self.roster.chain
        time = belief.time[chain]
        position = belief.position
        return State(
            q=position[chain],
            time=float(time.min()),
            fresh=bool(ok.all()),
            extra={name: float(position[self.roster.index(name)]) for name in self.roster.extra},
            age=self.clock.now() - time,
            voltage=self._voltage[chain],
            temperature=self.meter.temperature[chain],
            faults=self.faults(),
            **self._rows,
        )

    def faults(self) -> tuple[str, ...]:
        """Return the present faults of the servos, one sentence each."""
        reported = [text for found in self._trouble.values() for text in found]
        jumped = self.belief.faults(self.roster.names)
        return (*reported, *jumped, *self.meter.faults(self.roster.names))

    def delay(self, now: float) -> float:
        """Return the age at `now` of the goals that were in force at the last reading [s]."""
        sampled = float(self.belief.time[self.roster.chain].max())
        return max(now - sampled, 0.0) + float(getattr(self.drive, "latency", 0.0))

    @property
    def q(self) -> Array:
        """Last plausible positions of the chain (n,) [rad]."""
        q: Array = self.belief.position[self.roster.chain]
        return q

    def gravity(self) -> Array:
        """Return torques (n,) [N·m] that hold the chain against gravity at `q`."""
        return np.asarray(self.model.gravity(self.q), dtype=np.float64)

    def standing(self) -> tuple[Array, Array]:
        """Return goals [rad] and limits [N·m] (n,) read from the chain's servos; NaN if unknown."""
        orders = getattr(self.drive, "orders", None)
        chain = self.roster.chain
        if orders is None:
            return np.full(self.model.n, np.nan), np.full(self.model.n, np.nan)
        return np.asarray(orders[0])[chain], np.asarray(orders[1])[chain]

    def guard(self, seconds: float) -> None:
        """Set the servos' watchdog: they stop after this silence [s], where supported; 0: never.

        Raises:
            ServoError: A servo did not confirm.
        """
        self._watchdog = seconds
        self.drive.watchdog(seconds)
        self._spoke = self.clock.now()

    def _wake(self) -> None:
        """Rearm the watchdog after a long silence; once tripped it refuses goals until cleared."""
        if self._watchdog and self.clock.now() - self._spoke > 0.5 * self._watchdog:
            self._rearm()

    def _rearm(self) -> None:
        """Clear tripped watchdogs and arm them again; errors are ignored, a later call retries."""
        self._heard = self.clock.now()
        with contextlib.suppress(ServoError):
            self.drive.watchdog(0.0)
            self.drive.watchdog(self._watchdog)

    def is_refused(self) -> bool:
        """Return True if a joint of the chain refuses goals; its torque must then stay on."""
        refusing = getattr(self.drive, "refusing", None)
        return refusing is not None and bool(np.any(np.asarray(refusing)[self.roster.chain]))

    # Writing.

    def ease(self, limit: Array | float = 0.0) -> None:
        """Ramp limits up again, from the holding torque and at least from `limit` (n,) [N·m]."""
        self._eased, self._least = self.clock.now(), limit

    def write(
        self,
        goal: ArrayLike,
        limit: ArrayLike | None,
        extra: Mapping[str, tuple[float, float]] | None,
        *,
        lead: bool,
        velocity: ArrayLike | None = None,
    ) -> None:
        """Check, clip and send goals and limits; see `Arm.write`."""
        goal = vector(self.model, goal, "goal")
        limit = self.limit if limit is None else vector(self.model, limit, "limit")
        if limit.min() < 0.0:
            raise OutOfRangeError(f"limit must be at least 0 N·m, got {limit.min():g}")
        if velocity is not None:
            velocity = vector(self.model, velocity, "velocity", finite=False)
            if not velocity.min() >= 0.0:
                raise OutOfRangeError(f"velocity must be at least 0 rad/s, got {velocity.tolist()}")
        orders = {} if extra is None else self.roster.check(extra)
        gravity, model, chain = self.gravity(), self.model, self.roster.chain
        need, most = gravity / self._kp[chain], self._usable[chain] / self._kp[chain]
        far = np.maximum(model.lower - goal, goal - model.upper)
        if far.max() > FAR + most[far.argmax()]:
            joint = int(far.argmax())
            raise OutOfRangeError(
                f"goal of {model.joint_names[joint]} is {goal[joint]:g} rad, far outside of "
                f"{model.lower[joint]:.3g} to {model.upper[joint]:.3g} rad: are these degrees? "
                "Nothing was sent"
            )
        self.orders = {**self.orders, **orders}
        out = (most, most) if lead else (np.maximum(-need, 0.0), np.maximum(need, 0.0))
        goal = np.clip(goal, model.lower - out[0], model.upper + out[1])
        self.send(goal, self._cut(goal, limit, gravity), velocity)
        if lead:
            self._shortfall.none()
        else:
            self._shortfall.look(limit, gravity, self.clock.now())

    def _cut(self, goal: Array, limit: Array, gravity: Array) -> Array:
        """Return limits (n,) [N·m], bounded by heat, by supply and by the ramp after a silence."""
        chain, least = self.roster.chain, SUPPORT * np.abs(gravity)
        usable = self._usable[chain]
        firm = np.minimum(np.maximum(least + margin(self.servos, gravity), self._least), usable)
        share = min(max((self.clock.now() - self._eased) / EASE, 0.0), 1.0)
        limit = np.minimum(limit, firm + share * (usable - firm))
        limit = np.minimum(limit, np.maximum(self.meter.ceiling()[chain], least))
        goals, limits = self._all(goal, limit)
        floor = self.roster.join(least, np.zeros(self.roster.beside.size))
        pull = self._kp * np.nan_to_num(goals - self.belief.position)
        rationed: Array = self.meter.ration(pull, limits, floor)[chain]
        return rationed

    def begin(self, goal: Array, limit: Array) -> None:
        """Switch torque on with these first goals [rad] and limits [N·m] (n,).

        Raises:
            ServoError: A joint moved or did not obey.
        """
        self.goal, self.limit = goal.copy(), limit.copy()
        self._sent = self._all(goal, np.minimum(limit, self._usable[self.roster.chain]))
        self.drive.enable(*self._sent)

    def send(self, goal: Array, limit: Array, velocity: Array | None = None) -> None:
        """Send goals and limits of the chain (n,) unchanged; joints off the chain get their orders.

        `velocity` (n,) [rad/s] goes to the servos' speed registers; None: no speed limit.

        Raises:
            ServoError: The connection is gone.
        """
        goals, limits = self._all(goal, np.minimum(limit, self._usable[self.roster.chain]))
        self._wake()
        self._sent = goals, limits
        self.goal, self.limit = goal.copy(), limits[self.roster.chain]
        beside = np.full(self.roster.beside.size, np.inf)
        speeds = None if velocity is None else self.roster.join(velocity, beside)
        self.drive.write(goals, limits, speeds)
        self._spoke = self.clock.now()
        self._learn(self.drive.poll_status())

    def _all(self, goal: Array, limit: Array) -> tuple[Array, Array]:
        """Return goals and limits (N,) in drive order; limits off the chain are bounded by heat."""
        beside = self.roster.beside
        orders = [self.orders[name] for name in self.roster.extra]
        most = np.minimum([order[1] for order in orders], self.meter.ceiling()[beside])
        goals = self.roster.join(goal, np.array([order[0] for order in orders]))
        return goals, self.roster.join(limit, most)

    def _heat(self, load: Array | None) -> None:
        """Update the thermal model with the torques exerted since the last reading."""
        now = self.clock.now()
        if self._used is not None and self._sent is not None:
            goal, limit = self._sent
            error = np.nan_to_num(goal - self.belief.position)
            torque = np.minimum(np.abs(self._kp * error), limit)
            if load is not None:
                torque = np.where(np.isfinite(load), np.abs(load), torque)
            self.meter.use(torque, now - self._used)
        self._used = now

    def _learn(self, health: ServoStatus | None) -> None:
        """Store voltage, temperature and faults from one slow read."""
        if health is None:
            return
        place = self.roster.index(health.name)
        if health.voltage is not None:
            self._voltage[place] = health.voltage
        if health.temperature is not None:
            self.meter.temperature[place] = health.temperature
        self._trouble[health.name] = health.faults


def _row(value: ArrayLike, size: int) -> Array:
    """Return one number per joint."""
    return np.broadcast_to(np.asarray(value, dtype=np.float64), size).copy()
