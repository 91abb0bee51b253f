"""Validation of function arguments; an error shows the argument's value and the allowed values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pliant._core import ConfigError, Model, OutOfRangeError, Servos, ShapeError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike

    from pliant._typing import Array

T = TypeVar("T")

#: Task axes in their order: translations [m], then rotations [rad].
AXES = ("x", "y", "z", "roll", "pitch", "yaw")

#: For each argument type, a phrase for error messages that says how to create such an object.
HINTS: dict[type, str] = {
    Model: "as pliant.robots.arm7(), .so101(), .koch() or Model.from_urdf(path) make one",
    Servos: "e.g. Servos.of(['sts3215'] * model.n)",
}


def format_value(value: Any) -> str:
    """Return a value and its type as text for an error message."""
    text = repr(value)
    return f"{text if len(text) <= 80 else text[:77] + '...'} ({type(value).__name__})"


def instance(value: Any, kind: type[T], name: str, hint: str = "") -> T:
    """Return `value` if it is an instance of `kind`.

    Raises:
        TypeError: `value` has another type; the message contains `hint`, or else that of `HINTS`.
    """
    if not isinstance(value, kind):
        hint = hint or HINTS.get(kind, "")
        article = "an" if kind.__name__[0] in "AEIOU" else "a"
        expected = f"{name} must be {article} {kind.__name__}" + (f", {hint}" if hint else "")
        raise TypeError(f"{expected}, got {format_value(value)}")
    return value


def mapping(value: Any, name: str, hint: str) -> Mapping[Any, Any]:
    """Return `value` if it is a mapping.

    Raises:
        TypeError: `value` is not a mapping; the message contains `hint`.
    """
    if not isinstance(value, Mapping):
        raise TypeError(f"{name} must be a mapping, {hint}, got {format_value(value)}")
    return value


def real(value: Any, name: str) -> float:
    """Return `value` as a float, finite or not.

    Raises:
        ConfigError: `value` is not a number.
    """
    if isinstance(value, (bool, str, bytes)) or np.ndim(value) != 0:
        raise ConfigError(f"{name} must be a number, got {format_value(value)}")
    try:
        return float(value)
    except (TypeError, ValueError):
        raise ConfigError(f"{name} must be a number, got {format_value(value)}") from None


def number(value: Any, name: str, low: float, high: float = np.inf, unit: str = "") -> float:
    """Return a finite number in [low, high].

    Raises:
        ConfigError: `value` is not a number.
        OutOfRangeError: The number is NaN, infinite or out of range.
    """
    out = real(value, name)
    if not (low <= out <= high and np.isfinite(out)):
        end = "∞)" if np.isinf(high) else f"{high:g}]"
        label = f" [{unit}]" if unit else ""
        raise OutOfRangeError(f"{name}{label} must be in [{low:g}, {end}, got {out:g}")
    return out


def positive(value: Any, name: str, unit: str = "") -> float:
    """Return a finite number above zero.

    Raises:
        ConfigError: `value` is not a number.
        OutOfRangeError: The number is NaN, infinite, zero or negative.
    """
    out = number(value, name, 0.0, unit=unit)
    if out == 0.0:
        label = f" [{unit}]" if unit else ""
        raise OutOfRangeError(f"{name}{label} must be above 0, got 0")
    return out


def vector(value: ArrayLike, n: int, name: str, unit: str = "") -> Array:
    """Return a new array (n,) of finite numbers.

    Raises:
        ShapeError: `value` has the wrong shape, or an entry is not a finite number.
    """
    label = f" [{unit}]" if unit else ""
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.array(np.nan)
    if array.shape != (n,) or not np.isfinite(array).all():
        raise ShapeError(f"{name} must be {n} finite numbers{label}, got {format_value(value)}")
    return array


def named_together(texts: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Return pairs of name and text in which the names with equal texts are joined by commas."""
    names: dict[str, list[str]] = {}
    for name, text in texts:
        names.setdefault(text, []).append(name)
    return [(", ".join(same), text) for text, same in names.items()]


def rounded_up(value: float) -> str:
    """Format a lower bound with three digits, rounded up so that the shown value is accepted."""
    digit = 10.0 ** (math.floor(math.log10(value)) - 2)
    return f"{math.ceil(value / digit) * digit:.3g}"
