"""What a page may ask of the arm: small frozen messages, one class each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


class Order:
    """Anything a page asks for."""


@dataclass(frozen=True)
class Target(Order):
    """The tool shall go to a pose (4, 4), base axes."""

    pose: Array


@dataclass(frozen=True)
class Push(Order):
    """A simulated hand pushes the tool, and stops unless it is told again in time.

    Attributes:
        force: (3,) [N], base axes.
        torque: (3,) [N·m], base axes.
        seconds: For how long.
    """

    force: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torque: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seconds: float = 0.5


@dataclass(frozen=True)
class Grab(Order):
    """A simulated hand holds a point of the arm and pulls it toward a place.

    Attributes:
        body: Number of the body in the simulation.
        point: What is held (3,) [m], base axes, at the moment of the order; None: as before.
        toward: Where the hand is (3,) [m], base axes.
    """

    body: int
    point: tuple[float, float, float] | None
    toward: tuple[float, float, float]


@dataclass(frozen=True)
class LetGo(Order):
    """No hand any more."""


@dataclass(frozen=True)
class Edit(Order):
    """A change of the settings; the arm answers with its number.

    Attributes:
        number: Counts up in the page.
    """

    number: int


@dataclass(frozen=True)
class Preset(Edit):
    """Settings by the name of a preset."""

    name: str


@dataclass(frozen=True)
class Law(Edit):
    """Another law; strengths go back to the arm's own."""

    law: str


@dataclass(frozen=True)
class Change(Edit):
    """Other fields of one task axis, as of `pliant.Axis`."""

    axis: str
    fields: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Eta(Edit):
    """Another target adaptation of every axis that yields."""

    value: float


@dataclass(frozen=True)
class Firm(Edit):
    """Nothing yields while this is on; off brings the former settings back."""

    on: bool


@dataclass(frozen=True)
class Home(Order):
    """The target goes back to where the arm started."""


@dataclass(frozen=True)
class Play(Order):
    """What the scene is for: the target opens the door, a person takes the object."""


@dataclass(frozen=True)
class Scene(Order):
    """Another scene, by name; only a simulated arm has them."""

    name: str


@dataclass(frozen=True)
class Stop(Order):
    """Leave: the arm is lowered, torque goes off."""


@dataclass(frozen=True)
class Start(Order):
    """Torque on again."""


def latest(heard: Sequence[Order]) -> list[Order]:
    """The same without those that a later one makes pointless: a slider says everything thrice."""
    out: list[Order] = []
    seen: set[object] = set()
    for order in reversed(heard):
        key = _key(order)
        if key is None or key not in seen:
            out.append(order)
            seen.add(key)
    return out[::-1]


def _key(order: Order) -> object | None:
    """Orders of one key replace each other; None: each counts."""
    match order:
        case Change(axis=axis, fields=fields):
            return Change, axis, tuple(fields)
        case Target() | Push() | Eta():
            return type(order)
        case Grab(point=None):
            return Grab
    return None
