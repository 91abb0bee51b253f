"""Identification and checks of every servo when the bus is opened.

This module only reads registers. Its error messages name the remedy, often `pliant servos setup`,
which writes EEPROM.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pliant._core import ServoError
from pliant._validation import named_together
from pliant.servo._device import TRIPPED
from pliant.servo._transactions import RESPONSE_DELAY
from pliant.servo.eeprom import OVERLOAD_BIT, SAME_ID
from pliant.servo.models import by_number
from pliant.servo.models.protocol2 import STARTUP
from pliant.servo.transport import BusError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant.servo._device import Device
    from pliant.servo._port import Port
    from pliant.servo._transactions import Reply, TransactionGuard

#: Highest id that is pinged for the list of ids that answer.
NEARBY = 20
#: Extra delay of replies, beyond their wire time, above which the adapter is reported as slow [s].
MIN_HOLD_BACK = 0.008
#: Number of the bit of Feetech's register Phase that is set if the unit of speed is 1 step/s.
SPEED_UNIT_BIT = 2


#: Error text about a servo that answers pings, but no reads. The level is in RAM or in EEPROM.
MUTE = (
    "it answers a ping but no read, as with Status Return Level 0: switch its supply off and on; "
    "if that does not help, set this level to 2 with the maker's tool (`pliant servos setup` "
    "cannot read the servo either)"
)
#: Remedy in errors about a calibration file that differs from the registers of the servo.
CALIBRATION_REMEDY = (
    "the file is of another arm, or older than its last calibration: name the file of this arm, or "
    "run lerobot-calibrate, which writes both file and servos"
)
#: LeRobot's name in the calibration file of each register that the file contains.
LEROBOT_NAMES = {
    "homing_offset": "homing_offset",
    "position_min": "range_min",
    "position_max": "range_max",
    "drive_mode": "drive_mode",
}


@dataclass(frozen=True)
class ServoInfo:
    """Identification of one servo.

    Attributes:
        joint: Joint name.
        id: Id on the bus.
        model: Model name in the servo table.
        firmware: Firmware version number; of Feetech servos: major + 256 · minor.
        voltage: Supply voltage [V].
        temperature: Servo temperature [°C].
        return_delay: Time that the servo waits before it replies [s].
        torque_on: True if torque was on when the bus was opened.
        notes: Warnings, each with its remedy.
    """

    joint: str
    id: int
    model: str
    firmware: int
    voltage: float
    temperature: float
    return_delay: float
    torque_on: bool
    notes: tuple[str, ...] = ()


class RegisterImage:
    """Registers of one servo, from one or several replies.

    ``image["position"]`` is the value of the register `position`.

    Attributes:
        replies: Replies that contain the bytes of the registers.
    """

    def __init__(self, device: Device, *replies: Reply) -> None:
        """Store the replies of the servo `device`; its family decodes them."""
        self._family, self.replies = device.family, replies

    @property
    def time(self) -> float:
        """Time of the earliest request for these registers [s]."""
        return self.replies[0].time

    def __contains__(self, name: str) -> bool:
        return name in self._family.registers

    def __getitem__(self, name: str) -> int:
        """Return the value of a register by name."""
        address = self._family.registers[name].address
        for reply in self.replies:
            if reply.block.address <= address < reply.block.address + reply.block.size:
                return self._family.decode(reply.block, reply.data, name)
        raise KeyError(name)


def read_image(
    guard: TransactionGuard, device: Device, *names: str, again: bool = True
) -> RegisterImage:
    """Read the registers `names` of a servo; without names, read all registers.

    `again`: True to retry after a failure.

    Raises:
        BusError: The servo did not answer.
    """
    blocks = device.family.blocks(*names)
    return RegisterImage(device, *(guard.read(device.id, block, again=again) for block in blocks))


def identify(port: Port) -> tuple[ServoInfo, ...]:
    """Identify and check every servo of a port, and store register values in its `Device`.

    Raises:
        ServoError: A servo is missing or is another model, its settings do not allow control, or
            its supply does not fit. The message lists all errors.
    """
    port.guard.start_cycle()
    port.guard.find_unused_id({device.id for device in port.devices}, port.highest)
    images: list[tuple[Device, RegisterImage]] = []
    missing: list[Device] = []
    broken: list[tuple[Device, BusError]] = []
    for device in port.devices:
        try:
            image = read_image(port.guard, device)
        except BusError as error:
            error.raise_if_gone()
            if error.reason == "noisy":
                raise ServoError(f"{port.path}: {error}") from error
            if error.reason == "timeout":
                missing.append(device)
            else:
                broken.append((device, error))
            continue
        images.append((device, image))
    errors = _broken(port, broken, all_of_them=not images and not missing)
    infos = []
    faulty: list[tuple[str, str]] = []
    # A servo that returns no status answers pings all the same.
    mute = [device for device in missing if port.guard.ping(device.id)]
    faulty += [(f"{device.spec.name} (id {device.id})", MUTE) for device in mute]
    if silent := [device for device in missing if device not in mute]:
        errors.insert(0, _missing(port, silent))
    unfit: dict[str, dict[str, float]] = {}
    for device, image in images:
        name = f"{device.spec.name} (id {device.id})"
        faults = _check(device, image) + _startup_errors(port.guard, device)
        faulty += [(name, text) for text in faults]
        low, high = _supply(device, image)
        has_supply = low <= (volts := image["voltage"] / 10.0) <= high
        if not has_supply and image["model"] == device.row.model_number:
            unfit.setdefault(_supply_range(device, image), {})[name] = volts
        elif not faults:
            try:
                infos.append(_store_registers(device, image))
            except ServoError as error:
                errors.append(str(error))
    for allowed, readings in unfit.items():
        text = _supply_error(allowed, list(readings.values()))
        faulty += [(name, text) for name in readings]
    errors += [f"{names} on {port.path}: {text}" for names, text in named_together(faulty)]
    if errors:
        raise ServoError("\n".join(errors))
    port.guard.response_delay = RESPONSE_DELAY + max(info.return_delay for info in infos)
    if note := _adapter_note(port):
        infos = [replace(info, notes=(*info.notes, note)) for info in infos]
    return tuple(infos)


def _adapter_note(port: Port) -> str:
    """Return a warning if the USB adapter holds replies back, else an empty text.

    The delay is read from the adapter's latency timer, or measured.
    """
    guard = port.guard
    if guard.held_back > max(MIN_HOLD_BACK, port.latency or 0.0):
        port.latency = guard.latency = round(guard.held_back, 3)
        return (
            f"every answer on {port.path} comes {guard.held_back * 1e3:.0f} ms later than the wire "
            "takes: the adapter delays short answers (16 ms is FTDI's default), so the loop is "
            "slower, and the arm reacts late and sinks more as torque comes on: set its latency "
            "timer to 1 ms (docs/troubleshooting.md)"
        )
    if port.latency is not None and port.latency > 0.001:
        return (
            f"the latency timer of {port.path} is {port.latency * 1e3:.0f} ms, which delays every "
            "answer: set it to 1 ms (docs/troubleshooting.md)"
        )
    return ""


def _broken(port: Port, broken: list[tuple[Device, BusError]], *, all_of_them: bool) -> list[str]:
    """Return error texts for servos whose replies are corrupt, with likely causes.

    If all replies on the port are corrupt (`all_of_them`), the line has an error; if only some are,
    two servos may have one id.
    """
    if all_of_them and len(broken) > 1:
        return [
            f"{port.path}: every answer is broken ({broken[0][1]}). Causes: an adapter that "
            "receives its own requests (switch its echo off) or adds bytes when it changes "
            "direction, another baud rate, or noise (cable, ground, termination)"
        ]
    return [f"{device.name}: {error}. {SAME_ID}" for device, error in broken]


def other_ids(port: Port) -> list[int]:
    """Return the ids up to `NEARBY` that answer a ping and that no joint has."""
    expected = {device.id for device in port.devices}
    return [i for i in range(NEARBY + 1) if i not in expected and port.guard.ping(i)]


def _missing(port: Port, missing: list[Device]) -> str:
    """Return an error text that names the servos without an answer, and the ids that answer."""
    expected = {device.id for device in port.devices}
    silent = {device.id for device in missing}
    names = ", ".join(f"{device.spec.name} (id {device.id})" for device in missing)
    answering = sorted(expected - silent | set(other_ids(port)))
    if not answering:
        return (
            f"no servo answers on {port.path}: is their power on, is it the right port, and is the "
            "baud rate right? `pliant servos scan` tries all of them"
        )
    return (
        f"no answer on {port.path} from {names}; ids that answer: "
        f"{', '.join(map(str, answering))}. The servos behind a loose plug are silent too; "
        "`pliant servos scan` finds one with another baud rate, as a new servo may have; a wrong "
        "id is changed by `pliant servos setup ARM --set-id OLD:NEW`"
    )


def _check(device: Device, image: RegisterImage) -> list[str]:
    """Return a text for each obstacle to control of a servo; empty if the servo is usable.

    The supply is not checked here: `identify` reports it once for all servos of a model.
    """
    row = device.row
    number = image["model"]
    if number != row.model_number:
        known = by_number(number)
        present = " or ".join(r.name for r in known)
        present = (
            present
            or f"no {row.name} (it reads as model number {number}, which is in no table; "
            f"`pliant servos scan` names it. If it has the control table of {row.name}, add "
            f"`model_number = {number}` to its line)"
        )
        return [f"it is {present}, the configuration says {row.name} ({row.model_number})"]
    errors = [*_check_mode(device, image), *_calibration_differences(device, image)]
    if image["return_level"] < (1 if device.family.status == "feetech" else 2):
        errors.append(
            "it does not acknowledge writes: `pliant servos setup` sets its Status Return Level"
        )
    if not device.family.multi_turn and image["position_min"] > image["position_max"]:
        errors.append("its position limits are reversed: calibrate it again")
    # The gain register of a servo without `row.gain` is a compliance slope.
    names = dict.fromkeys((device.family.ceiling, "pwm_limit", *["gain"] * (row.gain > 0.0)))
    return errors + [
        f"its register {name} is 0, so that it has no torque: set it with the maker's tool"
        for name in names
        if name in image and not image[name]
    ]


def _store_initial_values(device: Device, image: RegisterImage) -> None:
    """Store the register values that torque off restores, and the values that torque on writes.

    If torque is on or the limit is 0, an earlier program or an overload has set limit and speed
    cap; the values to restore are then those after power-up.
    """
    family = device.family
    device.drive_values = {
        name: value if isinstance(value, int) else image[value]
        for name, value in family.drive_values.items()
    }
    device.initial_values = {name: image[name] for name in family.restored_registers}
    if device.torque_on or device.initial_values["limit"] == 0:
        device.initial_values |= {"limit": image[family.ceiling], "speed_cap": 0}
    if device.initial_values.get("watchdog") == TRIPPED:
        device.initial_values["watchdog"] = 0


def _supply(device: Device, image: RegisterImage) -> tuple[float, float]:
    """Return lowest and highest supply voltage [V] at which the servo may be driven.

    They are the limits in the servo's EEPROM, clipped to the range of the data sheet.
    """
    lowest, highest = _data_sheet_supply(device)
    low, high = image["voltage_min"] / 10.0, image["voltage_max"] / 10.0
    return max(low, lowest), min(high, highest)


def _data_sheet_supply(device: Device) -> tuple[float, float]:
    """Return lowest and highest supply voltage [V] of the data sheet ±0.5 V."""
    lowest, highest = device.row.voltage
    return lowest - 0.5, highest + 0.5


def _supply_range(device: Device, image: RegisterImage) -> str:
    """Return the range of voltages that the present supply of a servo is outside of, as a text."""
    name, (lowest, highest) = device.row.name, _data_sheet_supply(device)
    if not lowest <= image["voltage"] / 10.0 <= highest:
        low, high = _supply(device, image)
        return f"{name} takes {low:g} to {high:g} V"
    low, high = image["voltage_min"] / 10.0, image["voltage_max"] / 10.0
    return (
        f"the voltage limits in the EEPROM are {low:g} to {high:g} V ({name} takes {lowest:g} to "
        f"{highest:g} V)"
    )


def _supply_error(allowed: str, volts: Sequence[float]) -> str:
    """Return the error text for servos whose supply voltages `volts` [V] are outside a range.

    `allowed` is the text about this range.
    """
    ends = dict.fromkeys(f"{end(volts):.1f}" for end in (min, max))
    return (
        f"{'its' if len(volts) == 1 else 'their'} supply is {' to '.join(ends)} V and {allowed}: "
        "wrong supply (take the power off), another variant than the configuration says (name it "
        "there), or wrong voltage limits in the EEPROM (set them with the maker's tool)"
    )


def _check_mode(device: Device, image: RegisterImage) -> list[str]:
    """Return an error text for each mode, secondary id or EEPROM gain that is unusable."""
    errors = []
    family = device.family
    if family.status == "p2":
        modes = (5,) if device.row.limit_type == "current" else (3, 4)
        if image["mode"] not in modes:
            errors.append(
                f"operating mode {image['mode']}, needed is {' or '.join(map(str, modes))}: "
                "`pliant servos setup` changes it"
            )
        for bit, text in (
            (1, "follows another servo"),
            (2, "has a time-based profile"),
            (3, "switches its torque on by a goal"),
        ):
            if image["drive_mode"] & 1 << bit:
                errors.append(
                    f"its Drive Mode {text} (bit {bit}): clear it with `pliant servos setup`"
                )
        shadow = image["shadow_id"]
        if shadow <= 252:
            errors.append(
                f"it obeys id {shadow} as well (Secondary ID): clear that with `pliant servos "
                "setup` and name it as the joint's secondary"
            )
    elif family.status == "feetech":
        if image["mode"] != 0:
            errors.append(
                f"operating mode {image['mode']}, needed is 0: `pliant servos setup` changes it"
            )
        if image["integral_gain"]:
            errors.append(
                f"its I gain is {image['integral_gain']}, with which it pushes harder and harder "
                "against a hand: `pliant servos setup` sets 0"
            )
    else:
        if image["position_min"] == image["position_max"]:
            errors.append(
                "its angle limits are equal, which is wheel or multi-turn mode: `pliant servos "
                "setup` sets them"
            )
        if "drive_mode" in image and image["drive_mode"] & 2:
            errors.append(
                "it is the slave of a dual joint: `pliant servos setup` ends that; name it as the "
                "joint's secondary"
            )
    return errors


def _startup_errors(guard: TransactionGuard, device: Device) -> list[str]:
    """Return an error text if a servo switches its torque on by itself after a restart.

    It would take its next goal from wherever its joint has fallen to.
    """
    if device.family.status != "p2":
        return []
    try:
        reply = guard.read(device.id, STARTUP)
    except BusError as error:
        error.raise_if_gone()
        return []  # this firmware has no such register
    if not reply.data[0] & 1:
        return []
    return [
        "its Startup Configuration switches its torque on after every restart (bit 0), with which "
        "a joint that fell meanwhile jumps back: support the arm, and clear the bit with the "
        "maker's tool"
    ]


def _store_registers(device: Device, image: RegisterImage) -> ServoInfo:
    """Store register values in the device; return the servo's identification with warnings."""
    row, family = device.row, device.family
    device.ceiling = min(image[family.ceiling], device.units.full)
    if row.limit_type == "current" and image["pwm_limit"] < family.full_duty:
        # Lower the ceiling to the torque at the register PWM Limit; at standstill, torque is
        # proportional to PWM.
        torque = image["pwm_limit"] / family.full_duty * device.units.usable(device.units.full)
        device.ceiling = min(device.ceiling, device.units.register(torque))
    device.gain = image["gain"]
    device.torque_on = bool(image["torque_enable"])
    device.stored_command = (image["goal"], image["limit"]) if device.torque_on else None
    _store_initial_values(device, image)
    device.min_voltage, _ = _supply(device, image)
    device.set_voltage(image["voltage"] / 10.0, image.time)
    device.temperature = float(image["temperature"])
    device.temperature_limit = float(image["temperature_limit"])
    device.multi_turn = family.multi_turn or (family.status == "p2" and image["mode"] == 4)
    low, high = image["position_min"], image["position_max"]
    has_range = not device.multi_turn and low < high
    device.low, device.high = (low, high) if has_range else (0, row.max_position)
    device.set_range()
    if "overload_torque" in image:
        device.overload = image["overload_torque"] / 100.0
    shuts_off = family.status == "feetech" or bool(image["shutdown"] & 1 << OVERLOAD_BIT)
    device.harmless = 0 if shuts_off else 1 << OVERLOAD_BIT
    if "hardware_error" in image:
        device.note_hardware_error(image["hardware_error"])
    notes = _calibration_notes(device)
    if device.torque_on:
        notes.append(
            "its torque is on already: another program may be using the arm, or has left it up. "
            "Enabling takes it over without switching it off; `pliant servos setup` needs it off"
        )
    if device.has_harmless_error:
        notes.append("it was overloaded after its last reboot, and kept its torque")
    if family.status != "feetech" and shuts_off:
        notes.append(
            "it shuts off on overload, but a compliant arm often pushes at its limit: "
            "`pliant servos setup` offers to clear bit 5 of Shutdown"
        )
    device.caps_speed = "phase" not in image or bool(image["phase"] & 1 << SPEED_UNIT_BIT)
    if not device.caps_speed:
        notes.append("its speed registers count in 50 steps/s (Phase, bit 2): speed caps are void")
    delay = image["return_delay"] * 2e-6
    if delay > 20e-6 and family.status != "feetech":
        notes.append(
            f"it waits {delay * 1e6:.0f} µs before each answer; `pliant servos setup` sets 0"
        )
    if device.ceiling < device.units.full and family.status != "p2":
        share = device.ceiling / device.units.full
        notes.append(f"its Max Torque is set to {share:.0%}, which is the ceiling of its limits")
    if family.ceiling == "current_limit" and image["current_limit"] < device.units.full:
        share = image["current_limit"] / device.units.full
        notes.append(
            f"its Current Limit is set to {share:.0%} of the largest value: "
            f"{device.units.usable(device.ceiling):.3g} N·m are left"
        )
    if "pwm_limit" in image and image["pwm_limit"] < family.full_duty:
        share = image["pwm_limit"] / family.full_duty
        notes.append(
            f"its PWM Limit is set to {share:.0%}, which bounds torque and speed: "
            f"{device.units.usable(device.ceiling):.3g} N·m are left"
        )
    return ServoInfo(
        device.spec.name,
        device.id,
        row.name,
        image["firmware"],
        device.voltage or 0.0,
        device.temperature,
        delay,
        device.torque_on,
        tuple(notes),
    )


