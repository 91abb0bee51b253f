"""Simulated uneven surface with friction, for wiping tasks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError
from pliant.sim.ground_truth import TOOL

if TYPE_CHECKING:
    from pliant.sim.ground_truth import GroundTruth
    from pliant.sim.hand import Wrench


#: Speed scale of the regularized friction force ``μ N tanh(v / FRICTION_SPEED)`` [m/s], with
#: friction coefficient μ, normal force N and sliding speed v.
FRICTION_SPEED = 0.005


@dataclass(frozen=True, kw_only=True)
class Surface:
    """Uneven surface below the arm, in contact with the four corners of a flat square pad.

    Relative to the position of the frame `at` at reset, the height of the surface at x, y is
    ``-below + unevenness sin(2π y/wave) cos(2π x/wave)``. The force ``max(k p - d v, 0) / 4``
    pushes each corner up, with `stiffness` k, `damping` d, penetration p [m] and upward velocity v
    [m/s] of the corner. Dry friction opposes its sliding.

    Attributes:
        below: Height of the frame at reset above the mean surface [m].
        unevenness: Amplitude of the surface's height [m].
        wave: Wavelength of the surface [m].
        stiffness: Contact stiffness of the whole pad [N/m].
        damping: Damping of the whole pad during contact [N·s/m].
        friction: Coefficient of dry friction [1].
        pad: Half the side length of the pad [m]; its sides are parallel to x and y of the frame.
        at: Name of the frame at the centre of the pad.
    """

    below: float = 0.01
    unevenness: float = 0.010
    wave: float = 0.30
    stiffness: float = 2e4
    damping: float = 20.0
    friction: float = 0.4
    pad: float = 0.02
    at: str = TOOL

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        low = min(self.stiffness, self.damping, self.friction, self.pad)
        if not (low >= 0.0 and self.wave > 0.0 and np.isfinite(self.below + self.unevenness)):
            raise ConfigError(
                "Surface needs wave > 0; stiffness, damping, friction and pad at least 0; "
                f"got {self!r}"
            )

    def height(self, x: float, y: float) -> float:
        """Return the height of the surface above its mean [m].

        x and y are relative to the position of the frame at reset [m].
        """
        k = 2.0 * np.pi / self.wave
        return self.unevenness * float(np.sin(k * y) * np.cos(k * x))

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return force [N] and torque [N·m] summed over the corners, and the frame's origin."""
        frame = ground_truth.frame(self.at)
        twist = frame.twist()
        total, torque = np.zeros(3), np.zeros(3)
        for corner in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
            lever = frame.rotation @ np.array((*corner, 0.0)) * self.pad
            point = frame.position + lever - frame.start
            depth = self.height(point[0], point[1]) - self.below - point[2]
            if depth <= 0.0:
                continue
            speed = twist[:3] + np.cross(twist[3:], lever)
            normal = max((self.stiffness * depth - self.damping * speed[2]) / 4.0, 0.0)
            force = np.array((0.0, 0.0, normal))
            sliding = float(np.hypot(speed[0], speed[1]))
            if sliding > 0.0:
                friction = self.friction * normal * np.tanh(sliding / FRICTION_SPEED)
                force[:2] = -friction * speed[:2] / sliding
            total += force
            torque += np.cross(lever, force)
        return total, torque, frame.position
