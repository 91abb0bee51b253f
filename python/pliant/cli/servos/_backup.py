"""Backup files of `pliant servos setup` (old register values): save, load and check them."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pliant._core import ConfigError, ServoError
from pliant._files import replacing
from pliant.servo.eeprom import SETUP_REGISTERS, RegisterChange
from pliant.servo.models import get_model

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant.servo import ServoSpec

#: Format of a backup file. Format 1 was a JSON list of changes without servo models.
FORMAT = "pliant servos setup 2"
#: Types of the required fields of an entry, which is the change of one register.
_KINDS = {"joint": str, "id": int, "register": str, "old": int, "new": int, "why": str}


def save(path: Path, arm: str, planned: Sequence[RegisterChange]) -> None:
    """Save the planned register changes of an arm, with the old values, as a new file.

    Raises:
        ConfigError: The file exists.
        OSError: The file cannot be written.
    """
    if path.exists():
        raise ConfigError(f"{path} exists, and keeps the old values in it: give another --backup")
    data = {"format": FORMAT, "arm": arm, "changes": [asdict(change) for change in planned]}
    with replacing(path) as temporary:
        temporary.write_text(json.dumps(data, indent=1), encoding="utf-8")


def load(path: Path, arm: str) -> list[RegisterChange]:
    """Return the register changes in a backup file.

    Raises:
        ConfigError: The backup belongs to another arm.
        FileNotFoundError: The file does not exist.
        ServoError: The file is not a backup file.
    """
    try:
        data: Any = json.loads(path.read_text(encoding="utf-8"))
        if isinstance(data, dict):
            if data["format"] != FORMAT:
                raise ServoError(f"{path} is {data['format']!r}, this pliant reads {FORMAT!r}")
            if Path(str(data["arm"])).name != Path(arm).name:
                raise ConfigError(
                    f"{path} holds the old values of {data['arm']}, not of {arm}: give that arm, "
                    'or change "arm" in the file if it is the same one'
                )
            data = data["changes"]
        return [_change(entry) for entry in data]
    except FileNotFoundError:
        raise  # the command line lists the existing files
    except (OSError, LookupError, RecursionError, TypeError, ValueError) as error:
        why = f"it has no {error}" if isinstance(error, KeyError) else error
        raise ServoError(f"{path} is not a backup of pliant servos setup: {why}") from error


def check(path: Path, former: Sequence[RegisterChange], specs: Sequence[ServoSpec]) -> None:
    """Check that every old value of a backup can be written to a servo of the arm.

    Args:
        path: Path of the backup, for error messages.
        former: Register changes in the backup.
        specs: Servos of the arm.

    Raises:
        ConfigError: A servo is not configured or has another model; a register is not one that
            `pliant servos setup` writes, or occurs twice; or a value is out of range.
    """
    rows = {(spec.name, number): spec.row for spec in specs for number, _ in spec.servos}
    unknown = dict.fromkeys(f"{c.joint} (id {c.id})" for c in former if (c.joint, c.id) not in rows)
    if unknown:
        configured = ", ".join(f"{joint} (id {number})" for joint, number in rows)
        raise ConfigError(
            f"{path} has values of {', '.join(unknown)}, which the configuration does not have; "
            f"it has {configured}. Nothing was written"
        )
    checked = set()
    for change in former:
        row, where = rows[change.joint, change.id], f"{path}: {change.joint} (id {change.id})"
        # A servo that is not in the servo table has the name of a model, but another model number.
        is_named = change.model in {"", row.name}
        if not is_named and get_model(change.model).model_number != row.model_number:
            raise ConfigError(
                f"{where} was {change.model}, the configuration says {row.name}: its registers "
                "mean something else. Nothing was written"
            )
        known = [name for name in SETUP_REGISTERS if name in row.family.registers]
        if change.register not in known:
            raise ConfigError(
                f"{where}: {change.register!r} is not a register that setup writes on {row.name}; "
                f"those are {', '.join(known)}. Nothing was written"
            )
        highest = 256 ** row.family.registers[change.register].size - 1
        if not 0 <= change.old <= highest:
            raise ConfigError(
                f"{where}: {change.register} takes 0 to {highest}, got {change.old}. Nothing was "
                "written"
            )
        if (change.joint, change.id, change.register) in checked:
            raise ConfigError(f"{where}: {change.register} comes twice. Nothing was written")
        checked.add((change.joint, change.id, change.register))


def _change(entry: Any) -> RegisterChange:
    """Return the register change in an entry of a backup; only its field `model` is optional."""
    kinds = {**_KINDS, "model": str}
    if not isinstance(entry, dict) or not set(_KINDS) <= set(entry) <= set(kinds):
        raise TypeError(f"an entry has {', '.join(f.name for f in fields(RegisterChange))}")
    for name, value in entry.items():
        if type(value) is not kinds[name]:
            raise TypeError(f"{name} is {'text' if kinds[name] is str else 'a whole number'}")
    return RegisterChange(**entry)
