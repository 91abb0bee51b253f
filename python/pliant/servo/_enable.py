"""Sequences of packets that switch torque on without moving the arm, and torque off."""

from __future__ import annotations

import time
from contextlib import suppress
from math import inf
from typing import TYPE_CHECKING, NamedTuple

from pliant._core import ServoError, ServoFaultError
from pliant._validation import named_together
from pliant.servo._device import TRIPPED
from pliant.servo._handshake import RegisterImage, read_image
from pliant.servo._port import write_groups
from pliant.servo._status import refusal
from pliant.servo._transactions import Reply
from pliant.servo.transport import BusError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from pliant.servo._device import Device
    from pliant.servo._port import Group, Port
    from pliant.servo.models.base import Block

    Ports = Mapping[int, Port]

#: Largest motion of a joint while its torque comes on [rad], beyond the motion that falling and the
#: position error under load explain; a larger motion switches the torque off again.
MAX_MOTION = 0.05
#: Largest difference of measured and expected position at which torque is switched on [rad].
MAX_START_ERROR = 0.15
#: Number of attempts to send goal and limit until they read back as written.
MAX_SENDS = 5
#: Distance from its goal above which a joint without torque gets a new goal [rad].
MAX_DRIFT = 0.01
#: Time within which a servo must answer after a reboot [s].
REBOOT = 2.0
#: `ServoBus.reopen` gives up silent servos when no further servo has answered for this time [s].
RESUME_TIME = 3.0
#: Registers that are read and checked before torque is switched on.
_CHECKED = ("torque_enable", "position", "hardware_error", "watchdog", "voltage", "temperature")
#: Registers of the first command, in the order of `FirstCommand`.
_COMMANDED = ("goal", "limit", "speed_cap")
#: Registers that `resume` reads from a servo of an ended program.
_RESUMED = ("torque_enable", "goal", "limit")
#: Number of torque-off packets to a servo that does not reply.
OFF_PACKETS = 3
#: Largest number of attempts to send torque-off packets: on a noisy line, an attempt may fail.
OFF_TRIES = 30
MAY_BE_ON = "torque may still be on: "
#: Text about servos whose registers could not be restored after torque off.
KEPT = "torque limits and speeds are pliant's until the supply is switched off and on"