def _calibration_differences(device: Device, image: RegisterImage) -> list[str]:
    """Return an error text for each register that differs from the joint's calibration file.

    The text gives both values and the resulting error of the joint's zero. Secondary servos are not
    checked, because the file contains only the first servo of a joint.
    """
    file = device.spec.calibration
    if file is None or device.id != device.spec.id:
        return []
    known = device.family.registers
    differences = []
    for name, expected in file.registers(known).items():
        actual = image[name] & 1 if name == "drive_mode" else image[name]
        if actual == (expected & 1 if name == "drive_mode" else expected):
            continue
        if name == "homing_offset":
            effect = f"its zero would be off by {_degrees(device, expected - actual):.3g}°"
        elif name == "drive_mode":
            effect = "it counts in the opposite direction"
        else:
            middle = (image["position_min"] + image["position_max"]) / 2.0
            effect = f"its zero would be off by {_degrees(device, file.middle - middle):.3g}°"
        differences.append(
            f"the calibration file says {LEROBOT_NAMES[name]} {expected}, the servo {actual}: "
            f"{effect}; {CALIBRATION_REMEDY}"
        )
    return differences


def _calibration_notes(device: Device) -> list[str]:
    """Return a warning if the file has `drive_mode` 1 and the servo has no such register."""
    file = device.spec.calibration
    if file is None or device.id != device.spec.id or not file.drive_mode:
        return []
    if "drive_mode" in device.family.registers:
        return []
    return [
        "the calibration file has drive_mode 1: LeRobot inverts this joint's values, and only "
        "`sign` counts here; compare with `pliant servos doctor ARM --watch`"
    ]


def _degrees(device: Device, counts: float) -> float:
    """Return the joint angle [°], without sign, of a difference of `counts` encoder counts."""
    return abs(counts) * math.degrees(device.units.count)
