"""What follows a condition: hold, yield, follow, retract, stop, call.

An action is a description; `begin` makes what runs. It changes the target that the step gets, the
settings, or nothing; goals and limits stay the controller's own business.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

import pliant
from pliant.arguments import given, positive, vector
from pliant.reactions.moment import indices
from pliant.reactions.poses import moved

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant.reactions.moment import Moment

    Array = NDArray[np.float64]


class Running:
    """An action in force."""

    def target(self, now: Moment, target: Array) -> Array:
        """Pose (4, 4) that the step shall have in place of `target`."""
        return target

    def over(self, now: Moment) -> bool | None:
        """Whether it has done its work; None: its condition decides."""
        return None

    def end(self, now: Moment) -> None:
        """Undo what must not stay."""


class Action(ABC):
    """Something to do when a condition begins to hold."""

    #: Whether it stays in force until `ReactionMonitor.resume()` where the reaction has no `until`.
    latched = False
    #: Whether it is done at once.
    momentary = False
    #: Whether it asks for a force.
    feels = False

    def check(self, controller: pliant.Controller) -> None:  # noqa: B027 - most refuse nothing
        """Refuse what cannot be done with this controller.

        Raises:
            ConfigError, OutOfRangeError: With what would be right.
        """

    @abstractmethod
    def begin(self, now: Moment) -> Running:
        """Put it in force."""


@dataclass
class _Frozen(Running):
    """The target stays at a pose."""

    pose: Array

    def target(self, now: Moment, target: Array) -> Array:
        return self.pose


@dataclass(frozen=True)
class Hold(Action):
    """The target becomes the pose in which the tool is now: the arm stops to push and stays.

    It ends once the condition has not held for the reaction's `clear`; the target then goes back to
    the caller's at the watch's speed.
    """

    def begin(self, now: Moment) -> Running:
        """Remember the pose."""
        return _Frozen(now.tool.copy())


@dataclass(frozen=True)
class Stop(Action):
    """As `Hold`, until `ReactionMonitor.resume()` is called; `ReactionMonitor.stopped` says so."""

    latched = True

    def begin(self, now: Moment) -> Running:
        """Remember the pose."""
        return _Frozen(now.tool.copy())


class _Yielding(Running):
    """Other settings, until the end."""

    def __init__(self, controller: pliant.Controller, settings: pliant.Settings) -> None:
        self._before, self._changed = controller.settings, settings
        controller.update(settings)

    def end(self, now: Moment) -> None:
        # Settings that somebody else has changed meanwhile are not ours to undo.
        if now.controller.settings == self._changed:
            now.controller.update(self._before)


@dataclass(frozen=True, repr=False)
class Yield(Action):
    """Axes of the task give way, pushed either way, while it is in force; the target stays.

    Args:
        axes: Axis key of the task.
        fields: Other attributes of `pliant.Axis` meanwhile, e.g. ``{"soft": 2.0, "adaptation":
            0.9}``.
    """

    axes: str
    fields: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check the words and numbers once."""
        indices(self.axes)
        if not isinstance(self.fields, Mapping):
            raise pliant.ConfigError(
                'Yield.fields must be a dict of fields of Axis, as in {"soft": 2.0}, '
                f"got {given(self.fields)}"
            )
        pliant.Axis(**self.fields)

    def _settings(self, settings: pliant.Settings) -> pliant.Settings:
        names = settings.task.names
        chosen = [names[index] for index in indices(self.axes, names)]
        axes: dict[str, pliant.Axis] = dict(settings.axes.items())
        for name in chosen:
            axes[name] = settings.axes[name].replace(**{"yields": "both", **self.fields})
        return settings.replace(axes=axes)

    def check(self, controller: pliant.Controller) -> None:
        """Try the settings on a controller of the same arm."""
        settings = self._settings(controller.settings)
        pliant.Controller(controller.model, settings, controller.servos)

    def begin(self, now: Moment) -> Running:
        """Take the settings."""
        return _Yielding(now.controller, self._settings(now.controller.settings))

    def __repr__(self) -> str:
        more = f", {dict(self.fields)!r}" if self.fields else ""
        return f"Yield({self.axes!r}{more})"


