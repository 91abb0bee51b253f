"""Validation of joint vectors, times and poses that the caller passes to `Arm`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError, OutOfRangeError, ShapeError
from pliant._validation import format_value, named_together, number, real

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import ArrayLike

    from pliant._core import ArmPoints, Joint, Model, PliantError
    from pliant._typing import Array


#: Error message if an arm without torque is used.
TORQUE_OFF = "torque is off: use `with connect(...) as arm`, or arm.enable()"
#: Type of joint vectors.
FLOAT = np.dtype(np.float64)
#: Distance by which an accepted joint position may exceed its limits [rad].
SLACK = 0.1
#: Largest accepted value of the argument `comm_timeout` [s].
MAX_COMM_TIMEOUT = 60.0
#: Largest accepted distance of a table from the origin of the base [m].
MAX_TABLE_HEIGHT = 100.0
#: A command of a loop is rejected if its tick began longer ago than both this many periods and this
#: time [s].
STALE_PERIODS, STALE = 5.0, 0.1
#: Remedy if joints cannot hold the weight of the model.
CHECK_WEIGHT = (
    "Check mass [kg] and com [m] of the payload, which is [robot] payload or an argument of "
    "Model.from_urdf, the masses of the URDF [kg], and the servo models with their Max Torque, "
    "Current or PWM Limit"
)
#: Largest differences in a joint's position [m] and orientation [rad] between two models of the
#: same robot, for example one from drawings and one that was measured.
MAX_SHIFT, MAX_TURN = 0.005, 0.05


def vector(model: Model, value: ArrayLike, name: str, *, finite: bool = True) -> Array:
    """Return `value` as a joint vector: a float array (n,), one entry per joint of the chain.

    An array that has this form already is returned without a copy.

    Raises:
        ShapeError: The value has the wrong shape, or is not made of real numbers.
        OutOfRangeError: `finite` is True, and an entry is not finite.
    """
    # Fast path for most calls.
    if type(value) is np.ndarray and value.dtype is FLOAT and value.shape == (model.n,):
        if finite and not all(map(math.isfinite, value.tolist())):
            raise OutOfRangeError(f"{name} is not finite, nothing was sent: {value.tolist()}")
        return value
    try:
        raw = np.asarray(value)
        # Reject bool, complex and text: NumPy would convert them to float without an error.
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


def check_same_robot(model: Model, arm: Model) -> None:
    """Check that a controller's model is of the same robot as the model of the arm.

    The names, types, placements and axes of the chain's joints are compared. Masses, limits,
    payload, gravity, base and tip may differ.

    Raises:
        ConfigError: The model is of another robot.
    """
    if model is arm:
        return
    if model.joint_names != arm.joint_names:
        which = f"joints {', '.join(model.joint_names)}, not {', '.join(arm.joint_names)}"
    elif (joint := _moved_joint(model, arm)) is not None:
        which = f"joint {joint} has another place, axis or type"
    else:
        return
    raise ConfigError(
        f"the controller is made for {model.name}, the arm is {arm.name} ({which}): make the "
        "controller with the model of the arm"
    )


def _moved_joint(model: Model, other: Model) -> str | None:
    """Return the first joint whose type, axis or origin differs in the two models, or None."""
    for a, b in zip(_chain(model), _chain(other), strict=True):
        if a.kind != b.kind:
            return a.name
        if not np.allclose(a.axis, b.axis, rtol=0.0, atol=MAX_TURN):
            return a.name
        change = np.asarray(a.origin.matrix) - np.asarray(b.origin.matrix)
        if np.abs(change[:3, 3]).max() > MAX_SHIFT or np.abs(change[:3, :3]).max() > MAX_TURN:
            return a.name
    return None


def _chain(model: Model) -> list[Joint]:
    """Return the independent joints of the chain in the order of `Model.joint_names`."""
    joints = {joint.name: joint for joint in model.joints}
    return [joints[name] for name in model.joint_names]


def times(rate: float, comm_timeout: float, watchdog: float) -> tuple[float, float, float]:
    """Validate arguments of `Arm`; return rate [Hz], `comm_timeout` [s] and watchdog [s] as floats.

    Raises:
        ConfigError: A value is not a number, or out of range.
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


