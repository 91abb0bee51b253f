"""Conditions on measured quantities, combined with ``&``, ``|`` and ``~``, and their duration.

A condition is a description: it can be printed, compared and used in several reactions. Its state,
e.g. how long it has held, is in the function that `evaluator()` returns.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant._core import (
    ConfigError,
    ContactEstimator,
    Controller,
    OutOfRangeError,
    Task,
    WrenchEstimate,
)
from pliant._validation import AXES, format_value, number, positive, rounded_up

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant._typing import Array


@dataclass(frozen=True)
class TickContext:
    """Data of one tick.

    Attributes:
        controller: Controller of the arm.
        time: Time since the monitor started [s].
        dt: Time since the last tick [s].
        q: Measured joint positions (n,) [rad].
        tool: Measured pose of the tool (4, 4).
        target: The caller's target pose (4, 4).
        wrench: Estimated wrench on the tool; None if no condition needs it.
        guard: Multiple of the uncertainty that a force must exceed to count.
    """

    controller: Controller
    time: float
    dt: float
    q: Array
    tool: Array
    target: Array
    wrench: WrenchEstimate | None
    guard: float = 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the task's axes."""
        return self.controller.settings.task.names

    @property
    def deviation(self) -> Array:
        """Target minus actual (k,) [m, rad] at the last step, task frame."""
        return self.controller.diagnostics.deviation

    @property
    def speed(self) -> Array:
        """Velocity of the tool (k,) [m/s, rad/s] along the task's axes."""
        velocity = (
            self.controller.diagnostics.velocity if self.wrench is None else self.wrench.velocity
        )
        moved: Array = self.controller.diagnostics.task_jacobian @ velocity
        return moved

    def force(self) -> WrenchEstimate:
        """Return the estimated wrench on the tool.

        Raises:
            ConfigError: The monitor has no contact estimator.
        """
        if self.wrench is None:
            raise ConfigError(
                "this monitor has no force estimate: give it contact=ContactEstimator(...)"
            )
        return self.wrench

    @property
    def base_from_task(self) -> Array:
        """Axes of the task (3, 3) as columns, in base axes."""
        frame = self.controller.settings.task.frame
        if isinstance(frame, str):
            return self.tool[:3, :3] if frame == "tool" else np.eye(3)
        return frame


def indices(axes: str, names: Sequence[str] = AXES) -> tuple[int, ...]:
    """Return the indices of an axis key's axes in `names`.

    Raises:
        ConfigError: The key is invalid, or an axis is not among the names.
    """
    requested = Task(axes).names
    absent = [name for name in requested if name not in names]
    if absent:
        raise ConfigError(
            f"axes {', '.join(absent)} are not of this task; it has {' '.join(names)}"
        )
    return tuple(list(names).index(name) for name in requested)


#: Evaluates a condition at a tick; to be called exactly once per tick.
Evaluator = Callable[["TickContext"], bool]


