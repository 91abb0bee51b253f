"""Choice of poses near the present one that separate stiffness, payload and friction."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import OutOfRangeError, ShapeError
from pliant._validation import format_value
from pliant.identify._excitation import LIMIT_MARGIN
from pliant.identify._segments import bare_gravity, payload_rows

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import ArrayLike

    from pliant._typing import Array
    from pliant.identify._excitation import Excitation


#: Number of candidates, and largest share of the usable torque that may hold one of them.
CANDIDATES, MAX_HOLDING_SHARE = 200, 0.6
#: Largest distance of a chosen pose from the present one, least and largest swing [rad].
SPAN, SWING = np.pi, (0.01, 0.5)
#: Largest descent of the tool below its first height [m].
MAX_DROP = 0.05


def check_poses(poses: int | ArrayLike, n: int) -> int | Array:
    """Check a number of poses, or postures (K, n) [rad].

    Raises:
        OutOfRangeError: Fewer than one. ShapeError: Postures have another length or are not finite.
    """
    if isinstance(poses, (int, np.integer)):
        if poses < 1:
            raise OutOfRangeError(f"poses must be at least 1, got {poses}")
        return int(poses)
    try:
        postures = np.atleast_2d(np.array(poses, dtype=np.float64))
    except (TypeError, ValueError):
        postures = np.zeros((0, 0))
    if postures.ndim != 2 or postures.shape[1] != n or not np.isfinite(postures).all():
        raise ShapeError(
            f"poses must be how many to choose, or postures (K, {n}) of finite numbers [rad], "
            f"got {format_value(poses)}"
        )
    return postures


def pose_list(
    rig: Excitation, q: Array, poses: int | Array, span: float, size: Array
) -> list[Array]:
    """Return the poses to visit, the present one first unless the poses are given.

    Chosen poses keep each joint within `span` [rad] of q; `size` (n,) [rad] is their swing.

    Raises:
        OutOfRangeError: A pose and its swing leave the position limits.
    """
    if isinstance(poses, int):
        rig.check_range(q - size, q + size)
        return choose(rig, q, poses, span, size)
    for pose in poses:
        rig.check_range(pose - size, pose + size)
    return list(poses)


def choose(rig: Excitation, q: Array, count: int, span: float, size: Array) -> list[Array]:
    """Return `count` poses within ±span of q that are most informative together, q first.

    Greedy choice: each step adds the candidate that raises the determinant of the information on
    stiffness and payload most. Candidates that lower the tool by more than `MAX_DROP`, or need more
    than `MAX_HOLDING_SHARE` of a servo, are excluded.
    """
    model, rng = rig.model, np.random.default_rng(0)
    low = np.maximum(q - span, model.lower + LIMIT_MARGIN + size)
    high = np.minimum(q + span, model.upper - LIMIT_MARGIN - size)
    height = _height(rig, q)
    candidates = [
        pose
        for pose in rng.uniform(np.minimum(low, q), np.maximum(high, q), (CANDIDATES, rig.n))
        if _height(rig, pose) > height - MAX_DROP
        and (np.abs(model.gravity(pose)) < MAX_HOLDING_SHARE * rig.torque).all()
    ]
    chosen = [q]
    information = np.eye(rig.n + 4) + _information(rig, q)
    pieces = [_information(rig, pose) for pose in candidates]
    for _ in range(min(count - 1, len(candidates))):
        gains = [np.linalg.slogdet(information + piece)[1] for piece in pieces]
        best = int(np.argmax(gains))
        chosen.append(candidates[best])
        information = information + pieces[best]
    return _ordered(chosen)


def _height(rig: Excitation, q: Array) -> float:
    """Return the height of the tool against gravity [m]."""
    down = np.asarray(rig.model.gravity_vector)
    size = float(np.linalg.norm(down))
    tool = rig.model.forward_kinematics(q)[:3, 3]
    return float(-tool @ down / size) if size > 0.0 else 0.0


def _information(rig: Excitation, q: Array) -> Array:
    """Return the information of one pose on the shares of k_p (n) and φ in kg and 0.1 kg m (4)."""
    gravity, rows = bare_gravity(rig.model, q), payload_rows(rig.model, q)
    design = np.hstack([np.diag(gravity), -rows * np.array([1.0, 0.1, 0.1, 0.1])])
    design /= (0.04 * rig.friction + 1e-3 * rig.torque)[:, None]
    out: Array = design.T @ design
    return out


def _ordered(poses: Sequence[Array]) -> list[Array]:
    """Order the poses along a short path: always the nearest one next."""
    remaining, path = list(poses[1:]), [poses[0]]
    while remaining:
        nearest = int(np.argmin([np.abs(pose - path[-1]).max() for pose in remaining]))
        path.append(remaining.pop(nearest))
    return path
