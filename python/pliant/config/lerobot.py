"""Reading of LeRobot's calibration files, so that a calibrated arm needs no second calibration.

LeRobot writes a JSON file per robot. The file maps each motor name to `id`, `drive_mode`,
`homing_offset`, `range_min` and `range_max`. The range is in counts of the register *Present
Position*, which includes the homing offset. LeRobot's zero angle is the middle of the range.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any, Literal

from pliant._core import ConfigError
from pliant._files import read_text
from pliant.config._messages import suggest
from pliant.servo.spec import Calibration

__all__ = ["Calibration", "find_calibration", "read_calibration"]

#: Maximum number of keys of an invalid file that an error message shows.
SHOWN = 6
#: Largest register value of a servo: four bytes, signed.
LARGEST = 2**31 - 1
#: Smallest range of a joint that was moved from end to end [counts]: about 1° of a 12-bit encoder.
SMALLEST_RANGE = 12
_FIELDS = ("id", "drive_mode", "homing_offset", "range_min", "range_max")


def read_calibration(path: str | Path) -> dict[str, Calibration]:
    """Read a calibration file.

    Args:
        path: The JSON file, usually in `~/.cache/huggingface/lerobot/calibration/robots/…`.

    Returns:
        Calibration of each motor by name.

    Raises:
        ConfigError: The file is missing or invalid, or a motor's range is empty.
    """
    file = Path(path).expanduser()
    try:
        data: Any = json.loads(read_text(file))
    except FileNotFoundError:
        raise ConfigError(
            f"there is no calibration file {file}; it is what lerobot-calibrate writes, or leave "
            "`calibration` out and give every servo its `zero`"
        ) from None
    except PermissionError as error:
        raise ConfigError(f"{file} must not be read: {error.strerror}") from error
    except RecursionError as error:
        raise ConfigError(f"{file} is not a calibration file: it is nested too deeply") from error
    except OSError as error:
        raise ConfigError(f"{file} cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # also an integer of more digits than Python reads
        raise ConfigError(f"{file} is not a calibration file: {error}") from error
    if not isinstance(data, dict) or not data:
        raise ConfigError(f"{file} is not a calibration file: it contains no table of motors")
    if not any(isinstance(entry, dict) for entry in data.values()):
        raise ConfigError(
            f"{file} is not a calibration file: LeRobot's has a table of {', '.join(_FIELDS)} for "
            f"each motor; here what is under {', '.join(list(data)[:SHOWN])} is not a table"
        )
    return {str(name): _motor(file, str(name), entry) for name, entry in data.items()}


def _motor(file: Path, name: str, entry: object) -> Calibration:
    if not isinstance(entry, dict):
        raise ConfigError(f"{file}: {name} is not a table of {', '.join(_FIELDS)}: {entry!r}")
    missing = [key for key in _FIELDS if key not in entry]
    if missing:
        raise ConfigError(f"{file}: {name} lacks {', '.join(missing)}")
    unknown = [key for key in entry if key not in _FIELDS]
    if unknown:
        raise ConfigError(
            f"{file}: {name}: {unknown[0]!r} is not known; {suggest(unknown[0], _FIELDS)}"
        )
    invalid = {k: entry[k] for k in _FIELDS if type(entry[k]) is not int}
    if invalid:
        key, value = next(iter(invalid.items()))
        raise ConfigError(f"{file}: {name}.{key} is a whole number, got {value!r}")
    for key in _FIELDS:
        if abs(entry[key]) > LARGEST:
            raise ConfigError(
                f"{file}: {name}.{key} is larger than any register, which end at {LARGEST}: "
                f"{str(entry[key])[:SHOWN]}… of {len(str(abs(entry[key])))} digits"
            )
    out = Calibration(**{key: entry[key] for key in _FIELDS})
    if out.drive_mode not in {0, 1}:
        raise ConfigError(f"{file}: {name}.drive_mode is 0 or 1, got {out.drive_mode}")
    if out.range_max - out.range_min < SMALLEST_RANGE:
        raise ConfigError(
            f"{file}: {name} has an empty range, {out.range_min} to {out.range_max} counts: "
            "calibrate it again, moving the joint from end to end"
        )
    return out


#: For each kind of device with a LeRobot calibration: its option in LeRobot's commands, and the
#: last word of its types and of the names of its folders.
_KINDS = {"robots": ("robot", "follower"), "teleoperators": ("teleop", "leader")}
#: Start of the names of LeRobot's calibration folders for each built-in arm, newest name first:
#: LeRobot 0.6 has one folder for all SO arms, earlier versions one folder per arm.
_FOLDERS = {arm: ("so", "so101", "so100") for arm in ("so101", "so100")} | {"koch": ("koch",)}


def calibration_folder() -> Path:
    """Return the folder that holds LeRobot's calibrations, from its environment variables."""
    cache = os.environ.get("HF_HOME") or "~/.cache/huggingface"
    home = os.environ.get("HF_LEROBOT_HOME") or f"{cache}/lerobot"
    return Path(os.environ.get("HF_LEROBOT_CALIBRATION") or f"{home}/calibration").expanduser()


def find_calibration(
    name: str, arm: str, kind: Literal["robots", "teleoperators"] = "robots"
) -> Path:
    """Return the calibration file that LeRobot wrote for an arm.

    Args:
        name: The arm's id in LeRobot.
        arm: Name of a built-in arm; for any other name, the folders of all built-in arms are
            searched.
        kind: `"robots"`: followers; `"teleoperators"`: leaders.

    Raises:
        ConfigError: There is no such file; the message names the folder and the ids found in it.
    """
    root = calibration_folder() / kind
    option, word = _KINDS[kind]
    known = _FOLDERS.get(arm) or dict.fromkeys(
        f for prefixes in _FOLDERS.values() for f in prefixes
    )
    folders = [root / f"{folder}_{word}" for folder in known]
    for folder in folders:
        if (file := folder / f"{name}.json").is_file():
            return file
    ids = sorted({file.stem for folder in folders for file in folder.glob("*.json")})
    hint = f"; there are {', '.join(ids)}" if ids else ""
    # Only LeRobot's own types write the file; those of the plugin do not.
    stock = arm if arm in _FOLDERS else "so101"
    raise ConfigError(
        f"LeRobot has no calibration with id {name!r} in {root}/{folders[0].name}{hint}: run "
        f"lerobot-calibrate --{option}.type={stock}_{word} --{option}.id={name} "
        f"--{option}.port=PORT, or name the file as `calibration`"
    )