def enable(
    devices: Sequence[Device],
    ports: Ports,
    goal: Sequence[float],
    limit: Sequence[float],
    lead: Sequence[float],
    *,
    max_speed: float,
) -> None:
    """Switch torque on with the present positions plus `lead` as goals; see `ServoBus.enable`.

    Limits and goals are written and read back before torque on. Afterwards torque and positions
    are verified; after a failure torque is switched off again. After a signal (KeyboardInterrupt,
    SystemExit) the joints that have torque keep it, so that the arm can be lowered.

    Args:
        devices: The servos.
        ports: Port of each servo.
        goal: Expected joint positions (n,) [rad].
        limit: Torque limits (n,) [N·m].
        lead: Goal minus position of joints without torque (n,) [rad].
        max_speed: Largest joint speed [rad/s]; 0: the no-load speed.
    """
    for device in devices:
        device.is_off_requested = False
    images = {}
    for device in devices:
        images[id(device)] = _check_state(device, ports, goal)
    switched = [d for d in devices if not images[id(d)]["torque_enable"]]
    indices = [device.index for device in devices]
    codec = devices[0].codec
    columns = codec.encode(indices, goal, limit, None, max_speed)[:3]
    ahead = [angle + extra for angle, extra in zip(goal, lead, strict=True)]
    leading_goals = codec.encode(indices, ahead, limit, None, max_speed)[0]
    commands, leads = {}, {}
    for device, row, leading in zip(
        devices, zip(*columns, strict=True), leading_goals, strict=True
    ):
        commands[id(device)] = FirstCommand(*row)
        leads[id(device)] = leading - row[0]
    is_sent = False
    changed: list[Device] = []
    try:
        for device in devices:
            changed.append(device)
            if _has_tripped(device, images):
                _set(device, ports, "watchdog", 0)
            _write_limits(device, ports, commands[id(device)].limit)
        # Read the positions for the goals only now: an arm without torque may be sinking.
        start = {id(d): _image(d, ports, "position", "speed") for d in devices}
        for device in switched:
            goal_register = _goal(device, start[id(device)], leads[id(device)])
            commands[id(device)] = commands[id(device)]._replace(goal=goal_register)
        # Failures from here on may leave torque on: on some servos a goal switches it on.
        is_sent = True
        for port in dict.fromkeys(ports[id(device)] for device in devices):
            served = [device for device in devices if ports[id(device)] is port]
            for group in write_groups(served):
                rows = [commands[id(device)] for device in group.devices]
                port.send(group, *_encoded(group, rows))
        # Send few requests from here on: servos may already hold the arm without a loop.
        found = _images(devices, ports, *_COMMANDED, "torque_enable", "position", "speed")
        switched_by_goal: dict[Port, list[Device]] = {}
        for device in devices:
            start[id(device)], is_on = _send_first_command(
                device,
                ports,
                commands[id(device)],
                (start[id(device)], found[id(device)]),
                leads[id(device)],
            )
            if not is_on:
                _set(device, ports, "torque_enable", 1)
            elif device in switched:
                switched_by_goal.setdefault(ports[id(device)], []).append(device)
        for port, served in switched_by_goal.items():
            # Send one packet without a reply: torque is on already, and is checked below.
            for group in write_groups(served):
                register = group.family.registers["torque_enable"]
                ones = [register.encode(1)] * len(group.ids)
                port.guard.sync_write(group.ids, register.address, ones)
        found = _images(devices, ports, "torque_enable", "position")
        for device in devices:
            _check_still(device, start[id(device)], found[id(device)])
        # Read now: after a silence, the first reading asks each servo whether it restarted.
        for port in dict.fromkeys(ports[id(device)] for device in devices):
            port.read(inf)
    except BaseException as error:
        if is_sent and not isinstance(error, Exception):
            # After a signal, torque stays as it is, because it may hold the arm up. All servos
            # count as enabled, so that the caller's goals lower every joint that has torque.
            for device in devices:
                device.enabled = device.torque_on = True
            raise
        failures = _first_names(
            (device, text) for device in switched if (text := _try_off(device, ports))
        )
        if not (switched and isinstance(error, ServoError)):
            raise
        lines = [str(error)]
        if is_sent and failures:
            lines.append(f"{MAY_BE_ON}{failures}\nsupport the arm and cut the supply")
        elif is_sent:
            names = ", ".join(device.name for device in switched)
            where = "all joints" if len(switched) == len(devices) else names
            lines.append(f"torque is OFF again in {where}: what it carried falls")
        unrestored = [d.name for d in changed if d in switched and d.is_unrestored]
        if unrestored:
            lines.append(f"{', '.join(unrestored)}: {KEPT}")
        if len(lines) == 1:
            raise
        raise ServoError("\n".join(lines)) from error
    for device in devices:
        device.enabled = device.torque_on = True


def resume(devices: Sequence[Device], ports: Ports, budget: float, patience: float) -> list[Device]:
    """Read the servos of an ended program, and enable those whose torque is on.

    Each servo is asked until it answers, or until no servo has answered for the time `patience`. A
    servo that does not answer keeps goal and limit, and gets no goals.

    Args:
        devices: The servos.
        ports: Port of each servo.
        budget: Time for each attempt to read a servo [s].
        patience: Time without an answer after which no servo is asked again [s]; 0: each servo is
            asked once.

    Returns:
        Servos that did not answer; their torque may be on.

    Raises:
        BusError: A port is gone.
    """
    pending = list(devices)
    for device in devices:
        device.enabled, device.torque_unknown = False, True
        device.accept_any_position()
    # Read with few requests: until the first goal, the servos execute the old command.
    together, failed = _read_together(devices, ports, budget) if patience > 0.0 else ({}, set())
    deadline = time.monotonic() + patience
    while pending:
        silent = []
        for device in pending:
            guard = ports[id(device)].guard
            # An infinite budget allows longer drains and more tries: a late reply to the failed
            # request must not be taken for a reply to this one.
            has_failed = id(device) in failed
            guard.start_cycle(inf if has_failed else budget)
            try:
                *replies, reading = together.pop(id(device), None) or [
                    *read_image(guard, device, *_RESUMED, again=not has_failed).replies,
                    guard.read(device.id, *device.family.read, again=not has_failed),
                ]
            except BusError as error:
                error.raise_if_gone()
                silent.append(device)
                continue
            image = RegisterImage(device, *replies)
            device.accept(reading)
            device.enabled = device.torque_on = bool(image["torque_enable"])
            device.torque_unknown = False
            device.record_sent(image["goal"], image["limit"])
            deadline = time.monotonic() + patience
        pending, failed = silent, set()
        if time.monotonic() > deadline:
            break
    return pending


