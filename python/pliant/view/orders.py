"""Orders of the page to the arm: small frozen messages, one class each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pliant._typing import Array


#: Largest number of queued orders, and of orders carried out in one tick.
MOST, PER_TICK = 64, 8
#: Fields of an axis that a change of the law resets.
STRENGTHS = frozenset({"soft", "firm", "hold", "stiffness", "damping"})


class Order:
    """Base class of all orders."""


@dataclass(frozen=True)
class Target(Order):
    """Move the tool to a pose (4, 4), base axes."""

    pose: Array


@dataclass(frozen=True)
class Push(Order):
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
class Grab(Order):
    """Hold a point of the arm with a simulated hand, and pull it toward a place.

    Attributes:
        body: Number of the body in the simulation.
        point: Held point (3,) [m], base axes, at the time of the order; None: unchanged.
        toward: Position of the hand (3,) [m], base axes.
    """

    body: int
    point: tuple[float, float, float] | None
    toward: tuple[float, float, float]


@dataclass(frozen=True)
class LetGo(Order):
    """Release the hand."""


@dataclass(frozen=True)
class Edit(Order):
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
class Eta(Edit):
    """Change the target adaptation of every axis that yields."""

    value: float


@dataclass(frozen=True)
class Firm(Edit):
    """Let no axis yield while on; off restores the settings."""

    on: bool


@dataclass(frozen=True)
class Home(Order):
    """Return the target to the start pose."""


@dataclass(frozen=True)
class Play(Order):
    """Run the action of the scene: the target opens the door, or a person takes the object."""


@dataclass(frozen=True)
class Scene(Order):
    """Change to another scene, by name; only for a simulated arm."""

    name: str


@dataclass(frozen=True)
class Stop(Order):
    """Stop: lower the arm and switch torque off."""


@dataclass(frozen=True)
class Start(Order):
    """Switch torque on again."""


class Queue:
    """A bounded queue of orders in which later orders replace obsolete ones.

    A slider sends each value several times, and a flood of orders must neither starve the loop nor
    fill the memory.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._waiting: list[Order] = []

    def __len__(self) -> int:
        return len(self._waiting)

    def put(self, order: Order) -> None:
        """Add an order and remove obsolete ones; beyond `MOST` the oldest are dropped."""
        left = [held for held in self._waiting if not _replaces(order, held)]
        if len(left) >= MOST:
            del left[next(i for i, held in enumerate(left) if not isinstance(held, Stop))]
        self._waiting = [*left, order]

    def take(self, *, edit: bool = True) -> list[Order]:
        """Remove and return the next orders: a stop first, at most `PER_TICK`, at most one edit.

        Args:
            edit: True if an edit may be among them. A change of the task axes takes milliseconds.
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
    """Return True if an order makes an earlier one obsolete."""
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
