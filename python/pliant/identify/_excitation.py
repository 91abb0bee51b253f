"""Slow joint motions for identification, with bounded torque; each control cycle is recorded."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import Command, OutOfRangeError, ServoError
from pliant._validation import number

if TYPE_CHECKING:
    from collections.abc import Generator

    from numpy.typing import ArrayLike

    from pliant._core import Model, Servos
    from pliant._typing import Array

    Motion = Generator[Command, Array, Array]

#: Largest speeds of a joint [rad/s] and of the tool [m/s] on the way between two poses.
TRAVEL_SPEED, TRAVEL_TOOL_SPEED = 0.4, 0.1
#: Number of sections of a way, along which the way of the tool is measured.
TRAVEL_SECTIONS = 16
#: Duration of each reversal of an oscillation, as a share of its period [1].
REVERSAL_SHARE = 0.2
#: A joint counts as blocked if it lags behind its planned position by `tracking_tolerance` plus
#: this angle [rad].
BLOCKED_LAG = 0.2
#: The torque limit that drives a joint includes a spring toward the planned position: stiffness
#: of this spring, as a share of the servo's stiffness k_p [1].
SPRING_SHARE = 0.15
#: Share of the assumed friction that is fed forward while a joint is driven by its torque limit.
FRICTION_SHARE = 0.8
#: Bounds of the overshoot, beyond the planned amplitude, at which a joint driven by its torque
#: limit is stopped [rad]. Between them, the allowed overshoot grows with the joint's friction.
OVERSHOOT_RANGE = (0.06, 0.25)
#: Minimum lead (goal minus position) of a joint driven by its torque limit [rad].
MIN_LEAD = 0.05
#: Time between two step changes of a joint's goal [s].
STEP_TIME = 0.5
#: Minimum distance of all motions from the position limits [rad].
LIMIT_MARGIN = 0.02


@dataclass
class Record:
    """Positions and commands in the N ticks (control cycles) of one motion.

    The goal of row k was sent after the positions of row k had been read.

    Attributes:
        q: Measured positions (N, n) [rad].
        goal: Goals sent, rounded to encoder counts (N, n) [rad].
        limit: Torque limits sent (N, n) [N·m].
        speed: Planned speeds (N, n) [rad/s].
        driven: Index of the joint that is driven by its torque limit; -1: all joints follow goals.
    """

    q: list[Array] = field(default_factory=list)
    goal: list[Array] = field(default_factory=list)
    limit: list[Array] = field(default_factory=list)
    speed: list[Array] = field(default_factory=list)
    driven: int = -1

    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """Return positions, goals, limits and speeds as arrays, (N, n) each."""
        return np.array(self.q), np.array(self.goal), np.array(self.limit), np.array(self.speed)


class Excitation:
    """Slow joint motions for identification, as generators of commands; each motion is recorded.

    Args:
        model: The arm.
        servos: Assumed servo parameters.
        period: Control period [s].
        torque_share: Torque allowed in addition to gravity, as a share of the maximum torque [1].
        stiffness_uncertainty: Factor by which the true stiffness may be smaller than assumed.
        opposing: True: oscillating joints start in such directions that the tool moves little;
            False: all in the same direction, so that their loads vary more.

    Attributes:
        extra_torque: Torques that hold the arm in addition to gravity, against a payload that the
            model lacks and a force at the tool (n,) [N·m].
        records: Records of all motions.
        undriven: Indices of joints that could not be driven by their torque limit, see
            `drive_by_limit`.
    """

    def __init__(
        self,
        model: Model,
        servos: Servos,
        period: float,
        *,
        torque_share: float = 0.6,
        stiffness_uncertainty: float = 1.3,
        opposing: bool = False,
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
        self._torque_share, self.stiffness_uncertainty = torque_share, stiffness_uncertainty
        self._opposing = opposing
        self._count_or_one = np.where(self.count > 0.0, self.count, 1.0)
        self.extra_torque: Array = np.zeros(n)
        self.records: list[Record] = []
        self.undriven: list[int] = []
        #: Last planned positions (n,) [rad]; None before the first motion.
        self._planned: Array | None = None

    def start_record(self, driven: int = -1) -> Record:
        """Start and return a new record; `driven` is the joint driven by its torque limit."""
        self.records.append(Record(driven=driven))
        return self.records[-1]

    def gravity_lead(self, q: ArrayLike) -> Array:
        """Return the leads (goal minus position) that hold the arm against gravity (n,) [rad].

        The leads are those at positions q (n,) [rad] for the assumed servo stiffness.
        """
        return (np.asarray(self.model.gravity(q)) + self.extra_torque) / self.kp

    def limits(self, q: ArrayLike) -> Array:
        """Return the torque limits at positions q (n,) [N·m], at most the maximum torque.

        They are 1.3 times the torque that holds the arm, of gravity and `extra_torque`, plus
        `torque_share` times the maximum torque.
        """
        needed = (
            1.3 * np.abs(self.model.gravity(q) + self.extra_torque)
            + self._torque_share * self.torque
        )
        return np.minimum(self.torque, needed)

    def fit_within_limits(self, q: Array, size: Array) -> Array:
        """Return the pose nearest to q at which motions by ±size stay within the position limits.

        Raises:
            OutOfRangeError: The motion of a joint is wider than the range between its limits.
        """
        margin = LIMIT_MARGIN + size
        low, high = self.model.lower + margin, self.model.upper - margin
        if (low > high).any():
            middle = 0.5 * (np.asarray(self.model.lower) + self.model.upper)
            self.check_range(middle - size, middle + size)
        return np.clip(q, low, high)

    def check_range(self, low: ArrayLike, high: ArrayLike) -> None:
        """Check that motions from `low` to `high` (n,) [rad] stay within the position limits.

        Raises:
            OutOfRangeError: The motion of a joint comes closer to a limit than `LIMIT_MARGIN`.
        """
        low, high = np.asarray(low), np.asarray(high)
        is_outside = (low < self.model.lower + LIMIT_MARGIN) | (
            high > self.model.upper - LIMIT_MARGIN
        )
        for i in np.flatnonzero(is_outside):
            raise OutOfRangeError(
                f"joint {self.model.joint_names[i]} would move in {low[i]:.3f}…{high[i]:.3f} rad; "
                f"its limits are {self.model.lower[i]:.3f}…{self.model.upper[i]:.3f} rad, less "
                f"{LIMIT_MARGIN:g} rad: start farther inside or give other poses"
            )

    def send(self, q: Array, goal: Array, limit: Array, speed: Array) -> Motion:
        """Record and send one command; return the positions read in the next tick (n,) [rad].

        Args:
            q: Positions read in this tick (n,) [rad].
            goal: Goals (n,) [rad]; they are rounded to encoder counts.
            limit: Torque limits (n,) [N·m].
            speed: Planned speeds (n,) [rad/s], which are only recorded.
        """
        goal = np.where(
            self.count > 0.0, np.round(goal / self._count_or_one) * self._count_or_one, goal
        )
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
        """Move through planned positions, one per tick; return the last positions read (n,) [rad].

        Args:
            q: Present measured positions (n,) [rad].
            path: Planned positions (N, n) [rad].
            speed: Planned speeds (N, n) [rad/s], which are only recorded.

        Raises:
            ServoError: A joint lags behind by more than `tracking_tolerance` plus `BLOCKED_LAG`.
        """
        for planned, rate in zip(path, speed, strict=True):
            lag = np.abs(planned - q)
            joint = int(np.argmax(lag - self.tracking_tolerance))
            if lag[joint] > self.tracking_tolerance[joint] + BLOCKED_LAG:
                yield from self.hold(q)
                raise ServoError(
                    f"joint {self.model.joint_names[joint]} stays {lag[joint]:.2f} rad behind: "
                    "something holds it, or its servo is much weaker than its table"
                )
            self._planned = planned
            q = yield from self.send(
                q, planned + self.gravity_lead(planned), self.limits(planned), rate
            )
        return q

    def hold(self, q: Array) -> Motion:
        """Hold the measured positions q (n,) [rad] for one tick; return the next positions."""
        self._planned = q
        return (yield from self.send(q, q + self.gravity_lead(q), self.limits(q), np.zeros(self.n)))

    @property
    def tracking_tolerance(self) -> Array:
        """Largest lag of a joint that friction and a wrong gravity model may cause (n,) [rad]."""
        return (8.0 * self.friction + 0.5 * self.torque) / self.kp

    def travel(self, q: Array, end: Array) -> Motion:
        """Move to pose `end` (n,) [rad] and rest there for 0.4 s.

        The motion starts at the last planned positions; the first one starts at the measured
        positions q (n,) [rad]. Return the last positions read.
        """
        start = q if self._planned is None else self._planned
        shares = np.linspace(0.0, 1.0, TRAVEL_SECTIONS + 1)
        tool = [self.model.forward_kinematics(start + s * (end - start))[:3, 3] for s in shares]
        # The cosine below is π/2 times as fast in the middle as on average.
        sections = np.linalg.norm(np.diff(tool, axis=0), axis=1)
        by_tool = TRAVEL_SECTIONS * sections.max() / TRAVEL_TOOL_SPEED
        by_joint = np.abs(end - start).max() / TRAVEL_SPEED
        seconds = max(0.5 * np.pi * max(by_joint, by_tool), self.period)
        count = max(int(np.ceil(seconds / self.period)), 1)
        phase = np.arange(1, count + 1) / count
        share = 0.5 - 0.5 * np.cos(np.pi * phase)
        path = start + share[:, None] * (end - start)
        rest = np.repeat(end[None], round(0.4 / self.period), axis=0)
        path = np.concatenate([path, rest])
        return (yield from self.follow(q, path, np.zeros_like(path)))

    def sweep(self, q: Array, pose: Array, size: Array, seconds: float, swings: float) -> Motion:
        """Oscillate all joints about a pose by ±size (n,) [rad]; return the last positions read.

        The speed is constant between reversals. One oscillation takes `seconds`; their number
        `swings` may be fractional. The motion starts at the pose, where the joints must be.
        """
        time = np.arange(1, round(swings * seconds / self.period) + 1) * self.period
        wave, slope = triangle(time / seconds)
        if self._opposing:
            size = size * opposing_signs(np.asarray(self.model.jacobian(pose))[:3] * size)
        path = pose + wave[:, None] * size
        return (yield from self.follow(q, path, slope[:, None] * size / seconds))

    def drive_by_limit(
        self, q: Array, pose: Array, joint: int, size: float, timing: tuple[float, float]
    ) -> Motion:
        """Oscillate one joint by setting its torque limit; the other joints hold the pose.

        The goal is so far from the position that the servo's torque equals its limit. The limit is
        the modelled torque of gravity, friction and damping, plus a soft spring toward the planned
        position. `size` is the amplitude [rad]; `timing` is the period [s] and the number of
        oscillations. A joint that overshoots is stopped and added to `undriven`. Return the last
        positions read (n,) [rad].
        """
        seconds, swings = timing
        time = np.arange(1, round(swings * seconds / self.period) + 1) * self.period
        wave, slope = triangle(time / seconds)
        spring = SPRING_SHARE * self.kp[joint]
        viscous = self.damping[joint] + self.back_emf[joint]
        max_torque = self.limits(pose)[joint]
        overshoot = min(
            OVERSHOOT_RANGE[0] + 2.0 * self.friction[joint] / spring, OVERSHOOT_RANGE[1]
        )
        for w, rate in zip(wave, slope * size / seconds, strict=True):
            planned = pose[joint] + w * size
            if abs(pose[joint] - q[joint]) > size + overshoot:
                # The assumed load or friction is wrong: stop the joint and drop the record.
                self.records.pop()
                self.undriven.append(joint)
                self.start_record()
                return (yield from self.hold(q))
            self._planned = np.where(np.arange(self.n) == joint, q, pose)
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
        """Change the goal of one joint in `count` steps between ±size [rad], every `STEP_TIME`.

        The last step leads back to the pose. Return the last positions read (n,) [rad].
        """
        rest = round(STEP_TIME / self.period)
        for k in range(count):
            target = pose.copy()
            target[joint] += (0.5 - (k + 1) % 2) * 2.0 * size if k < count - 1 else 0.0
            for _ in range(rest):
                q = yield from self.send(
                    q, target + self.gravity_lead(pose), self.limits(pose), np.zeros(self.n)
                )
        return q


def opposing_signs(columns: Array) -> Array:
    """Return signs ±1 (n,) with which the sum of the columns (m, n) is small.

    From the longest column to the shortest, each sign shortens the sum.
    """
    total, signs = np.zeros(len(columns)), np.ones(columns.shape[1])
    for i in np.argsort(-np.linalg.norm(columns, axis=0)):
        signs[i] = -1.0 if total @ columns[:, i] > 0.0 else 1.0
        total += signs[i] * columns[:, i]
    return signs


def triangle(phase: ArrayLike) -> tuple[Array, Array]:
    """Return a triangle wave of period 1 and amplitude 1 with rounded corners, and its slope.

    The wave rises from 0 at phase 0. Its slope is constant except around the reversals, each of
    which takes `REVERSAL_SHARE` of the period.
    """
    phase = np.asarray(phase, dtype=np.float64)
    grid = np.linspace(0.0, 1.0, 2001)
    distance = np.abs(grid % 0.5 - 0.25)  # to the nearest reversal, in periods
    speed = np.clip(distance / (0.5 * REVERSAL_SHARE), 0.0, 1.0)
    sign = np.where((grid > 0.25) & (grid < 0.75), -1.0, 1.0)
    slope = sign * speed
    wave = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(grid))])
    peak = wave.max()
    cycle = phase % 1.0
    return np.interp(cycle, grid, wave / peak), np.interp(cycle, grid, slope / peak)
