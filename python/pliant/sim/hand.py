"""Simulated hands that push, drag and turn the arm with a bounded force.

A hand is a force law: it maps the true state and the time to a force [N] and a torque [N·m] in base
axes at one point of the arm. A hand has no state; the plant records the force of each hand in an
`AppliedForce`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np

from pliant._core import ConfigError
from pliant.sim.ground_truth import TOOL, WRIST, ZERO

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant._typing import Array
    from pliant.sim.ground_truth import GroundTruth

    Wrench = tuple[Array, Array, Array]

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_TURNS = {"roll": _AXES["x"], "pitch": _AXES["y"], "yaw": _AXES["z"]}


class Hand(Protocol):
    """Interface of a force law that acts on one frame of the arm."""

    @property
    def at(self) -> str:
        """Name of the frame on which the force acts: a link, `tool` or `wrist`."""

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return force (3,) [N], torque (3,) [N·m] and point of application (3,) [m], base axes."""


@dataclass
class AppliedForce:
    """Record of the force of one hand.

    Attributes:
        hand: The hand.
        force: Mean force over the last control period (3,) [N].
        torque: Mean torque over the last control period (3,) [N·m].
        peak_force: Largest norm of the force in any physics step since reset [N].
        peak_torque: Largest norm of the torque in any physics step since reset [N·m].
    """

    hand: Hand
    force: Array = field(default_factory=lambda: np.zeros(3))
    torque: Array = field(default_factory=lambda: np.zeros(3))
    peak_force: float = 0.0
    peak_torque: float = 0.0

    def begin(self) -> None:
        """Start a control period: set the sums of force and torque to zero."""
        self.force, self.torque = np.zeros(3), np.zeros(3)

    def add(self, force: Array, torque: Array) -> None:
        """Add force (3,) [N] and torque (3,) [N·m] of one physics step, and update the peaks."""
        if force is not ZERO:
            self.force += force
            self.peak_force = max(self.peak_force, math.sqrt(_dot(force, force)))
        if torque is not ZERO:
            self.torque += torque
            self.peak_torque = max(self.peak_torque, math.sqrt(_dot(torque, torque)))

    def end(self, steps: int) -> None:
        """End a control period of `steps` physics steps: divide the sums, which gives the means."""
        self.force /= max(steps, 1)
        self.torque /= max(steps, 1)


@dataclass(frozen=True, kw_only=True)
class ForceProfile:
    """Time course of a hand: a ramp from 0 to 1, then constant until the hand lets go.

    Times are on the clock of the plant, like `Tick.began`. `Tick.time` differs: it is 0 when the
    `Loop` starts, and `Arm.enable` before it takes 0.7 to 7 s of simulated time.

    Attributes:
        start: Start time [s].
        rise: Length of the ramp [s].
        end: Time at which the hand lets go [s].
    """

    start: float = 2.0
    rise: float = 1.5
    end: float = 5.0

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless `end` is at least `start` and `rise` at least 0."""
        if not (self.rise >= 0.0 and self.end >= self.start):
            raise ConfigError(f"a hand needs rise >= 0 and end >= start, got {self!r}")

    def active(self, t: float) -> bool:
        """Return True if the hand acts at time t [s]: from `start` on, until `end`."""
        return self.start <= t < self.end

    def share(self, t: float) -> float:
        """Return the value of the ramp at time t [s], from 0 to 1."""
        if self.rise <= 0.0:
            return 1.0 if t >= self.start else 0.0
        return min(max((t - self.start) / self.rise, 0.0), 1.0)


@dataclass(frozen=True, kw_only=True)
class Drag:
    """Hand that drags a frame along one axis with a bounded force; it leaves other axes free.

    The force along the axis is
    ``clip(stiffness (distance share(t) + offset - shift) - damping v, ±limit)`` [N]: share(t) is
    the ramp of `course`, shift the displacement of the frame since reset, v its velocity.

    Attributes:
        axis: `x`, `y`, `z` or a direction (3,) in base axes.
        distance: Commanded displacement [m].
        stiffness: Stiffness of the grip [N/m].
        damping: Damping of the grip [N·s/m].
        limit: Largest force of the grip [N].
        at: Frame on which the hand acts.
        course: Time course of the commanded displacement.
        offset: Commanded displacement at the start of the ramp [m].
    """

    axis: str | Sequence[float] = "y"
    distance: float = 0.25
    stiffness: float = 800.0
    damping: float = 30.0
    limit: float = 15.0
    at: str = WRIST
    course: ForceProfile = field(default_factory=ForceProfile)
    offset: float = 0.0

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        _direction(self.axis, _AXES)
        _not_negative(stiffness=self.stiffness, damping=self.damping, limit=self.limit)

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return the hand's force [N], a zero torque, and the frame's origin at time t [s]."""
        frame = ground_truth.frame(self.at)
        if not self.course.active(t):
            return ZERO, ZERO, frame.position
        axis = self._unit
        goal = self.distance * self.course.share(t) + self.offset
        spring = self.stiffness * (goal - _dot(axis, frame.shift()))
        force = spring - self.damping * _dot(axis, frame.velocities()[0])
        return min(max(force, -self.limit), self.limit) * axis, ZERO, frame.position

    @cached_property
    def _unit(self) -> Array:
        return _direction(self.axis, _AXES)


