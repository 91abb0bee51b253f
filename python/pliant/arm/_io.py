"""Reading and writing of all joints of an arm, with checks of readings and of commands."""

from __future__ import annotations

import contextlib
import logging
import math
import warnings
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import (
    ArmCycle,
    CommandLimiter,
    ConfigError,
    JointReadings,
    OutOfRangeError,
    PositionFilter,
    ServoError,
)
from pliant._servo_tables import take
from pliant._validation import format_value, mapping, real
from pliant.arm._checks import vector
from pliant.arm._messages import MESSAGES
from pliant.arm.thermal import TOO_HOT, thermal_faults
from pliant.drive import MonotonicClock

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike

    from pliant._core import Model, Servos, State
    from pliant._typing import Array, Mask
    from pliant.arm.thermal import Budget
    from pliant.drive import Drive, ServoStatus

    Orders = Mapping[str, tuple[float, float]]


#: Assumed largest speed of a joint without a speed limit in the model [rad/s].
DEFAULT_SPEED = 10.0
#: Number of consecutive implausible positions of a joint that is reported as a fault.
MAX_JUMPS = 3
#: Ratio of lowest to highest voltage since torque on below which the user is warned.
SAG = 0.85


#: Format of the argument `extra` (joints off the chain) in error messages.
EXTRA = "as {'gripper': (goal [rad], limit [N·m])}"


class JointMap:
    """Joints of a drive, split into the chain from base to tool and other joints (grippers).

    Vectors (N,) are in drive order, the order in which the drive lists the joints.

    Attributes:
        names: Names of all joints (N,).
        chain: Index of each joint of the chain in drive order (n,).
        select: Index of the chain in a vector (N,): a slice, which returns a view, if its joints
            are consecutive; else `chain`.
        off_chain: Index of each joint off the chain in drive order (N - n,).
        extra: Names of the joints off the chain (N - n,).
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
        first, last = self.chain[0], self.chain[-1]
        in_a_row = np.array_equal(self.chain, np.arange(first, last + 1))
        self.select = slice(first, last + 1) if in_a_row else self.chain
        self.off_chain = np.setdiff1d(np.arange(len(self.names)), self.chain)
        self.extra = tuple(self.names[i] for i in self.off_chain)

    def index(self, name: str) -> int:
        """Return the index of the joint `name` in drive order.

        Raises:
            ConfigError: The drive has no such joint.
        """
        if name not in self.names:
            raise ConfigError(
                f"the drive reports the status of {name!r}, which is not one of its names: "
                f"{', '.join(self.names)}"
            )
        return self.names.index(name)

    def servos(self, drive: Drive) -> Servos:
        """Return the servo parameters of the chain, n entries, from those of the drive."""
        size = len(self.names)
        table = take(drive.servos, size, self.chain)
        known = getattr(drive, "stiffness_known", None)
        if known is None:
            return table
        return table.replace(stiffness_known=bool(np.broadcast_to(known, size)[self.chain].all()))

    def max_speeds(self, model: Model) -> Array:
        """Return the largest joint speeds (N,) [rad/s]: limits of the model, or `DEFAULT_SPEED`."""
        max_speeds = np.full(len(self.names), DEFAULT_SPEED)
        known = np.asarray(model.velocity_limit)
        max_speeds[self.chain] = np.where(np.isfinite(known), known, DEFAULT_SPEED)
        return max_speeds

    def join(self, chain: Array, off_chain: Array) -> Array:
        """Merge values of the chain (n,) and of other joints (N - n,) into a vector (N,)."""
        both = np.empty(len(self.names))
        both[self.chain], both[self.off_chain] = chain, off_chain
        return both

    def check(self, orders: Orders) -> dict[str, tuple[float, float]]:
        """Validate and return `orders`: goal [rad] and limit [N·m] of joints off the chain.

        Raises:
            TypeError: `orders` is not a mapping.
            ConfigError: A joint is unknown, or the value of a joint is not a pair of numbers.
            OutOfRangeError: A number is not finite, or a limit is negative.
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


