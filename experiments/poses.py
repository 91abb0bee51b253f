"""Poses and targets of the experiments on `arm7`. Base axes: x forward, y left, z up; SI units."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

import pliant
from pliant import robots
from pliant.sim.postures import posture

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Target = Callable[[float], Array]

#: Start of the target that leaves the arm's reach (tool at (0.40, 0, -0.15) m).
AT_REACH = posture(-0.4038, -0.7315, 0.7274, -2.0369, 0.9780, 0.8364, 0.3106)

AXES = ("x", "y", "z", "roll", "pitch", "yaw")

#: Amplitudes of the sinusoids [m, rad]: large, but inside the workspace around the vertical grasp.
AMPLITUDE = {"x": 0.12, "y": 0.15, "z": 0.12, "roll": 0.5, "pitch": 0.4, "yaw": 0.5}
#: Their period [s].
PERIOD = 8.0

#: Path of the target that leaves the arm's reach: height [m], nearest and farthest x [m].
REACH_HEIGHT, REACH_NEAR, REACH_FAR = -0.15, 0.40, 0.80


@cache
def arm() -> pliant.Model:
    """Return the arm of all experiments."""
    return robots.arm7()


def servos(model: pliant.Model | None = None) -> pliant.Servos:
    """Return the servo table of a model, by default of `arm`.

    Raises:
        ConfigError: The model has no servos.
    """
    table = (arm() if model is None else model).servos
    if table is None:
        raise pliant.ConfigError("the model has no servos: give Model.from_urdf(..., servos=...)")
    return table


def tool(q: Array) -> Array:
    """Return the pose (4, 4) of the tool at q (7,) [rad]."""
    pose: Array = arm().forward_kinematics(q)
    return pose


def turn(vector: Array) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector (3,) [rad] (Rodrigues' formula)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    rotation: Array = np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k)
    return rotation


def displaced(start: Array, axis: str, amount: float) -> Array:
    """Return `start` (4, 4) moved along, or turned about, a base axis by `amount` [m or rad]."""
    pose = start.copy()
    index = AXES.index(axis)
    if index < 3:
        pose[index, 3] += amount
    else:
        pose[:3, :3] = turn(amount * np.eye(3)[index - 3]) @ start[:3, :3]
    return pose


def sinusoid(start: Array, axis: str, amplitude: float) -> Target:
    """Return a target that oscillates by `amplitude` [m or rad], two periods from 1 s on."""

    def target(t: float) -> Array:
        phase = 2.0 * np.pi * (max(t, 1.0) - 1.0) / PERIOD
        return displaced(start, axis, amplitude * float(np.sin(phase)))

    return target


def pull(
    start: Array, distance: float, *, axis: str = "x", speed: float = -0.05, begin: float = 1.0
) -> Target:
    """Return a target that moves away along a base axis.

    Args:
        start: Initial pose (4, 4).
        distance: Path length [m], at least 0.
        axis: `x`, `y` or `z`.
        speed: With its sign [m/s].
        begin: Start time [s].

    Returns:
        Pose (4, 4) by time.
    """

    def target(t: float) -> Array:
        way = min(max(abs(speed) * (t - begin), 0.0), distance)
        return displaced(start, axis, float(np.copysign(way, speed)))

    return target


def tilted(start: Array, vector: tuple[float, float, float] = (0.25, -0.2, 0.3)) -> Target:
    """Return a target that jumps at 1 s: `start` turned by a rotation vector [rad] in base axes."""
    pose = start.copy()
    pose[:3, :3] = turn(np.array(vector)) @ start[:3, :3]
    return lambda t: pose if t >= 1.0 else start


def beyond_reach(t: float) -> Array:
    """Return a target (4, 4) that leaves the reach within 1 to 6 s and returns within 8 to 13 s."""
    out = np.clip((t - 1.0) / 5.0, 0.0, 1.0) - np.clip((t - 8.0) / 5.0, 0.0, 1.0)
    pose = np.eye(4)
    pose[:3, 3] = (REACH_NEAR + (REACH_FAR - REACH_NEAR) * out, 0.0, REACH_HEIGHT)
    return pose
