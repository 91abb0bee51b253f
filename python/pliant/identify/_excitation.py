"""Safe motions of an arm in joint space, with a record of orders and readings."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import Command, ConfigError, OutOfRangeError, ServoError
from pliant._validation import number

if TYPE_CHECKING:
    from collections.abc import Generator

    from numpy.typing import ArrayLike

    from pliant._core import Model, Servos
    from pliant._typing import Array

    Motion = Generator[Command, Array, Array]

#: Peak speed of a joint between poses [rad/s].
TRAVEL_SPEED = 0.4
#: Share of a sweep's period for a reversal.
CORNER = 0.2
#: Lag behind the plan, beyond the slack, at which a joint counts as blocked [rad].
BLOCKED_LAG = 0.2
#: Spring toward the plan for a joint driven by its limit, as a share of k_p.
SPRING = 0.15
#: Share of the assumed friction that is fed forward.
FRICTION_SHARE = 0.8
#: Least and largest distance beyond its swing at which the joint is stopped [rad].
OVERSHOOT = (0.06, 0.25)
#: Least lead of its goal [rad].
MIN_LEAD = 0.05
#: Settling time after a step of the goal [s].
STEP_TIME = 0.5
#: Margin to the position limits [rad].
LIMIT_MARGIN = 0.02


@dataclass
class Record:
    """Ticks of one motion.

    The goal of row k was sent after q of row k had been read, and holds until row k + 1.

    Attributes:
        q: Positions read (N, n) [rad].
        goal: Goals sent, rounded to counts (N, n) [rad].
        limit: Torque limits sent (N, n) [N·m].
        speed: Planned speed (N, n) [rad/s].
        driven: Joint driven by its limit, -1 for none.
    """

    q: list[Array] = field(default_factory=list)
    goal: list[Array] = field(default_factory=list)
    limit: list[Array] = field(default_factory=list)
    speed: list[Array] = field(default_factory=list)
    driven: int = -1

    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """Positions, goals, limits and speeds, (N, n) each."""
        return np.array(self.q), np.array(self.goal), np.array(self.limit), np.array(self.speed)


class Excitation:
    """An arm with an assumed servo table, moved slowly and with bounded torque.

    Args:
        model: The arm.
        servos: Assumed servo table.
        period: Control period [s].
        torque_share: Torque allowed on top of gravity, as a share of the usable torque.
        stiffness_uncertainty: Factor by which the true stiffness may be smaller than assumed.

    Attributes:
        extra_torque: Identified torque at the pose in addition to the model's (n,) [N·m].
        records: Records of all motions.
        undriven: Joints that could not be driven by their limits.
    """

    def __init__(
        self,
        model: Model,
        servos: Servos,
        period: float,
        *,
        torque_share: float = 0.6,
        stiffness_uncertainty: float = 1.3,
    ) -> None:
        torque_share = number(torque_share, "torque_share", 0.01, 1.0)
        period = number(period, "period", 1e-3, 0.1, "s")
        n = self.n = model.n
        self.model, self.servos, self.period = model, servos, period
        columns = [
            np.broadcast_to(np.asarray(value), n).astype(np.float64)
            for value in (
                servos.kp,
                servos.friction,
                servos.max_torque,
                servos.encoder_step,
                servos.damping,
                servos.kv,
            )
        ]
        self.kp, self.friction, self.torque, self.count, self.damping, self.kv = columns
        if servos.limit_type == "pwm" and servos.no_load_speed is not None:
            self.back_emf: Array = self.torque / np.asarray(servos.no_load_speed)
        else:
            self.back_emf = np.zeros(n)
        self._share, self.stiffness_uncertainty = torque_share, stiffness_uncertainty
        self._grid = np.where(self.count > 0.0, self.count, 1.0)
        self.extra_torque: Array = np.zeros(n)
        self.records: list[Record] = []
        self.undriven: list[int] = []

    def start_record(self, driven: int = -1) -> Record:
        """Start a new record for all orders from now on."""
        self.records.append(Record(driven=driven))
        return self.records[-1]

    def gravity_lead(self, q: ArrayLike) -> Array:
        """Return the lead of the goals that carries the arm at q, by the table (n,) [rad]."""
        return (np.asarray(self.model.gravity(q)) + self.extra_torque) / self.kp

    def limits(self, q: ArrayLike) -> Array:
        """Return torque limits that carry the arm at q plus `torque_share` (n,) [N·m]."""
        needed = 1.3 * np.abs(self.model.gravity(q) + self.extra_torque) + self._share * self.torque
        out: Array = np.minimum(self.torque, needed)
        return out

    def fit_within_limits(self, q: Array, size: Array) -> Array:
        """Return the pose nearest to q whose swing of ±size fits into the position limits.

        Raises:
            OutOfRangeError: It fits nowhere.
        """
        margin = LIMIT_MARGIN + size
        low, high = self.model.lower + margin, self.model.upper - margin
        if (low > high).any():
            middle = 0.5 * (np.asarray(self.model.lower) + self.model.upper)
            self.check_range(middle - size, middle + size)
        out: Array = np.clip(q, low, high)
        return out

    def check_range(self, low: ArrayLike, high: ArrayLike) -> None:
        """Check that a range [rad] keeps its margin to the position limits.

        Raises:
            OutOfRangeError: It does not; names the joint, the range and its limits.
        """
        low, high = np.asarray(low), np.asarray(high)
        bad = (low < self.model.lower + LIMIT_MARGIN) | (high > self.model.upper - LIMIT_MARGIN)
        for i in np.flatnonzero(bad):
            raise OutOfRangeError(
                f"joint {self.model.joint_names[i]} would move in {low[i]:.3f}…{high[i]:.3f} rad; "
                f"its limits are {self.model.lower[i]:.3f}…{self.model.upper[i]:.3f} rad, less "
                f"{LIMIT_MARGIN:g} rad: start farther inside or give other poses"
            )

    def send(self, q: Array, goal: Array, limit: Array, speed: Array) -> Motion:
        """Run one tick: send, record, and return the next positions."""
        goal = np.where(self.count > 0.0, np.round(goal / self._grid) * self._grid, goal)
        record = self.records[-1]
        for rows, value in (
            (record.q, q),
            (record.goal, goal),
            (record.limit, limit),
            (record.speed, speed),
        ):
            rows.append(value)
        return (yield Command(goal, limit))

    def follow(self, q: Array, path: Array, speed: Array) -> Motion:
        """Follow positions (N, n) [rad] with planned speeds (N, n) [rad/s]."""
        for planned, rate in zip(path, speed, strict=True):
            lag = np.abs(planned - q)
            joint = int(np.argmax(lag - self.tracking_tolerance))
            if lag[joint] > self.tracking_tolerance[joint] + BLOCKED_LAG:
                yield from self.hold(q)
                raise ServoError(
                    f"joint {self.model.joint_names[joint]} stays {lag[joint]:.2f} rad behind: "
                    "something holds it, or its servo is much weaker than its table"
                )
            q = yield from self.send(
                q, planned + self.gravity_lead(planned), self.limits(planned), rate
            )
        return q

    def hold(self, q: Array) -> Motion:
        """Hold the present positions."""
        return (yield from self.send(q, q + self.gravity_lead(q), self.limits(q), np.zeros(self.n)))

    @property
    def tracking_tolerance(self) -> Array:
        """Lag that friction and gravity errors may cause (n,) [rad]."""
        return (8.0 * self.friction + 0.5 * self.torque) / self.kp

    def travel(self, q: Array, start: Array, end: Array) -> Motion:
        """Move from a planned pose to another one and come to rest."""
        seconds = max(0.5 * np.pi * np.abs(end - start).max() / TRAVEL_SPEED, self.period)
        count = max(int(np.ceil(seconds / self.period)), 1)
        phase = np.arange(1, count + 1) / count
        share = 0.5 - 0.5 * np.cos(np.pi * phase)
        path = start + share[:, None] * (end - start)
        rest = np.repeat(end[None], round(0.4 / self.period), axis=0)
        path = np.concatenate([path, rest])
        return (yield from self.follow(q, path, np.zeros_like(path)))

    def sweep(self, q: Array, pose: Array, size: Array, seconds: float, turns: float) -> Motion:
        """Swing all joints about a pose by ±size (n,) [rad], at constant speed between turns."""
        time = np.arange(1, round(turns * seconds / self.period) + 1) * self.period
        wave, slope = triangle(time / seconds)
        path = pose + wave[:, None] * size
        return (yield from self.follow(q, path, slope[:, None] * size / seconds))

    def push(
        self, q: Array, pose: Array, joint: int, size: float, timing: tuple[float, float]
    ) -> Motion:
        """Swing one joint by the torque of its limit alone; the others hold the pose.

        The goal stays far ahead, so that the servo torque equals its limit. The limit is gravity,
        friction and damping by the table, plus a soft spring toward the plan that corrects errors.
        The pace is a period [s] and a number of swings.
        """
        seconds, turns = timing
        time = np.arange(1, round(turns * seconds / self.period) + 1) * self.period
        wave, slope = triangle(time / seconds)
        spring = SPRING * self.kp[joint]
        viscous = self.damping[joint] + self.back_emf[joint]
        max_torque = self.limits(pose)[joint]
        overshoot = min(OVERSHOOT[0] + 2.0 * self.friction[joint] / spring, OVERSHOOT[1])
        for w, rate in zip(wave, slope * size / seconds, strict=True):
            planned = pose[joint] + w * size
            if abs(pose[joint] - q[joint]) > size + overshoot:
                # Load or friction differ from the result of the swings: stop, without data.
                self.records.pop()
                self.undriven.append(joint)
                self.start_record()
                return (yield from self.hold(q))
            torque = float(self.model.gravity(q)[joint] + self.extra_torque[joint])
            torque += np.tanh(rate / 0.02) * FRICTION_SHARE * self.friction[joint] + viscous * rate
            torque += spring * (planned - q[joint])
            torque = min(max(torque, -max_torque), max_torque)
            goal, limit = pose + self.gravity_lead(pose), self.limits(pose)
            goal[joint] = q[joint] + np.sign(torque) * (
                4.0 * abs(torque) / self.kp[joint] + MIN_LEAD
            )
            limit[joint] = abs(torque)
            speed = np.zeros(self.n)
            speed[joint] = rate
            q = yield from self.send(q, goal, limit, speed)
        return q

    def steps(self, q: Array, pose: Array, joint: int, size: float, count: int) -> Motion:
        """Step the goal of one joint to and fro, `count` times, with time to settle."""
        rest = round(STEP_TIME / self.period)
        for k in range(count):
            target = pose.copy()
            target[joint] += (0.5 - (k + 1) % 2) * 2.0 * size if k < count - 1 else 0.0
            for _ in range(rest):
                q = yield from self.send(
                    q, target + self.gravity_lead(pose), self.limits(pose), np.zeros(self.n)
                )
        return q


def triangle(phase: ArrayLike) -> tuple[Array, Array]:
    """Return a triangle wave of period 1 with rounded corners, rising from 0, and its slope.

    The speed is constant except within `CORNER` of the period around each reversal.
    """
    phase = np.asarray(phase, dtype=np.float64)
    grid = np.linspace(0.0, 1.0, 2001)
    distance = np.abs((grid - 0.25 + 0.25) % 0.5 - 0.25)  # to the next turn, in periods
    speed = np.clip(distance / (0.5 * CORNER), 0.0, 1.0)
    sign = np.where((grid > 0.25) & (grid < 0.75), -1.0, 1.0)
    slope = sign * speed
    wave = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(grid))])
    top = wave.max()
    if top <= 0.0:
        raise ConfigError("a triangle needs a phase")
    cycle = phase % 1.0
    return np.interp(cycle, grid, wave / top), np.interp(cycle, grid, slope / top)
