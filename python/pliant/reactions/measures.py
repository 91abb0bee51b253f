"""Conditions on measured quantities: force, evidence, deviation, speed, time, saturation."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant._core import ConfigError, ContactEstimator, Controller, OutOfRangeError
from pliant._validation import AXES, format_value, number, positive, rounded_up
from pliant.reactions.conditions import Condition, Judge
from pliant.reactions.moment import indices

if TYPE_CHECKING:
    from pliant.reactions.moment import Moment


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
        accept: ``("thresholds",)`` uses the threshold without regard to the uncertainty.
    """

    axes: str
    above: float | None = None
    below: float | None = None
    toward: Literal["both", "+", "-"] = "both"
    accept: tuple[str, ...] = ()
    feels = True

    def __post_init__(self) -> None:
        """Check the arguments once."""
        indices(self.axes)
        _one_side(self.above, self.below, "Force")
        if self.toward not in {"both", "+", "-"}:
            raise ConfigError(f"Force.toward is 'both', '+' or '-', not {self.toward!r}")
        unknown = set(self.accept) - {"thresholds"}
        if unknown:
            raise ConfigError(f"Force.accept knows 'thresholds', not {sorted(unknown)}")

    def check(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Reject a threshold that the arm at rest cannot distinguish from its own friction."""
        if contact is None:
            return
        indices(self.axes, contact.axes)
        if self.accept or self.above is None:
            return
        least = contact.guard * contact.typical_uncertainty()
        for axis in indices(self.axes):
            if self.above < least[axis]:
                unit = "N" if axis < 3 else "N·m"
                raise OutOfRangeError(
                    f"{self!r}: {AXES[axis]} = {self.above:g} {unit} is outside "
                    f"[{rounded_up(least[axis])}, ∞): below it this arm, at rest in the median "
                    "pose, cannot tell a contact from friction, k_p and gravity; raise it, say in "
                    "ContactEstimator(...) how well the arm is known, or accept=('thresholds',)"
                )

    def judge(self) -> Judge:
        """Return a judge that compares with the larger of threshold and uncertainty."""
        chosen = list(indices(self.axes))
        sign = {"both": 0.0, "+": 1.0, "-": -1.0}[self.toward]

        def holds(now: Moment) -> bool:
            felt = now.force()
            force = felt.force[chosen]
            size = sign * force if sign else np.abs(force)
            if self.above is None:
                return bool(np.all(size < (self.below or 0.0)))
            least = 0.0 if self.accept else now.guard * felt.uncertainty[chosen]
            return bool(np.any(size > np.maximum(self.above, least)))

        return holds

    def __repr__(self) -> str:
        side = "" if self.toward == "both" else f", toward={self.toward!r}"
        accept = f", accept={self.accept!r}" if self.accept else ""
        return f"Force({_threshold(self.axes, self.above, self.below)}{side}{accept})"


@dataclass(frozen=True, repr=False)
class Touched(Condition):
    """The contact estimate reports `touch` or `stop` on one of these axes.

    Args:
        axes: Axis key of the task frame.
        kind: Which of the two events.
    """

    axes: str = "all"
    kind: Literal["touch", "stop"] = "touch"
    feels = True

    def __post_init__(self) -> None:
        """Check the arguments once."""
        indices(self.axes)
        if self.kind not in {"touch", "stop"}:
            raise ConfigError(f"Touched.kind is 'touch' or 'stop', not {self.kind!r}")

    def judge(self) -> Judge:
        """Return a judge of the events."""
        chosen, stop = list(indices(self.axes)), self.kind == "stop"

        def holds(now: Moment) -> bool:
            felt = now.force()
            return bool((felt.stop if stop else felt.touch)[chosen].any())

        return holds

    def __repr__(self) -> str:
        return f"Touched({self.axes!r}, {self.kind!r})"


@dataclass(frozen=True, repr=False)
class Evidence(Condition):
    """The residual of some joint exceeds `above` times its uncertainty: a contact somewhere.

    It detects a contact earlier than any axis does, anywhere on the arm, but gives neither its
    place nor its force.
    """

    above: float = 1.0
    feels = True

    def __post_init__(self) -> None:
        """Check the number."""
        _one_side(self.above, None, "Evidence")

    def judge(self) -> Judge:
        """Return a judge of the joint residuals."""
        return lambda now: now.force().residual_ratio > self.above

    def __repr__(self) -> str:
        return f"Evidence(above={self.above:g})"


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

    def check(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Reject axes that are not in the task."""
        indices(self.axes, controller.settings.task.names)

    @abstractmethod
    def _measure(self, now: Moment) -> np.ndarray:
        """Return the quantity for all axes of the task."""

    def judge(self) -> Judge:
        """Return a judge that compares the magnitude."""

        def holds(now: Moment) -> bool:
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

    def _measure(self, now: Moment) -> np.ndarray:
        return now.deviation


class Speed(_OfTask):
    """The tool moves along some axis faster than `above`, or along all slower than `below`.

    Args:
        axes: Axis key of the task.
        above, below: Threshold [m/s], for rotations [rad/s]; exactly one of them.
    """

    def _measure(self, now: Moment) -> np.ndarray:
        return now.speed


@dataclass(frozen=True, repr=False)
class Elapsed(Condition):
    """A time [s] has passed since the monitor started; in `until`, since the reaction began."""

    seconds: float

    def __post_init__(self) -> None:
        """Check the time."""
        number(self.seconds, "Elapsed.seconds", 0.0, unit="s")

    def judge(self) -> Judge:
        """Return a judge that counts from the first tick."""
        passed = -1.0

        def holds(now: Moment) -> bool:
            nonlocal passed
            passed = 0.0 if passed < 0.0 else passed + now.dt
            return passed >= self.seconds - 1e-9

        return holds

    def __repr__(self) -> str:
        return f"Elapsed({self.seconds:g})"


@dataclass(frozen=True, repr=False)
class Saturated(Condition):
    """The torque of a servo is at its limit; any joint unless named."""

    joints: tuple[str, ...] = ()
    feels = True

    def __post_init__(self) -> None:
        """Check that it is a list of names, not a string, which is a list of letters."""
        if isinstance(self.joints, str) or not isinstance(self.joints, Iterable):
            raise ConfigError(
                f"Saturated.joints must be names, as in ('elbow_pitch',), got "
                f"{format_value(self.joints)}"
            )

    def check(self, contact: ContactEstimator | None, controller: Controller) -> None:
        """Reject joints that the arm does not have."""
        known = controller.model.joint_names
        unknown = [name for name in self.joints if name not in known]
        if unknown:
            raise ConfigError(f"no joint {', '.join(unknown)}; there are {', '.join(known)}")

    def judge(self) -> Judge:
        """Return a judge of the saturated servos."""

        def holds(now: Moment) -> bool:
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
