"""The table `settings` and the preset: fields of `pliant.Settings`, all that is wrong with them."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import pliant
from pliant import ConfigError, PliantError
from pliant.config.messages import suggest
from pliant.functional import PaperOptions

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pliant import Settings

#: Presets that need nothing but their name, and the one that needs axes.
PRESETS = ("paper", "firm", "door", "drawer", "hand_guiding", "hand_over", "plug", "soft", "wipe")
#: Groups of settings, each a table of its own.
GROUPS = {
    "tracking": pliant.Tracking,
    "null_space": pliant.NullSpace,
    "compensation": pliant.Compensation,
    "torque_limits": pliant.TorqueLimits,
    "paper_options": PaperOptions,
}
#: Fields on which the meaning of others depends: once one is wrong, the others cannot be judged.
FIRST = ("task", "law")


def check_preset(preset: str | dict[str, Any] | None) -> None:
    """See that there is such a preset.

    Raises:
        ValueError: There is none.
    """
    name, _ = _preset(preset)
    if name not in (None, *PRESETS):
        raise ValueError(f"there is no preset {name!r}; {suggest(str(name), PRESETS)}")


def resolve(
    fields: Mapping[str, Any], preset: str | dict[str, Any] | None, rate: float
) -> tuple[Settings | None, list[str]]:
    """Make settings, or say all that is wrong with them.

    What is wrong is left out and the rest tried again, until what is left is right or an error
    names nothing that could be left out.

    Args:
        fields: The table `settings` as read.
        preset: Name of a preset, or a table with its name and arguments.
        rate: Of the loop [Hz], where the fields have none.

    Returns:
        The settings, or None; and what is wrong, a sentence each.
    """
    left, wrong = dict(fields), list[str]()
    if "axes" in left:
        left["axes"] = _axes(left["axes"], wrong)
    if isinstance(left.get("task"), dict):
        try:
            left["task"] = pliant.Task(**left["task"])
        except (PliantError, TypeError) as error:
            wrong.append(f"task.{str(error).removeprefix('task.')}")
            del left["task"]
    for name in GROUPS.keys() & left.keys():
        group = _group(name, left.pop(name), wrong)
        if group is not None:
            left[name] = group
    while True:
        try:
            made = _make(left, preset, rate)
        except (PliantError, TypeError) as error:
            wrong.append(str(error))
            if not _leave_out(left, str(error)):
                return None, wrong
        else:
            return (None if wrong else made), wrong


def _make(fields: dict[str, Any], preset: str | dict[str, Any] | None, rate: float) -> Settings:
    """Settings of fields whose axes are made."""
    given = {"rate": rate, **fields}
    name, arguments = _preset(preset)
    if name is None:
        return pliant.Settings(**given)
    if name == "soft":
        if "axes" not in arguments:
            raise ConfigError('preset "soft" needs its axes: { name = "soft", axes = "y yaw" }')
        return pliant.Settings.soft(arguments.pop("axes"), **arguments, **given)
    made: Settings = getattr(pliant.Settings, name)(**arguments, **given)
    return made


def _preset(preset: str | dict[str, Any] | None) -> tuple[Any, dict[str, Any]]:
    """Name and arguments of the preset."""
    if isinstance(preset, dict):
        arguments = dict(preset)
        return arguments.pop("name", "(without a name)"), arguments
    return preset, {}


def _axes(table: Any, wrong: list[str]) -> dict[str, pliant.Axis]:
    """The axes that can be read; what is wrong with the others is added."""
    if not isinstance(table, dict):
        wrong.append(f"axes is a table of axis keys, got {table!r}")
        return {}
    return {key: axis for key, value in table.items() if (axis := _axis(key, value, wrong))}


def _axis(key: str, value: Any, wrong: list[str]) -> pliant.Axis | None:
    """One axis, or None and what is wrong with it."""
    if not isinstance(value, dict):
        wrong.append(f"axes.{key} is a table such as {{ soft = 4.0 }}, got {value!r}")
        return None
    left: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in value.items()}
    good = True
    while True:
        try:
            axis = pliant.Axis(**left)
        except (PliantError, TypeError) as error:
            # An axis does not know its name.
            said = str(error).removeprefix("Axis.")
            wrong.append(f"axes.{key}: {said}")
            good = False
            if not _leave_out(left, said):
                return None
        else:
            return axis if good else None


def _group(name: str, table: Any, wrong: list[str]) -> Any:
    """A group of settings, or None and what is wrong with it."""
    if not isinstance(table, dict):
        wrong.append(f"{name} is a table such as [settings.{name}], got {table!r}")
        return None
    left, good = dict(table), True
    while True:
        try:
            group = GROUPS[name](**left)
        except (PliantError, TypeError) as error:
            said = str(error).removeprefix(f"{name}.")
            wrong.append(f"{name}.{said}")
            good = False
            if not _leave_out(left, said):
                return None
        else:
            return group if good else None


def _leave_out(left: dict[str, Any], said: str) -> bool:
    """Take what an error names out of the fields; whether the rest can be judged without it."""
    name, _, rest = said.partition(".")
    axes = left.get("axes")
    if name == "axes" and axes:
        key = re.split(r"[:.]", rest)[0]
        # A key of several axes is named by one of them, which cannot be left out alone.
        left["axes"] = {k: v for k, v in axes.items() if k != key} if key in axes else {}
        return True
    found = re.match(r"\w+", said)
    name = found[0] if found else ""
    return name not in FIRST and left.pop(name, None) is not None
