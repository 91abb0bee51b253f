"""Torque on and off: sequences that keep the arm where it is, whatever fails on the way."""

from __future__ import annotations

import time
from math import ceil
from typing import TYPE_CHECKING

from pliant import ServoError, ServoFault
from pliant.servo.identify import Image, read_image
from pliant.servo.status import refusal
from pliant.servo.transport import BusError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from pliant.servo.device import Device
    from pliant.servo.port import Port

    Array = NDArray[np.float64]
    Ports = Mapping[int, Port]

#: A joint at rest that moves further than this while its torque comes on is switched off again
#: [rad].
MOVED = 0.05
#: A joint must be this near to where it is believed to be [rad].
ELSEWHERE = 0.15
#: How long a servo may take to come back from a reboot [s].
REBOOT = 2.0
#: What is looked at before torque goes on.
_BEFORE = ("torque_enable", "position", "hardware_error", "watchdog", "voltage")
#: One unit of the bus watchdog [s].
WATCHDOG_UNIT = 0.02


def enable(devices: Sequence[Device], ports: Ports, goal: Array, limit: Array, cap: Array) -> None:
    """Limit, then goal = present position, then torque, then a look; see `ServoChain.enable`."""
    before = {}
    for device in devices:
        before[id(device)] = _look(device, ports, goal)
    for device in devices:
        if _tripped(device, before):
            _set(device, ports, "watchdog", 0)
        register = device.limit_register(float(limit[device.joint]))
        _set(device, ports, "limit", register)
        device.limit = register
        found = _image(device, ports, "limit")["limit"]
        if found != register:
            raise ServoError(
                f"{device.name} did not take the torque limit: it reads {found}, written was "
                f"{register}; nothing was switched on"
            )
    switched = [d for d in devices if not before[id(d)]["torque_enable"]]
    try:
        # Fresh, and all in one go: an arm that nobody holds yet is on its way down.
        here = {id(d): _image(d, ports, "position", "speed") for d in devices}
        packets: dict[Port, list[tuple[Device, int, int, int]]] = {}
        for device in devices:
            angle, speed = float(goal[device.joint]), float(cap[device.joint])
            register = (
                here[id(device)]["position"] if device in switched else device.goal_counts(angle)
            )
            packets.setdefault(ports[id(device)], []).append(
                (device, register, device.limit, device.units.speed_register(speed))
            )
        for port, group in packets.items():
            port.write(group)
        for device in switched:
            _set(device, ports, "torque_enable", 1)
        for device in devices:
            _stayed(device, ports, here[id(device)])
    except BaseException:
        for device in switched:
            _try_off(device, ports)
        raise
    for device in devices:
        device.enabled = device.torque_on = True


def _look(device: Device, ports: Ports, goal: Array) -> Image:
    """The servo before anything is sent; refuses what must not be switched on."""
    names = [name for name in _BEFORE if name in device.family.registers]
    image = _image(device, ports, *names)
    if device.hardware:
        raise ServoFault("\n".join(device.faults) + f"\nreboot({device.spec.name!r}) clears it")
    if device.position is None:
        raise ServoError(f"{device.name} has not been read yet")
    here = device.angle(device.position)
    believed = float(goal[device.joint])
    if abs(here - believed) > ELSEWHERE and not image["torque_enable"]:
        raise ServoError(
            f"{device.name} is at {here:.2f} rad and not at {believed:.2f}: enable it with the "
            "goal where it is, and move it afterwards"
        )
    raw = round(device.position)
    if not device.multi_turn and not device.low <= raw <= device.high:
        raise ServoError(
            f"{device.name} is at count {raw}, outside of {device.low} to {device.high} where its "
            "goals may be, and would jump there: move it by hand"
        )
    return image


def _tripped(device: Device, before: Mapping[int, Image]) -> bool:
    image = before[id(device)]
    return "watchdog" in image and image["watchdog"] == 255


def _stayed(device: Device, ports: Ports, before: Image) -> None:
    """Look again: torque is on, and the joint is where it was, or where its fall was caught."""
    image = _image(device, ports, "torque_enable", "position")
    if not image["torque_enable"]:
        raise ServoError(f"{device.name} did not switch its torque on; all are off again")
    moved = abs(image["position"] - before["position"]) * device.units.count
    passed = image.time - before.time
    fallen = 2.0 * abs(device.units.velocity(before["speed"])) * passed
    # A soft servo must be pushed away from its goal to exert anything: at most by limit / k_p.
    kp = device.spec.kp or device.units.stiffness(device.gain)
    sag = device.units.torque(device.limit) / kp
    if moved > MOVED + fallen + sag:
        raise ServoError(
            f"{device.name} moved by {moved:.2f} rad as its torque came on; all are off again. "
            "A limit below what carries its weight lets it sink, a wrong Homing Offset lets it jump"
        )


def disable(devices: Sequence[Device], ports: Ports) -> None:
    """Torque off; every servo is tried."""
    failed = []
    for device in devices:
        problem = _try_off(device, ports)
        if problem:
            failed.append(problem)
    if failed:
        raise ServoError("torque may still be on: " + "; ".join(failed))


def reboot(devices: Sequence[Device], ports: Ports) -> None:
    """Restart servos and wait for them."""
    for device in devices:
        if device.family.status != "p2":
            raise ServoError(
                f"{device.name}: a {device.row.name} has no reboot over the bus; take its load "
                "off, let it cool down, or switch its supply off and on"
            )
        guard = ports[id(device)].guard
        device.enabled = device.torque_on = False
        guard.begin()
        guard.reboot(device.id)
        end = time.monotonic() + REBOOT
        while not guard.ping(device.id):
            if time.monotonic() > end:
                raise ServoError(f"{device.name} did not come back within {REBOOT:g} s of a reboot")
        device.hardware = device.conditions = ()
        _image(device, ports, "hardware_error", "torque_enable")


def watchdog(devices: Sequence[Device], ports: Ports, seconds: float) -> None:
    """Set the bus watchdog of the servos that have one."""
    units = min(127, ceil(seconds / WATCHDOG_UNIT)) if seconds > 0.0 else 0
    for device in devices:
        if "watchdog" in device.family.registers:
            _set(device, ports, "watchdog", units)


def _try_off(device: Device, ports: Ports) -> str | None:
    """Torque off; what went wrong, None when it is off."""
    device.enabled = False
    device.rota.pop("torque", None)
    try:
        _set(device, ports, "torque_enable", 0)
    except ServoError as error:
        return str(error)
    device.torque_on = False
    return None


def _image(device: Device, ports: Ports, *names: str) -> Image:
    """Registers of a servo, fresh."""
    guard = ports[id(device)].guard
    guard.begin()
    image = read_image(guard, device, *names)
    for reply in image.replies:
        device.note(reply)
    return image


def _set(device: Device, ports: Ports, name: str, value: int) -> None:
    """Write one register and see it acknowledged."""
    guard = ports[id(device)].guard
    guard.begin()
    register = device.family.registers[name]
    try:
        status = guard.write(device.id, register.address, register.encode(value))
    except BusError as error:
        if error.reason == "gone":
            raise
        raise ServoError(f"{device.name} did not confirm {name} = {value}: {error}") from error
    why = refusal(device.family, status)
    if why is not None:
        guard.counters.refused += 1
        raise ServoError(f"{device.name} refused {name} = {value}: {why}")