def _read_together(
    devices: Sequence[Device], ports: Ports, budget: float
) -> tuple[dict[int, list[Reply]], set[int]]:
    """Read registers `_RESUMED` and position, with one request per block for servos of one kind.

    Servos that cannot be read like this are left out.

    Returns:
        Replies by ``id(device)``, the one with the position last; and ``id(device)`` of the servos
        whose request failed, because one of them did not answer.

    Raises:
        BusError: A port is gone.
    """
    replies: dict[int, list[Reply]] = {}
    failed: set[int] = set()
    for port, group in _sync_groups(devices, ports):
        family = group[0].family
        port.guard.start_cycle(budget)
        try:
            replies |= _sync_replies(group, port, [*family.blocks(*_RESUMED), family.read[0]])
        except BusError as error:
            error.raise_if_gone()
            failed.update(map(id, group))
    return replies, failed


class FirstCommand(NamedTuple):
    """Register values of the first command of a servo.

    Attributes:
        goal: Goal position [counts].
        limit: Value of the limit register.
        speed: Value of the speed cap register.
    """

    goal: int
    limit: int
    speed: int


def _encoded(
    group: Group, commands: Sequence[FirstCommand]
) -> tuple[list[int], list[int], list[list[bytes]]]:
    """Return goal registers, limit registers and packets of the commands, see `Port.send`."""
    packets = [
        [device.packet(names, *row) for device, row in zip(group.devices, commands, strict=True)]
        for names in group.family.write
    ]
    return [row.goal for row in commands], [row.limit for row in commands], packets


def _write_limits(device: Device, ports: Ports, limit: int) -> None:
    """Write the limit register and `Device.drive_values`, and read them back.

    The `drive_values` are further registers that bound torque or motion.

    Raises:
        ServoError: A register did not read back as written.
    """
    expected_values = {"limit": limit, **device.drive_values}
    for name, value in expected_values.items():
        _set(device, ports, name, value)
    device.record_sent(device.goal, limit)
    image = _image(device, ports, *expected_values)
    for name, value in expected_values.items():
        if image[name] != value:
            what = "the torque limit" if name == "limit" else name
            raise ServoError(
                f"{device.name} did not take {what}: it reads {image[name]}, written was {value}; "
                "nothing was switched on"
            )


def _goal(device: Device, image: RegisterImage, lead: int) -> int:
    """Return the goal register of a joint at the position in `image`, with a lead [counts]."""
    goal = image["position"] + lead
    return goal if device.multi_turn else min(max(goal, device.low), device.high)


