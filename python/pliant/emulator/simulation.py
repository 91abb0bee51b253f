"""Servos, their physics and the clock, without ports or threads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant._core import ConfigError
from pliant.emulator.motion import Joints

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant.emulator.motion import Physics
    from pliant.emulator.servo import Servo

#: Longest period of protections and watchdogs [s].
SLICE = 0.010


class Simulation:
    """Advances the physics, then updates every servo.

    Attributes:
        servos: All servos of all ports.
        physics: Physics of their shafts.
        time: Since the start [s], a whole number of physics steps.
    """

    def __init__(self, servos: Sequence[Servo], physics: Physics | None = None) -> None:
        """Bind the servos to `physics`; by default they are independent."""
        self.servos = list(servos)
        self.physics: Physics = Joints() if physics is None else physics
        self.time = 0.0
        self._steps, self._owed, self._unseen = 0, 0.0, 0
        self.physics.bind(self.servos)
        for servo in self.servos:
            servo.power_up()
            servo.wake()

    def advance(self, seconds: float, *, settle: bool = True) -> None:
        """Advance the time; a remainder below one physics step is kept for the next call.

        Args:
            seconds: Duration [s].
            settle: True: the servos are also updated at the end, not only every 10 ms.

        Raises:
            ConfigError: Not a number, or negative.
        """
        if not 0.0 <= seconds < float("inf"):
            raise ConfigError(f"time can advance by 0 s or more, got {seconds!r}")
        dt = self.physics.dt
        self._owed += seconds
        steps = int(self._owed / dt + 1e-6)
        self._owed = max(self._owed - steps * dt, 0.0)
        most = max(round(SLICE / dt), 1)
        while steps > 0:
            now = min(steps, most - self._unseen)
            self.physics.step(now)
            self._steps += now
            self._unseen += now
            steps -= now
            self.time = self._steps * dt
            for servo in self.servos:
                servo.now = self.time
            if self._unseen >= most:
                self._look()
        if settle and self._unseen:
            self._look()

    def _look(self) -> None:
        """Update every servo."""
        for servo in self.servos:
            servo.update(self._unseen * self.physics.dt)
        self._unseen = 0

    def servo(self, id: int) -> Servo:
        """Return the first servo with this id.

        Raises:
            ConfigError: No servo has it; the message lists the known ones.
        """
        for servo in self.servos:
            if servo.id == id:
                return servo
        there = ", ".join(f"{servo.id} ({servo.model.name})" for servo in self.servos)
        raise ConfigError(f"no servo with id {id} is emulated; there are {there}")
