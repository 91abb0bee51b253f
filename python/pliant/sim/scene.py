"""Simulated walls and tables: stiff planes that push frames of the arm back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError
from pliant.sim.ground_truth import TOOL, WRIST, ZERO

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant._typing import Array
    from pliant.sim.ground_truth import GroundTruth
    from pliant.sim.hand import Hand, Wrench


@dataclass(frozen=True, kw_only=True)
class Wall:
    """Stiff plane without friction that pushes one frame of the arm back.

    Attributes:
        into: Direction (3,) in base axes from free space into the wall.
        distance: Distance along `into` from the frame's position at reset to the plane [m].
        stiffness: Stiffness of the plane [N/m].
        damping: Damping of the plane during contact [N·s/m]; the plane never pulls.
        at: Name of the frame on which the wall acts.
    """

    into: Sequence[float] = (1.0, 0.0, 0.0)
    distance: float = 0.05
    stiffness: float = 2e4
    damping: float = 0.0
    at: str = TOOL

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        if np.shape(self.into) != (3,) or abs(float(np.linalg.norm(self.into)) - 1.0) > 1e-9:
            raise ConfigError(f"Wall.into must be a unit vector (3,), got {self.into!r}")
        if not (self.stiffness >= 0.0 and self.damping >= 0.0):
            raise ConfigError(f"Wall.stiffness and damping must be at least 0, got {self!r}")

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return the force of the wall [N], a zero torque, and the frame's origin."""
        frame = ground_truth.frame(self.at)
        into = self._into
        depth = float(into.dot(frame.shift())) - self.distance
        if depth <= 0.0:
            return ZERO, ZERO, frame.position
        force = self.stiffness * depth
        if self.damping:
            force = max(force + self.damping * float(into.dot(frame.velocities()[0])), 0.0)
        return -force * into, ZERO, frame.position

    @cached_property
    def _into(self) -> Array:
        return np.asarray(self.into, dtype=np.float64)


@dataclass(frozen=True, kw_only=True)
class Table:
    """Stiff horizontal plane without friction under one frame of the arm, at a fixed height.

    Attributes:
        height: Height of the plane in base axes [m].
        stiffness: Stiffness of the plane [N/m].
        damping: Damping of the plane during contact [N·s/m].
        at: Name of the frame that can rest on the table.
    """

    height: float
    stiffness: float = 2e4
    damping: float = 20.0
    at: str = TOOL

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        if not (np.isfinite(self.height) and self.stiffness >= 0.0 and self.damping >= 0.0):
            raise ConfigError(
                f"Table needs a finite height, stiffness and damping at least 0, got {self!r}"
            )

    def force(self, ground_truth: GroundTruth, t: float) -> Wrench:
        """Return the force of the table [N], a zero torque, and the frame's origin."""
        frame = ground_truth.frame(self.at)
        depth = self.height - float(frame.position[2])
        if depth <= 0.0:
            return ZERO, ZERO, frame.position
        force = self.stiffness * depth - self.damping * float(frame.velocities()[0][2])
        return np.array((0.0, 0.0, max(force, 0.0))), ZERO, frame.position


def table(height: float) -> list[Hand]:
    """Return a table of a given height [m] for tool and wrist: a list with one `Table` each."""
    return [Table(height=height, at=frame) for frame in (TOOL, WRIST)]
