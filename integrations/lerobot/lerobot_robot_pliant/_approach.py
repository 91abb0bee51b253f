"""Slow approach of a joint target."""

from __future__ import annotations

import numpy as np

#: Joint distance to the target below which the slow approach ends [rad].
ARRIVED = 0.05


class Approach:
    """Joint targets that move slowly until they have reached their target, and then equal it.

    Args:
        q: Joint positions to start from (n,) [rad].
        speed: Speed of the joint with the longest way [rad/s].

    Attributes:
        is_slow: Whether the target is still approached; set it to start another approach.
    """

    def __init__(self, q: np.ndarray, speed: float) -> None:
        """Start slowly from q."""
        self._q, self._speed = q.copy(), speed
        self.is_slow = True

    def step(self, target: np.ndarray, dt: float) -> np.ndarray:
        """Return joint targets (n,) [rad] after a further time `dt` [s]."""
        gap = target - self._q
        largest = float(np.abs(gap).max())
        self.is_slow = self.is_slow and largest > ARRIVED
        share = min(1.0, self._speed * dt / largest) if self.is_slow else 1.0
        self._q = self._q + share * gap
        return self._q
