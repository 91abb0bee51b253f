"""Clock of a host program whose waits advance the emulated time."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pliant.emulator.emulator import Emulator


class ManualClock:
    """Clock for `ServoBus(..., clock=...)` on an emulator with the clock `steps`.

    A wait only advances the emulated time, so the program runs as fast as the computer allows. A
    busy computer matters only if a reply takes longer than the host's reply timeout.

    Args:
        bus: The emulator, in the same process as the program.
    """

    def __init__(self, bus: Emulator) -> None:
        self._bus = bus

    def now(self) -> float:
        """Let the servos process all bytes that the host has written; return the time [s]."""
        self._bus.sync()
        return self._bus.time

    def wait_until(self, deadline: float) -> None:
        """Advance the emulated time to `deadline` [s], instead of waiting."""
        remaining = deadline - self.now()
        if remaining > 0.0:
            self._bus.advance(remaining)
