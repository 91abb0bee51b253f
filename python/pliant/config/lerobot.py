"""Calibration files of LeRobot, read as they are: no arm is calibrated twice.

LeRobot writes one JSON file per robot: motor name to `id`, `drive_mode`, `homing_offset`,
`range_min`, `range_max`, in counts of the present position, which already has the homing offset in
it. Its zero degrees are the middle of the range.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pliant import ConfigError
from pliant.config.messages import suggest

if TYPE_CHECKING:
    from pliant.servo.models import ServoModel

#: Keys that are named of a file of another kind.
SHOWN = 6
#: Largest number of a servo's register, of four bytes with a sign.
LARGEST = 2**31 - 1
_FIELDS = ("id", "drive_mode", "homing_offset", "range_min", "range_max")


@dataclass(frozen=True)
class Calibration:
    """One motor of a calibration file.

    Attributes:
        id: Servo id.
        drive_mode: 1 where LeRobot turns the direction of normalised values; counts are not
            affected.
        homing_offset: What the servo itself adds [counts].
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


def read_calibration(path: str | Path) -> dict[str, Calibration]:
    """Read a calibration file.

    Args:
        path: The JSON file, usually in `~/.cache/huggingface/lerobot/calibration/robots/…`.

    Returns:
        Motor name to calibration.

    Raises:
        ConfigError: It is not there, is no such file, or a motor's range is empty.
    """
    file = Path(path).expanduser()
    try:
        data: Any = json.loads(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(
            f"there is no calibration file {file}; it is what lerobot-calibrate writes, or leave "
            "`calibration` out and give every servo its `zero`"
        ) from None
    except RecursionError as error:
        raise ConfigError(f"{file} is no calibration file: it is nested too deeply") from error
    except (OSError, ValueError) as error:  # also an integer of more digits than Python reads
        raise ConfigError(f"{file} is no calibration file: {error}") from error
    if not isinstance(data, dict) or not data:
        raise ConfigError(f"{file} is no calibration file: it holds no table of motors")
    if not any(isinstance(entry, dict) for entry in data.values()):
        raise ConfigError(
            f"{file} is no calibration file: LeRobot's has a table of {', '.join(_FIELDS)} for "
            f"each motor; here what is under {', '.join(list(data)[:SHOWN])} is no table"
        )
    return {str(name): _motor(file, str(name), entry) for name, entry in data.items()}


def _motor(file: Path, name: str, entry: object) -> Calibration:
    if not isinstance(entry, dict):
        raise ConfigError(f"{file}: {name} is no table of {', '.join(_FIELDS)}: {entry!r}")
    missing = [key for key in _FIELDS if key not in entry]
    if missing:
        raise ConfigError(f"{file}: {name} lacks {', '.join(missing)}")
    unknown = [key for key in entry if key not in _FIELDS]
    if unknown:
        raise ConfigError(
            f"{file}: {name}: {unknown[0]!r} is not known; {suggest(unknown[0], _FIELDS)}"
        )
    wrong = {k: entry[k] for k in _FIELDS if type(entry[k]) is not int}
    if wrong:
        key, value = next(iter(wrong.items()))
        raise ConfigError(f"{file}: {name}.{key} is a whole number, got {value!r}")
    for key in _FIELDS:
        if abs(entry[key]) > LARGEST:
            raise ConfigError(
                f"{file}: {name}.{key} is larger than any register, which end at {LARGEST}: "
                f"{str(entry[key])[:SHOWN]}… of {len(str(abs(entry[key])))} digits"
            )
    out = Calibration(**{key: entry[key] for key in _FIELDS})
    if out.range_min >= out.range_max:
        raise ConfigError(
            f"{file}: {name} has an empty range, {out.range_min} to {out.range_max} counts: "
            "calibrate it again, moving the joint from end to end"
        )
    return out
