"""Direction in which each joint moves the tool as its angle grows, for a visual check."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from pliant import Model

    Array = NDArray[np.float64]

#: Tool motion below which a joint only turns the tool in place [m/rad].
IN_PLACE = 0.02
#: Least share of the motion from which on an axis is named.
NAMED = 0.3


def ways(model: Model, q: ArrayLike, *, up: ArrayLike, falling: bool = False) -> tuple[str, ...]:
    """Describe the motion of the tool as each joint angle grows, in base axes.

    From the columns of the geometric Jacobian: the axes with most of the motion, with signs; if the
    tool turns in place, the axes of rotation.

    Args:
        model: The robot.
        q: Joint positions (n,) [rad].
        up: Upward vector (3,) in base axes; the axis along it is also labelled up or down.
        falling: Describe the motion for a falling angle instead.

    Returns:
        One phrase per joint, `goes +x 0.11, -z (down) 0.30 m/rad`.
    """
    columns = np.asarray(model.jacobian(q)).T * (-1.0 if falling else 1.0)
    rise = np.asarray(up, dtype=np.float64)
    rise = rise / max(float(np.linalg.norm(rise)), 1e-9)
    return tuple(_way(column[:3], column[3:], rise) for column in columns)


def _way(linear: Array, angular: Array, up: Array) -> str:
    if np.linalg.norm(linear) >= IN_PLACE:
        return f"goes {_axes(linear, up, numbers=True)} m/rad"
    return f"turns in place about {_axes(angular, up, numbers=False)}, as a screw goes in"


def _axes(vector: Array, up: Array, *, numbers: bool) -> str:
    """Format the large components of a vector, the largest first."""
    size, parts = np.abs(vector), []
    for axis in np.argsort(-size):
        if size[axis] >= NAMED * np.linalg.norm(vector):
            sign = 1.0 if vector[axis] > 0.0 else -1.0
            tilt = sign * up[axis]
            word = " (up)" if tilt > 0.9 else " (down)" if tilt < -0.9 else ""
            number = f" {size[axis]:.2f}" if numbers else ""
            parts.append(f"{'+' if sign > 0.0 else '-'}{'xyz'[axis]}{word}{number}")
    return ", ".join(parts)