@dataclass(frozen=True, kw_only=True)
class Twist:
    """Hand that turns a frame about one base axis with a bounded torque.

    The torque about the axis is ``clip(stiffness (angle share(t) - turn) - damping w, ±limit)``
    [N·m]: share(t) is the ramp of `course`, turn the component along the axis of the frame's
    rotation vector since reset [rad], w the angular velocity about the axis [rad/s].

    Attributes:
        axis: `roll`, `pitch`, `yaw` or a direction (3,) in base axes.
        angle: Commanded rotation [rad].
        stiffness: Stiffness of the grip [N·m/rad].
        damping: Damping of the grip [N·m·s/rad].
        limit: Largest torque of the grip [N·m].
        at: Frame on which the hand acts.
        course: Time course of the commanded rotation.
    """

    axis: str | Sequence[float] = "yaw"
    angle: float = 0.8
    stiffness: float = 30.0
    damping: float = 0.5
    limit: float = 3.0
    at: str = TOOL
    course: ForceProfile = field(default_factory=ForceProfile)

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        _direction(self.axis, _TURNS)
        _not_negative(stiffness=self.stiffness, damping=self.damping, limit=self.limit)

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return a zero force, the hand's torque [N·m], and the frame's origin at time t [s]."""
        frame = ground_truth.frame(self.at)
        if not self.course.active(t):
            return ZERO, ZERO, frame.position
        axis = self._unit
        spring = self.stiffness * (self.angle * self.course.share(t) - _dot(axis, frame.turn()))
        torque = spring - self.damping * _dot(axis, frame.velocities()[1])
        return ZERO, min(max(torque, -self.limit), self.limit) * axis, frame.position

    @cached_property
    def _unit(self) -> Array:
        return _direction(self.axis, _TURNS)


@dataclass(frozen=True, kw_only=True)
class Push:
    """Push with a prescribed force and torque, independent of the arm's position.

    Attributes:
        force_vector: Force (3,) in base axes [N].
        torque_vector: Torque (3,) in base axes [N·m].
        at: Frame on which the push acts.
        course: Time course of the share of force and torque that acts.
    """

    force_vector: Sequence[float] = (0.0, 0.0, 0.0)
    torque_vector: Sequence[float] = (0.0, 0.0, 0.0)
    at: str = TOOL
    course: ForceProfile = field(default_factory=lambda: ForceProfile(start=2.0, rise=1.0, end=5.0))

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        if np.shape(self.force_vector) != (3,) or np.shape(self.torque_vector) != (3,):
            raise ConfigError("Push.force_vector and torque_vector have three entries each")

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return force [N] and torque [N·m] of the push, and the frame's origin, at time t [s]."""
        frame = ground_truth.frame(self.at)
        if not self.course.active(t):
            return ZERO, ZERO, frame.position
        share, (force, torque) = self.course.share(t), self._wrench
        return share * force, share * torque if torque.any() else ZERO, frame.position

    @cached_property
    def _wrench(self) -> tuple[Array, Array]:
        return np.asarray(self.force_vector), np.asarray(self.torque_vector)


