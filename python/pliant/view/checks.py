"""Checks of the page's orders, with the same bounds as for targets or forces on a command line."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError

if TYPE_CHECKING:
    from pliant._core import Model
    from pliant._typing import Array
    from pliant.view.orders import Grab, Push, Target


#: Longest push per order [s].
LONGEST = 10.0
#: Largest coordinate of a point toward which a hand pulls [m].
FARTHEST = 100.0
#: Largest entry of R Rᵀ - I for a rotation.
ORTHOGONAL = 1e-6
#: Relative rounding tolerance of a force bound.
ROUNDING = 1e-3


def target(order: Target, model: Model) -> Array:
    """Return the pose (4, 4) of a target that the arm can reach when stretched.

    Raises:
        ConfigError: The pose is not finite, not a pose, or out of reach.
    """
    pose = _numbers("target", order.pose, (4, 4))
    turn = pose[:3, :3]
    off = np.abs(turn @ turn.T - np.eye(3)).max()
    if off > ORTHOGONAL or np.linalg.det(turn) < 0.0 or (pose[3] != (0.0, 0.0, 0.0, 1.0)).any():
        raise ConfigError("target is not a pose: its rotation is not orthogonal")
    away = math.dist(pose[:3, 3], model.reach_origin)
    if away > model.reach:
        raise ConfigError(
            f"target is {away:.3g} m from {model.joint_names[0]}, and the arm reaches "
            f"{model.reach:.3g} m"
        )
    return pose


def push(order: Push, strong: tuple[float, float]) -> None:
    """Check a push against the largest force [N] and torque [N·m] of the page's sliders.

    Raises:
        ConfigError: A number is not finite or beyond its bound.
    """
    parts = (("force", order.force, strong[0], "N"), ("torque", order.torque, strong[1], "N·m"))
    for name, value, bound, unit in parts:
        size = float(np.abs(_numbers(f"push: {name}", value, (3,))).max())
        if size > bound * (1.0 + ROUNDING):
            raise ConfigError(f"push: {name} = {size:.3g} {unit} is more than {bound:.3g} {unit}")
    seconds = float(_numbers("push: seconds", order.seconds, ()))
    if not 0.0 < seconds <= LONGEST:
        raise ConfigError(f"push: seconds = {seconds:.3g} is outside (0, {LONGEST:g}]")


def grab(order: Grab) -> None:
    """Check the places of a hand that holds the arm.

    Raises:
        ConfigError: A number is not finite, or a place is farther away than `FARTHEST`.
    """
    for name, place in (("point", order.point), ("toward", order.toward)):
        if place is None:
            continue
        away = float(np.abs(_numbers(f"hand: {name}", place, (3,))).max())
        if away > FARTHEST:
            raise ConfigError(f"hand: {name} is {away:.3g} m away, more than {FARTHEST:g} m")


def _numbers(name: str, value: object, shape: tuple[int, ...]) -> Array:
    """Return finite floats of a shape."""
    try:
        out = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ConfigError(f"{name} is not made of numbers") from None
    if out.shape != shape:
        raise ConfigError(f"{name} has shape {out.shape}, not {shape}")
    if not np.isfinite(out).all():
        raise ConfigError(f"{name} is not finite")
    return out
