"""Simulated time as fast as life, or slower where the computer cannot keep up.

A simulated arm in real time would miss ticks on a busy computer and behave worse than it is. Here
every tick happens, and the page says that it shows slow motion.
"""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING

from pliant.arm.drive import MonotonicClock
from pliant.arm.lateness import Lateness

if TYPE_CHECKING:
    from pliant.arm.drive import Clock

#: Delay that is made up for; of a longer one the rest is never made up [s].
SLACK = 0.03
#: Time over which the speed is taken [s].
WINDOW = 2.0


class Pace:
    """Waits, after every reading, until life has come as far as the simulation.

    Attributes:
        lateness: Of every reading.
    """

    def __init__(self, clock: Clock) -> None:
        """Start now."""
        self._clock, self._wall = clock, MonotonicClock()
        self._lag = self._wall.now() - clock.now()
        self._seen: deque[tuple[float, float]] = deque([(self._wall.now(), clock.now())])
        self.lateness = Lateness()

    def wait(self) -> None:
        """Sleep, or let life run ahead."""
        now = self._clock.now()
        late = self._wall.now() - (now + self._lag)
        self.lateness.add(late)
        if late > SLACK:
            self._lag += late - SLACK
        else:
            self._wall.wait_until(now + self._lag)
        self._seen.append((time.perf_counter(), now))
        while self._seen[-1][0] - self._seen[0][0] > WINDOW:
            self._seen.popleft()

    @property
    def speed(self) -> float:
        """Simulated seconds per second of life, over the last two."""
        (wall, first), (end, last) = self._seen[0], self._seen[-1]
        return min((last - first) / (end - wall), 1.0) if end - wall > 0.5 * WINDOW else 1.0
