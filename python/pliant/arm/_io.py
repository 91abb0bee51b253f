"""Reading and writing of all joints of an arm, with checks of readings and of commands."""

from __future__ import annotations

import contextlib
import math
import warnings
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import (
    SUPPORT,
    ConfigError,
    OutOfRangeError,
    ServoError,
    ServoTimeoutError,
    torque_margin,
)
from pliant._servo_tables import take
from pliant._validation import format_value, mapping, real
from pliant.arm._checks import vector
from pliant.arm.thermal import thermal_faults
from pliant.drive import MonotonicClock, State

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import ArrayLike, NDArray

    from pliant._core import Model, Servos
    from pliant._typing import Array, Mask
    from pliant.arm.thermal import Budget
    from pliant.drive import Clock, Drive, JointReadings, ServoStatus

    Orders = Mapping[str, tuple[float, float]]


#: `FASTEST`: assumed largest speed of a joint without a known one [rad/s]. `JUMP`: change of
#: position that is accepted after any time [rad].
FASTEST, JUMP = 10.0, 0.2
#: Largest speed of a joint that is pushed, as a multiple of its limit.
THROWN = 2.0
#: `IMPOSSIBLE`: number of implausible readings in a row that is reported as a fault. `PAUSE`: gap
#: between readings above which the joint may have moved unseen even after a jump [s].
IMPOSSIBLE, PAUSE = 3, 0.1


