"""Slow approach of a joint target."""

from __future__ import annotations

import numpy as np

#: Joint distance to the target below which the slow approach ends [rad].
ARRIVED = 0.05


class Approach:
    """Joint targets that move slowly to a given target, and equal it once they have reached it.

    Args:
        q: Initial joint positions (n,) [rad].
        speed: Speed of the joint that has to move farthest [rad/s].

    Attributes:
        is_slow: True until the target is reached; set it to start another slow approach.
    """

    def __init__(self, q: np.ndarray, speed: float) -> None:
        """Start slowly from q."""
        self._q, self._speed = q.copy(), speed
        self.is_slow = True

    def step(self, target: np.ndarray, dt: float) -> np.ndarray:
        """Return the joint targets (n,) [rad] `dt` [s] after the last call."""
        difference = target - self._q
        largest = float(np.abs(difference).max())
        self.is_slow = self.is_slow and largest > ARRIVED
        share = min(1.0, self._speed * dt / largest) if self.is_slow else 1.0
        self._q = self._q + share * difference
        return self._q