def _send_first_command(
    device: Device,
    ports: Ports,
    command: FirstCommand,
    images: tuple[RegisterImage, RegisterImage],
    lead: int,
) -> tuple[RegisterImage, bool]:
    """Check that goal, limit and speed cap read back as written, and send them again if not.

    A joint without torque that has moved since its position was read gets a new goal.

    Args:
        device: The servo.
        ports: Port of each servo.
        command: Register values that were sent.
        images: Registers from which the goal was made, with position and speed; and registers after
            the command was sent.
        lead: Goal minus position of a joint without torque [counts].

    Returns:
        Registers with position and speed from which the final goal was made, and True if the torque
        is on: on some servos, the goal switches it on.

    Raises:
        ServoError: After `MAX_SENDS` attempts the registers still differ from the values written,
            or the joint still moves.
    """
    expected_values = dict(zip(_COMMANDED, command, strict=True))
    start, image = images
    for _ in range(MAX_SENDS):
        is_off = not image["torque_enable"]
        goal = _goal(device, image, lead)
        drift = abs(goal - expected_values["goal"]) * device.units.count
        differing = [name for name, value in expected_values.items() if image[name] != value]
        if not differing and not (is_off and drift > MAX_DRIFT):
            return start, not is_off
        if is_off:
            expected_values["goal"], start = goal, image
        for names in device.family.write:
            data = device.packet(names, expected_values["goal"], command.limit, command.speed)
            _send(device, ports, names[0], data)
        device.record_sent(expected_values["goal"], command.limit)
        image = _image(device, ports, *_COMMANDED, "torque_enable", "position", "speed")
    if not differing:
        raise ServoError(
            f"{device.name} moves while it has no torque, by {drift:.2f} rad since its goal was "
            "made: hold the arm still while torque comes on"
        )
    raise ServoError(
        f"{device.name} did not take its {' and '.join(differing)}: "
        + ", ".join(f"{n} reads {image[n]}, written was {expected_values[n]}" for n in differing)
    )


def _check_state(device: Device, ports: Ports, goal: Sequence[float]) -> RegisterImage:
    """Check that the torque of a servo may be switched on; return its present registers.

    Raises:
        ServoError: The servo has a fault or is too hot, or its position differs from `goal` or is
            out of range.
    """
    names = [name for name in _CHECKED if name in device.family.registers]
    image = _image(device, ports, *names)
    if text := hardware_error(device):
        raise ServoFaultError(text)
    if not image["torque_enable"] and (text := device.heat()):
        raise ServoFaultError(f"{device.name}: {text}")
    if device.position is None:
        raise ServoError(f"{device.name} has not been read yet")
    start = device.angle(device.position)
    expected = float(goal[device.joint])
    if abs(start - expected) > MAX_START_ERROR and not image["torque_enable"]:
        raise ServoError(
            f"{device.name} is at {start:.2f} rad and not at {expected:.2f}: enable it with its "
            "present position as goal, and move it afterwards"
        )
    error = range_error(device)
    if error is not None and not image["torque_enable"]:
        raise ServoError(error)
    return image


def hardware_error(device: Device) -> str:
    """Return an error text if a servo has a latched hardware fault, else an empty one."""
    if not device.hardware:
        return ""
    return (
        "; ".join(device.faults) + ". To clear this, switch its supply off and on, or call "
        f"ServoBus.reboot({device.spec.name!r})"
    )


def range_error(device: Device) -> str | None:
    """Return an error text if a servo is too far outside the range of its goals for torque on.

    A joint pressed against its stop reads a little outside of the range that was calibrated there;
    torque moves it back by less than `MAX_MOTION`.
    """
    if device.multi_turn or device.position is None:
        return None
    raw, slack = round(device.position), MAX_MOTION / device.units.count
    if device.low - slack <= raw <= device.high + slack:
        return None
    return (
        f"{device.name} is at count {raw}, more than {slack:.0f} outside of {device.low} to "
        f"{device.high} where its goals may be, and would jump there: move it by hand"
    )


def _has_tripped(device: Device, images: Mapping[int, RegisterImage]) -> bool:
    image = images[id(device)]
    return "watchdog" in image and image["watchdog"] == TRIPPED


def _check_still(device: Device, before: RegisterImage, image: RegisterImage) -> None:
    """Check that torque is on, and that the joint has moved no farther than falling explains.

    `before` contains position and speed of the servo before torque on, `image` the present ones.
    """
    if not image["torque_enable"]:
        raise ServoError(f"{device.name} did not switch its torque on")
    motion = abs(image["position"] - before["position"]) * device.units.count
    passed = image.time - before.time
    fall = 2.0 * abs(device.units.velocity(before["speed"])) * passed
    # Also allow the position error at which the servo exerts its torque limit: limit / k_p.
    kp = device.spec.kp or device.units.stiffness(device.gain)
    sag = device.units.torque(device.limit) / kp
    if motion > MAX_MOTION + fall + sag:
        raise ServoError(
            f"{device.name} moved by {motion:.2f} rad as its torque came on. "
            "A limit below what carries its weight lets it sink, a wrong Homing Offset lets it jump"
        )