#: A warning is issued if the torque limit of a joint stays below `LOW_SHARE` of its gravity torque
#: for `LOW_TIME` [s].
LOW_SHARE, LOW_TIME = 0.5, 0.2


class LowTorqueWarning:
    """Warns about torque limits that are too low for the arm's weight.

    The torque limit of a joint [N·m] is too low if ``limit < 0.5 |g|`` and ``limit + τ_f < |g|``,
    with the joint's gravity torque g and dry friction τ_f [N·m]. Commands of a `Controller` are not
    checked, because their limits allow for the weight.

    Attributes:
        since: Time since which a limit is too low [s]; None: no limit is too low.
    """

    def __init__(self, model: Model, servos: Servos) -> None:
        """Store the joint names of the model and the friction of the servos."""
        self._names, self._friction = model.joint_names, np.asarray(servos.friction)
        self.since: float | None = None
        self._is_warned = False

    def reset(self) -> None:
        """Restart the time `LOW_TIME`; call this after every command of a `Controller`."""
        self.since = None

    def check(self, limit: Array, gravity: Array, now: float) -> None:
        """Warn once, if a torque limit has been too low for `LOW_TIME`.

        Args:
            limit: Torque limits (n,) [N·m].
            gravity: Gravity torques (n,) [N·m].
            now: Present time [s].

        Warns:
            RuntimeWarning: The joint with the largest missing torque.
        """
        weight = np.abs(gravity)
        short = (limit < LOW_SHARE * weight) & (limit + self._friction < weight)
        if self._is_warned or not short.any():
            self.since = None
            return
        self.since = now if self.since is None else self.since
        if now - self.since <= LOW_TIME:
            return
        self._is_warned = True
        joint = int(np.where(short, weight - limit, -np.inf).argmax())
        warnings.warn(
            f"{self._names[joint]} may exert {limit[joint]:.3g} N·m, and this pose needs "
            f"{weight[joint]:.3g}: the arm sinks or falls. Limits are sent as they are; None keeps "
            "the last limits, a Controller's limits hold the weight. arm.lower() brings the arm "
            "down, arm.disable_torque() lets it fall",
            RuntimeWarning,
            stacklevel=4,
        )


#: Time in which torque limits rise from holding torque to their requested values, after torque on
#: and after a time without commands [s].
RAMP_TIME = 0.5

#: Time without a position [s] after which a joint of the chain counts as silent, and after which a
#: joint off the chain is reported as silent.
SILENCE, EXTRA_SILENCE = 0.2, 1.0
#: Largest number of reads until all joints of an arm with torque, from an ended program, answer.
RESUME_READS = 5


