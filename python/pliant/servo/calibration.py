"""LeRobot's calibration of one motor, and whether a servo still has it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pliant import ConfigError

if TYPE_CHECKING:
    from collections.abc import Container

    from pliant.servo.device import Device
    from pliant.servo.identify import Image
    from pliant.servo.models import ServoModel

#: What to do about a file that does not fit.
REMEDY = (
    "the file is of another arm, or older than its last calibration: name the file of this arm, or "
    "run lerobot-calibrate, which writes file and servos alike"
)


@dataclass(frozen=True)
class Calibration:
    """One motor of a calibration file.

    Attributes:
        id: Servo id.
        drive_mode: 1 where LeRobot turns the direction of normalised values; on Feetech counts are
            not affected, Dynamixel servos count the other way round.
        homing_offset: What the servo itself adds (Dynamixel) or takes off (Feetech) [counts].
        range_min, range_max: Ends of the travel, present position [counts].
    """

    id: int
    drive_mode: int
    homing_offset: int
    range_min: int
    range_max: int

    @property
    def middle(self) -> float:
        """Count of LeRobot's zero degrees."""
        return (self.range_min + self.range_max) / 2.0

    def check_range(self, joint: str, row: ServoModel) -> None:
        """See that the ends of the travel are positions of the joint's servo.

        Raises:
            ConfigError: One is no count of its encoder; goals of a multi-turn servo may be a turn
                beyond either end.
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
        """Registers that LeRobot writes from this file, by pliant's names, of those known.

        LeRobot compares the same ones at each connect. Feetech servos have no direction.
        """
        written = {
            "homing_offset": self.homing_offset,
            "position_min": self.range_min,
            "position_max": self.range_max,
            "drive_mode": self.drive_mode,
        }
        return {name: value for name, value in written.items() if name in known}


def differences(device: Device, image: Image) -> list[str]:
    """Return in which registers a servo differs from its joint's calibration file.

    Each sentence has the value of the file and of the servo, and by how much the joint's zero would
    be off. A second servo of the joint is not in the file.
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


#: What LeRobot's file calls the registers.
WORDS = {
    "homing_offset": "homing_offset",
    "position_min": "range_min",
    "position_max": "range_max",
    "drive_mode": "drive_mode",
}


def notes(device: Device) -> list[str]:
    """Return what is worth knowing of a file that fits."""
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
    """Angle of the joint [°] of so many counts."""
    return abs(counts) * device.units.count * 57.29577951308232
