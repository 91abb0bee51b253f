"""Simulated time in step with real time, or slower if the computer is too slow.

A simulated arm in real time would miss ticks on a busy computer and behave worse than it is. With
`Pace` no tick is missed, and the page shows that it runs in slow motion.
"""

from __future__ import annotations

import time
from collections import deque
from typing import TYPE_CHECKING

from pliant.drive import MonotonicClock
from pliant.loop import LatenessHistogram

if TYPE_CHECKING:
    from pliant.drive import Clock

#: Largest delay that is caught up [s]; the rest of a longer delay is not.
SLACK = 0.03
#: Time window of the speed measurement [s].
WINDOW = 2.0


class Pace:
    """Waits after every reading until real time has caught up with the simulation.

    Attributes:
        lateness: Lateness of every reading.
    """

    def __init__(self, clock: Clock) -> None:
        """Start now."""
        self._clock, self._wall = clock, MonotonicClock()
        self._lag = self._wall.now() - clock.now()
        self._seen: deque[tuple[float, float]] = deque([(self._wall.now(), clock.now())])
        self.lateness = LatenessHistogram()

    def wait(self) -> None:
        """Sleep, or accept the delay if the simulation is late."""
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
        """Return the simulated seconds per real second, over the last two seconds."""
        (wall, first), (end, last) = self._seen[0], self._seen[-1]
        return min((last - first) / (end - wall), 1.0) if end - wall > 0.5 * WINDOW else 1.0
