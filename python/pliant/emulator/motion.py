"""Physics of the shafts: independent servos, or any object with a `step`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant.emulator.servo import Drive, Servo


class Physics(Protocol):
    """Moves the shafts of servos.

    Attributes:
        dt: Physics step [s].
    """

    dt: float

    def bind(self, servos: Sequence[Servo]) -> None:
        """Take over these servos and set their shafts."""

    def step(self, count: int) -> None:
        """Run so many steps: read every servo's `drive()`, write the result to its `shaft`."""


class Joints:
    """Independent servos, each with its `load`: rotor, gears, a pendulum, hard stops.

    ``J dω = clip(k e − kv ω, ±ceiling) − slope ω + outer torque − damping ω``, dry friction as an
    impulse that only brakes, all at `dt`.
    """

    def __init__(self, dt: float = 0.001) -> None:
        """Choose the step [s]."""
        self.dt = dt
        self._servos: list[Servo] = []
        self._references: list[float | None] = []

    def bind(self, servos: Sequence[Servo]) -> None:
        """Take over these servos."""
        self._servos = list(servos)
        self._references = [None] * len(self._servos)

    def step(self, count: int) -> None:
        """Run so many steps."""
        for index, servo in enumerate(self._servos):
            drive, reference = servo.drive(), self._references[index]
            for _ in range(count):
                reference = walk(drive, reference, servo.shaft.angle, self.dt)
                self._move(servo, drive, reference)
            self._references[index] = reference

    def _move(self, servo: Servo, drive: Drive, reference: float | None) -> None:
        shaft, load, motor, dt = servo.shaft, servo.load, servo.model.motor, self.dt
        inertia = motor.inertia + load.inertia
        torque = 0.0
        if reference is not None:
            error = reference - shaft.angle
            error -= max(-drive.dead, min(error, drive.dead))
            torque = drive.stiffness * error - drive.kv * shaft.speed
            torque = max(-drive.ceiling, min(torque, drive.ceiling))
        outer = load.torque - load.pendulum * math.sin(shaft.angle - load.down)
        resist = motor.damping + drive.slope
        # Damping is integrated implicitly, so that a light rotor cannot oscillate with the step.
        speed = (shaft.speed + dt * (torque + outer) / inertia) / (1.0 + dt * resist / inertia)
        brake = dt * motor.friction / inertia
        speed = math.copysign(max(abs(speed) - brake, 0.0), speed)
        angle = shaft.angle + dt * speed
        low, high = load.stops
        if not low <= angle <= high:
            angle, speed = max(low, min(angle, high)), 0.0
        shaft.angle, shaft.speed = angle, speed
        shaft.torque = torque - drive.slope * speed


def walk(drive: Drive, reference: float | None, angle: float, seconds: float) -> float | None:
    """Return the reference of the servo's profile after `seconds`; None without power."""
    if drive.goal is None:
        return None
    if math.isinf(drive.speed):
        return drive.goal
    start = angle if reference is None else reference
    most = drive.speed * seconds
    return start + max(-most, min(drive.goal - start, most))
