"""Physics of the servo shafts: the interface `Physics` and independent servos, `Joints`."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant.emulator.servo import Drive, Servo


class Physics(Protocol):
    """Interface of the physics that moves the servo shafts.

    Attributes:
        dt: Physics step [s].
    """

    dt: float

    def bind(self, servos: Sequence[Servo]) -> None:
        """Store the servos whose shafts this physics moves, and set their initial shaft states."""

    def step(self, count: int) -> None:
        """Run `count` steps: read every servo's `drive()`, write the result to its `shaft`."""


class Joints:
    """Physics of independent servos, each with its `load`: inertia, pendulum, hard stops.

    ``J dω/dt = clip(k e − kv ω, ±ceiling) − slope ω + τ − d ω`` is integrated with step `dt`. J is
    the inertia of rotor and load [kg·m²], ω the shaft speed [rad/s], e the position error outside
    the dead zone [rad]. `stiffness` k, `kv`, `ceiling` and `slope` are attributes of `Drive`. τ is
    the load torque [N·m], d the gear damping [N·m·s/rad]. Dry friction reduces the speed of each
    step.
    """

    def __init__(self, dt: float = 0.001) -> None:
        """Set the physics step `dt` [s]."""
        self.dt = dt
        self._servos: list[Servo] = []
        self._references: list[float | None] = []

    def bind(self, servos: Sequence[Servo]) -> None:
        """Store the servos to move; they start without a velocity profile."""
        self._servos = list(servos)
        self._references = [None] * len(self._servos)

    def step(self, count: int) -> None:
        """Run `count` physics steps of all servos."""
        for index, servo in enumerate(self._servos):
            drive, reference = servo.drive(), self._references[index]
            for _ in range(count):
                reference = profile_reference(drive, reference, servo.shaft.angle, self.dt)
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
        load_torque = load.torque - load.pendulum * math.sin(shaft.angle - load.down)
        damping = motor.damping + drive.slope
        # Integrate damping implicitly: this is stable for a light rotor at any step size.
        speed = shaft.speed + dt * (torque + load_torque) / inertia
        speed /= 1.0 + dt * damping / inertia
        brake = dt * motor.friction / inertia
        speed = math.copysign(max(abs(speed) - brake, 0.0), speed)
        angle = shaft.angle + dt * speed
        low, high = load.stops
        if not low <= angle <= high:
            angle, speed = max(low, min(angle, high)), 0.0
        shaft.angle, shaft.speed = angle, speed
        shaft.torque = torque - drive.slope * speed


def profile_reference(
    drive: Drive, reference: float | None, angle: float, seconds: float
) -> float | None:
    """Return the goal angle [rad] of the servo's velocity profile after `seconds` [s].

    Args:
        drive: Motor request with goal angle and profile speed.
        reference: Goal angle of the profile at present [rad]; None: the profile starts now.
        angle: Present shaft angle, at which a profile starts [rad].
        seconds: Duration of the step [s].

    Returns:
        The new goal angle of the profile; None for a motor without power.
    """
    if drive.goal is None:
        return None
    if math.isinf(drive.speed):
        return drive.goal
    start = angle if reference is None else reference
    max_change = drive.speed * seconds
    return start + max(-max_change, min(drive.goal - start, max_change))
