"""Which readings are believed, and how old the last believed ones are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant.arm.drive import Sampled

    Array = NDArray[np.float64]

#: Speed of a joint whose limit is not known [rad/s], and a jump that any reading may show [rad].
FASTEST, JUMP = 10.0, 0.2
#: How much faster than its limit a joint may be thrown.
THROWN = 2.0


class Belief:
    """The last believed position of each of N joints.

    A position is believed when it was read in this cycle, is finite, and lies within
    ``2 v_max Δt + 0.2 rad`` of the last believed one: protocols without sequence numbers hand out
    answers of earlier cycles.

    Attributes:
        position: (N,) [rad]; NaN before the first.
        time: When each was sampled (N,) [s].
        jumps: Readings refused for their jump so far.
    """

    def __init__(self, fastest: Array) -> None:
        """Know the largest speeds (N,) [rad/s]; not finite: unknown."""
        self._fastest = np.where(np.isfinite(fastest), fastest, FASTEST)
        self.position = np.full(fastest.size, np.nan)
        self.time = np.full(fastest.size, -np.inf)
        self.jumps = 0

    def take(self, sample: Sampled) -> NDArray[np.bool_]:
        """Take what can be believed of a sample; return which joints that were (N,)."""
        ok = np.asarray(sample.ok, dtype=bool) & np.isfinite(sample.position)
        first = np.isnan(self.position)
        reach = THROWN * self._fastest * np.where(first, 0.0, sample.time - self.time) + JUMP
        with np.errstate(invalid="ignore"):
            near = first | (np.abs(sample.position - self.position) <= reach)
        self.jumps += int((ok & ~near).sum())
        ok &= near
        self.position = np.where(ok, sample.position, self.position)
        self.time = np.where(ok, sample.time, self.time)
        return ok

    def forget(self) -> None:
        """Believe any position next: the arm may have been moved meanwhile."""
        self.position = np.full_like(self.position, np.nan)
        self.time = np.full_like(self.time, -np.inf)
