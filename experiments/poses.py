"""Poses and targets of the experiments on `arm7`; base axes are x forward, y left, z up."""

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

#: Start pose of the run whose target leaves the arm's reach; the tool is at (0.40, 0, -0.15) m.
AT_REACH = posture(-0.4038, -0.7315, 0.7274, -2.0369, 0.9780, 0.8364, 0.3106)

AXES = ("x", "y", "z", "roll", "pitch", "yaw")

#: Amplitude of the sinusoidal target along each axis [m] or about it [rad]; the targets stay in the
#: workspace around the vertical grasp pose.
AMPLITUDE = {"x": 0.12, "y": 0.15, "z": 0.12, "roll": 0.5, "pitch": 0.4, "yaw": 0.5}
#: Period of the sinusoidal targets [s].
PERIOD = 8.0

#: Path of the target that leaves the arm's reach: height [m], nearest and farthest x [m].
REACH_HEIGHT, REACH_NEAR, REACH_FAR = -0.15, 0.40, 0.80


@cache
def arm() -> pliant.Model:
    """Return `arm7`, the seven-joint arm of the experiments."""
    return robots.arm7()


def servos(model: pliant.Model | None = None) -> pliant.Servos:
    """Return the servo parameters of a model, by default of `arm`.

    Raises:
        ConfigError: The model has no servos.
    """
    table = (arm() if model is None else model).servos
    if table is None:
        raise pliant.ConfigError("the model has no servos: give Model.from_urdf(..., servos=...)")
    return table


def tool(q: Array) -> Array:
    """Return the pose (4, 4) of the tool of `arm7` at q (7,) [rad]."""
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
    """Return the pose `start` (4, 4) after a motion by `amount` [m or rad].

    The motion is along the base axis x, y, z, or about it for roll, pitch, yaw.
    """
    pose = start.copy()
    index = AXES.index(axis)
    if index < 3:
        pose[index, 3] += amount
    else:
        pose[:3, :3] = turn(amount * np.eye(3)[index - 3]) @ start[:3, :3]
    return pose


def sinusoid(start: Array, axis: str, amplitude: float) -> Target:
    """Return a target that oscillates around the pose `start` (4, 4) from 1 s on.

    The result is a function of the time [s] that returns a pose (4, 4). The `amplitude` is in m or
    rad, and the period is `PERIOD`.
    """

    def target(t: float) -> Array:
        phase = 2.0 * np.pi * (max(t, 1.0) - 1.0) / PERIOD
        return displaced(start, axis, amplitude * float(np.sin(phase)))

    return target


def pull(
    start: Array, distance: float, *, axis: str = "x", speed: float = -0.05, begin: float = 1.0
) -> Target:
    """Return a target that moves from a pose along a base axis and then stays.

    Args:
        start: Initial pose (4, 4).
        distance: Path length [m], at least 0.
        axis: `x`, `y` or `z`.
        speed: Signed speed [m/s].
        begin: Start time [s].

    Returns:
        Function of the time [s] that returns the pose (4, 4).
    """

    def target(t: float) -> Array:
        distance_moved = min(max(abs(speed) * (t - begin), 0.0), distance)
        return displaced(start, axis, float(np.copysign(distance_moved, speed)))

    return target


def tilted(start: Array, vector: tuple[float, float, float] = (0.25, -0.2, 0.3)) -> Target:
    """Return a target that is `start` (4, 4) and, from 1 s on, this pose turned by a rotation.

    The result is a function of the time [s]; `vector` is a rotation vector [rad] in base axes.
    """
    pose = start.copy()
    pose[:3, :3] = turn(np.array(vector)) @ start[:3, :3]
    return lambda t: pose if t >= 1.0 else start


def beyond_reach(t: float) -> Array:
    """Return the target (4, 4) at time t [s]: it moves out from 1 to 6 s, back from 8 to 13 s."""
    out = np.clip((t - 1.0) / 5.0, 0.0, 1.0) - np.clip((t - 8.0) / 5.0, 0.0, 1.0)
    pose = np.eye(4)
    pose[:3, 3] = (REACH_NEAR + (REACH_FAR - REACH_NEAR) * out, 0.0, REACH_HEIGHT)
    return pose
