"""Actions of a reaction: hold, yield, follow, retract, stop, call.

An action is a description; `begin` creates the running action. A running action changes the target
of the step, the settings, or nothing. Goals and limits stay with the controller.
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
    """Move a pose (4, 4) by `shift` (3,) [m] and turn it by `turn` (3,) [rad], in base axes."""
    out = pose.copy()
    out[:3, 3] += shift
    out[:3, :3] = Pose.from_rotvec(np.zeros(3), turn).rotation @ pose[:3, :3]
    return out


def step_toward(pose: Array, target: Array, distance: float, angle: float) -> Array:
    """Return a pose (4, 4) nearer to a target, by at most `distance` [m] and `angle` [rad]."""
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
    """An action in force."""

    def target(self, now: TickContext, target: Array) -> Array:
        """Return the pose (4, 4) that replaces `target` in the step."""
        return target

    def over(self, now: TickContext) -> bool | None:
        """Return True once the action is complete; None: its condition decides."""
        return None

    def end(self, now: TickContext) -> None:
        """Undo temporary changes."""


class Action(ABC):
    """An action that starts when a condition becomes true."""

    #: True if, without `until`, it stays in force until `ReactionMonitor.resume()`.
    is_latching = False
    #: True if it completes immediately.
    is_one_shot = False

    @property
    def needs_force(self) -> bool:
        """True if it needs a force estimate."""
        return False

    def validate(self, controller: Controller) -> None:  # noqa: B027 - optional for a subclass
        """Check that the action is possible with this controller.

        Raises:
            ConfigError, OutOfRangeError: It is not; the message names a valid choice.
        """

    @abstractmethod
    def begin(self, now: TickContext) -> Running:
        """Put the action in force."""


@dataclass
class _FixedTarget(Running):
    """A constant target pose."""

    pose: Array

    def target(self, now: TickContext, target: Array) -> Array:
        return self.pose


@dataclass(frozen=True)
class Hold(Action):
    """Set the target to the present tool pose: the arm stops pushing and stays.

    It ends once the condition has been false for the reaction's `clear`. The target then returns
    to the caller's at the monitor's `resume_speed`.
    """

    def begin(self, now: TickContext) -> Running:
        """Store the pose."""
        return _FixedTarget(now.tool.copy())


@dataclass(frozen=True)
class Stop(Action):
    """Act as `Hold` until `ReactionMonitor.resume()`; `ReactionMonitor.stopped` is then True."""

    is_latching = True

    def begin(self, now: TickContext) -> Running:
        """Store the pose."""
        return _FixedTarget(now.tool.copy())


class _ChangedSettings(Running):
    """Changed settings until the end."""

    def __init__(self, controller: Controller, settings: Settings) -> None:
        self._before, self._changed = controller.settings, settings
        controller.update(settings)

    def end(self, now: TickContext) -> None:
        # Do not undo settings that were changed elsewhere in the meantime.
        if now.controller.settings == self._changed:
            now.controller.update(self._before)


@dataclass(frozen=True, repr=False)
class Yield(Action):
    """Let axes of the task yield in both directions while in force; the target stays.

    Args:
        axes: Axis key of the task.
        fields: Other attributes of `pliant.Axis` for this time, e.g. ``{"soft": 2.0, "adaptation":
            0.9}``.
    """

    axes: str
    fields: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the arguments once."""
        indices(self.axes)
        if not isinstance(self.fields, Mapping):
            raise ConfigError(
                'Yield.fields must be a dict of fields of Axis, as in {"soft": 2.0}, '
                f"got {format_value(self.fields)}"
            )
        Axis(**self.fields)

    def _settings(self, settings: Settings) -> Settings:
        names = settings.task.names
        chosen = [names[index] for index in indices(self.axes, names)]
        axes: dict[str, Axis] = dict(settings.axes.items())
        for name in chosen:
            axes[name] = settings.axes[name].replace(**{"yields": "both", **self.fields})
        return settings.replace(axes=axes)

    def validate(self, controller: Controller) -> None:
        """Try the settings on a controller of the same arm."""
        settings = self._settings(controller.settings)
        Controller(controller.model, settings, controller.servos)

    def begin(self, now: TickContext) -> Running:
        """Apply the settings."""
        return _ChangedSettings(now.controller, self._settings(now.controller.settings))

    def __repr__(self) -> str:
        more = f", {dict(self.fields)!r}" if self.fields else ""
        return f"Yield({self.axes!r}{more})"


