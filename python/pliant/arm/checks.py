"""Joint vectors from outside: of this arm, finite, and within its limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant import LimitError, ShapeError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import ArrayLike, NDArray

    from pliant import Model

    Array = NDArray[np.float64]

#: How far outside of the limits a pose may be that is brought inside, and a joint that lies beyond
#: its stop [rad].
SLACK = 0.1


def vector(model: Model, value: ArrayLike, name: str, *, finite: bool = True) -> Array:
    """A joint vector (n,) that can be sent.

    Raises:
        ShapeError: Another shape. LimitError: Not finite, where it has to be.
    """
    array = np.array(value, dtype=np.float64)
    if array.shape != (model.n,):
        raise ShapeError(f"{name} has shape {array.shape}, expected ({model.n},)")
    if finite and not np.isfinite(array).all():
        raise LimitError(f"{name} is not finite, nothing was sent: {array.tolist()}")
    return array


def posture(model: Model, value: ArrayLike, name: str) -> Array:
    """A pose of this arm (n,) [rad], brought within the limits where it is just outside.

    Raises:
        ShapeError, LimitError: It is none.
    """
    pose = vector(model, value, name)
    for joint, q, least, most in outside(model, pose):
        raise LimitError(
            f"{name}: {joint} = {q:g} rad is outside of {least:.3g} to {most:.3g} rad"
            + (": are these degrees?" if abs(q) > 2.0 * np.pi else "")
        )
    return np.clip(pose, model.lower, model.upper)


def outside(model: Model, q: Array) -> Iterator[tuple[str, float, float, float]]:
    """Joints of q (n,) [rad] that are beyond their limits by more than `SLACK`.

    Yields:
        Name, position and limits of each [rad].
    """
    for row in zip(model.joint_names, q.tolist(), model.lower, model.upper, strict=True):
        _, here, low, high = row
        if not low - SLACK <= here <= high + SLACK:
            yield row
