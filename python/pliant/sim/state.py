"""Records at the plant's interface: orders sent, and forces of hands."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from pliant.sim.hand import Hand

    Array = NDArray[np.float64]


@dataclass
class Felt:
    """Record of one hand: means of the last period, peaks of all physics steps since reset.

    Attributes:
        hand: The hand.
        force: Mean force (3,) [N].
        torque: Mean torque (3,) [N·m].
        peak_force: Largest norm of the force [N].
        peak_torque: Largest norm of the torque [N·m].
    """

    hand: Hand
    force: Array = field(default_factory=lambda: np.zeros(3))
    torque: Array = field(default_factory=lambda: np.zeros(3))
    peak_force: float = 0.0
    peak_torque: float = 0.0

    def begin(self) -> None:
        """Start a period."""
        self.force, self.torque = np.zeros(3), np.zeros(3)

    def add(self, force: Array, torque: Array) -> None:
        """Add one physics step."""
        self.force += force
        self.torque += torque
        self.peak_force = max(self.peak_force, float(np.sqrt(force @ force)))
        self.peak_torque = max(self.peak_torque, float(np.sqrt(torque @ torque)))

    def end(self, steps: int) -> None:
        """Turn the sums of a period into means."""
        self.force /= max(steps, 1)
        self.torque /= max(steps, 1)


@dataclass(frozen=True)
class Order:
    """One write on its way to the servos."""

    goal: Array
    limit: Array
    extra: Mapping[str, tuple[float, float]]