class Condition(ABC):
    """A condition that is evaluated once per tick."""

    @property
    def needs_force(self) -> bool:
        """True if it needs a force estimate."""
        return False

    @abstractmethod
    def evaluator(self) -> Evaluator:
        """Return a new evaluator of this condition, a function called once per tick."""

    def validate(  # noqa: B027 - optional for a subclass
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

    def for_seconds(self, seconds: float) -> Condition:
        """Return a condition that holds once this one has held without a break for so long [s]."""
        return Lasting(self, seconds)


def condition(value: object, name: str) -> Condition:
    """Return the value if it is a condition.

    Raises:
        TypeError: It is not; the message names valid conditions.
    """
    if not isinstance(value, Condition):
        wanted = "a condition, as Force('z', above=8.0) or After(1.0)"
        raise TypeError(f"{name} must be {wanted}, got {format_value(value)}")
    return value


@dataclass(frozen=True, repr=False)
class Joined(Condition):
    """Two conditions joined by ``&`` or ``|``."""

    how: Literal["&", "|"]
    one: Condition
    other: Condition

    @property
    def needs_force(self) -> bool:
        """True if one of them needs a force estimate."""
        return self.one.needs_force or self.other.needs_force

    def validate(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Check both conditions; see `Condition.validate`."""
        self.one.validate(contact, controller)
        self.other.validate(contact, controller)

    def evaluator(self) -> Evaluator:
        """Return an evaluator that calls both at every tick, so that both track durations."""
        one, other, both = self.one.evaluator(), self.other.evaluator(), self.how == "&"

        def holds(now: TickContext) -> bool:
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
    def needs_force(self) -> bool:
        """True if it needs a force estimate."""
        return self.one.needs_force

    def validate(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Check the condition."""
        self.one.validate(contact, controller)

    def evaluator(self) -> Evaluator:
        """Return a judge of the negation."""
        one = self.one.evaluator()
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
        number(self.seconds, "for_seconds", 0.0, unit="s")

    @property
    def needs_force(self) -> bool:
        """True if it needs a force estimate."""
        return self.one.needs_force

    def validate(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Check the condition."""
        self.one.validate(contact, controller)

    def evaluator(self) -> Evaluator:
        """Return a judge that measures the duration."""
        one, lasted = self.one.evaluator(), -1.0

        def holds(now: TickContext) -> bool:
            nonlocal lasted
            if not one(now):
                lasted = -1.0
                return False
            lasted = 0.0 if lasted < 0.0 else lasted + now.dt
            return lasted >= self.seconds - 1e-9

        return holds

    def __repr__(self) -> str:
        return f"{self.one!r}.for_seconds({self.seconds:g})"


def _one_side(above: float | None, below: float | None, what: str) -> None:
    """Check that exactly one threshold is given, and that it is positive."""
    sides = {"above": above, "below": below}
    thresholds = {name: value for name, value in sides.items() if value is not None}
    if len(thresholds) != 1:
        raise ConfigError(
            f"{what} needs either above or below, got above={above!r}, below={below!r}"
        )
    for name, value in thresholds.items():
        positive(value, f"{what}.{name}")


@dataclass(frozen=True, repr=False)
class Force(Condition):
    """The force on some axis is above `above`, or on all axes below `below`.

    A force counts only above its present uncertainty (times the contact's `guard`): near a
    singular pose, where the force on an axis cannot be estimated, the condition does not hold.

    Args:
        axes: Axis key of the task frame.
        above, below: Threshold [N], for rotations [N·m]; exactly one of them.
        toward: Direction of the pushes that count.
        accept_thresholds: Use the threshold without regard to the uncertainty.
    """

    axes: str
    above: float | None = None
    below: float | None = None
    toward: Literal["both", "+", "-"] = "both"
    accept_thresholds: bool = False
    needs_force = True

    def __post_init__(self) -> None:
        """Check the arguments once."""
        indices(self.axes)
        _one_side(self.above, self.below, "Force")
        if self.toward not in {"both", "+", "-"}:
            raise ConfigError(f"Force.toward is 'both', '+' or '-', not {self.toward!r}")

    def validate(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Reject a threshold that the arm at rest cannot distinguish from its own friction."""
        if contact is None:
            return
        indices(self.axes, contact.axes)
        if self.accept_thresholds or self.above is None:
            return
        bound = contact.guard * contact.typical_uncertainty()
        for axis in indices(self.axes):
            if self.above < bound[axis]:
                unit = "N" if axis < 3 else "N·m"
                raise OutOfRangeError(
                    f"{self!r}: {AXES[axis]} = {self.above:g} {unit} is outside "
                    f"[{rounded_up(bound[axis])}, ∞): below it this arm, at rest in a typical "
                    "pose, cannot tell a contact from friction, k_p and gravity; raise it, say in "
                    "ContactEstimator(...) how well the arm is known, or accept_thresholds=True"
                )

    def evaluator(self) -> Evaluator:
        """Return a judge that compares with the larger of threshold and uncertainty."""
        chosen = list(indices(self.axes))
        sign = {"both": 0.0, "+": 1.0, "-": -1.0}[self.toward]

        def holds(now: TickContext) -> bool:
            wrench = now.force()
            force = wrench.force[chosen]
            size = sign * force if sign else np.abs(force)
            if self.above is None:
                return bool(np.all(size < (self.below or 0.0)))
            bound = 0.0 if self.accept_thresholds else now.guard * wrench.uncertainty[chosen]
            return bool(np.any(size > np.maximum(self.above, bound)))

        return holds

    def __repr__(self) -> str:
        side = "" if self.toward == "both" else f", toward={self.toward!r}"
        accept = ", accept_thresholds=True" if self.accept_thresholds else ""
        return f"Force({_threshold(self.axes, self.above, self.below)}{side}{accept})"


@dataclass(frozen=True, repr=False)
class ContactEvent(Condition):
    """The contact estimate reports `touch` or `stop` on one of these axes.

    Args:
        axes: Axis key of the task frame.
        kind: Which of the two events.
    """

    axes: str = "all"
    kind: Literal["touch", "stop"] = "touch"
    needs_force = True

    def __post_init__(self) -> None:
        """Check the arguments once."""
        indices(self.axes)
        if self.kind not in {"touch", "stop"}:
            raise ConfigError(f"ContactEvent.kind is 'touch' or 'stop', not {self.kind!r}")

    def evaluator(self) -> Evaluator:
        """Return a judge of the events."""
        chosen, stop = list(indices(self.axes)), self.kind == "stop"

        def holds(now: TickContext) -> bool:
            wrench = now.force()
            return bool((wrench.stop if stop else wrench.touch)[chosen].any())

        return holds

    def __repr__(self) -> str:
        return f"ContactEvent({self.axes!r}, {self.kind!r})"


@dataclass(frozen=True, repr=False)
class ResidualAbove(Condition):
    """The residual of some joint exceeds `above` times its uncertainty: a contact somewhere.

    It detects a contact earlier than any axis does, anywhere on the arm, but gives neither its
    place nor its force.
    """

    above: float = 1.0
    needs_force = True

    def __post_init__(self) -> None:
        """Check the number."""
        _one_side(self.above, None, "ResidualAbove")

    def evaluator(self) -> Evaluator:
        """Return a judge of the joint residuals."""
        return lambda now: now.force().residual_ratio > self.above

    def __repr__(self) -> str:
        return f"ResidualAbove(above={self.above:g})"


@dataclass(frozen=True, repr=False)
class _OfTask(Condition):
    """A quantity along the task's axes: one is above, or all are below a threshold."""

    axes: str
    above: float | None = None
    below: float | None = None

    def __post_init__(self) -> None:
        """Check the arguments once."""
        indices(self.axes)
        _one_side(self.above, self.below, type(self).__name__)

    def validate(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Reject axes that are not in the task."""
        indices(self.axes, controller.settings.task.names)

    @abstractmethod
    def _measure(self, now: TickContext) -> np.ndarray:
        """Return the quantity for all axes of the task."""

    def evaluator(self) -> Evaluator:
        """Return a judge that compares the magnitude."""

        def holds(now: TickContext) -> bool:
            size = np.abs(self._measure(now)[list(indices(self.axes, now.names))])
            if self.above is None:
                return bool(np.all(size < (self.below or 0.0)))
            return bool(np.any(size > self.above))

        return holds

    def __repr__(self) -> str:
        return f"{type(self).__name__}({_threshold(self.axes, self.above, self.below)})"


class Deviation(_OfTask):
    """Some axis deviates from its target by more than `above`, or all by less than `below`.

    Args:
        axes: Axis key of the task.
        above, below: Threshold [m], for rotations [rad]; exactly one of them.
    """

    def _measure(self, now: TickContext) -> np.ndarray:
        return now.deviation


class Speed(_OfTask):
    """The tool moves along some axis faster than `above`, or along all slower than `below`.

    Args:
        axes: Axis key of the task.
        above, below: Threshold [m/s], for rotations [rad/s]; exactly one of them.
    """

    def _measure(self, now: TickContext) -> np.ndarray:
        return now.speed


@dataclass(frozen=True, repr=False)
class After(Condition):
    """A time [s] has passed since the monitor started; in `until`, since the reaction began."""

    seconds: float

    def __post_init__(self) -> None:
        """Check the time."""
        number(self.seconds, "After.seconds", 0.0, unit="s")

    def evaluator(self) -> Evaluator:
        """Return a judge that counts from the first tick."""
        passed = -1.0

        def holds(now: TickContext) -> bool:
            nonlocal passed
            passed = 0.0 if passed < 0.0 else passed + now.dt
            return passed >= self.seconds - 1e-9

        return holds

    def __repr__(self) -> str:
        return f"After({self.seconds:g})"


@dataclass(frozen=True, repr=False)
class Saturated(Condition):
    """The torque of a servo is at its limit; any joint unless named."""

    joints: tuple[str, ...] = ()
    needs_force = True

    def __post_init__(self) -> None:
        """Check that it is a list of names, not a string, which is a list of letters."""
        if isinstance(self.joints, str) or not isinstance(self.joints, Iterable):
            raise ConfigError(
                f"Saturated.joints must be names, as in ('elbow_pitch',), got "
                f"{format_value(self.joints)}"
            )

    def validate(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Reject joints that the arm does not have."""
        known = controller.model.joint_names
        unknown = [name for name in self.joints if name not in known]
        if unknown:
            raise ConfigError(f"no joint {', '.join(unknown)}; there are {', '.join(known)}")

    def evaluator(self) -> Evaluator:
        """Return a judge of the saturated servos."""

        def holds(now: TickContext) -> bool:
            names, cut = now.controller.model.joint_names, now.force().saturated
            if not self.joints:
                return bool(cut.any())
            return any(cut[list(names).index(name)] for name in self.joints)

        return holds

    def __repr__(self) -> str:
        return f"Saturated({', '.join(repr(name) for name in self.joints)})"


def _threshold(axes: str, above: float | None, below: float | None) -> str:
    """Format a threshold."""
    return f"{axes!r}, below={below:g}" if above is None else f"{axes!r}, above={above:g}"
