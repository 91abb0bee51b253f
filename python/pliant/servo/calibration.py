"""LeRobot's calibration of one motor, and its comparison with the servo's registers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pliant._core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Container

    from pliant.servo.device import Device
    from pliant.servo.identify import Image
    from pliant.servo.models import ServoModel

#: Remedy for a file that does not fit.
REMEDY = (
    "the file is of another arm, or older than its last calibration: name the file of this arm, or "
    "run lerobot-calibrate, which writes file and servos alike"
)


@dataclass(frozen=True)
class Calibration:
    """Entry of one motor in a calibration file.

    Attributes:
        id: Servo id.
        drive_mode: 1 if LeRobot inverts normalised values. Feetech counts are not affected;
            Dynamixel servos then count in the opposite direction.
        homing_offset: Offset that the servo adds (Dynamixel) or subtracts (Feetech) [counts].
        range_min, range_max: Ends of the travel, present position [counts].
    """

    id: int
    drive_mode: int
    homing_offset: int
    range_min: int
    range_max: int

    @property
    def middle(self) -> float:
        """Count at LeRobot's zero angle."""
        return (self.range_min + self.range_max) / 2.0

    def check_range(self, joint: str, row: ServoModel) -> None:
        """Check that the ends of the travel are valid positions of the servo.

        Raises:
            ConfigError: An end is not a count of its encoder. For a multi-turn servo, one turn
                beyond either end of the encoder is allowed.
        """
        beyond = row.counts + 1 if row.family.multi_turn else 0
        low, high = -beyond, row.counts + beyond
        for key in ("range_min", "range_max"):
            if not low <= getattr(self, key) <= high:
                raise ConfigError(
                    f"{joint}.{key} is {getattr(self, key)}, and positions of {row.name} run from "
                    f"{low} to {high}: the calibration is of another servo, or was changed by hand"
                )

    def registers(self, known: Container[str]) -> dict[str, int]:
        """Return the registers that LeRobot writes from this file, limited to the known names.

        LeRobot compares the same registers at each connect. Feetech servos have no direction
        register.
        """
        written = {
            "homing_offset": self.homing_offset,
            "position_min": self.range_min,
            "position_max": self.range_max,
            "drive_mode": self.drive_mode,
        }
        return {name: value for name, value in written.items() if name in known}


def differences(device: Device, image: Image) -> list[str]:
    """Describe the registers in which a servo differs from its joint's calibration file.

    Each sentence has the value of the file and of the servo, and the resulting error of the joint's
    zero. A second servo of the joint is not in the file.
    """
    file = device.spec.calibration
    if file is None or device.id != device.spec.id:
        return []
    known = device.family.registers
    said = []
    for name, wanted in file.registers(known).items():
        have = image[name] & 1 if name == "drive_mode" else image[name]
        if have == (wanted & 1 if name == "drive_mode" else wanted):
            continue
        if name == "homing_offset":
            effect = f"its zero would be off by {_degrees(device, wanted - have):.3g}°"
        elif name == "drive_mode":
            effect = "it counts the other way round"
        else:
            middle = (image["position_min"] + image["position_max"]) / 2.0
            effect = f"its zero would be off by {_degrees(device, file.middle - middle):.3g}°"
        said.append(
            f"the calibration file says {WORDS[name]} {wanted}, the servo {have}: {effect}; "
            f"{REMEDY}"
        )
    return said


#: Register names in LeRobot's file.
WORDS = {
    "homing_offset": "homing_offset",
    "position_min": "range_min",
    "position_max": "range_max",
    "drive_mode": "drive_mode",
}


def notes(device: Device) -> list[str]:
    """Return notes about a file that fits."""
    file = device.spec.calibration
    if file is None or device.id != device.spec.id or not file.drive_mode:
        return []
    if "drive_mode" in device.family.registers:
        return []
    return [
        "the calibration file has drive_mode 1: LeRobot turns this joint's values round, pliant "
        "counts as its `sign` says; compare with `pliant servos doctor ARM --watch`"
    ]


def _degrees(device: Device, counts: float) -> float:
    """Return the joint angle of a number of counts [°]."""
    return abs(counts) * device.units.count * 57.29577951308232
