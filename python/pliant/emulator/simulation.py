"""Simulation of the servos: physics, protections and time, without ports or threads."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant._core import ConfigError
from pliant.emulator.motion import Joints

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pliant.emulator.motion import Physics
    from pliant.emulator.servo import Servo

#: Longest emulated time between two updates of the servos' protections and watchdogs [s].
SLICE = 0.010


class Simulation:
    """Advances the physics of all servos, and updates their protections.

    Attributes:
        servos: All servos of all ports.
        physics: Physics of the servo shafts.
        time: Emulated time since the start [s], a whole number of physics steps.
        watchers: Functions that are called with the number of physics steps just made.
    """

    def __init__(self, servos: Sequence[Servo], physics: Physics | None = None) -> None:
        """Connect the servos to `physics` and boot them; None: the servos move independently."""
        self.servos = list(servos)
        self.physics: Physics = Joints() if physics is None else physics
        self.time = 0.0
        self.watchers: list[Callable[[int], None]] = []
        self._steps, self._remainder, self._steps_since_update = 0, 0.0, 0
        self.physics.bind(self.servos)
        for servo in self.servos:
            servo.power_up()
            servo.wake()

    def advance(self, seconds: float, *, settle: bool = True) -> None:
        """Run the physics; keep a remainder below one physics step for the next call.

        Args:
            seconds: Emulated time to add [s].
            settle: True: also update the servos' protections at the end, not only every `SLICE`.

        Raises:
            ConfigError: `seconds` is negative or not finite.
        """
        if not 0.0 <= seconds < float("inf"):
            raise ConfigError(f"time can advance by 0 s or more, got {seconds!r}")
        dt = self.physics.dt
        self._remainder += seconds
        steps = int(self._remainder / dt + 1e-6)
        self._remainder = max(self._remainder - steps * dt, 0.0)
        slice_steps = max(round(SLICE / dt), 1)
        while steps > 0:
            count = min(steps, slice_steps - self._steps_since_update)
            self.physics.step(count)
            for watch in tuple(self.watchers):
                watch(count)
            self._steps += count
            self._steps_since_update += count
            steps -= count
            self.time = self._steps * dt
            for servo in self.servos:
                servo.now = self.time
            if self._steps_since_update >= slice_steps:
                self._update_servos()
        if settle and self._steps_since_update:
            self._update_servos()

    def _update_servos(self) -> None:
        """Update temperature and protections of every servo for the steps since the last update."""
        for servo in self.servos:
            servo.update(self._steps_since_update * self.physics.dt)
        self._steps_since_update = 0

    def servo(self, id: int) -> Servo:
        """Return the first servo with this id.

        Raises:
            ConfigError: No servo has this id; the message lists the servos.
        """
        for servo in self.servos:
            if servo.id == id:
                return servo
        known = ", ".join(f"{servo.id} ({servo.model.name})" for servo in self.servos)
        raise ConfigError(f"no servo with id {id} is emulated; there are {known}")
