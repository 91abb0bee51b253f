"""The rest pose: whether the arm can lie there, and whether the way there is free."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant import OutOfRangeError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant import Model
    from pliant.arm.points import Points

    Array = NDArray[np.float64]

#: Poses that are looked at on the way.
STEPS = 60
#: How far a point of the model may be inside the table [m]: models are as good as that.
TOLERANCE = 0.005


def check_rest(model: Model, points: Points, rest: Array, table: float | None) -> None:
    """See that the arm is above its table in a rest pose (n,) [rad].

    Raises:
        OutOfRangeError: It is inside.
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
    """Return why the way from q to the rest pose, straight through joint space, is not free.

    Both ends are inside the joint limits, and so is all that lies between. A point that begins
    inside the table may stay as deep as it began.

    Args:
        model: The arm.
        points: Its points.
        q: Where it stands (n,) [rad].
        rest: The rest pose (n,) [rad].
        table: Height of the table in base axes [m]; None: there is none.
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
