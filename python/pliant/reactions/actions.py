"""Actions of a reaction: hold, yield, follow, retract, stop, call.

An `Action` is an immutable description. Its method `begin` returns a `Running` action, which
changes the target pose or the settings of the controller while the reaction is in force.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant import functional
from pliant._core import Axis, ConfigError, Controller, Pose, Settings
from pliant._validation import format_value, positive, vector
from pliant.reactions.conditions import indices

if TYPE_CHECKING:
    from pliant._typing import Array
    from pliant.reactions.conditions import TickContext


def offset_pose(pose: Array, shift: Array, turn: Array) -> Array:
    """Return a pose (4, 4) moved by `shift` (3,) [m] and turned by `turn` (3,) [rad], base axes."""
    out = pose.copy()
    out[:3, 3] += shift
    out[:3, :3] = Pose.from_rotvec(np.zeros(3), turn).rotation @ pose[:3, :3]
    return out


def step_toward(pose: Array, target: Array, distance: float, angle: float) -> Array:
    """Return a pose (4, 4) moved toward a target, by at most `distance` [m] and `angle` [rad]."""
    error = functional.pose_error(pose, target)
    shift, turn = error[:3], error[3:]
    shares = [
        min(1.0, limit / size) if (size := float(np.linalg.norm(part))) > 0.0 else 1.0
        for part, limit in ((shift, distance), (turn, angle))
    ]
    if min(shares) >= 1.0:
        return target
    return offset_pose(pose, shares[0] * shift, shares[1] * turn)


class Running:
    """State of an action that is in force; this base class changes nothing."""

    def target(self, tick: TickContext, target: Array) -> Array:
        """Return the target pose (4, 4) for the controller's step, which replaces `target`."""
        return target

    def over(self, tick: TickContext) -> bool | None:
        """Return True if the action is complete, False if not, None if it has no end of its own."""
        return None

    def end(self, tick: TickContext) -> None:
        """Undo temporary changes of the controller's settings at the end of the reaction."""


class Action(ABC):
    """Base class of actions; an action begins when the condition of its reaction becomes true."""

    #: True if only `ReactionMonitor.resume()` ends the action in a reaction without `until`.
    is_latching = False
    #: True if the action is complete as soon as it has begun.
    is_one_shot = False

    @property
    def needs_force(self) -> bool:
        """True if the action needs an estimate of the contact force."""
        return False

    def validate(self, controller: Controller) -> None:  # noqa: B027 - optional for a subclass
        """Check that the action is possible with a controller.

        Raises:
            ConfigError, OutOfRangeError: The action is impossible; the message says what is valid.
        """

    @abstractmethod
    def begin(self, tick: TickContext) -> Running:
        """Begin the action; return the `Running` action, in force until the reaction ends."""


@dataclass
class _FixedTarget(Running):
    """Running action with a constant target pose (4, 4)."""

    pose: Array

    def target(self, tick: TickContext, target: Array) -> Array:
        return self.pose


@dataclass(frozen=True)
class Hold(Action):
    """Set the target to the present tool pose, so that the arm stops pushing and stays.

    `Reaction.until` says when it ends.
    """

    def begin(self, tick: TickContext) -> Running:
        """Return a running action whose target is the present tool pose."""
        return _FixedTarget(tick.tool.copy())


@dataclass(frozen=True)
class Stop(Hold):
    """Hold the present tool pose until `ReactionMonitor.resume()`."""

    is_latching = True


class _ChangedSettings(Running):
    """Running action that changes the controller's settings and restores them at its end."""

    def __init__(self, controller: Controller, settings: Settings) -> None:
        self._before, self._changed = controller.settings, settings
        controller.update(settings)

    def end(self, tick: TickContext) -> None:
        # Restore the settings only if the program has not changed them in the meantime.
        if tick.controller.settings == self._changed:
            tick.controller.update(self._before)


