"""Motion of target poses by small steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant import functional
from pliant._core import Pose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


def moved(pose: Array, shift: Array, turn: Array) -> Array:
    """Return a pose (4, 4) moved by `shift` (3,) [m] and turned by `turn` (3,) [rad], base axes."""
    out = pose.copy()
    out[:3, 3] += shift
    out[:3, :3] = Pose.from_rotvec(np.zeros(3), turn).rotation @ pose[:3, :3]
    return out


def toward(pose: Array, target: Array, way: float, angle: float) -> Array:
    """Return a pose (4, 4) one step closer to a target: at most `way` [m] and `angle` [rad]."""
    error = functional.pose_error(pose, target)
    shift, turn = error[:3], error[3:]
    shares = [
        min(1.0, most / size) if (size := float(np.linalg.norm(part))) > 0.0 else 1.0
        for part, most in ((shift, way), (turn, angle))
    ]
    if min(shares) >= 1.0:
        return target
    return moved(pose, shares[0] * shift, shares[1] * turn)
