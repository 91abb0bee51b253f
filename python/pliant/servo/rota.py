"""Slow data, a small read per cycle: voltage, temperature, faults, limits as they stand."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant.arm.drive import Health
from pliant.servo.transport import BusError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pliant.servo.device import Device
    from pliant.servo.models import Block, Family
    from pliant.servo.port import Port


def parts(family: Family) -> tuple[Block, ...]:
    """What the rota reads of a servo, one block per step, latched faults first."""
    if family.status == "p2":
        alone = ("hardware_error", "torque_enable", "limit", "watchdog")
        return (
            *(family.block(name) for name in alone),
            family.block("voltage", "temperature"),
        )
    # Voltage and temperature come with every reading.
    return (family.block("torque_enable", "limit"),)


class Rota:
    """Goes round the servos of all joints, one block per step; alarms first.

    Args:
        joints: Servos of each joint.
    """

    def __init__(self, joints: Sequence[Sequence[Device]]) -> None:
        """Start with the first joint."""
        self._joints = joints
        devices = [device for joint in joints for device in joint]
        self._steps = [(d, block) for d in devices for block in parts(d.family)]
        self._next = 0
        self._alarmed: set[int] = set()
        self._again = False

    def step(self, ports: Mapping[int, Port]) -> Health | None:
        """Read one block, and say what is known of its joint.

        A servo whose last answer carried an alert it has not been asked about is read first, and so
        is one whose torque went off, and one whose limit read other than written: a lost packet and
        a servo that refuses look alike until the next.

        Raises:
            BusError: The port is gone.
        """
        device, block = self._choose()
        guard = ports[id(device)].guard
        try:
            device.note(guard.read(device.id, block))
        except BusError as error:
            if error.reason == "gone":
                raise
            return None
        return self._health(device.joint)

    def _choose(self) -> tuple[Device, Block]:
        for joint in self._joints:
            for device in joint:
                if device.doubted and not self._again:
                    self._again = True
                    return device, device.family.block("limit")
                alarm = bool(device.conditions) or "torque" in device.rota
                if alarm and id(device) not in self._alarmed:
                    self._alarmed.add(id(device))
                    return device, parts(device.family)[0]
                if not alarm:
                    self._alarmed.discard(id(device))
        self._again = False
        step = self._steps[self._next]
        self._next = (self._next + 1) % len(self._steps)
        return step

    def _health(self, joint: int) -> Health:
        devices = self._joints[joint]
        volts = [d.voltage for d in devices if d.voltage is not None]
        heat = [d.temperature for d in devices if d.temperature is not None]
        first = devices[0]
        limit = None if first.limit_read is None else first.units.torque(first.limit_read)
        return Health(
            first.spec.name,
            min(volts) if volts else None,
            max(heat) if heat else None,
            tuple(text for d in devices for text in d.faults),
            limit,
        )
