"""Which readings are believed, and how old the last believed ones are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pliant.arm.drive import Sampled

    Array = NDArray[np.float64]

#: Speed of a joint whose limit is not known [rad/s], and a jump that any reading may show [rad].
FASTEST, JUMP = 10.0, 0.2
#: How much faster than its limit a joint may be thrown.
THROWN = 2.0
#: Readings in a row that a joint cannot have reached and that are a fault, and a pause between
#: readings after which it may have moved meanwhile [s].
IMPOSSIBLE, PAUSE = 3, 0.1


class Belief:
    """The last believed position of each of N joints.

    A position is believed when it was read in this cycle, is finite, and lies within
    ``2 v_max Δt + 0.2 rad`` of the last believed one: protocols without sequence numbers hand out
    answers of earlier cycles. Δt does not grow while readings come that are farther away: an
    encoder that stepped is a fault, and never believed.

    Attributes:
        position: (N,) [rad]; NaN before the first.
        time: When each was sampled (N,) [s].
        jumps: Readings refused for their jump so far.
    """

    def __init__(self, fastest: Array) -> None:
        """Know the largest speeds (N,) [rad/s]; not finite: unknown."""
        self._fastest = np.where(np.isfinite(fastest), fastest, FASTEST)
        self.position: Array = np.full(fastest.size, np.nan)
        self.time: Array = np.full(fastest.size, -np.inf)
        self.jumps = 0
        # When each was last read; for how long it may have moved since it was believed; how often
        # in a row, and by how much, it was read where it cannot be.
        self._last: Array = self.time.copy()
        self._allowed: Array = np.zeros(fastest.size)
        self._refused: NDArray[np.int_] = np.zeros(fastest.size, dtype=np.int_)
        self._way: Array = np.zeros(fastest.size)

    def take(self, sample: Sampled) -> NDArray[np.bool_]:
        """Take what can be believed of a sample; return which joints that were (N,)."""
        read = np.asarray(sample.ok, dtype=bool) & np.isfinite(sample.position)
        first = np.isnan(self.position)
        gap = np.where(first, 0.0, sample.time - self._last)
        self._last = np.where(read, sample.time, self._last)
        grows = read & ((self._refused == 0) | (gap > PAUSE))
        self._allowed += np.where(grows, gap, 0.0)
        reach = THROWN * self._fastest * self._allowed + JUMP
        with np.errstate(invalid="ignore"):
            way = np.abs(sample.position - self.position)
            near = first | (way <= reach)
        far, ok = read & ~near, read & near
        self.jumps += int(far.sum())
        self._refused = np.where(far, self._refused + 1, np.where(ok, 0, self._refused))
        self._way = np.where(far, way, self._way)
        self._allowed = np.where(ok, 0.0, self._allowed)
        self.position = np.where(ok, sample.position, self.position)
        self.time = np.where(ok, sample.time, self.time)
        return ok

    def faults(self, names: Sequence[str]) -> tuple[str, ...]:
        """Joints that have been read for several times where they cannot be, in sentences."""
        return tuple(
            f"{names[int(i)]}: its position jumped by {self._way[i]:.2f} rad, which it cannot have "
            "moved: encoder fault, slipped horn or loose gear. Torque off, then check its zero"
            for i in np.flatnonzero(self._refused >= IMPOSSIBLE)
        )

    def forget(self) -> None:
        """Believe any position next: the arm may have been moved meanwhile."""
        self.position = np.full_like(self._fastest, np.nan)
        self.time = np.full_like(self._fastest, -np.inf)
        self._last = self.time.copy()
        self._allowed, self._way = np.zeros_like(self.time), np.zeros_like(self.time)
        self._refused = np.zeros_like(self._refused)
