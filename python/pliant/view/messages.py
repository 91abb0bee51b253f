"""Messages from the browser page to the control loop, checks of their values, and their queue."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError

if TYPE_CHECKING:
    from pliant._core import Model
    from pliant._typing import Array


#: Maximum duration of the push that one `Push` message requests [s].
MAX_PUSH_TIME = 10.0
#: Maximum magnitude of the coordinates in a `Grab` message [m].
MAX_COORDINATE = 100.0
#: Maximum magnitude of the entries of R Rᵀ - I, for the rotation matrix R of a target [1].
ORTHOGONALITY_TOLERANCE = 1e-6
#: A push may exceed its maximum by this share [1], because the page's sliders round their values.
FORCE_TOLERANCE = 1e-3
#: Maximum number of queued messages.
MAX_QUEUED = 64
#: Maximum number of messages handled in one tick.
PER_TICK = 8
#: Fields of `pliant.Axis` that get default values when the user changes the control law.
LAW_FIELDS = frozenset({"soft", "firm", "hold", "stiffness", "damping"})


class Message:
    """Base class of all messages from the browser page to the control loop."""


@dataclass(frozen=True)
class Target(Message):
    """Set the target pose (4, 4) of the tool, `base_from_tool`."""

    pose: Array


@dataclass(frozen=True)
class Push(Message):
    """Push the tool of a simulated arm with a simulated hand, for a time or until the next push.

    Attributes:
        force: Force (3,) [N], base axes.
        torque: Torque (3,) [N·m], base axes.
        seconds: Duration [s].
    """

    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torque: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seconds: float = 0.5


@dataclass(frozen=True)
class Grab(Message):
    """Grip a point of the arm with a simulated hand, and pull it toward another point.

    Attributes:
        body: Index of the MuJoCo body.
        point: Gripped point (3,) [m], base axes, at the time of the message; None: keep the gripped
            point of an earlier message.
        toward: Position of the hand (3,) [m], base axes.
    """

    body: int
    point: tuple[float, float, float] | None
    toward: tuple[float, float, float]


@dataclass(frozen=True)
class LetGo(Message):
    """Remove the simulated hand from the arm."""


@dataclass(frozen=True)
class Edit(Message):
    """Base class of messages that change the settings of the controller.

    Attributes:
        number: Serial number that the page assigns. Each snapshot contains the number of the last
            handled edit, so that the page knows which changes the snapshot includes.
    """

    number: int


@dataclass(frozen=True)
class Preset(Edit):
    """Replace all settings of the controller by those of a preset."""

    name: str


@dataclass(frozen=True)
class Law(Edit):
    """Change the control law; caps, stiffness and damping of all axes get their default values."""

    law: str


@dataclass(frozen=True)
class Change(Edit):
    """Change settings of one task axis; `fields` maps field names of `pliant.Axis` to values."""

    axis: str
    fields: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Adaptation(Edit):
    """Change `Axis.adaptation` of every axis that yields."""

    value: float


@dataclass(frozen=True)
class Firm(Edit):
    """Let no axis yield if `on` is True; if `on` is False, restore the settings of the axes."""

    on: bool


@dataclass(frozen=True)
class Home(Message):
    """Set the target to the pose of the tool at the start of the run."""


@dataclass(frozen=True)
class Play(Message):
    """Start the action of the scene: the target moves as scripted, or a person takes the object."""


@dataclass(frozen=True)
class Scene(Message):
    """Change to the scene with the given name; only for a simulated arm."""

    name: str


@dataclass(frozen=True)
class Stop(Message):
    """Lower the arm and switch torque off (the STOP button)."""


@dataclass(frozen=True)
class Start(Message):
    """Switch torque on again."""


class Queue:
    """A bounded queue in which a new message replaces those that it makes obsolete.

    Many messages, as from a moving slider, must neither delay the control loop nor fill the memory.
    """

    def __init__(self) -> None:
        """Create an empty queue."""
        self._messages: list[Message] = []

    def __len__(self) -> int:
        return len(self._messages)

    def put(self, message: Message) -> None:
        """Add a message and remove those that it makes obsolete.

        If the queue still holds `MAX_QUEUED` messages, the oldest one that is not a `Stop` is
        dropped.
        """
        remaining = [queued for queued in self._messages if not _replaces(message, queued)]
        if len(remaining) >= MAX_QUEUED:
            del remaining[
                next(i for i, queued in enumerate(remaining) if not isinstance(queued, Stop))
            ]
        self._messages = [*remaining, message]

    def take(self, *, edit: bool = True) -> list[Message]:
        """Remove at most `PER_TICK` messages and return them: `Stop` first, at most one `Edit`.

        Args:
            edit: False: leave all edits in the queue, because one edit may take milliseconds.
        """
        out: list[Message] = [queued for queued in self._messages if isinstance(queued, Stop)]
        rest: list[Message] = []
        for queued in self._messages:
            is_edit = isinstance(queued, Edit)
            if isinstance(queued, Stop):
                continue
            if len(out) >= PER_TICK or (is_edit and not edit):
                rest.append(queued)
                continue
            out.append(queued)
            edit = edit and not is_edit
        self._messages = rest
        return out


def _replaces(new: Message, old: Message) -> bool:
    """Return True if the message `new` makes the earlier message `old` obsolete."""
    match new, old:
        case Preset(), Edit():
            return True
        case Law(), Change(fields=fields):
            return set(fields) <= LAW_FIELDS
        case Change(axis=axis, fields=fields), Change(axis=old_axis, fields=old_fields):
            return axis == old_axis and set(old_fields) <= set(fields)
        case Grab(point=None), Grab(point=None):
            return True
        case Grab(point=None), _:
            return False
        case ((Push() | Grab() | LetGo()), (Push() | Grab() | LetGo())):
            return True
        case ((Target() | Home()), (Target() | Home())):
            return True
    return type(new) is type(old) and not isinstance(new, Change)


def check_target(message: Target, model: Model) -> Array:
    """Check a target message and return its pose (4, 4).

    Raises:
        ConfigError: The matrix is not finite, not a pose, or out of the reach of the arm.
    """
    pose = _finite_floats("target", message.pose, (4, 4))
    rotation = pose[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # huge entries give inf or NaN
        error = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if (
        not error <= ORTHOGONALITY_TOLERANCE
        or np.linalg.det(rotation) < 0.0
        or (pose[3] != (0.0, 0.0, 0.0, 1.0)).any()
    ):
        raise ConfigError("target is not a pose: its rotation is not orthogonal")
    distance = math.dist(pose[:3, 3], model.reach_origin)
    if distance > model.reach:
        raise ConfigError(
            f"target is {distance:.3g} m from {model.joint_names[0]}, and the arm reaches "
            f"{model.reach:.3g} m"
        )
    return pose


def check_push(message: Push, max_push: tuple[float, float]) -> None:
    """Check a push; `max_push` is the largest component of force [N] and of torque [N·m].

    Raises:
        ConfigError: A number is not finite, or exceeds `max_push` or `MAX_PUSH_TIME`.
    """
    parts = (
        ("force", message.force, max_push[0], "N"),
        ("torque", message.torque, max_push[1], "N·m"),
    )
    for name, value, bound, unit in parts:
        largest = float(np.abs(_finite_floats(f"push: {name}", value, (3,))).max())
        if largest > bound * (1.0 + FORCE_TOLERANCE):
            raise ConfigError(
                f"push: {name} = {largest:.3g} {unit} is more than {bound:.3g} {unit}"
            )
    seconds = float(_finite_floats("push: seconds", message.seconds, ()))
    if not 0.0 < seconds <= MAX_PUSH_TIME:
        raise ConfigError(f"push: seconds = {seconds:.3g} is outside (0, {MAX_PUSH_TIME:g}]")


def check_grab(message: Grab) -> None:
    """Check the points in a `Grab` message.

    Raises:
        ConfigError: A coordinate is not finite, or exceeds `MAX_COORDINATE`.
    """
    for name, point in (("point", message.point), ("toward", message.toward)):
        if point is None:
            continue
        largest = float(np.abs(_finite_floats(f"hand: {name}", point, (3,))).max())
        if largest > MAX_COORDINATE:
            raise ConfigError(
                f"hand: {name} is {largest:.3g} m away, more than {MAX_COORDINATE:g} m"
            )


def _finite_floats(name: str, value: object, shape: tuple[int, ...]) -> Array:
    """Return `value` as an array of finite floats of a given shape.

    Raises:
        ConfigError: The value has another shape, or an entry is not a finite number.
    """
    try:
        out = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):  # an integer may be too large for a float
        raise ConfigError(f"{name} is not made of numbers") from None
    if out.shape != shape:
        raise ConfigError(f"{name} has shape {out.shape}, not {shape}")
    if not np.isfinite(out).all():
        raise ConfigError(f"{name} is not finite")
    return out
