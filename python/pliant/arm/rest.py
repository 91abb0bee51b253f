"""Checks of the rest pose and of the path to it against the table."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import OutOfRangeError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant._core import Model
    from pliant.arm.points import Points

    Array = NDArray[np.float64]

#: Number of poses checked along the path.
STEPS = 60
#: Depth by which a point may be inside the table, as models are not exact [m].
TOLERANCE = 0.005


def check_rest(model: Model, points: Points, rest: Array, table: float | None) -> None:
    """Check that the arm is above its table in a rest pose (n,) [rad].

    Raises:
        OutOfRangeError: A point of the arm is inside the table.
    """
    if table is None:
        return
    height = points(rest).position[:, 2]
    lowest = int(height.argmin())
    if height[lowest] < table - TOLERANCE:
        raise OutOfRangeError(
            f"rest_q: {_name(model, lowest)} would be {table - height[lowest]:.3f} m inside the "
            f"table at z = {table:g} m; `pliant servos doctor ARM --watch` prints the pose in "
            "which you lay the arm down"
        )


def obstacle(
    model: Model, points: Points, q: Array, rest: Array, table: float | None
) -> str | None:
    """Return why the straight joint-space path from q to the rest pose is blocked, or None.

    Both ends are inside the joint limits, so every pose between them is too. A point that starts
    inside the table may stay at that depth.

    Args:
        model: The arm.
        points: Its points.
        q: Present joint positions (n,) [rad].
        rest: The rest pose (n,) [rad].
        table: Height of the table in base axes [m]; None: no table.
    """
    if table is None:
        return None
    start = points(q).position[:, 2]
    way = np.array(
        [points(q + s * (rest - q)).position[:, 2] for s in np.linspace(0.0, 1.0, STEPS)]
    )
    depth = np.where(way < np.minimum(table - TOLERANCE, start) - 1e-9, table - way, 0.0)
    if not depth.any():
        return None
    worst = int(depth.max(axis=0).argmax())
    return (
        f"the way to the rest pose leads {_name(model, worst)} {depth.max():.3f} m into the table"
    )


def _name(model: Model, point: int) -> str:
    """Return the name of a point of the arm."""
    return "the tool" if point >= model.n else model.joint_names[point]