class ArmIO(ArmCycle):
    """Read and write all joints of a drive, with the checks that apply to every cycle.

    `ArmCycle` has the methods `read` and `write`, and the attributes that they use.

    Attributes:
        servos: Servo parameters of the chain, n entries.
        load: Mass at the tool beyond the model's payload, found at torque on [kg].
        thermal: Thermal model of the servos.
    """

    def __init__(self, model: Model, drive: Drive, budget: Budget) -> None:
        """Match the joints of the model to those of the drive; read nothing from the drive."""
        self.model, self.drive = model, drive
        self.clock = getattr(drive, "clock", None) or MonotonicClock()
        self.joints = JointMap(model, drive)
        self.servos = self.joints.servos(drive)
        self.load = 0.0
        size = len(self.joints.names)
        self._kp, self._usable = (
            _per_joint(drive.servos.kp, size),
            _per_joint(drive.servos.max_torque, size),
        )
        self.thermal = budget.thermal_model(self._usable, getattr(drive, "stall_current", None))
        # Temperature offset of servos that switch off below `budget.hottest` [°C].
        limit = _per_joint(getattr(drive, "temperature_limit", np.inf), size)
        self._extra_heat = np.maximum(budget.hottest - limit, 0.0)
        self.positions = PositionFilter(self.joints.max_speeds(model))
        self.limiter = CommandLimiter(
            model,
            self.servos,
            self.thermal,
            chain=self.joints.chain.tolist(),
            extra=self.joints.extra,
            kp=self._kp,
            max_torque=self._usable,
            max_jumps=MAX_JUMPS,
            max_heat=TOO_HOT,
        )
        self._low_torque = LowTorqueWarning(model, self.servos)
        self.ramp_time, self.min_limit = RAMP_TIME, np.zeros(model.n)
        self.goals, self.limits = np.zeros(size), np.zeros(size)
        # Read-only arrays (N,): states hold views of them, so a change creates a new array.
        self._voltage = self._temperature = _with_entry(np.full(size, np.nan), 0, np.nan)
        self._set_supply()
        #: Lowest and highest voltage of each joint (2, N) since `start` [V]; NaN before a reading.
        self.voltage_range: Array = np.full((2, size), np.nan)
        #: End of the last loop that a `ServoError` ended [s], and positions (n,) [rad] shortly
        #: before, at which it held the arm; None: no such loop.
        self.held: tuple[float, Array] | None = None
        # True from the end of torque on until the warning of a sagging supply.
        self._watches_supply = False
        # Protections that have tripped since torque on and were reported to the user.
        self._told_protections: set[str] = set()
        # Last status by joint name.
        self._statuses: dict[str, ServoStatus] = {}
        self.readings = JointReadings(np.full(size, np.nan), np.zeros(size, dtype=bool), 0.0)
        self._silent: set[str] = set()
        # Time of the last position received [s], and of the last access to the bus; `set_watchdog`
        # sets both.
        self._last_position: float
        #: Mask (N,) of joints whose torque an ended program may have left on, and that have not
        #: answered yet.
        self.torque_unknown: Mask = np.zeros(size, dtype=bool)

    # Methods that read from the drive.

    def sample(self) -> Mask:
        """Read all joints; return the mask (n,) of the chain's joints with a new position.

        Raises:
            ServoError: The connection to the drive is lost.
        """
        self.read()
        is_new: Mask = self.positions.accepted[self.joints.chain]
        return is_new

    def _readings_of_none(self) -> JointReadings:
        """Return the last readings, with no new position: no joint has answered."""
        return self.readings.replace(ok=np.zeros(len(self.joints.names), dtype=bool))

    def _note_answers(self, readings: JointReadings, now: float) -> None:
        """Rearm the servos' watchdogs at the first position after a long silence."""
        if np.any(readings.ok):
            gap, self._last_position = now - self._last_position, now
            if gap > 0.5 * self.watchdog_time:
                self._rearm()

    def _with_faults(self, state: State) -> State:
        """Return a state with the present faults of the servos."""
        return state.replace(faults=self.faults())

    def faults(self) -> tuple[str, ...]:
        """Return the present faults of the servos, one sentence each."""
        names = self.joints.names
        found = [text for texts in self.reported.values() for text in texts]
        found += [
            f"{names[i]}: its position jumped by {jump:.2f} rad, which it cannot have moved: "
            "encoder fault, slipped horn or loose gear. Torque off, then check its zero"
            for i, jump in self.positions.implausible(MAX_JUMPS)
        ]
        if self.thermal.is_too_hot(TOO_HOT):
            found += thermal_faults(self.thermal, names, self._temperature)
        return tuple(found)

    def unfit_joints(self, now: float) -> dict[str, str]:
        """Return the joints of the chain that may not follow their goals: reason by name.

        They are silent while others answer, report a fault, or are so hot that their torque limit
        is zero.
        """
        is_silent = now - self.positions.time > SILENCE
        is_hot = self.thermal.temperature >= self.thermal.zero_torque_temperature
        if is_silent[self.joints.chain].all():
            is_silent[:] = False
        found = {}
        for i, name in enumerate(self.joints.names):
            if i not in self.joints.chain:
                continue
            if texts := self.reported.get(name):
                found[name] = "; ".join(text.removeprefix(f"{name}: ") for text in texts)
            elif is_silent[i]:
                found[name] = f"no answer for {SILENCE:g} s"
            elif is_hot[i]:
                found[name] = f"at {self._temperature[i]:.0f} °C it gets no torque"
        return found

    def outdated(self) -> Mask:
        """Return the mask (n,) of the joints whose position is unknown or older than `SILENCE`.

        The age is that at the last reading, however long a reading takes.
        """
        is_old = ~(self.last_update - self.positions.time <= SILENCE)
        mask: Mask = (is_old | self.torque_unknown)[self.joints.chain]
        return mask

    def delay(self, now: float) -> float:
        """Return the age of the newest position at time `now` [s], plus the drive's latency [s]."""
        sampled = float(self.positions.time[self.joints.chain].max())
        return max(now - sampled, 0.0) + float(getattr(self.drive, "latency", 0.0))

    @property
    def q(self) -> Array:
        """Last plausible positions of the chain (n,) [rad]."""
        q: Array = self.positions.position[self.joints.chain]
        return q

    @property
    def goal(self) -> Array:
        """Goals last sent to the chain (n,) [rad]."""
        goal: Array = self.goals[self.joints.chain]
        return goal

    @property
    def limit(self) -> Array:
        """Torque limits last sent to the chain (n,) [N·m]."""
        limit: Array = self.limits[self.joints.chain]
        return limit

    def gravity(self) -> Array:
        """Return torques (n,) [N·m] that hold the chain against gravity at `q`."""
        return np.asarray(self.model.gravity(self.q), dtype=np.float64)

    def stored_commands(self) -> tuple[Array, Array]:
        """Return the goals [rad] and limits [N·m] (n,) in the chain's servos; NaN if unknown.

        The drive reports them as its attribute `orders`, for an arm whose torque is on already.
        """
        orders = getattr(self.drive, "orders", None)
        chain = self.joints.chain
        if orders is None:
            return np.full(self.model.n, np.nan), np.full(self.model.n, np.nan)
        return np.asarray(orders[0])[chain], np.asarray(orders[1])[chain]

    def stored_order(self, name: str) -> tuple[float, float] | None:
        """Return goal [rad] and limit [N·m] in the servo of a joint off the chain.

        Return None if its torque is off, or torque, goal or limit are unknown.
        """
        i = self.joints.index(name)
        if not self.drive_mask("enabled")[i] or self.drive_mask("torque_unknown")[i]:
            return None
        found = getattr(self.drive, "orders", None)
        if found is not None and math.isfinite(found[0][i] + found[1][i]):
            return float(found[0][i]), float(found[1][i])
        return self.orders.get(name)

    def set_watchdog(self, seconds: float) -> None:
        """Set the servos' watchdog, if supported: they stop after this bus silence [s]; 0 is off.

        Raises:
            ServoError: A servo did not confirm the new watchdog time.
        """
        self.watchdog_time = seconds
        self.drive.watchdog(seconds)
        self.last_access = self._last_position = self.clock.now()

    def _rearm_after_silence(self) -> None:
        """Rearm the servos' watchdogs if the bus was silent for more than half the watchdog time.

        They may have tripped meanwhile.
        """
        if self.clock.now() - self.last_access > 0.5 * self.watchdog_time:
            self._rearm()

    def _rearm(self) -> None:
        """Clear and arm the servos' watchdogs; ignore bus errors, because a later call retries."""
        self._last_position = self.clock.now()
        with contextlib.suppress(ServoError):
            self.drive.watchdog(0.0)
            self.drive.watchdog(self.watchdog_time)

    def is_refused(self) -> bool:
        """Return True if the drive reports that a servo of the chain rejects goals."""
        return bool(self.drive_mask("refusing")[self.joints.chain].any())

    def drive_mask(self, name: str, *, default: bool = False) -> Mask:
        """Return the mask (N,) in an optional attribute of the drive.

        `default` is the value for all joints if the drive does not have this attribute.
        """
        return np.broadcast_to(getattr(self.drive, name, default), len(self.joints.names))

    def joints_where(self, name: str, *, default: bool = False) -> list[str]:
        """Return the names of the joints for which `drive_mask` is True."""
        mask = self.drive_mask(name, default=default)
        return [joint for joint, on in zip(self.joints.names, mask, strict=True) if on]

    def without_torque(self) -> list[str]:
        """Return the names of the chain's joints whose torque is off, if the drive reports this."""
        on = self.drive_mask("enabled", default=True)
        return [self.joints.names[i] for i in self.joints.chain if not on[i]]

    # Methods that write to the drive.

    def resume(self, rate: float) -> bool:
        """Take over the joints whose torque an ended program left on; send nothing.

        Their goals and limits are those stored in the servos. A joint that does not answer counts
        as having torque, see `resume_silent`; until it answers, its position is the one that the
        ended program measured before it switched torque on.

        Args:
            rate: Rate of the reads [Hz].

        Returns:
            True if a joint has torque.

        Raises:
            ServoError: A port cannot be opened; or servos do not answer, and the others have no
                torque.
        """
        goals, limits = self._reopen()
        has_torque = np.isfinite(goals)
        for _ in range(RESUME_READS):
            if self.sample().all():
                break
            self.clock.wait_until(self.clock.now() + 1.0 / rate)
        if np.isnan(self.positions.position).any():
            self.positions.assume(self.drive.read().position, self.clock.now())
        goals = np.where(has_torque, goals, self.positions.position)
        limits = np.where(has_torque, limits, 0.0)
        self.goals, self.limits, self.is_sent = goals, limits, True
        self.orders = {
            name: (float(goals[i]), float(limits[i]))
            for name, i in zip(self.joints.extra, self.joints.off_chain, strict=True)
        }
        return bool((has_torque | self.torque_unknown).any())

    def resume_silent(self) -> Mask | None:
        """Take over joints that did not answer in `resume`, and have answered in the last `sample`.

        Returns:
            Mask (n,) of the joints of the chain whose torque is known now, or None if there is no
            new joint, on the chain or off it. `goal` and `limit` of a joint with torque are those
            in its servo, of a joint without torque its position and 0.

        Raises:
            ServoError: The connection to the drive is lost.
        """
        before = self.torque_unknown
        if not (before & self.readings.ok).any():
            return None
        goals, limits = self._reopen()
        found = before & ~self.torque_unknown
        if not found.any():
            return None
        has_torque = found & np.isfinite(goals)
        goals = np.where(has_torque, goals, self.positions.position)
        self.goals = np.where(found, goals, self.goals)
        self.limits = np.where(found, np.where(has_torque, limits, 0.0), self.limits)
        for name, i in zip(self.joints.extra, self.joints.off_chain, strict=True):
            if has_torque[i]:
                self.orders[name] = (float(goals[i]), float(limits[i]))
        is_new: Mask = found[self.joints.chain]
        return is_new

    def unknown_joints(self) -> list[str]:
        """Return the names of the joints in `torque_unknown`."""
        return [self.joints.names[i] for i in np.flatnonzero(self.torque_unknown)]

    def _reopen(self) -> tuple[Array, Array]:
        """Return goals and limits (N,) of `Drive.reopen`, and set `torque_unknown`."""
        goals, limits = self.drive.reopen()  # type: ignore[attr-defined]
        self.torque_unknown = self.drive_mask("enabled") & np.isnan(goals)
        return goals, limits

    def ramp_limits(self, limit: Array | float = 0.0) -> None:
        """Limit torque for `RAMP_TIME` by a ramp from holding torque to usable torque.

        Args:
            limit: Lower bound of the ramp at its start (n,) [N·m].
        """
        self.ramp_start = self.clock.now()
        self.min_limit = _per_joint(limit, self.model.n)

    def _orders_with(self, extra: Orders) -> dict[str, tuple[float, float]]:
        """Return `orders` with those in `extra`; raise as `JointMap.check` does."""
        return {**self.orders, **self.joints.check(extra)}

    def _watch_limits(self, limit: ArrayLike, gravity: Array | None) -> None:
        """Warn of limits (n,) [N·m] that are too low for the weight.

        `gravity` are gravity torques (n,) [N·m]; None: the command came from a controller.
        """
        if gravity is None:
            self._low_torque.reset()
        else:
            self._low_torque.check(np.asarray(limit), gravity, self.clock.now())

    def _check_command(
        self, goal: ArrayLike, limit: ArrayLike, velocity: ArrayLike | None
    ) -> tuple[Array, Array, Array | None]:
        """Validate and return goals, torque limits and largest speeds (n,) of the chain."""
        goal, limit = vector(self.model, goal, "goal"), vector(self.model, limit, "limit")
        if (least := min(limit.tolist())) < 0.0:
            raise OutOfRangeError(f"limit must be at least 0 N·m, got {least:g}")
        if velocity is not None:
            velocity = vector(self.model, velocity, "velocity", finite=False)
            if not all(map((0.0).__le__, velocity.tolist())):
                raise OutOfRangeError(f"velocity must be at least 0 rad/s, got {velocity.tolist()}")
        joint = self.limiter.unreachable(goal)
        if joint is not None:
            model = self.model
            raise OutOfRangeError(
                f"goal of {model.joint_names[joint]} is {goal[joint]:g} rad, far outside of "
                f"{model.lower[joint]:.3g} to {model.upper[joint]:.3g} rad: are these degrees? "
                "Nothing was sent"
            )
        return goal, limit, velocity

    def start(self, goal: Array, limit: Array, lead: Array) -> None:
        """Switch torque on with these first goals [rad] and limits [N·m] (n,).

        If the drive accepts leads, `lead` (n,) [rad] is added to the first goal of each joint whose
        torque is still off.

        Raises:
            ServoError: A joint moved when torque came on, or its servo did not confirm.
        """
        self.voltage_range.fill(np.nan)
        self._watches_supply = False
        self._told_protections.clear()
        usable = self._usable[self.joints.chain]
        goals, self.limits = self._in_drive_order(goal, np.minimum(limit, usable))
        self.goals, self.is_sent = goals, True
        if getattr(self.drive, "accepts_lead", False):
            leads = self.joints.join(lead, np.zeros(len(self.joints.off_chain)))
            self.goals = goals + leads
            self.drive.enable(goals, self.limits, lead=leads)  # type: ignore[call-arg]
        else:
            self.drive.enable(goals, self.limits)

    def send(self, goal: Array, limit: Array, velocity: Array | None = None) -> None:
        """Send goals and limits of the chain, and `orders` to the joints off the chain.

        Args:
            goal: Joint goals (n,) [rad].
            limit: Torque limits (n,) [N·m], clipped to the servos' usable torque.
            velocity: Speed limits (n,) [rad/s]; None: no speed limit.

        Raises:
            ServoError: The connection to the drive is lost.
        """
        usable = self._usable[self.joints.chain]
        if velocity is not None:
            velocity = self.joints.join(velocity, np.full(len(self.joints.extra), np.inf))
        self.transmit(*self._in_drive_order(goal, np.minimum(limit, usable)), velocity)

    def _report_silent(self) -> None:
        """Warn once of each joint off the chain that is silent."""
        times = self.positions.time
        for name, i in zip(self.joints.extra, self.joints.off_chain, strict=True):
            if times.max() - times[i] > EXTRA_SILENCE and name not in self._silent:
                self._silent.add(name)
                MESSAGES.post(f"no answer from {name}: look at its plug and cable", logging.WARNING)

    def _in_drive_order(self, goal: Array, limit: Array) -> tuple[Array, Array]:
        """Extend goals and limits of the chain (n,) to all joints (N,), with values of `orders`.

        The thermal budget bounds the limits of the joints off the chain.
        """
        off_chain = self.joints.off_chain
        orders = [self.orders[name] for name in self.joints.extra]
        ceiling = self.thermal.torque_ceiling()[off_chain]
        max_lead = np.minimum([order[1] for order in orders], ceiling)
        goals = self.joints.join(goal, np.array([order[0] for order in orders]))
        return goals, self.joints.join(limit, max_lead)

    def _update_status(self, status: ServoStatus) -> int:
        """Store voltage, temperature and faults of the servo in `status`; return its joint."""
        name, last = status.name, self._statuses.get(status.name)
        joint = self.joints.index(name)
        self._statuses[name] = status
        supply = (status.voltage, status.temperature)
        if last is None or supply != (last.voltage, last.temperature):
            self._store_supply(joint, *supply)
        if status.protections:
            self._report_protections(status)
        if status.faults:
            self.reported[name] = status.faults
        elif self.reported:
            self.reported.pop(name, None)
        return joint

    def _report_protections(self, status: ServoStatus) -> None:
        """Warn once of each protection of a servo that tripped while the arm goes on.

        A trip that lasts is a fault, which ends a loop with its own error.
        """
        new = [text for text in status.protections if text not in self._told_protections]
        self._told_protections.update(new)
        if new and not status.faults:
            MESSAGES.post(
                f"{'; '.join(new)}: the servo's protection tripped and reduced its torque until "
                "the next command; the arm goes on. Lower the load of this joint or its torque "
                "limits, or end the program and let the servo cool: a trip that lasts ends the "
                "loop",
                logging.WARNING,
            )

    def _store_supply(self, index: int, voltage: float | None, temperature: float | None) -> None:
        """Store voltage [V] and temperature [°C] of a joint; None keeps the last value."""
        if voltage is not None:
            self._voltage = _with_entry(self._voltage, index, voltage)
            low, high = self.voltage_range
            low[index], high[index] = np.fmin(low[index], voltage), np.fmax(high[index], voltage)
            if self._watches_supply and (text := self._supply_sag("since torque came on")):
                self._watches_supply = False
                MESSAGES.post(text, logging.WARNING)
        if temperature is not None:
            self.thermal.set_temperature(index, temperature + self._extra_heat[index])
            self._temperature = _with_entry(self._temperature, index, temperature)
        self._set_supply()

    def watch_supply(self) -> str | None:
        """Return a warning if the supply sagged while torque came on; else warn once it does later.

        The check needs no work in cycles in which no servo reports another voltage.
        """
        text = self._supply_sag("while torque came on")
        self._watches_supply = text is None
        return text

    def _supply_sag(self, when: str) -> str | None:
        """Return a warning if the supply voltage changed much since `start`, or None."""
        low, high = self.voltage_range
        changed = np.flatnonzero(low < SAG * high)
        if not changed.size:
            return None
        worst = changed[np.argmin(low[changed])]
        return (
            f"the supply voltage of {self.joints.names[worst]} was between {low[worst]:.1f} and "
            f"{high[worst]:.1f} V {when}: leads that hold the arm at one voltage do not hold it at "
            "another, so it rises or sinks by centimetres as the voltage changes; repair supply "
            "and cable, then switch torque on again"
        )

    def _set_supply(self) -> None:
        """Pass voltages and temperatures of the chain to the limiter, for the next states."""
        select = self.joints.select
        self.limiter.set_supply(self._voltage[select], self._temperature[select])


def _with_entry(values: Array, index: int, value: float | None) -> Array:
    """Return a read-only copy of an array with another value at `index`."""
    changed = values.copy()
    changed[index] = value
    changed.flags.writeable = False
    return changed


def _per_joint(value: ArrayLike, size: int) -> Array:
    """Return a new array (size,) with a scalar repeated, or with the values of an array (size,)."""
    return np.broadcast_to(np.asarray(value, dtype=np.float64), size).copy()
