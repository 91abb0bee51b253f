"""Slow data, one small read per cycle: voltage, temperature, faults and stored limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant.drive import ServoStatus
from pliant.servo.transport import BusError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pliant.servo.device import Device
    from pliant.servo.models import Block, Family
    from pliant.servo.port import Port


def parts(family: Family) -> tuple[Block, ...]:
    """Return the slow blocks of a servo, one per step, latched faults first."""
    if family.status == "p2":
        alone = ("hardware_error", "torque_enable", "watchdog")
        return (
            *(family.block(name) for name in alone),
            *echoes(family),
            family.block("voltage", "temperature"),
        )
    # Voltage and temperature come with every reading.
    return (family.block("torque_enable", "limit", "goal"),)


def echoes(family: Family) -> tuple[Block, ...]:
    """Return blocks with the goal and limit stored in a servo, as many as there are packets."""
    return tuple(
        family.block(*(name for name in names if name in {"goal", "limit"}))
        for names in family.write
    )


#: Faults that are reported at once, before the joint's turn.
ALARMS = frozenset({"torque", "jump", "port"})
#: Number of steps between two requests for the torque state of all servos.
TORQUE_EVERY = 3


class Rota:
    """Cyclic schedule of slow reads over all servos, one block per step; alarms come first.

    Args:
        joints: Servos of each joint.
    """

    def __init__(self, joints: Sequence[Sequence[Device]]) -> None:
        """Start with the first servo."""
        self._joints = joints
        devices = [device for joint in joints for device in joint]
        self._steps = [(d, block) for d in devices for block in parts(d.family)]
        self._next = 0
        self._alarmed: set[int] = set()
        self._again = False
        self._echo = self._count = 0

    def step(self, ports: Mapping[int, Port]) -> ServoStatus | None:
        """Read one block; return the slow data of its joint.

        Three kinds of servos are read first: those with a new alert, with an urgent fault, and with
        a goal or limit that read back wrong, because only a second reading distinguishes a lost
        packet from a servo that rejects it.

        Raises:
            BusError: The port is gone.
        """
        self._count += 1
        if self._count % TORQUE_EVERY == 0 and self._look_at_torque(ports):
            return None
        device, block = self._choose()
        guard = ports[id(device)].guard
        if guard.gone:
            return self._health(device.joint)
        try:
            device.note(guard.read(device.id, block))
        except BusError as error:
            if error.reason == "gone":
                raise
            return None
        return self._health(device.joint)

    def _look_at_torque(self, ports: Mapping[int, Port]) -> bool:
        """Read with one request whether torque is on, for all servos of the next port.

        This is done only if such a request exists and takes little of a cycle. A loss of torque is
        then detected within a few ticks.
        """
        several = [port for port in dict.fromkeys(ports.values()) if port.can_ask_all()]
        if not several:
            return False
        port = several[self._count // TORQUE_EVERY % len(several)]
        asked = [d for d in port.heard if d.enabled]
        if not asked:
            return False
        try:
            block = asked[0].family.block("torque_enable")
            replies = port.guard.sync_read([d.id for d in asked], block)
        except BusError as error:
            if error.reason == "gone":
                raise
            return True
        for device in asked:
            device.note(replies[device.id])
        # A servo that lost its torque raises an alarm: it is read next, in this step.
        return all(d.enabled for d in asked)

    def _choose(self) -> tuple[Device, Block]:
        for joint in self._joints:
            for device in joint:
                if device.doubted and not self._again:
                    self._again = True
                    blocks = echoes(device.family)
                    self._echo += 1
                    return device, blocks[self._echo % len(blocks)]
                alarm = bool(device.conditions) or not ALARMS.isdisjoint(device.rota)
                if alarm and id(device) not in self._alarmed:
                    self._alarmed.add(id(device))
                    return device, parts(device.family)[0]
                if not alarm:
                    self._alarmed.discard(id(device))
        self._again = False
        step = self._steps[self._next]
        self._next = (self._next + 1) % len(self._steps)
        return step

    def _health(self, joint: int) -> ServoStatus:
        devices = self._joints[joint]
        volts = [d.voltage for d in devices if d.voltage is not None]
        heat = [d.temperature for d in devices if d.temperature is not None]
        first = devices[0]
        limit = None if first.limit_read is None else first.units.torque(first.limit_read)
        return ServoStatus(
            first.spec.name,
            min(volts) if volts else None,
            max(heat) if heat else None,
            tuple(text for d in devices for text in d.faults),
            limit,
        )
