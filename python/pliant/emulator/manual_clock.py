"""Clock of an emulator whose time advances only during waits."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pliant.emulator.emulator import Emulator


class ManualClock:
    """Time of an emulator with the clock `steps`, for `ServoBus(..., clock=...)`.

    Waiting advances the emulated time, so a program over real bytes runs as fast as the computer
    allows. The computer's load matters only if a reply exceeds the host's timeout.

    Args:
        bus: The emulator, in this process.
    """

    def __init__(self, bus: Emulator) -> None:
        self._bus = bus

    def now(self) -> float:
        """Return the emulated time [s], after all bytes of the host so far."""
        self._bus.sync()
        return self._bus.time

    def wait_until(self, deadline: float) -> None:
        """Advance the time to `deadline` [s]."""
        left = deadline - self.now()
        if left > 0.0:
            self._bus.advance(left)
