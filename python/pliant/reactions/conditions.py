"""Conditions, combined with ``&``, ``|`` and ``~``, and their duration.

A condition is a description: it can be printed, compared and used in several reactions. Its state,
e.g. how long it has held, is in the judge that `judge()` returns.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pliant._validation import format_value, number

if TYPE_CHECKING:
    from pliant._core import ContactEstimator, Controller
    from pliant.reactions.moment import Moment

#: Evaluates a condition at a tick; to be called exactly once per tick.
Judge = Callable[["Moment"], bool]


class Condition(ABC):
    """A condition that is evaluated once per tick."""

    #: True if it needs a force estimate.
    feels = False

    @abstractmethod
    def judge(self) -> Judge:
        """Return a new judge of this condition."""

    def check(  # noqa: B027 - most refuse nothing
        self, contact: ContactEstimator | None, controller: Controller
    ) -> None:
        """Check that this arm can evaluate the condition.

        Raises:
            ConfigError: An axis or joint does not exist.
            OutOfRangeError: A threshold is below the uncertainty.
        """

    def __and__(self, other: Condition) -> Condition:
        """Return a condition that holds if both hold."""
        return Joined("&", self, condition(other, "what follows &"))

    def __or__(self, other: Condition) -> Condition:
        """Return a condition that holds if at least one holds."""
        return Joined("|", self, condition(other, "what follows |"))

    def __invert__(self) -> Condition:
        """Return a condition that holds if this one does not."""
        return Not(self)

    def __bool__(self) -> bool:
        """Reject `and`, `or` and `not`, which Python would evaluate immediately."""
        raise TypeError("join conditions with &, | and ~, not with and, or, not")

    def lasting(self, seconds: float) -> Condition:
        """Return a condition that holds once this one has held without a break for so long [s]."""
        return Lasting(self, seconds)


def condition(value: object, name: str) -> Condition:
    """Return the value if it is a condition.

    Raises:
        TypeError: It is not; the message names valid conditions.
    """
    if not isinstance(value, Condition):
        wanted = "a condition, as Force('z', above=8.0) or Elapsed(1.0)"
        raise TypeError(f"{name} must be {wanted}, got {format_value(value)}")
    return value


@dataclass(frozen=True, repr=False)
class Joined(Condition):
    """Two conditions joined by ``&`` or ``|``."""

    how: Literal["&", "|"]
    one: Condition
    other: Condition

    @property
    def feels(self) -> bool:  # type: ignore[override]
        """True if one of them needs a force estimate."""
        return self.one.feels or self.other.feels

    def check(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Check both."""
        self.one.check(contact, controller)
        self.other.check(contact, controller)

    def judge(self) -> Judge:
        """Return a judge that evaluates both at every tick, so that both keep their durations."""
        one, other, both = self.one.judge(), self.other.judge(), self.how == "&"

        def holds(now: Moment) -> bool:
            first, second = one(now), other(now)
            return (first and second) if both else (first or second)

        return holds

    def __repr__(self) -> str:
        return f"({self.one!r} {self.how} {self.other!r})"


@dataclass(frozen=True, repr=False)
class Not(Condition):
    """The negation of a condition."""

    one: Condition

    @property
    def feels(self) -> bool:  # type: ignore[override]
        """True if it needs a force estimate."""
        return self.one.feels

    def check(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Check the condition."""
        self.one.check(contact, controller)

    def judge(self) -> Judge:
        """Return a judge of the negation."""
        one = self.one.judge()
        return lambda now: not one(now)

    def __repr__(self) -> str:
        return f"~{self.one!r}"


@dataclass(frozen=True, repr=False)
class Lasting(Condition):
    """A condition that has held without a break; at its first tick the duration is 0."""

    one: Condition
    seconds: float

    def __post_init__(self) -> None:
        """Check the time."""
        number(self.seconds, "lasting", 0.0, unit="s")

    @property
    def feels(self) -> bool:  # type: ignore[override]
        """True if it needs a force estimate."""
        return self.one.feels

    def check(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Check the condition."""
        self.one.check(contact, controller)

    def judge(self) -> Judge:
        """Return a judge that measures the duration."""
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