def disable(devices: Sequence[Device], ports: Ports) -> None:
    """Switch the torque of each servo off, and restore the RAM registers that were written.

    Raises:
        ServoError: Servos did not confirm; the message names them. The other servos are off.
    """
    failed = {id(device) for device in devices if _try_off(device, ports)}
    # Try again: the line may have been dead for a moment only.
    problems = []
    for device in devices:
        if id(device) in failed:
            if problem := _try_off(device, ports):
                problems.append((device, problem))
        elif device.is_unrestored:
            _try_restore(device, ports)
    if problems:
        raise ServoError(MAY_BE_ON + _first_names(problems))


def _first_names(problems: Iterable[tuple[Device, str]]) -> str:
    """Return one text about servos and their problems: names first, each problem once."""
    texts = ((device.name, text.removeprefix(device.name)) for device, text in problems)
    # A text that is not about the servo, but about its port, has no name to replace.
    return "; ".join(
        f"{names}{'' if text.startswith(' ') else ': '}{text}"
        for names, text in named_together(texts)
    )


def finish_disable(devices: Sequence[Device], ports: Ports, budget: float) -> None:
    """Complete an earlier torque off of servos that did not confirm it or kept their registers.

    Errors are ignored. A servo that is still silent is asked for at most the time `budget` [s].
    """
    for device in devices:
        if not device.is_unrestored or device.enabled or id(device) not in ports:
            continue
        guard = ports[id(device)].guard
        guard.start_cycle(budget)
        try:
            reply = guard.read(device.id, device.family.block("torque_enable"))
        except BusError:
            continue
        device.note(reply)
        if device.is_off_requested:
            _try_off(device, ports)
        elif not device.torque_on:
            _try_restore(device, ports)


def reboot(devices: Sequence[Device], ports: Ports) -> None:
    """Restart the servos one after the other, and wait until each answers again.

    Raises:
        ServoError: A servo cannot reboot over the bus, or does not answer within `REBOOT` seconds.
    """
    for device in devices:
        if device.family.status != "p2":
            raise ServoError(
                f"{device.name}: a {device.row.name} has no reboot over the bus; take its load "
                "off, let it cool down, or switch its supply off and on"
            )
        guard = ports[id(device)].guard
        device.enabled = device.torque_on = False
        guard.start_cycle()
        guard.reboot(device.id)
        end = time.monotonic() + REBOOT
        while not guard.ping(device.id):
            if time.monotonic() > end:
                raise ServoError(f"{device.name} did not come back within {REBOOT:g} s of a reboot")
        device.hardware = device.conditions = ()
        _image(device, ports, "hardware_error", "torque_enable")


def _try_off(device: Device, ports: Ports) -> str | None:
    """Switch a servo's torque off and restore its registers; return None if torque is off.

    Otherwise return the text of the error.
    """
    device.enabled = False
    device.accept_any_position()
    for key in ("torque", "limit", "goal"):
        device.fault(key, False, "")
    device.torque_unknown = device.is_unrestored = device.is_off_requested = True
    try:
        _set(device, ports, "torque_enable", 0)
    except BusError as error:
        return str(error)
    except ServoError as error:
        cause, text = error.__cause__, str(error)
        if isinstance(cause, BusError) and cause.reason == "timeout":
            # Without port and id, the texts of servos differ in the name only, see `_first_names`.
            text = f"{device.name} did not confirm torque_enable = 0: no answer"
        return f"{text}{_send_off_blindly(device, ports)}"
    device.torque_on = device.torque_unknown = False
    _try_restore(device, ports)
    return None


def _try_restore(device: Device, ports: Ports) -> None:
    """Restore the RAM registers of a servo whose torque is off; `is_unrestored` tells if it failed.

    Errors are ignored.
    """
    with suppress(ServoError):
        _restore_registers(device, ports)
        device.is_unrestored = False


