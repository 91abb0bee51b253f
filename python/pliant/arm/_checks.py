"""Checks of joint vectors, times and poses from the caller."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError, OutOfRangeError, ShapeError
from pliant._validation import format_value, real

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike

    from pliant._core import ArmPoints, Model
    from pliant._typing import Array


#: A position up to this far outside its limits is accepted; a requested pose is then clipped [rad].
SLACK = 0.1
#: Largest `comm_timeout` [s].
MAX_COMM_TIMEOUT = 60.0


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
        raise ShapeError(f"{name} must be {model.n} real numbers, got {format_value(value)}")
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
    if not 0.0 < comm_timeout <= MAX_COMM_TIMEOUT:
        raise ConfigError(
            f"comm_timeout must be above 0 s and at most {MAX_COMM_TIMEOUT:g} s, got "
            f"{comm_timeout:g}: an arm whose bus is silent is lowered after that"
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
    for joint, q, low, high in outside(model, pose):
        raise OutOfRangeError(
            f"{name}: {joint} = {q:g} rad is outside of {low:.3g} to {high:.3g} rad"
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


#: Number of poses checked along the path.
STEPS = 60
#: Depth by which a point of the model may be inside the table, because models are not exact [m].
TOLERANCE = 0.005


def check_rest(model: Model, points: ArmPoints, rest: Array, table: float | None) -> None:
    """Check that the arm is above its table in a rest pose (n,) [rad].

    Raises:
        OutOfRangeError: A point of the arm is inside the table.
    """
    if table is None:
        return
    height = points.position(rest)[:, 2]
    lowest = int(height.argmin())
    if height[lowest] < table - TOLERANCE:
        raise OutOfRangeError(
            f"rest_q: {_point_name(model, lowest)} would be {table - height[lowest]:.3f} m inside "
            f"the table at z = {table:g} m; `pliant servos doctor ARM --watch` prints the pose in "
            "which you lay the arm down"
        )


def path_obstacle(
    model: Model, points: ArmPoints, q: Array, rest: Array, table: float | None
) -> str | None:
    """Return why the straight path from q to the rest pose (n,) [rad] is blocked, or None.

    Both ends are inside the joint limits, so every pose between them is too. A point that starts
    inside the table may stay at that depth.
    """
    if table is None:
        return None
    start = points.position(q)[:, 2]
    heights = np.array(
        [points.position(q + s * (rest - q))[:, 2] for s in np.linspace(0.0, 1.0, STEPS)]
    )
    depth = np.where(heights < np.minimum(table - TOLERANCE, start) - 1e-9, table - heights, 0.0)
    if not depth.any():
        return None
    worst = int(depth.max(axis=0).argmax())
    name = _point_name(model, worst)
    return f"the way to the rest pose leads {name} {depth.max():.3f} m into the table"


def _point_name(model: Model, point: int) -> str:
    """Return the name of a point of the arm."""
    return "the tool" if point >= model.n else model.joint_names[point]