@dataclass(frozen=True, kw_only=True)
class SpringConstraint:
    """Springs that hold some axes of a frame at its start pose and leave the others free.

    Attributes:
        axes: Names of the held axes: any of x y z roll pitch yaw.
        stiffness: Translational stiffness [N/m].
        rotational: Rotational stiffness [N·m/rad].
        damping: Translational damping [N·s/m], and rotational damping [N·m·s/rad].
        at: Name of the frame that is held.
        course: Time in which the springs act; by default always.
    """

    axes: str = "x z roll pitch yaw"
    stiffness: float = 3000.0
    rotational: float = 60.0
    damping: tuple[float, float] = (30.0, 0.5)
    at: str = TOOL
    course: ForceProfile = field(
        default_factory=lambda: ForceProfile(start=0.0, rise=0.0, end=np.inf)
    )

    def __post_init__(self) -> None:
        """Raise `ConfigError` for unknown axis names or negative stiffness."""
        unknown = set(self.axes.split()) - set(_AXES) - set(_TURNS)
        if unknown:
            raise ConfigError(
                "SpringConstraint.axes knows x y z roll pitch yaw, "
                f"not {', '.join(sorted(unknown))}"
            )
        _not_negative(stiffness=self.stiffness, rotational=self.rotational)

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return force [N] and torque [N·m] of the springs, and the frame's origin."""
        frame = ground_truth.frame(self.at)
        if not self.course.active(t):
            return ZERO, ZERO, frame.position
        (linear, angular), (v, w) = self._is_held, frame.velocities()
        force = -self.stiffness * frame.shift() - self.damping[0] * v
        torque = -self.rotational * frame.turn() - self.damping[1] * w
        return linear * force, angular * torque, frame.position

    @cached_property
    def _is_held(self) -> tuple[Array, Array]:
        names = self.axes.split()
        linear, angular = ([name in names for name in group] for group in (_AXES, _TURNS))
        return np.array(linear, dtype=np.float64), np.array(angular, dtype=np.float64)


def tap(force: Sequence[float], *, start: float = 1.0) -> Push:
    """Return a push of the tool for 0.12 s: to `force` (3,) [N] in 20 ms, then constant."""
    return Push(force_vector=force, course=ForceProfile(start=start, rise=0.02, end=start + 0.12))


def _direction(axis: str | Sequence[float], names: dict[str, tuple[float, float, float]]) -> Array:
    """Return the unit vector (3,) of an axis given as a key of `names` or as a direction (3,)."""
    if isinstance(axis, str):
        if axis not in names:
            raise ConfigError(
                f"axis {axis!r} is unknown; choose {', '.join(names)} or give a direction (3,)"
            )
        return np.asarray(names[axis])
    vector = np.asarray(axis, dtype=np.float64)
    if vector.shape != (3,) or not np.linalg.norm(vector) > 0.0:
        raise ConfigError(f"a direction has three entries, not all zero; got {axis!r}")
    return vector / np.linalg.norm(vector)


def _dot(left: Array, right: Array) -> float:
    """Return the dot product of two vectors (3,); for so few numbers, NumPy takes longer."""
    (a, b, c), (x, y, z) = left.tolist(), right.tolist()
    product: float = a * x + b * y + c * z
    return product


def _not_negative(**values: float) -> None:
    """Raise `ConfigError` unless every value is at least zero."""
    for name, value in values.items():
        if not value >= 0.0:
            raise ConfigError(f"{name} must be at least 0, got {value!r}")


#: Hands of the experiments, named by their force or torque limit: a drag along y at the wrist
#: centre, two drags along y at the tool, and a twist of the tool about yaw.
DRAG_15N = Drag()
DRAG_80N = Drag(distance=0.15, stiffness=3000.0, limit=80.0, at=TOOL)
DRAG_30N = Drag(distance=0.20, stiffness=2000.0, limit=30.0, at=TOOL)
TWIST_3NM = Twist()
