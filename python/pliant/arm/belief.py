"""Plausibility check of joint readings, and the age of the last plausible ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pliant.drive import JointReadings

    Array = NDArray[np.float64]

#: Assumed speed of a joint without a known limit [rad/s]; jump that is always accepted [rad].
FASTEST, JUMP = 10.0, 0.2
#: Largest speed of a joint that is pushed, as a multiple of its limit.
THROWN = 2.0
#: Implausible readings in a row that are a fault; and the gap between readings after which the
#: joint may have moved in between [s].
IMPOSSIBLE, PAUSE = 3, 0.1


class Belief:
    """Last plausible position of each of N joints.

    A position is accepted if it was read in this cycle, is finite, and lies within
    ``2 v_max Δt + 0.2 rad`` of the last accepted one. The check is needed because protocols without
    sequence numbers can deliver answers of earlier cycles. Δt does not grow while implausible
    readings arrive: a jump of the encoder is a fault and is never accepted.

    Attributes:
        position: Last accepted positions (N,) [rad]; NaN before the first.
        time: Time at which each was sampled (N,) [s].
        jumps: Number of readings rejected because of a jump.
    """

    def __init__(self, fastest: Array) -> None:
        """Set the largest speeds (N,) [rad/s]; NaN or inf: unknown."""
        self._fastest = np.where(np.isfinite(fastest), fastest, FASTEST)
        self.position: Array = np.full(fastest.size, np.nan)
        self.time: Array = np.full(fastest.size, -np.inf)
        self.jumps = 0
        # Per joint: time of the last reading; time in which it may have moved since the last
        # accepted position; implausible readings in a row, and the size of the last jump.
        self._last: Array = self.time.copy()
        self._allowed: Array = np.zeros(fastest.size)
        self._refused: NDArray[np.int_] = np.zeros(fastest.size, dtype=np.int_)
        self._way: Array = np.zeros(fastest.size)

    def take(self, sample: JointReadings) -> NDArray[np.bool_]:
        """Accept the plausible positions of a sample; return a mask (N,) of the accepted joints."""
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
        """Return a sentence for each joint with repeated implausible readings."""
        return tuple(
            f"{names[int(i)]}: its position jumped by {self._way[i]:.2f} rad, which it cannot have "
            "moved: encoder fault, slipped horn or loose gear. Torque off, then check its zero"
            for i in np.flatnonzero(self._refused >= IMPOSSIBLE)
        )

    def forget(self) -> None:
        """Accept any position next, because the arm may have been moved in between."""
        self.position = np.full_like(self._fastest, np.nan)
        self.time = np.full_like(self._fastest, -np.inf)
        self._last = self.time.copy()
        self._allowed, self._way = np.zeros_like(self.time), np.zeros_like(self.time)
        self._refused = np.zeros_like(self._refused)
