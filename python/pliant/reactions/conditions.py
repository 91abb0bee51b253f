"""Conditions on measured quantities; ``&``, ``|``, ``~`` and `for_seconds` combine them.

A `Condition` is an immutable description that can be printed, compared and used in several
reactions. Its method `evaluator()` returns a function that evaluates the condition once per tick
and keeps the state, such as the time for which the condition has been true.
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
    """Data of one tick (control cycle), for conditions and actions.

    Attributes:
        controller: Controller of the arm.
        time: Time since the first update of the monitor [s].
        dt: Time since the last tick [s].
        q: Measured joint positions (n,) [rad].
        tool: Measured pose of the tool (4, 4).
        target: The caller's target pose (4, 4).
        wrench: Estimated wrench on the tool; None: the monitor has no contact estimator.
        guard: A force counts only if it exceeds its uncertainty times this factor [1].
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
        """Names of the k task axes."""
        return self.controller.settings.task.names

    @property
    def deviation(self) -> Array:
        """Target minus actual pose along the task axes, at the last step (k,) [m, rad]."""
        return self.controller.diagnostics.deviation

    @property
    def speed(self) -> Array:
        """Velocity of the tool along the task axes (k,) [m/s, rad/s]."""
        velocity = (
            self.controller.diagnostics.velocity if self.wrench is None else self.wrench.velocity
        )
        return self.controller.diagnostics.task_jacobian @ velocity

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
        """Rotation matrix (3, 3) that turns vectors from task-frame axes to base axes."""
        frame = self.controller.settings.task.frame
        if isinstance(frame, str):
            return self.tool[:3, :3] if frame == "tool" else np.eye(3)
        return frame


def indices(axes: str, names: Sequence[str] = AXES) -> tuple[int, ...]:
    """Return the indices in `names` of the axes in a text such as "x yaw".

    Raises:
        ConfigError: The text is invalid, or an axis is not in `names`.
    """
    requested = Task(axes).names
    absent = [name for name in requested if name not in names]
    if absent:
        raise ConfigError(
            f"axes {', '.join(absent)} are not of this task; it has {' '.join(names)}"
        )
    return tuple(list(names).index(name) for name in requested)


#: Function that returns True if a condition is true; it must be called exactly once per tick.
Evaluator = Callable[["TickContext"], bool]


class Condition(ABC):
    """Base class of conditions, which are evaluated once per tick (control cycle)."""

    @property
    def needs_force(self) -> bool:
        """True if the condition needs an estimate of the contact force."""
        return False

    @abstractmethod
    def evaluator(self) -> Evaluator:
        """Return a new function that evaluates the condition; it is called once per tick."""

    def validate(  # noqa: B027 - optional for a subclass
        self, contact: ContactEstimator | None, controller: Controller
    ) -> None:
        """Check that the condition can be evaluated for the arm of a controller.

        Raises:
            ConfigError: An axis or joint does not exist.
            OutOfRangeError: A threshold is below the uncertainty of the force estimate.
        """

    def __and__(self, other: Condition) -> Condition:
        """Return a condition that is true while both conditions are true."""
        return Joined("&", self, condition(other, "what follows &"))

    def __or__(self, other: Condition) -> Condition:
        """Return a condition that is true while at least one of the two conditions is true."""
        return Joined("|", self, condition(other, "what follows |"))

    def __invert__(self) -> Condition:
        """Return a condition that is true while this condition is false."""
        return Not(self)

    def __bool__(self) -> bool:
        """Reject `and`, `or` and `not`, which cannot be overloaded in Python.

        Raises:
            TypeError: In any case.
        """
        raise TypeError("join conditions with &, | and ~, not with and, or, not")

    def for_seconds(self, seconds: float) -> Condition:
        """Return a condition that is true after this one has been true for `seconds` [s].

        A tick in which this condition is false restarts the time.
        """
        return Lasting(self, seconds)


def condition(value: object, name: str) -> Condition:
    """Return `value` if it is a condition; `name` is the name of the value in the error message.

    Raises:
        TypeError: The value is not a condition.
    """
    if not isinstance(value, Condition):
        expected = "a condition, as Force('z', above=8.0) or After(1.0)"
        raise TypeError(f"{name} must be {expected}, got {format_value(value)}")
    return value


