"""Choice of poses near the present one, from which stiffness and payload can both be identified."""

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


#: Number of random candidate poses.
CANDIDATES = 200
#: Largest gravity torque of a servo in a candidate pose, as a share of its maximum torque [1].
MAX_HOLDING_SHARE = 0.6
#: Range of the argument `span` [rad]. Poses that are closer together than the swings about them add
#: no information; on the straight way between poses that are farther apart, the tool can sink far
#: below both.
SPAN_RANGE = (0.05, 0.5)
#: Range of the argument `amplitude` [rad].
AMPLITUDE_RANGE = (0.01, 0.5)
#: Largest distance by which the tool may be below its present height in a chosen pose [m].
MAX_DROP = 0.05


def check_poses(poses: int | ArrayLike, n: int) -> int | Array:
    """Check and return a number of poses, or joint positions of poses (K, n) [rad].

    Raises:
        OutOfRangeError: The number is below 1.
        ShapeError: The positions have another shape or are not finite.
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
    """Return the poses of a procedure: those given, or chosen ones if `poses` is a number.

    Args:
        rig: Model and servo parameters of the arm.
        q: Present joint positions (n,) [rad].
        poses: Number of poses, or joint positions of poses (K, n) [rad].
        span: Maximum distance of chosen poses from q, per joint [rad].
        size: Amplitude of each joint about a pose (n,) [rad].

    Raises:
        OutOfRangeError: A motion by ±size about a pose leaves the position limits.
    """
    if isinstance(poses, int):
        rig.check_range(q - size, q + size)
        return choose_poses(rig, q, poses, span, size)
    for pose in poses:
        rig.check_range(pose - size, pose + size)
    return list(poses)


def choose_poses(rig: Excitation, q: Array, count: int, span: float, size: Array) -> list[Array]:
    """Return `count` poses within ±span [rad] of q, q first, that determine stiffness and payload.

    Poses are added one by one. Each is the random candidate that most increases the determinant of
    the information matrix of stiffness and payload. Candidates are excluded if they lower the tool
    by more than `MAX_DROP` or load a servo with more than `MAX_HOLDING_SHARE` of its maximum
    torque. The poses are sorted for a short path through them.
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
    poses = [q]
    information = np.eye(rig.n + 4) + _information(rig, q)
    pieces = [_information(rig, pose) for pose in candidates]
    for _ in range(min(count - 1, len(candidates))):
        gains = [np.linalg.slogdet(information + piece)[1] for piece in pieces]
        best = int(np.argmax(gains))
        poses.append(candidates[best])
        information = information + pieces[best]
    return _ordered(poses)


def _height(rig: Excitation, q: Array) -> float:
    """Return the height of the tool over the base [m], opposite to gravity; 0 without gravity."""
    down = np.asarray(rig.model.gravity_vector)
    size = float(np.linalg.norm(down))
    tool = rig.model.forward_kinematics(q)[:3, 3]
    return float(-tool @ down / size) if size > 0.0 else 0.0


def _information(rig: Excitation, q: Array) -> Array:
    """Return the information matrix (n + 4, n + 4) of one pose for the least-squares fit.

    The unknowns are the relative errors of the n servo stiffnesses, the mass of the payload [kg],
    and its three first moments (mass times centre) in units of 0.1 kg·m.
    """
    gravity, rows = bare_gravity(rig.model, q), payload_rows(rig.model, q)
    design = np.hstack([np.diag(gravity), -rows * np.array([1.0, 0.1, 0.1, 0.1])])
    design /= (0.04 * rig.friction + 1e-3 * rig.torque)[:, None]
    out: Array = design.T @ design
    return out


def _ordered(poses: Sequence[Array]) -> list[Array]:
    """Return the poses in a new order: the first one, then always the nearest remaining pose."""
    remaining, path = list(poses[1:]), [poses[0]]
    while remaining:
        nearest = int(np.argmin([np.abs(pose - path[-1]).max() for pose in remaining]))
        path.append(remaining.pop(nearest))
    return path