class PositionFilter:
    """Filter that rejects implausible positions of N joints.

    A position is accepted if it was read in this cycle, is finite, and lies within
    ``2 v_max Δt + 0.2 rad`` of the last accepted one. The check is needed because protocols without
    sequence numbers can deliver answers of earlier cycles. Δt does not grow while implausible
    readings arrive: a jump of the encoder is a fault and is never accepted.

    Attributes:
        position: Last accepted positions (N,) [rad]; NaN before the first.
        time: Time at which each was sampled (N,) [s].
        jumps: Number of positions rejected because of a jump.
    """

    def __init__(self, fastest: Array) -> None:
        """Set the largest speeds (N,) [rad/s]; NaN or inf: unknown."""
        self._fastest = np.where(np.isfinite(fastest), fastest, FASTEST)
        self.position: Array = np.full(fastest.size, np.nan)
        self.time: Array = np.full(fastest.size, -np.inf)
        self.jumps = 0
        # Per joint: `_last`: time of the last reading; `_allowed`: Δt of the check; `_rejected`:
        # implausible readings in a row; `_jump`: size of the last jump [rad].
        self._last: Array = self.time.copy()
        self._allowed: Array = np.zeros(fastest.size)
        self._rejected: NDArray[np.int_] = np.zeros(fastest.size, dtype=np.int_)
        self._jump: Array = np.zeros(fastest.size)

    def update(self, sample: JointReadings) -> Mask:
        """Accept the plausible positions of a sample; return a mask (N,) of the accepted joints."""
        read = np.asarray(sample.ok, dtype=bool) & np.isfinite(sample.position)
        first = np.isnan(self.position)
        gap = np.where(first, 0.0, sample.time - self._last)
        self._last = np.where(read, sample.time, self._last)
        counts = read & ((self._rejected == 0) | (gap > PAUSE))
        self._allowed += np.where(counts, gap, 0.0)
        reach = THROWN * self._fastest * self._allowed + JUMP
        with np.errstate(invalid="ignore"):
            distance = np.abs(sample.position - self.position)
            plausible = first | (distance <= reach)
        far, ok = read & ~plausible, read & plausible
        self.jumps += int(far.sum())
        self._rejected = np.where(far, self._rejected + 1, np.where(ok, 0, self._rejected))
        self._jump = np.where(far, distance, self._jump)
        self._allowed = np.where(ok, 0.0, self._allowed)
        self.position = np.where(ok, sample.position, self.position)
        self.time = np.where(ok, sample.time, self.time)
        return ok

    def faults(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return a sentence for each joint with repeated implausible readings."""
        return tuple(
            f"{names[int(i)]}: its position jumped by {self._jump[i]:.2f} rad, which it cannot "
            "have moved: encoder fault, slipped horn or loose gear. Torque off, then check its zero"
            for i in np.flatnonzero(self._rejected >= IMPOSSIBLE)
        )

    def reset(self) -> None:
        """Forget all positions, so that the next ones are accepted after any movement."""
        self.position = np.full_like(self._fastest, np.nan)
        self.time = np.full_like(self._fastest, -np.inf)
        self._last = self.time.copy()
        self._allowed, self._jump = np.zeros_like(self.time), np.zeros_like(self.time)
        self._rejected = np.zeros_like(self._rejected)


#: Format of orders for joints off the chain, as errors show it.
EXTRA = "as {'gripper': (goal [rad], limit [N·m])}"


class JointMap:
    """Joints of a drive, split into chain joints and others.

    Attributes:
        names: All joint names in drive order (N,).
        chain: Indices of the chain's joints in drive order (n,).
        off_chain: Indices of the joints off the chain.
        extra: Names of the joints off the chain.
    """

    def __init__(self, model: Model, drive: Drive) -> None:
        """Match the joint names of the model and the drive.

        Raises:
            ConfigError: A joint of the chain has no servo, or a name is not unique.
        """
        self.names = tuple(drive.names)
        if len(set(self.names)) != len(self.names):
            raise ConfigError(f"two servos have one joint name: {', '.join(self.names)}")
        missing = [name for name in model.joint_names if name not in self.names]
        if missing:
            raise ConfigError(
                f"no servo is named {', '.join(missing)}; the servos are {', '.join(self.names)}, "
                f"the joints of {model.name!r} from {model.base!r} to {model.tip!r} "
                f"{', '.join(model.joint_names)}"
            )
        self.chain = np.array([self.names.index(name) for name in model.joint_names])
        self.off_chain = np.setdiff1d(np.arange(len(self.names)), self.chain)
        self.extra = tuple(self.names[i] for i in self.off_chain)

    def index(self, name: str) -> int:
        """Return the index of a joint in drive order."""
        return self.names.index(name)

    def servos(self, drive: Drive) -> Servos:
        """Return the chain's servo parameters from the drive's table, in chain order."""
        size = len(self.names)
        table = take(drive.servos, size, self.chain)
        known = getattr(drive, "stiffness_known", None)
        if known is None:
            return table
        return table.replace(stiffness_known=bool(np.broadcast_to(known, size)[self.chain].all()))

    def fastest(self, model: Model) -> Array:
        """Return the largest speeds (N,) [rad/s]: the model's limits; `FASTEST` without one."""
        fastest = np.full(len(self.names), FASTEST)
        known = np.asarray(model.velocity_limit)
        fastest[self.chain] = np.where(np.isfinite(known), known, FASTEST)
        return fastest

    def join(self, chain: Array, off_chain: Array) -> Array:
        """Merge chain values (n,) and other values into a vector (N,) in drive order."""
        both = np.empty(len(self.names))
        both[self.chain], both[self.off_chain] = chain, off_chain
        return both

    def check(self, orders: Orders) -> dict[str, tuple[float, float]]:
        """Return checked goals [rad] and limits [N·m] of joints off the chain.

        Raises:
            TypeError: Not a mapping. ConfigError: Unknown joint, or not two numbers.
                OutOfRangeError: Not finite, or a negative limit.
        """
        checked = {}
        for name, order in mapping(orders, "extra", EXTRA).items():
            if name not in self.extra:
                there = ", ".join(self.extra) or "none"
                raise ConfigError(
                    f"no joint {name!r} off the chain to write to; there are: {there}"
                )
            try:
                goal, limit = order
            except (TypeError, ValueError):
                raise ConfigError(
                    f"extra must be {EXTRA}, got {format_value(order)} for {name}"
                ) from None
            goal, limit = real(goal, f"goal of {name}"), real(limit, f"limit of {name}")
            if not (math.isfinite(goal) and math.isfinite(limit) and limit >= 0.0):
                raise OutOfRangeError(
                    f"extra[{name!r}] must be a finite goal and a limit >= 0, got {goal:g} and "
                    f"{limit:g}"
                )
            checked[name] = (goal, limit)
        return checked


#: A limit below `SHARE` of the gravity torque for more than `LASTING` [s] causes a warning.
SHARE, LASTING = 0.5, 0.2


class LowTorqueWarning:
    """Warning about torque limits too low for the weight, if no controller computed them.

    A limit is too low if it is below half of the joint's gravity torque g(q), and limit plus
    friction is below all of it: ``limit < 0.5 |g|`` and ``limit + τ_f < |g|``.
    """

    def __init__(self, model: Model, servos: Servos) -> None:
        """Store joint names and friction; no limit has been checked yet."""
        self._names, self._friction = model.joint_names, np.asarray(servos.friction)
        self._since: float | None = None
        self._is_warned = False

    def reset(self) -> None:
        """Reset the timer, because a controller sent this command."""
        self._since = None

    def check(self, limit: Array, gravity: Array, now: float) -> None:
        """Warn once if limits (n,) [N·m] stay too low for g (n,) [N·m]; `now` is the time [s].

        Warns:
            RuntimeWarning: The joint with the largest missing torque.
        """
        weight = np.abs(gravity)
        short = (limit < SHARE * weight) & (limit + self._friction < weight)
        if self._is_warned or not short.any():
            self._since = None
            return
        self._since = now if self._since is None else self._since
        if now - self._since <= LASTING:
            return
        self._is_warned = True
        joint = int(np.where(short, weight - limit, -np.inf).argmax())
        warnings.warn(
            f"{self._names[joint]} may exert {limit[joint]:.3g} N·m, and this pose needs "
            f"{weight[joint]:.3g}: the arm sinks or falls. Limits are sent as they are; None keeps "
            "the last, a Controller's carry the weight, arm.lower() brings the arm down, and "
            "arm.disable_torque() lets go of it by name",
            RuntimeWarning,
            stacklevel=4,
        )


#: Time in which limits rise to the requested values, after torque on and after a gap [s].
EASE = 0.5
#: Largest distance of a goal outside its position limits, plus the largest lead; a goal farther
#: outside is rejected [rad].
FAR = 1.0


class ArmIO:
    """Read and write all joints of a drive, with the checks that apply to every cycle.

    Attributes:
        servos: Servos of the chain, n entries.
        goal, limit: Goals [rad] and limits [N·m] last sent to the chain (n,).
        orders: Last goal [rad] and limit [N·m] of each joint off the chain, by name.
        thermal: Thermal model of the servos.
        positions: Last plausible positions.
    """

    def __init__(self, model: Model, drive: Drive, budget: Budget) -> None:
        """Match joints to servos; no reading is available yet."""
        self.model, self.drive = model, drive
        self.clock: Clock = getattr(drive, "clock", None) or MonotonicClock()
        self.joints = JointMap(model, drive)
        self.servos = self.joints.servos(drive)
        size = len(self.joints.names)
        self._kp, self._usable = (
            _per_joint(drive.servos.kp, size),
            _per_joint(drive.servos.max_torque, size),
        )
        self.thermal = budget.thermal_model(self._usable, getattr(drive, "stall_current", None))
        self.positions = PositionFilter(self.joints.fastest(model))
        self._low_torque = LowTorqueWarning(model, self.servos)
        self.goal, self.limit = np.zeros(model.n), np.zeros(model.n)
        self.orders: dict[str, tuple[float, float]] = {}
        self._ramp_start: float = -np.inf
        self._min_limit: Array | float = 0.0
        self._last_update: float | None = None
        self._sent: tuple[Array, Array] | None = None
        self._voltage = np.full(size, np.nan)
        self._reported: dict[str, tuple[str, ...]] = {}
        self._rows: dict[str, Array | None] = {}
        self._watchdog = 0.0
        # Time of the last bus access, and of the last position received.
        self._last_access = self._last_position = self.clock.now()

    # Reading.

    def sample(self) -> Mask:
        """Take a reading; return a mask (n,) of the chain's joints that have a new position.

        Raises:
            ServoError: The connection is gone.
        """
        self._rearm_after_silence()
        try:
            sample = self.drive.read()
        except ServoTimeoutError:
            self._update_thermal(None)
            return np.zeros(self.model.n, dtype=bool)
        finally:
            self._last_access = self.clock.now()
        if np.any(sample.ok):
            gap, self._last_position = self.clock.now() - self._last_position, self.clock.now()
            if self._watchdog and gap > 0.5 * self._watchdog:
                self._rearm()
        ok = self.positions.update(sample)
        chain = self.joints.chain
        self._rows = {
            "dq": None if sample.velocity is None else sample.velocity[chain],
            "load": None if sample.load is None else sample.load[chain],
            "current": None if sample.current is None else sample.current[chain],
        }
        self._update_thermal(sample.load)
        is_new: Mask = ok[chain]
        return is_new

    def state(self, ok: Mask) -> State:
        """Return the present state; `ok` (n,) marks joints read in the last sample."""
        positions, chain = self.positions, self.joints.chain
        time = positions.time[chain]
        position = positions.position
        return State(
            q=position[chain],
            time=float(time.min()),
            fresh=bool(ok.all()),
            extra={name: float(position[self.joints.index(name)]) for name in self.joints.extra},
            age=self.clock.now() - time,
            voltage=self._voltage[chain],
            temperature=self.thermal.temperature[chain],
            faults=self.faults(),
            **self._rows,
        )

    def faults(self) -> tuple[str, ...]:
        """Return the present faults of the servos, one sentence each."""
        reported = [text for found in self._reported.values() for text in found]
        jumped = self.positions.faults(self.joints.names)
        return (*reported, *jumped, *thermal_faults(self.thermal, self.joints.names))

    def delay(self, now: float) -> float:
        """Return the time from the newest sample to `now`, plus the drive's latency [s]."""
        sampled = float(self.positions.time[self.joints.chain].max())
        return max(now - sampled, 0.0) + float(getattr(self.drive, "latency", 0.0))

    @property
    def q(self) -> Array:
        """Last plausible positions of the chain (n,) [rad]."""
        q: Array = self.positions.position[self.joints.chain]
        return q

    def gravity(self) -> Array:
        """Return torques (n,) [N·m] that hold the chain against gravity at `q`."""
        return np.asarray(self.model.gravity(self.q), dtype=np.float64)

    def stored_commands(self) -> tuple[Array, Array]:
        """Return goals [rad] and limits [N·m] (n,) read from the chain's servos; NaN if unknown."""
        orders = getattr(self.drive, "orders", None)
        chain = self.joints.chain
        if orders is None:
            return np.full(self.model.n, np.nan), np.full(self.model.n, np.nan)
        return np.asarray(orders[0])[chain], np.asarray(orders[1])[chain]

    def set_watchdog(self, seconds: float) -> None:
        """Set the servos' watchdog: they stop after this silence [s], where supported; 0: never.

        Raises:
            ServoError: A servo did not confirm.
        """
        self._watchdog = seconds
        self.drive.watchdog(seconds)
        self._last_access = self.clock.now()

    def _rearm_after_silence(self) -> None:
        """Rearm the watchdog after a gap of half its time: servos that it stopped refuse goals."""
        if self._watchdog and self.clock.now() - self._last_access > 0.5 * self._watchdog:
            self._rearm()

    def _rearm(self) -> None:
        """Clear tripped watchdogs and arm them again; errors are ignored, a later call retries."""
        self._last_position = self.clock.now()
        with contextlib.suppress(ServoError):
            self.drive.watchdog(0.0)
            self.drive.watchdog(self._watchdog)

    def is_refused(self) -> bool:
        """Return True if a joint of the chain refuses goals; its torque must then stay on."""
        refusing = getattr(self.drive, "refusing", None)
        return refusing is not None and bool(np.any(np.asarray(refusing)[self.joints.chain]))

    # Writing.

    def ramp_limits(self, limit: Array | float = 0.0) -> None:
        """Start a ramp of 0.5 s, from the greater of holding torque and `limit` (n,) [N·m]."""
        self._ramp_start, self._min_limit = self.clock.now(), limit

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
        orders = {} if extra is None else self.joints.check(extra)
        gravity, model, chain = self.gravity(), self.model, self.joints.chain
        need, max_lead = gravity / self._kp[chain], self._usable[chain] / self._kp[chain]
        excess = np.maximum(model.lower - goal, goal - model.upper)
        if excess.max() > FAR + max_lead[excess.argmax()]:
            joint = int(excess.argmax())
            raise OutOfRangeError(
                f"goal of {model.joint_names[joint]} is {goal[joint]:g} rad, far outside of "
                f"{model.lower[joint]:.3g} to {model.upper[joint]:.3g} rad: are these degrees? "
                "Nothing was sent"
            )
        self.orders = {**self.orders, **orders}
        out = (max_lead, max_lead) if lead else (np.maximum(-need, 0.0), np.maximum(need, 0.0))
        goal = np.clip(goal, model.lower - out[0], model.upper + out[1])
        self.send(goal, self._clip_limits(goal, limit, gravity), velocity)
        if lead:
            self._low_torque.reset()
        else:
            self._low_torque.check(limit, gravity, self.clock.now())

    def _clip_limits(self, goal: Array, limit: Array, gravity: Array) -> Array:
        """Return limits (n,) [N·m], bounded by heat, by supply current and by `ramp_limits`."""
        chain, support = self.joints.chain, SUPPORT * np.abs(gravity)
        usable = self._usable[chain]
        holding = np.minimum(
            np.maximum(support + torque_margin(self.servos, gravity), self._min_limit), usable
        )
        share = min(max((self.clock.now() - self._ramp_start) / EASE, 0.0), 1.0)
        limit = np.minimum(limit, holding + share * (usable - holding))
        limit = np.minimum(limit, np.maximum(self.thermal.torque_ceiling()[chain], support))
        goals, limits = self._in_drive_order(goal, limit)
        floor = self.joints.join(support, np.zeros(self.joints.off_chain.size))
        pull = self._kp * np.nan_to_num(goals - self.positions.position)
        limited: Array = self.thermal.limit_current(pull, floor, limits)[chain]
        return limited

    def start(self, goal: Array, limit: Array) -> None:
        """Switch torque on with these first goals [rad] and limits [N·m] (n,).

        Raises:
            ServoError: A joint moved or did not confirm.
        """
        self.goal, self.limit = goal.copy(), limit.copy()
        self._sent = self._in_drive_order(goal, np.minimum(limit, self._usable[self.joints.chain]))
        self.drive.enable(*self._sent)

    def send(self, goal: Array, limit: Array, velocity: Array | None = None) -> None:
        """Send goals [rad] and limits [N·m] of the chain (n,), and `orders` to all other joints.

        Limits are clipped only to the servos' usable torque.

        `velocity` (n,) [rad/s] goes to the servos' speed registers; None: no speed limit.

        Raises:
            ServoError: The connection is gone.
        """
        goals, limits = self._in_drive_order(
            goal, np.minimum(limit, self._usable[self.joints.chain])
        )
        self._rearm_after_silence()
        self._sent = goals, limits
        self.goal, self.limit = goal.copy(), limits[self.joints.chain]
        off_chain = np.full(self.joints.off_chain.size, np.inf)
        speeds = None if velocity is None else self.joints.join(velocity, off_chain)
        self.drive.write(goals, limits, speeds)
        self._last_access = self.clock.now()
        self._update_status(self.drive.poll_status())

    def _in_drive_order(self, goal: Array, limit: Array) -> tuple[Array, Array]:
        """Return goals and limits (N,) in drive order; limits off the chain are bounded by heat."""
        off_chain = self.joints.off_chain
        orders = [self.orders[name] for name in self.joints.extra]
        ceiling = self.thermal.torque_ceiling()[off_chain]
        max_lead = np.minimum([order[1] for order in orders], ceiling)
        goals = self.joints.join(goal, np.array([order[0] for order in orders]))
        return goals, self.joints.join(limit, max_lead)

    def _update_thermal(self, load: Array | None) -> None:
        """Update the thermal model with the torques exerted since the last reading."""
        now = self.clock.now()
        if self._last_update is not None and self._sent is not None:
            goal, limit = self._sent
            error = np.nan_to_num(goal - self.positions.position)
            torque = np.minimum(np.abs(self._kp * error), limit)
            if load is not None:
                torque = np.where(np.isfinite(load), np.abs(load), torque)
            self.thermal.update(torque, now - self._last_update)
        self._last_update = now

    def _update_status(self, status: ServoStatus | None) -> None:
        """Store voltage, temperature and faults from one slow read."""
        if status is None:
            return
        index = self.joints.index(status.name)
        if status.voltage is not None:
            self._voltage[index] = status.voltage
        if status.temperature is not None:
            self.thermal.set_temperature(index, status.temperature)
        self._reported[status.name] = status.faults


def _per_joint(value: ArrayLike, size: int) -> Array:
    """Return a new array (size,) from one number or one per joint."""
    return np.broadcast_to(np.asarray(value, dtype=np.float64), size).copy()
