"""Messages of the page to the arm, their bounds, and the queue of those not yet carried out."""

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


#: Longest push per message [s].
LONGEST = 10.0
#: Largest coordinate of a point toward which a hand pulls [m].
FARTHEST = 100.0
#: Largest entry of R Rᵀ - I for a rotation.
ORTHOGONAL = 1e-6
#: Relative rounding tolerance of a force bound.
ROUNDING = 1e-3
#: Largest number of queued messages, and of messages carried out in one tick.
MAX_QUEUED, PER_TICK = 64, 8
#: Fields of an axis that a change of the law resets.
STRENGTHS = frozenset({"soft", "firm", "hold", "stiffness", "damping"})


class Message:
    """Base class of all messages."""


@dataclass(frozen=True)
class Target(Message):
    """Move the tool to a pose (4, 4), base axes."""

    pose: Array


@dataclass(frozen=True)
class Push(Message):
    """Push the tool with a simulated hand, until a timeout or the next push.

    Attributes:
        force: (3,) [N], base axes.
        torque: (3,) [N·m], base axes.
        seconds: Duration [s].
    """

    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torque: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seconds: float = 0.5


@dataclass(frozen=True)
class Grab(Message):
    """Hold a point of the arm with a simulated hand, and pull it toward a place.

    Attributes:
        body: Number of the body in the simulation.
        point: Held point (3,) [m], base axes, at the time of the message; None: unchanged.
        toward: Position of the hand (3,) [m], base axes.
    """

    body: int
    point: tuple[float, float, float] | None
    toward: tuple[float, float, float]


@dataclass(frozen=True)
class LetGo(Message):
    """Release the hand."""


@dataclass(frozen=True)
class Edit(Message):
    """A change of the settings; the arm acknowledges its number.

    Attributes:
        number: Increasing number from the page.
    """

    number: int


@dataclass(frozen=True)
class Preset(Edit):
    """Change to the settings of a preset."""

    name: str


@dataclass(frozen=True)
class Law(Edit):
    """Change the law; strengths return to the arm's own."""

    law: str


@dataclass(frozen=True)
class Change(Edit):
    """Change fields of one task axis, as of `pliant.Axis`."""

    axis: str
    fields: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Adaptation(Edit):
    """Change the target adaptation of every axis that yields."""

    value: float


@dataclass(frozen=True)
class Firm(Edit):
    """Let no axis yield while on; off restores the settings."""

    on: bool


@dataclass(frozen=True)
class Home(Message):
    """Return the target to the start pose."""


@dataclass(frozen=True)
class Play(Message):
    """Run the action of the scene: the target opens the door, or a person takes the object."""


@dataclass(frozen=True)
class Scene(Message):
    """Change to another scene, by name; only for a simulated arm."""

    name: str


@dataclass(frozen=True)
class Stop(Message):
    """Stop: lower the arm and switch torque off."""


@dataclass(frozen=True)
class Start(Message):
    """Switch torque on again."""


class Queue:
    """A bounded queue of messages in which later messages replace obsolete ones.

    A slider sends each value several times, and a flood of messages must neither starve the loop
    nor fill the memory.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._waiting: list[Message] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, message: Message) -> None:
        """Add a message and remove obsolete ones; beyond `MAX_QUEUED` the oldest are dropped."""
        left = [held for held in self._waiting if not _replaces(message, held)]
        if len(left) >= MAX_QUEUED:
            del left[next(i for i, held in enumerate(left) if not isinstance(held, Stop))]
        self._waiting = [*left, message]

    def take(self, *, edit: bool = True) -> list[Message]:
        """Remove and return the next messages: a stop first, at most `PER_TICK`, at most one edit.

        Args:
            edit: True if an edit may be among them. A change of the task axes takes milliseconds.
        """
        out: list[Message] = [held for held in self._waiting if isinstance(held, Stop)]
        rest: list[Message] = []
        for held in self._waiting:
            is_edit = isinstance(held, Edit)
            if isinstance(held, Stop):
                continue
            if len(out) >= PER_TICK or (is_edit and not edit):
                rest.append(held)
                continue
            out.append(held)
            edit = edit and not is_edit
        self._waiting = rest
        return out


def _replaces(new: Message, old: Message) -> bool:
    """Return True if a message makes an earlier one obsolete."""
    match new, old:
        case Preset(), Edit():
            return True
        case Law(), Change(fields=fields):
            return set(fields) <= STRENGTHS
        case Change(axis=axis, fields=fields), Change(axis=before, fields=had):
            return axis == before and set(had) <= set(fields)
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
    """Return the pose (4, 4) of a target that the arm can reach when stretched.

    Raises:
        ConfigError: The pose is not finite, not a pose, or out of reach.
    """
    pose = _numbers("target", message.pose, (4, 4))
    turn = pose[:3, :3]
    off = np.abs(turn @ turn.T - np.eye(3)).max()
    if off > ORTHOGONAL or np.linalg.det(turn) < 0.0 or (pose[3] != (0.0, 0.0, 0.0, 1.0)).any():
        raise ConfigError("target is not a pose: its rotation is not orthogonal")
    away = math.dist(pose[:3, 3], model.reach_origin)
    if away > model.reach:
        raise ConfigError(
            f"target is {away:.3g} m from {model.joint_names[0]}, and the arm reaches "
            f"{model.reach:.3g} m"
        )
    return pose


def check_push(message: Push, max_push: tuple[float, float]) -> None:
    """Check a push against the largest force [N] and torque [N·m] of the page's sliders.

    Raises:
        ConfigError: A number is not finite or beyond its bound.
    """
    parts = (
        ("force", message.force, max_push[0], "N"),
        ("torque", message.torque, max_push[1], "N·m"),
    )
    for name, value, bound, unit in parts:
        size = float(np.abs(_numbers(f"push: {name}", value, (3,))).max())
        if size > bound * (1.0 + ROUNDING):
            raise ConfigError(f"push: {name} = {size:.3g} {unit} is more than {bound:.3g} {unit}")
    seconds = float(_numbers("push: seconds", message.seconds, ()))
    if not 0.0 < seconds <= LONGEST:
        raise ConfigError(f"push: seconds = {seconds:.3g} is outside (0, {LONGEST:g}]")


def check_grab(message: Grab) -> None:
    """Check the places of a hand that holds the arm.

    Raises:
        ConfigError: A number is not finite, or a place is farther away than `FARTHEST`.
    """
    for name, place in (("point", message.point), ("toward", message.toward)):
        if place is None:
            continue
        away = float(np.abs(_numbers(f"hand: {name}", place, (3,))).max())
        if away > FARTHEST:
            raise ConfigError(f"hand: {name} is {away:.3g} m away, more than {FARTHEST:g} m")


def _numbers(name: str, value: object, shape: tuple[int, ...]) -> Array:
    """Return finite floats of a shape."""
    try:
        out = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ConfigError(f"{name} is not made of numbers") from None
    if out.shape != shape:
        raise ConfigError(f"{name} has shape {out.shape}, not {shape}")
    if not np.isfinite(out).all():
        raise ConfigError(f"{name} is not finite")
    return out