def _send_off_blindly(device: Device, ports: Ports) -> str:
    """Send packets that switch a servo's torque off, without waiting for a reply.

    Return a text with the number of packets sent, for messages.
    """
    register = device.family.registers["torque_enable"]
    guard, sent = ports[id(device)].guard, 0
    for _ in range(OFF_TRIES):
        try:
            guard.sync_write([device.id], register.address, [register.encode(0)])
        except BusError as error:
            if error.reason == "gone":
                break
            continue  # the line is noisy: the transport found no silence to send in
        sent += 1
        if sent == OFF_PACKETS:
            break
    return f" (sent {sent} times more, without an answer)"


def _restore_registers(device: Device, ports: Ports) -> None:
    """Restore the initial values of RAM registers, on which other programs rely."""
    if not device.initial_values:
        return
    image = _image(device, ports, *device.initial_values)
    for name, value in device.initial_values.items():
        if image[name] != value:
            _set(device, ports, name, value)
    device.record_sent(device.goal, device.initial_values["limit"])


def _image(device: Device, ports: Ports, *names: str) -> RegisterImage:
    """Read the registers `names` of a servo, store their values in `device`, and return them."""
    guard = ports[id(device)].guard
    guard.start_cycle()
    image = read_image(guard, device, *names)
    for reply in image.replies:
        device.note(reply)
    return image


def _images(devices: Sequence[Device], ports: Ports, *names: str) -> dict[int, RegisterImage]:
    """Read the registers `names` of several servos, as `_image` does, with few requests.

    Servos of one port and kind answer one request per block; after a failure, and for kinds
    without such requests, each servo is read alone.
    """
    found: dict[int, list[Reply]] = {}
    for port, group in _sync_groups(devices, ports):
        port.guard.start_cycle()
        with suppress(BusError):
            found |= _sync_replies(group, port, group[0].family.blocks(*names))
    images = {}
    for device in devices:
        if id(device) in found:
            images[id(device)] = RegisterImage(device, *found[id(device)])
            for reply in found[id(device)]:
                device.note(reply)
        else:
            images[id(device)] = _image(device, ports, *names)
    return images


def _sync_groups(devices: Iterable[Device], ports: Ports) -> list[tuple[Port, list[Device]]]:
    """Return groups of two or more servos that one sync read can read, with their port."""
    groups: dict[tuple[int, int], tuple[Port, list[Device]]] = {}
    for device in devices:
        if device.family.sync_read:
            port = ports[id(device)]
            groups.setdefault((id(port), id(device.family)), (port, []))[1].append(device)
    return [(port, group) for port, group in groups.values() if len(group) > 1]


def _sync_replies(
    group: Sequence[Device], port: Port, blocks: Sequence[Block]
) -> dict[int, list[Reply]]:
    """Read blocks of registers of servos of one port and kind, with one request per block.

    Raises:
        BusError: A reply is missing or corrupt.
    """
    replies: dict[int, list[Reply]] = {id(device): [] for device in group}
    for wanted in blocks:
        block, answers, time = port.guard.sync_read([device.id for device in group], wanted)
        for device, (data, status) in zip(group, answers, strict=True):
            replies[id(device)].append(Reply(block, data, status, time))
    return replies


def _set(device: Device, ports: Ports, name: str, value: int) -> None:
    """Write the register `name` of a servo and wait for the servo's acknowledgement.

    Raises:
        ServoError: The port is gone, or the servo did not acknowledge or rejected the write.
    """
    register = device.family.registers[name]
    _send(device, ports, name, register.encode(value), f"{name} = {value}")


def _send(device: Device, ports: Ports, first: str, data: bytes, what: str = "its goal") -> None:
    """Write bytes from register `first` on, and wait for the servo's acknowledgement.

    Raises:
        BusError: The port is gone.
        ServoError: The servo did not acknowledge, or rejected the packet; the text names `what`.
    """
    guard = ports[id(device)].guard
    guard.start_cycle()
    try:
        status = guard.write(device.id, device.family.registers[first].address, data)
    except BusError as error:
        error.raise_if_gone()
        raise ServoError(f"{device.name} did not confirm {what}: {error}") from error
    why = refusal(device.family, status)
    if why is not None:
        guard.counters.refused += 1
        raise ServoError(f"{device.name} refused {what}: {why}")
