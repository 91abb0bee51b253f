"""What a page may ask of the arm: small frozen messages, one class each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


#: Orders that wait at most, and that are carried out in one tick.
MOST, PER_TICK = 64, 8
#: Fields of an axis that another law replaces.
STRENGTHS = frozenset({"soft", "firm", "hold", "stiffness", "damping"})


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


class Queue:
    """Orders that wait to be carried out: bounded, and without those that a later one replaces.

    A slider says everything thrice, and a page that floods must neither starve the loop nor fill
    the memory.
    """

    def __init__(self) -> None:
        """Hold no order."""
        self._waiting: list[Order] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, order: Order) -> None:
        """Add an order, in place of those that it makes pointless; the oldest go beyond `MOST`."""
        left = [held for held in self._waiting if not _replaces(order, held)]
        if len(left) >= MOST:
            del left[next(i for i, held in enumerate(left) if not isinstance(held, Stop))]
        self._waiting = [*left, order]

    def take(self, *, edit: bool = True) -> list[Order]:
        """Remove and return the next orders: a stop first, at most `PER_TICK`, at most one edit.

        Args:
            edit: Whether an edit may be among them. One of another set of axes takes milliseconds.
        """
        out: list[Order] = [held for held in self._waiting if isinstance(held, Stop)]
        rest: list[Order] = []
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


def _replaces(new: Order, old: Order) -> bool:
    """Tell whether an order makes an earlier one pointless."""
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