def longest_command_age(rate: float) -> float:
    """Return the largest age of a tick [s] at which a loop at `rate` [Hz] sends its command."""
    return max(STALE_PERIODS / rate, STALE)


def posture(model: Model, value: ArrayLike, name: str) -> Array:
    """Validate a pose, joint positions (n,) [rad], and return it clipped to the position limits.

    Raises:
        ShapeError: The pose is not a joint vector.
        OutOfRangeError: The pose is not finite, or more than `SLACK` outside the limits.
    """
    pose = vector(model, value, name)
    for joint, q, low, high in outside(model, pose):
        raise OutOfRangeError(
            f"{name}: {joint} = {q:g} rad is outside of {low:.3g} to {high:.3g} rad"
            + (": are these degrees?" if abs(q) > 2.0 * np.pi else "")
        )
    return np.clip(pose, model.lower, model.upper)


def setting(error: PliantError) -> str:
    """Return the key of the setting that a `ConfigError` is about; empty for other errors."""
    key = error.key if isinstance(error, ConfigError) else None
    return key or ""


def join_faults(faults: Iterable[str]) -> str:
    """Return one text for faults `name: text`, with joints of equal texts named together."""
    parts = (fault.partition(": ") for fault in faults)
    return "; ".join(
        map("".join, named_together((name, colon + text) for name, colon, text in parts))
    )


def outside(model: Model, q: Array) -> Iterator[tuple[str, float, float, float]]:
    """Yield the joints whose position in q (n,) [rad] is more than `SLACK` outside its limits.

    Yields:
        Name, position [rad], lower and upper position limit [rad] of each such joint.
    """
    for row in zip(model.joint_names, q.tolist(), model.lower, model.upper, strict=True):
        _, position, low, high = row
        if not low - SLACK <= position <= high + SLACK:
            yield row


#: Number of poses that `path_obstacle` checks along a path.
STEPS = 60
#: Depth inside the table at which a point of the arm is still accepted, because models of arm and
#: table are not exact [m].
TOLERANCE = 0.005


def table_height(value: Any) -> float:
    """Return the height of a table in base axes [m].

    Raises:
        ConfigError: The value is not a number.
        OutOfRangeError: The number is not finite, or more than `MAX_TABLE_HEIGHT` from 0.
    """
    return number(value, "table", -MAX_TABLE_HEIGHT, MAX_TABLE_HEIGHT, unit="m")


def check_rest(
    model: Model, points: ArmPoints, rest: Array, table: float | None, *, name: str = "rest_q"
) -> None:
    """Check that no point of the arm is inside the table in the rest pose `rest` (n,) [rad].

    `table` is the height of the table in base axes [m]; None: nothing is checked. `name` is the
    name of the argument `rest` in error messages.

    Raises:
        OutOfRangeError: A point of the arm is inside the table.
    """
    if table is None:
        return
    height = points.position(rest)[:, 2]
    lowest = int(height.argmin())
    if height[lowest] < table - TOLERANCE:
        raise OutOfRangeError(
            f"{name}: {_point_name(model, lowest)} would be {table - height[lowest]:.3f} m inside "
            f"the table at z = {table:g} m; `pliant servos doctor ARM --watch` prints the pose in "
            "which you lay the arm down"
        )


def path_obstacle(
    model: Model, points: ArmPoints, q: Array, rest: Array, table: float | None
) -> str | None:
    """Return a sentence if the table blocks the path from q to `rest` (n,) [rad], else None.

    The path is straight in joint space, so it stays within the joint limits. A point of the arm
    that is inside the table at the start may stay at its height, but not go lower. `table` is the
    height of the table in base axes [m]; None: nothing is checked.
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
    """Return the joint name of the point with index `point` in `ArmPoints`, or "the tool"."""
    return "the tool" if point >= model.n else model.joint_names[point]