@dataclass
class _Leashed(Running):
    """A target that some axes drag along."""

    axes: tuple[int, ...]
    leash: float
    back: float

    def _off(self, now: Moment, target: Array) -> tuple[Array, Array]:
        frame = now.base_from_task
        error = pliant.functional.pose_error(now.tool, target)
        return frame, np.concatenate((frame.T @ error[:3], frame.T @ error[3:]))

    def target(self, now: Moment, target: Array) -> Array:
        frame, error = self._off(now, target)
        chosen = list(self.axes)
        error[chosen] = np.clip(error[chosen], -self.leash, self.leash)
        return moved(now.tool, frame @ error[:3], frame @ error[3:])

    def over(self, now: Moment) -> bool | None:
        _, error = self._off(now, now.wanted)
        return bool(np.all(np.abs(error[list(self.axes)]) <= self.back))


@dataclass(frozen=True)
class Follow(Action):
    """The target comes along with the tool on some axes and stays at most `leash` away from it.

    So a stiff axis pushed farther than that gives way at the force it has there. It ends when the
    tool is back within nine tenths of the leash of the caller's target.

    Args:
        axes: Axis key of the task frame.
        leash: Largest deviation [m], for rotations [rad].
    """

    axes: str
    leash: float

    def __post_init__(self) -> None:
        """Check the numbers once."""
        indices(self.axes)
        positive(self.leash, "Follow.leash", "m, rad")

    def begin(self, now: Moment) -> Running:
        """Take the axes."""
        return _Leashed(indices(self.axes), self.leash, 0.9 * self.leash)


class _Retracting(Running):
    """A target that leaves a pose in a direction."""

    def __init__(self, pose: Array, direction: Array, distance: float, speed: float) -> None:
        self._pose, self._direction = pose, direction
        self._distance, self._speed, self._way = distance, speed, 0.0

    def target(self, now: Moment, target: Array) -> Array:
        self._way = min(self._way + self._speed * now.dt, self._distance)
        return moved(self._pose, self._way * self._direction, np.zeros(3))


@dataclass(frozen=True)
class Retract(Action):
    """The target leaves the pose in which the tool is now, and stays at the end of the way.

    Args:
        distance: How far [m].
        speed: How fast [m/s]; the controller's `max_tool_speed` bounds it too.
        along: Direction (3,) in base axes; None: where the contact pushes, by the force felt.
    """

    distance: float
    speed: float = 0.1
    along: tuple[float, float, float] | None = None
    latched = True

    def __post_init__(self) -> None:
        """Check the numbers once."""
        positive(self.distance, "Retract.distance", "m")
        positive(self.speed, "Retract.speed", "m/s")
        if self.along is not None:
            along = vector(self.along, 3, "Retract.along")
            positive(np.linalg.norm(along), "length of Retract.along")

    @property
    def feels(self) -> bool:  # type: ignore[override]
        """Whether the force says where to."""
        return self.along is None

    def begin(self, now: Moment) -> Running:
        """Choose the direction; without any force the arm holds."""
        way = now.force().force_base[:3] if self.along is None else np.asarray(self.along, float)
        size = float(np.linalg.norm(way))
        direction = way / size if size > 0.0 else np.zeros(3)
        return _Retracting(now.tool.copy(), direction, self.distance, self.speed)


@dataclass(frozen=True)
class Call(Action):
    """A function is called once, with the moment."""

    function: Callable[[Moment], object]
    momentary = True

    def __post_init__(self) -> None:
        """Check that it can be called."""
        if not callable(self.function):
            raise TypeError(
                f"Call.function must be a function of a Moment, got {given(self.function)}"
            )

    def begin(self, now: Moment) -> Running:
        """Call it."""
        self.function(now)
        return Running()