@dataclass(frozen=True, repr=False)
class Joined(Condition):
    """Two conditions joined by ``&`` or ``|``."""

    operator: Literal["&", "|"]
    first: Condition
    other: Condition

    @property
    def needs_force(self) -> bool:
        """True if one of the two conditions needs an estimate of the contact force."""
        return self.first.needs_force or self.other.needs_force

    def validate(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Check that both conditions can be evaluated for the arm of the controller."""
        self.first.validate(contact, controller)
        self.other.validate(contact, controller)

    def evaluator(self) -> Evaluator:
        """Return a function that combines both conditions.

        It evaluates both in every tick, because a condition may measure how long it has been true.
        """
        first, other, both = self.first.evaluator(), self.other.evaluator(), self.operator == "&"

        def holds(tick: TickContext) -> bool:
            a, b = first(tick), other(tick)
            return (a and b) if both else (a or b)

        return holds

    def __repr__(self) -> str:
        return f"({self.first!r} {self.operator} {self.other!r})"


@dataclass(frozen=True, repr=False)
class _Modified(Condition):
    """Base class of conditions that modify another condition, `inner`."""

    inner: Condition

    @property
    def needs_force(self) -> bool:
        """True if the inner condition needs a force estimate."""
        return self.inner.needs_force

    def validate(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Check the inner condition."""
        self.inner.validate(contact, controller)


@dataclass(frozen=True, repr=False)
class Not(_Modified):
    """The negation of a condition."""

    def evaluator(self) -> Evaluator:
        """Return a function that evaluates the negation."""
        inner = self.inner.evaluator()
        return lambda tick: not inner(tick)

    def __repr__(self) -> str:
        return f"~{self.inner!r}"


@dataclass(frozen=True, repr=False)
class Lasting(_Modified):
    """True if the condition `inner` has been true without a break for `seconds` [s].

    In the first tick in which `inner` is true, the duration is 0.
    """

    seconds: float

    def __post_init__(self) -> None:
        """Check that `seconds` is a number and not negative."""
        number(self.seconds, "for_seconds", 0.0, unit="s")

    def evaluator(self) -> Evaluator:
        """Return a function that measures for how long `inner` has been true."""
        inner, duration = self.inner.evaluator(), -1.0

        def holds(tick: TickContext) -> bool:
            nonlocal duration
            if not inner(tick):
                duration = -1.0
                return False
            duration = 0.0 if duration < 0.0 else duration + tick.dt
            return duration >= self.seconds - 1e-9

        return holds

    def __repr__(self) -> str:
        return f"{self.inner!r}.for_seconds({self.seconds:g})"


def _check_thresholds(above: float | None, below: float | None, what: str) -> None:
    """Check that `above` or `below` of the condition `what` is given, not both, and is positive."""
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
    """True while the contact force on any axis is above `above`, or on all axes below `below`.

    With `above`, a force must also exceed its uncertainty times `ContactEstimator.guard`. Near a
    singular pose, where a force cannot be estimated, the condition is therefore false.

    Args:
        axes: Names of axes of the task frame, e.g. "x yaw".
        above, below: Threshold [N], for rotations [N·m]; exactly one of them is given.
        toward: Direction of the forces that count: "+", "-" or "both".
        accept_thresholds: True: compare the force with the threshold only, not with the
            uncertainty, and accept any threshold.
    """

    axes: str
    above: float | None = None
    below: float | None = None
    toward: Literal["both", "+", "-"] = "both"
    accept_thresholds: bool = False
    needs_force = True

    def __post_init__(self) -> None:
        """Check the arguments."""
        indices(self.axes)
        _check_thresholds(self.above, self.below, "Force")
        if self.toward not in {"both", "+", "-"}:
            raise ConfigError(f"Force.toward is 'both', '+' or '-', not {self.toward!r}")

    def validate(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Reject a threshold `above` that is below the typical force uncertainty at rest."""
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
        """Return a function that compares the estimated force with threshold and uncertainty."""
        columns = list(indices(self.axes))
        sign = {"both": 0.0, "+": 1.0, "-": -1.0}[self.toward]

        def holds(tick: TickContext) -> bool:
            wrench = tick.force()
            force = wrench.force[columns]
            size = sign * force if sign else np.abs(force)
            if self.above is None:
                return bool(np.all(size < (self.below or 0.0)))
            bound = 0.0 if self.accept_thresholds else tick.guard * wrench.uncertainty[columns]
            return bool(np.any(size > np.maximum(self.above, bound)))

        return holds

    def __repr__(self) -> str:
        side = "" if self.toward == "both" else f", toward={self.toward!r}"
        accept = ", accept_thresholds=True" if self.accept_thresholds else ""
        return f"Force({_format_threshold(self.axes, self.above, self.below)}{side}{accept})"


@dataclass(frozen=True, repr=False)
class ContactEvent(Condition):
    """True while the contact estimator reports an event, `touch` or `stop`, on one of the axes.

    Args:
        axes: Names of axes of the task frame, e.g. "x yaw".
        kind: Name of the event, an attribute of `WrenchEstimate`.
    """

    axes: str = "all"
    kind: Literal["touch", "stop"] = "touch"
    needs_force = True

    def __post_init__(self) -> None:
        """Check the arguments."""
        indices(self.axes)
        if self.kind not in {"touch", "stop"}:
            raise ConfigError(f"ContactEvent.kind is 'touch' or 'stop', not {self.kind!r}")

    def evaluator(self) -> Evaluator:
        """Return a function that returns True if the event is reported on one of the axes."""
        columns, stop = list(indices(self.axes)), self.kind == "stop"

        def holds(tick: TickContext) -> bool:
            wrench = tick.force()
            return bool((wrench.stop if stop else wrench.touch)[columns].any())

        return holds

    def __repr__(self) -> str:
        return f"ContactEvent({self.axes!r}, {self.kind!r})"


@dataclass(frozen=True, repr=False)
class ResidualAbove(Condition):
    """True while the residual (external torque) of any joint exceeds `above` times its uncertainty.

    This condition detects a contact anywhere on the arm, but neither its place nor its force.
    """

    above: float = 1.0
    needs_force = True

    def __post_init__(self) -> None:
        """Check the threshold."""
        _check_thresholds(self.above, None, "ResidualAbove")

    def evaluator(self) -> Evaluator:
        """Return a function that compares the residuals of all joints with the threshold."""
        return lambda tick: tick.force().residual_ratio > self.above

    def __repr__(self) -> str:
        return f"ResidualAbove(above={self.above:g})"


@dataclass(frozen=True, repr=False)
class _TaskCondition(Condition):
    """Base class: true while a quantity is above a threshold on any axis, or below it on all."""

    axes: str
    above: float | None = None
    below: float | None = None

    def __post_init__(self) -> None:
        """Check the arguments."""
        indices(self.axes)
        _check_thresholds(self.above, self.below, type(self).__name__)

    def validate(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Reject axes that are not in the task."""
        indices(self.axes, controller.settings.task.names)

    @abstractmethod
    def _measure(self, tick: TickContext) -> np.ndarray:
        """Return the quantity that is compared with the threshold, along all task axes (k,)."""

    def evaluator(self) -> Evaluator:
        """Return a function that compares the magnitude of the quantity with the threshold."""

        def holds(tick: TickContext) -> bool:
            size = np.abs(self._measure(tick)[list(indices(self.axes, tick.names))])
            if self.above is None:
                return bool(np.all(size < (self.below or 0.0)))
            return bool(np.any(size > self.above))

        return holds

    def __repr__(self) -> str:
        return f"{type(self).__name__}({_format_threshold(self.axes, self.above, self.below)})"


class Deviation(_TaskCondition):
    """True while the deviation is above `above` on any axis, or below `below` on all axes.

    Args:
        axes: Names of task axes, e.g. "x yaw".
        above, below: Threshold [m], for rotations [rad]; exactly one of them is given.
    """

    def _measure(self, tick: TickContext) -> np.ndarray:
        return tick.deviation


class Speed(_TaskCondition):
    """True while the tool's speed along any axis is above `above`, or along all below `below`.

    Args:
        axes: Names of task axes, e.g. "x yaw".
        above, below: Threshold [m/s], for rotations [rad/s]; exactly one of them is given.
    """

    def _measure(self, tick: TickContext) -> np.ndarray:
        return tick.speed


@dataclass(frozen=True, repr=False)
class After(Condition):
    """True once `seconds` [s] have passed.

    The time counts from the first tick of the monitor, or, if the condition is the `until` of a
    reaction, from the beginning of this reaction.
    """

    seconds: float

    def __post_init__(self) -> None:
        """Check that `seconds` is a number and not negative."""
        number(self.seconds, "After.seconds", 0.0, unit="s")

    def evaluator(self) -> Evaluator:
        """Return a function that measures the time from its first call."""
        elapsed = -1.0

        def holds(tick: TickContext) -> bool:
            nonlocal elapsed
            elapsed = 0.0 if elapsed < 0.0 else elapsed + tick.dt
            return elapsed >= self.seconds - 1e-9

        return holds

    def __repr__(self) -> str:
        return f"After({self.seconds:g})"


@dataclass(frozen=True, repr=False)
class Saturated(Condition):
    """True while the torque of a servo is at its limit.

    Args:
        joints: Names of the joints that count; empty: all joints.
    """

    joints: tuple[str, ...] = ()
    needs_force = True

    def __post_init__(self) -> None:
        """Check that `joints` is a sequence of names and not a single text."""
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
        """Return a function that returns True if one of the joints is at its torque limit."""

        def holds(tick: TickContext) -> bool:
            names, saturated = tick.controller.model.joint_names, tick.force().saturated
            if not self.joints:
                return bool(saturated.any())
            return any(saturated[list(names).index(name)] for name in self.joints)

        return holds

    def __repr__(self) -> str:
        return f"Saturated({self.joints!r})" if self.joints else "Saturated()"


def _format_threshold(axes: str, above: float | None, below: float | None) -> str:
    """Return axes and threshold of a condition as text, for its `repr`."""
    return f"{axes!r}, below={below:g}" if above is None else f"{axes!r}, above={above:g}"
