"""Hands that push, drag and turn the arm with a bounded force.

A hand is a force law: it maps the true state and the time to a force [N] and a torque [N·m] in base
axes at one point of the arm. It is stateless, so that it can be reused, compared and printed; the
plant records its forces.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from pliant._core import ConfigError
from pliant.sim.ground_truth import TOOL, WRIST

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant._typing import Array
    from pliant.sim.ground_truth import GroundTruth

    Wrench = tuple[Array, Array, Array]

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_TURNS = {"roll": _AXES["x"], "pitch": _AXES["y"], "yaw": _AXES["z"]}
_ZERO = np.zeros(3)


class Hand(Protocol):
    """Protocol of a force law that acts on one frame of the arm."""

    @property
    def at(self) -> str:
        """Name of the frame on which it acts: a link, `tool` or `wrist`."""

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return force (3,) [N], torque (3,) [N·m] and point of application (3,) [m], base axes."""


@dataclass
class AppliedForce:
    """Record of one hand: means of the last period, peaks of all physics steps since reset.

    Attributes:
        hand: The hand.
        force: Mean force (3,) [N].
        torque: Mean torque (3,) [N·m].
        peak_force: Largest norm of the force [N].
        peak_torque: Largest norm of the torque [N·m].
    """

    hand: Hand
    force: Array = field(default_factory=lambda: np.zeros(3))
    torque: Array = field(default_factory=lambda: np.zeros(3))
    peak_force: float = 0.0
    peak_torque: float = 0.0

    def begin(self) -> None:
        """Start a period."""
        self.force, self.torque = np.zeros(3), np.zeros(3)

    def add(self, force: Array, torque: Array) -> None:
        """Add one physics step."""
        self.force += force
        self.torque += torque
        self.peak_force = max(self.peak_force, float(np.sqrt(force @ force)))
        self.peak_torque = max(self.peak_torque, float(np.sqrt(torque @ torque)))

    def end(self, steps: int) -> None:
        """Turn the sums of a period into means."""
        self.force /= max(steps, 1)
        self.torque /= max(steps, 1)


@dataclass(frozen=True, kw_only=True)
class ForceProfile:
    """Time course of a hand: a ramp from 0 to 1, then constant, then released.

    Times are on the clock of the plant, like `Tick.began`. An arm of `connect` spends the first
    half second ramping up torque, before a `Loop` begins and `Tick.time` is 0.

    Attributes:
        start: Beginning [s].
        rise: Length of the ramp [s].
        end: Release [s].
    """

    start: float = 2.0
    rise: float = 1.5
    end: float = 5.0

    def __post_init__(self) -> None:
        """Check the order."""
        if not (self.rise >= 0.0 and self.end >= self.start):
            raise ConfigError(f"a hand needs rise >= 0 and end >= start, got {self!r}")

    def active(self, t: float) -> bool:
        """Return True while the hand holds on, at time t [s]."""
        return self.start <= t < self.end

    def share(self, t: float) -> float:
        """Return the ramp value at time t [s], 0 to 1."""
        if self.rise <= 0.0:
            return 1.0 if t >= self.start else 0.0
        return min(max((t - self.start) / self.rise, 0.0), 1.0)


@dataclass(frozen=True, kw_only=True)
class Drag:
    """A hand that drags a point along one axis with a bounded force; all other axes are free.

    ``f = clip(stiffness (distance share(t) + offset - shift) - damping v, ±limit)`` along the axis.

    Attributes:
        axis: `x`, `y`, `z` or a direction (3,) in base axes.
        distance: Commanded displacement [m].
        stiffness: Stiffness of the grip [N/m].
        damping: Damping of the grip [N·s/m].
        limit: Largest force of the grip [N].
        at: Frame on which it acts.
        course: Time course.
        offset: Displacement of the frame from its start at which the hand takes hold of it [m].
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
        """Check the numbers once."""
        _direction(self.axis, _AXES)
        _not_negative(stiffness=self.stiffness, damping=self.damping, limit=self.limit)

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return the wrench: a force at the frame's origin."""
        frame = ground_truth.frame(self.at)
        if not self.course.active(t):
            return _ZERO, _ZERO, frame.position
        axis = _direction(self.axis, _AXES)
        place = self.distance * self.course.share(t) + self.offset
        spring = self.stiffness * (place - float(axis @ frame.shift()))
        size = spring - self.damping * float(axis @ frame.twist()[:3])
        return min(max(size, -self.limit), self.limit) * axis, _ZERO, frame.position