@dataclass(frozen=True, repr=False)
class Yield(Action):
    """Let task axes yield in both directions; the target stays unchanged.

    Args:
        axes: Names of the task axes, e.g. "x yaw".
        fields: Other fields of `pliant.Axis` for these axes while the action is in force, e.g.
            ``{"soft": 2.0, "adaptation": 0.9}``.
    """

    axes: str
    fields: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the arguments."""
        indices(self.axes)
        if not isinstance(self.fields, Mapping):
            raise ConfigError(
                'Yield.fields must be a dict of fields of Axis, as in {"soft": 2.0}, '
                f"got {format_value(self.fields)}"
            )
        Axis(**self.fields)

    def _settings(self, settings: Settings) -> Settings:
        names = settings.task.names
        axis_names = [names[index] for index in indices(self.axes, names)]
        axes: dict[str, Axis] = dict(settings.axes.items())
        for name in axis_names:
            axes[name] = settings.axes[name].replace(**{"yields": "both", **self.fields})
        return settings.replace(axes=axes)

    def validate(self, controller: Controller) -> None:
        """Check the changed settings by creating another controller of the arm with them."""
        settings = self._settings(controller.settings)
        Controller(controller.model, settings, controller.servos)

    def begin(self, tick: TickContext) -> Running:
        """Apply the changed settings to the controller; return the action that restores them."""
        return _ChangedSettings(tick.controller, self._settings(tick.controller.settings))

    def __repr__(self) -> str:
        fields_text = f", {dict(self.fields)!r}" if self.fields else ""
        return f"Yield({self.axes!r}{fields_text})"


@dataclass
class _FollowingTool(Running):
    """Running action whose target follows the tool along some axes."""

    axes: tuple[int, ...]
    max_deviation: float
    end_deviation: float

    def _task_error(self, tick: TickContext, target: Array) -> tuple[Array, Array]:
        frame = tick.base_from_task
        error = functional.pose_error(tick.tool, target)
        return frame, np.concatenate((frame.T @ error[:3], frame.T @ error[3:]))

    def target(self, tick: TickContext, target: Array) -> Array:
        frame, error = self._task_error(tick, target)
        axes = list(self.axes)
        error[axes] = np.clip(error[axes], -self.max_deviation, self.max_deviation)
        return offset_pose(tick.tool, frame @ error[:3], frame @ error[3:])

    def over(self, tick: TickContext) -> bool | None:
        _, error = self._task_error(tick, tick.target)
        return bool(np.all(np.abs(error[list(self.axes)]) <= self.end_deviation))


@dataclass(frozen=True)
class Follow(Action):
    """Let the target follow the tool along some axes, at a distance of at most `max_deviation`.

    A stiff axis that is pushed farther than `max_deviation` thus yields, with the force that it
    exerts at this deviation. In a reaction without `until`, the action ends when the tool is within
    0.9 times `max_deviation` of the caller's target along these axes.

    Args:
        axes: Names of axes of the task frame, e.g. "x yaw".
        max_deviation: Maximum deviation [m], for rotations [rad].
    """

    axes: str
    max_deviation: float

    def __post_init__(self) -> None:
        """Check the arguments."""
        indices(self.axes)
        positive(self.max_deviation, "Follow.max_deviation", "m, rad")

    def begin(self, tick: TickContext) -> Running:
        """Return a running action whose target follows the tool."""
        return _FollowingTool(indices(self.axes), self.max_deviation, 0.9 * self.max_deviation)


class _MovingAway(Running):
    """Running action that moves the target along a straight line, and keeps it at the end."""

    def __init__(self, pose: Array, direction: Array, distance: float, speed: float) -> None:
        self._pose, self._direction = pose, direction
        self._distance, self._speed, self._travelled = distance, speed, 0.0

    def target(self, tick: TickContext, target: Array) -> Array:
        self._travelled = min(self._travelled + self._speed * tick.dt, self._distance)
        return offset_pose(self._pose, self._travelled * self._direction, np.zeros(3))


@dataclass(frozen=True)
class Retract(Action):
    """Move the target away from the present tool pose by a distance, and keep it there.

    Args:
        distance: Length of the motion [m].
        speed: Speed of the target [m/s]; the controller's `max_tool_speed` also limits it.
        along: Direction (3,) in base axes; None: the direction of the estimated contact force.
    """

    distance: float
    speed: float = 0.1
    along: tuple[float, float, float] | None = None
    is_latching = True

    def __post_init__(self) -> None:
        """Check the arguments."""
        positive(self.distance, "Retract.distance", "m")
        positive(self.speed, "Retract.speed", "m/s")
        if self.along is not None:
            along = vector(self.along, 3, "Retract.along")
            positive(np.linalg.norm(along), "length of Retract.along")

    @property
    def needs_force(self) -> bool:
        """True if no direction is given, so that the force estimate gives the direction."""
        return self.along is None

    def begin(self, tick: TickContext) -> Running:
        """Return a running action whose target moves; it stays if the estimated force is 0."""
        push = tick.force().force_base[:3] if self.along is None else np.asarray(self.along, float)
        size = float(np.linalg.norm(push))
        direction = push / size if size > 0.0 else np.zeros(3)
        return _MovingAway(tick.tool.copy(), direction, self.distance, self.speed)


@dataclass(frozen=True)
class Call(Action):
    """Call a function once with the `TickContext` when the condition becomes true."""

    function: Callable[[TickContext], object]
    is_one_shot = True

    def __post_init__(self) -> None:
        """Check that the function is callable."""
        if not callable(self.function):
            raise TypeError(
                "Call.function must be a function of a TickContext, got "
                f"{format_value(self.function)}"
            )

    def begin(self, tick: TickContext) -> Running:
        """Call the function with `tick`; return a running action that changes nothing."""
        self.function(tick)
        return Running()
