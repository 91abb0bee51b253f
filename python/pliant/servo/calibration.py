"""LeRobot's calibration of one motor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from pliant._core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Container

    from pliant.servo.models import ServoModel


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
        margin = row.counts + 1 if row.family.multi_turn else 0
        low, high = -margin, row.counts + margin
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
