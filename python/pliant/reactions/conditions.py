"""Conditions joined with ``&``, ``|`` and ``~``, and how long they have lasted.

A condition is a description: it can be printed, compared and used in several reactions. What it
remembers (how long something has lasted) lives in the judge that `judge()` makes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pliant.arguments import given, number

if TYPE_CHECKING:
    import pliant
    from pliant.reactions.moment import Moment

#: Says at every tick whether a condition holds; to be called once per tick.
Judge = Callable[["Moment"], bool]


class Condition(ABC):
    """Something that holds or does not, judged once per tick."""

    #: Whether it asks for a force.
    feels = False

    @abstractmethod
    def judge(self) -> Judge:
        """A fresh judge of this condition."""

    def check(  # noqa: B027 - most refuse nothing
        self, contact: pliant.ContactEstimator | None, controller: pliant.Controller
    ) -> None:
        """Refuse what this arm cannot tell.

        Raises:
            ConfigError: An axis or joint that is not there.
            OutOfRangeError: A threshold below the uncertainty.
        """

    def __and__(self, other: Condition) -> Condition:
        """Both hold."""
        return Joined("&", self, condition(other, "what follows &"))

    def __or__(self, other: Condition) -> Condition:
        """One or both hold."""
        return Joined("|", self, condition(other, "what follows |"))

    def __invert__(self) -> Condition:
        """It does not hold."""
        return Not(self)

    def __bool__(self) -> bool:
        """Refuse `and`, `or`, `not`, which Python would settle at once."""
        raise TypeError("join conditions with &, | and ~, not with and, or, not")

    def lasting(self, seconds: float) -> Condition:
        """It has held for so long [s] without a break."""
        return Lasting(self, seconds)


def condition(value: object, name: str) -> Condition:
    """Return a value that is a condition.

    Raises:
        TypeError: It is none; says what would be one.
    """
    if not isinstance(value, Condition):
        wanted = "a condition, as Force('z', above=8.0) or Elapsed(1.0)"
        raise TypeError(f"{name} must be {wanted}, got {given(value)}")
    return value


@dataclass(frozen=True, repr=False)
class Joined(Condition):
    """Two conditions joined by ``&`` or ``|``."""

    how: Literal["&", "|"]
    one: Condition
    other: Condition

    @property
    def feels(self) -> bool:  # type: ignore[override]
        """Whether one of them asks for a force."""
        return self.one.feels or self.other.feels

    def check(self, contact: pliant.ContactEstimator | None, controller: pliant.Controller) -> None:
        """Check both."""
        self.one.check(contact, controller)
        self.other.check(contact, controller)

    def judge(self) -> Judge:
        """Judge both at every tick, so that times go on."""
        one, other, both = self.one.judge(), self.other.judge(), self.how == "&"

        def holds(now: Moment) -> bool:
            first, second = one(now), other(now)
            return (first and second) if both else (first or second)

        return holds

    def __repr__(self) -> str:
        return f"({self.one!r} {self.how} {self.other!r})"


@dataclass(frozen=True, repr=False)
class Not(Condition):
    """A condition that does not hold."""

    one: Condition

    @property
    def feels(self) -> bool:  # type: ignore[override]
        """Whether it asks for a force."""
        return self.one.feels

    def check(self, contact: pliant.ContactEstimator | None, controller: pliant.Controller) -> None:
        """Check it."""
        self.one.check(contact, controller)

    def judge(self) -> Judge:
        """The opposite."""
        one = self.one.judge()
        return lambda now: not one(now)

    def __repr__(self) -> str:
        return f"~{self.one!r}"


@dataclass(frozen=True, repr=False)
class Lasting(Condition):
    """A condition that has held without a break; its first tick has lasted for no time yet."""

    one: Condition
    seconds: float

    def __post_init__(self) -> None:
        """Check the time."""
        number(self.seconds, "lasting", 0.0, unit="s")

    @property
    def feels(self) -> bool:  # type: ignore[override]
        """Whether it asks for a force."""
        return self.one.feels

    def check(self, contact: pliant.ContactEstimator | None, controller: pliant.Controller) -> None:
        """Check it."""
        self.one.check(contact, controller)

    def judge(self) -> Judge:
        """Count while it holds."""
        one, lasted = self.one.judge(), -1.0

        def holds(now: Moment) -> bool:
            nonlocal lasted
            if not one(now):
                lasted = -1.0
                return False
            lasted = 0.0 if lasted < 0.0 else lasted + now.dt
            return lasted >= self.seconds - 1e-9

        return holds

    def __repr__(self) -> str:
        return f"{self.one!r}.lasting({self.seconds:g})"