@dataclass
class _FollowingTool(Running):
    """A target that follows the tool on some axes."""

    axes: tuple[int, ...]
    max_deviation: float
    back: float

    def _off(self, now: TickContext, target: Array) -> tuple[Array, Array]:
        frame = now.base_from_task
        error = functional.pose_error(now.tool, target)
        return frame, np.concatenate((frame.T @ error[:3], frame.T @ error[3:]))

    def target(self, now: TickContext, target: Array) -> Array:
        frame, error = self._off(now, target)
        chosen = list(self.axes)
        error[chosen] = np.clip(error[chosen], -self.max_deviation, self.max_deviation)
        return offset_pose(now.tool, frame @ error[:3], frame @ error[3:])

    def over(self, now: TickContext) -> bool | None:
        _, error = self._off(now, now.target)
        return bool(np.all(np.abs(error[list(self.axes)]) <= self.back))


@dataclass(frozen=True)
class Follow(Action):
    """Let the target follow the tool on some axes, at most `max_deviation` away from it.

    A stiff axis pushed farther than `max_deviation` thus yields at the force it has there. The
    action ends when the tool is within nine tenths of `max_deviation` of the caller's target.

    Args:
        axes: Axis key of the task frame.
        max_deviation: Largest deviation [m], for rotations [rad].
    """

    axes: str
    max_deviation: float

    def __post_init__(self) -> None:
        """Check the numbers once."""
        indices(self.axes)
        positive(self.max_deviation, "Follow.max_deviation", "m, rad")

    def begin(self, now: TickContext) -> Running:
        """Start following."""
        return _FollowingTool(indices(self.axes), self.max_deviation, 0.9 * self.max_deviation)


class _MovingAway(Running):
    """A target that moves away from a pose in one direction."""

    def __init__(self, pose: Array, direction: Array, distance: float, speed: float) -> None:
        self._pose, self._direction = pose, direction
        self._distance, self._speed, self._travelled = distance, speed, 0.0

    def target(self, now: TickContext, target: Array) -> Array:
        self._travelled = min(self._travelled + self._speed * now.dt, self._distance)
        return offset_pose(self._pose, self._travelled * self._direction, np.zeros(3))


@dataclass(frozen=True)
class Retract(Action):
    """Move the target away from the present tool pose, and keep it at the end.

    Args:
        distance: Length of the motion [m].
        speed: Speed of the target [m/s]; the controller's `max_tool_speed` also limits it.
        along: Direction (3,) in base axes; None: direction of the estimated contact force.
    """

    distance: float
    speed: float = 0.1
    along: tuple[float, float, float] | None = None
    is_latching = True

    def __post_init__(self) -> None:
        """Check the numbers once."""
        positive(self.distance, "Retract.distance", "m")
        positive(self.speed, "Retract.speed", "m/s")
        if self.along is not None:
            along = vector(self.along, 3, "Retract.along")
            positive(np.linalg.norm(along), "length of Retract.along")

    @property
    def needs_force(self) -> bool:
        """True if the direction comes from the force estimate."""
        return self.along is None

    def begin(self, now: TickContext) -> Running:
        """Choose the direction; without a force the arm holds."""
        push = now.force().force_base[:3] if self.along is None else np.asarray(self.along, float)
        size = float(np.linalg.norm(push))
        direction = push / size if size > 0.0 else np.zeros(3)
        return _MovingAway(now.tool.copy(), direction, self.distance, self.speed)


@dataclass(frozen=True)
class Call(Action):
    """Call a function once, with the `TickContext`."""

    function: Callable[[TickContext], object]
    is_one_shot = True

    def __post_init__(self) -> None:
        """Check that it is callable."""
        if not callable(self.function):
            raise TypeError(
                "Call.function must be a function of a TickContext, got "
                f"{format_value(self.function)}"
            )

    def begin(self, now: TickContext) -> Running:
        """Call the function."""
        self.function(now)
        return Running()
