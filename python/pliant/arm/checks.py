"""Checks of joint vectors and times from the caller."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError, OutOfRangeError, ShapeError
from pliant._validation import given, real

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

    from pliant._core import Model

    Array = NDArray[np.float64]

#: Distance outside the position limits up to which a pose is clipped to them, and up to which a
#: joint counts as inside [rad].
SLACK = 0.1
#: Largest `comm_timeout` [s].
LONGEST_HOLD = 60.0


def vector(model: Model, value: ArrayLike, name: str, *, finite: bool = True) -> Array:
    """Return `value` as a joint vector (n,).

    Raises:
        ShapeError: Wrong shape, or not real numbers. OutOfRangeError: Not finite, if `finite`.
    """
    try:
        raw = np.asarray(value)
        # NumPy would convert bool, complex and text silently.
        array = None if raw.dtype.kind in "bcUS" else np.array(raw, dtype=np.float64)
    except (TypeError, ValueError):
        array = None
    if array is None:
        raise ShapeError(f"{name} must be {model.n} real numbers, got {given(value)}")
    if array.shape != (model.n,):
        raise ShapeError(f"{name} has shape {array.shape}, expected ({model.n},)")
    if finite and not np.isfinite(array).all():
        raise OutOfRangeError(f"{name} is not finite, nothing was sent: {array.tolist()}")
    return array


def times(rate: float, comm_timeout: float, watchdog: float) -> tuple[float, float, float]:
    """Return checked rate [Hz], `comm_timeout` [s] and watchdog [s]; see `Arm`.

    Raises:
        ConfigError: A value is not a number or out of range.
    """
    rate, comm_timeout = real(rate, "rate"), real(comm_timeout, "comm_timeout")
    watchdog = real(watchdog, "watchdog")
    if not 0.0 < rate < np.inf:
        raise ConfigError(f"rate must be above 0 Hz and finite, got {rate:g}")
    if not 0.0 < comm_timeout <= LONGEST_HOLD:
        raise ConfigError(
            f"comm_timeout must be above 0 s and at most {LONGEST_HOLD:g} s, got {comm_timeout:g}: "
            "an arm whose bus is silent is lowered after that"
        )
    if not 0.0 <= watchdog < np.inf:
        raise ConfigError(f"watchdog must be 0 s (never) or more and finite, got {watchdog:g}")
    return rate, comm_timeout, watchdog


def posture(model: Model, value: ArrayLike, name: str) -> Array:
    """Return a checked pose (n,) [rad], clipped to the position limits.

    Raises:
        ShapeError, OutOfRangeError: Not a joint vector, or more than `SLACK` outside the limits.
    """
    pose = vector(model, value, name)
    for joint, q, least, most in outside(model, pose):
        raise OutOfRangeError(
            f"{name}: {joint} = {q:g} rad is outside of {least:.3g} to {most:.3g} rad"
            + (": are these degrees?" if abs(q) > 2.0 * np.pi else "")
        )
    return np.clip(pose, model.lower, model.upper)


def outside(model: Model, q: Array) -> Iterator[tuple[str, float, float, float]]:
    """Yield the joints of q (n,) [rad] that are more than `SLACK` outside their limits.

    Yields:
        Name, position and limits of each [rad].
    """
    for row in zip(model.joint_names, q.tolist(), model.lower, model.upper, strict=True):
        _, here, low, high = row
        if not low - SLACK <= here <= high + SLACK:
            yield row
