"""What stands around the arm: the interface of things with bodies, and stiff planes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from pliant import ConfigError
from pliant.sim.truth import TOOL, WRIST

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant.sim.hand import Hand, Wrench
    from pliant.sim.plant import Plant
    from pliant.sim.spec import Build
    from pliant.sim.truth import Truth

_ZERO = np.zeros(3)


class Fixture(Protocol):
    """A thing with bodies of its own (a door); hands and walls are mere force laws."""

    def add(self, build: Build) -> None:
        """Add bodies and constraints before the model is compiled."""

    def place(self, plant: Plant) -> None:
        """Move everything to where it belongs at a reset, relative to the tool."""

    def before(self, plant: Plant) -> None:
        """Called before each physics step, for motion that is prescribed."""

    def during(self, plant: Plant) -> None:
        """Called with positions known, for outer forces (`mj_data.qfrc_applied`)."""

    def after(self, plant: Plant) -> None:
        """Called after each physics step, for records."""


@dataclass(frozen=True, kw_only=True)
class Wall:
    """A plane that pushes a point back with a stiffness, without friction.

    Attributes:
        into: Direction (3,) in base axes in which one runs into the wall.
        distance: From the frame's place at reset to the plane, along `into` [m].
        stiffness: Of the plane [N/m].
        damping: Of the plane while it is pressed [N·s/m]; it never pulls.
        at: Frame that meets it.
    """

    into: Sequence[float] = (1.0, 0.0, 0.0)
    distance: float = 0.05
    stiffness: float = 2e4
    damping: float = 0.0
    at: str = TOOL

    def __post_init__(self) -> None:
        """Check the numbers once."""
        if np.shape(self.into) != (3,) or abs(float(np.linalg.norm(self.into)) - 1.0) > 1e-9:
            raise ConfigError(f"Wall.into must be a unit vector (3,), got {self.into!r}")
        if not (self.stiffness >= 0.0 and self.damping >= 0.0):
            raise ConfigError(f"Wall.stiffness and damping must be at least 0, got {self!r}")

    def force(self, truth: Truth, t: float) -> Wrench:
        """The wall's push at the frame's origin."""
        frame = truth.frame(self.at)
        into = np.asarray(self.into, dtype=np.float64)
        depth = float(into @ frame.shift()) - self.distance
        if depth <= 0.0:
            return _ZERO, _ZERO, frame.position
        size = self.stiffness * depth
        if self.damping:
            size = max(size + self.damping * float(into @ frame.twist()[:3]), 0.0)
        return -size * into, _ZERO, frame.position


@dataclass(frozen=True, kw_only=True)
class Table:
    """A horizontal plane under one frame, at a height in base axes rather than below the start.

    Attributes:
        height: Of the plane in base axes [m].
        stiffness: [N/m].
        damping: While pressed [N·s/m].
        at: Frame that can rest on it.
    """

    height: float
    stiffness: float = 2e4
    damping: float = 20.0
    at: str = TOOL

    def __post_init__(self) -> None:
        """Check the numbers once."""
        if not (np.isfinite(self.height) and self.stiffness >= 0.0 and self.damping >= 0.0):
            raise ConfigError(
                f"Table needs a finite height, stiffness and damping at least 0, got {self!r}"
            )

    def force(self, truth: Truth, t: float) -> Wrench:
        """The table's push at the frame's origin."""
        frame = truth.frame(self.at)
        depth = self.height - float(frame.position[2])
        if depth <= 0.0:
            return _ZERO, _ZERO, frame.position
        size = self.stiffness * depth - self.damping * float(frame.twist()[2])
        return np.array((0.0, 0.0, max(size, 0.0))), _ZERO, frame.position


def table(
    height: float, *, stiffness: float = 2e4, frames: Sequence[str] = (TOOL, WRIST)
) -> list[Hand]:
    """A table that several frames of the arm can rest on: one `Table` each."""
    return [Table(height=height, stiffness=stiffness, at=frame) for frame in frames]