@dataclass(frozen=True, kw_only=True)
class Twist:
    """A hand that turns a frame about one base axis with a bounded torque.

    ``t = clip(stiffness (angle share(t) - turn) - damping w, ±limit)``; the turn is the component
    of the rotation vector from the start.

    Attributes:
        axis: `roll`, `pitch`, `yaw` or a direction (3,).
        angle: Commanded rotation [rad].
        stiffness: Stiffness of the grip [N·m/rad].
        damping: Damping of the grip [N·m·s/rad].
        limit: Largest torque of the grip [N·m].
        at: Frame on which it acts.
        course: Time course.
    """

    axis: str | Sequence[float] = "yaw"
    angle: float = 0.8
    stiffness: float = 30.0
    damping: float = 0.5
    limit: float = 3.0
    at: str = TOOL
    course: ForceProfile = field(default_factory=ForceProfile)

    def __post_init__(self) -> None:
        """Check the numbers once."""
        _direction(self.axis, _TURNS)
        _not_negative(stiffness=self.stiffness, damping=self.damping, limit=self.limit)

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return the wrench: a torque on the frame's body."""
        frame = ground_truth.frame(self.at)
        if not self.course.active(t):
            return _ZERO, _ZERO, frame.position
        axis = _direction(self.axis, _TURNS)
        spring = self.stiffness * (self.angle * self.course.share(t) - float(axis @ frame.turn()))
        size = spring - self.damping * float(axis @ frame.twist()[3:])
        return _ZERO, min(max(size, -self.limit), self.limit) * axis, frame.position


@dataclass(frozen=True, kw_only=True)
class Push:
    """A push that does not depend on the arm's position: a ramp, then constant, then released.

    Attributes:
        force_vector: Force (3,) in base axes [N].
        torque_vector: Torque (3,) in base axes [N·m].
        at: Frame on which it acts.
        course: Time course; a short one is a tap.
    """

    force_vector: Sequence[float] = (0.0, 0.0, 0.0)
    torque_vector: Sequence[float] = (0.0, 0.0, 0.0)
    at: str = TOOL
    course: ForceProfile = field(default_factory=lambda: ForceProfile(start=2.0, rise=1.0, end=5.0))

    def __post_init__(self) -> None:
        """Check the shapes once."""
        if np.shape(self.force_vector) != (3,) or np.shape(self.torque_vector) != (3,):
            raise ConfigError("Push.force_vector and torque_vector have three entries each")

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return the wrench at the frame's origin."""
        frame = ground_truth.frame(self.at)
        if not self.course.active(t):
            return _ZERO, _ZERO, frame.position
        share = self.course.share(t)
        return (
            share * np.asarray(self.force_vector),
            share * np.asarray(self.torque_vector),
            frame.position,
        )


@dataclass(frozen=True, kw_only=True)
class SpringConstraint:
    """Springs that hold some axes of a frame, for pushes along one axis only.

    Attributes:
        axes: Names of the held axes: any of x y z roll pitch yaw.
        stiffness: Translational stiffness [N/m].
        rotational: Rotational stiffness [N·m/rad].
        damping: Translational [N·s/m] and rotational [N·m·s/rad].
        at: Frame that is held.
        course: Time course; by default always.
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
        """Check the axis names once."""
        unknown = set(self.axes.split()) - set(_AXES) - set(_TURNS)
        if unknown:
            raise ConfigError(
                "SpringConstraint.axes knows x y z roll pitch yaw, "
                f"not {', '.join(sorted(unknown))}"
            )
        _not_negative(stiffness=self.stiffness, rotational=self.rotational)

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return the wrench of the springs."""
        frame = ground_truth.frame(self.at)
        if not self.course.active(t):
            return _ZERO, _ZERO, frame.position
        names = self.axes.split()
        pull = np.array([name in names for name in _AXES], dtype=np.float64)
        turn = np.array([name in names for name in _TURNS], dtype=np.float64)
        twist = frame.twist()
        force = -self.stiffness * frame.shift() - self.damping[0] * twist[:3]
        torque = -self.rotational * frame.turn() - self.damping[1] * twist[3:]
        return pull * force, turn * torque, frame.position


def tap(force: Sequence[float], *, at: str = TOOL, start: float = 1.0) -> Push:
    """Return a tap of 0.12 s: up within 20 ms, held 0.1 s; force (3,) [N]."""
    return Push(
        force_vector=force, at=at, course=ForceProfile(start=start, rise=0.02, end=start + 0.12)
    )


def _direction(axis: str | Sequence[float], names: dict[str, tuple[float, float, float]]) -> Array:
    """Return the unit vector (3,) of an axis given by name or by numbers."""
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


def _not_negative(**values: float) -> None:
    """Raise unless every value is at least zero."""
    for name, value in values.items():
        if not value >= 0.0:
            raise ConfigError(f"{name} must be at least 0, got {value!r}")


#: The hands of the experiments: 15 N at the wrist centre, a strong one and a robust one at the
#: tool, and one that turns the tool.
LIGHT = Drag()
STRONG = Drag(distance=0.15, stiffness=3000.0, limit=80.0, at=TOOL)
ROBUST = Drag(distance=0.20, stiffness=2000.0, limit=30.0, at=TOOL)
YAW = Twist()
