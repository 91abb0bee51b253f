"""Parsing of the table `settings` and the preset into `pliant.Settings`, with all errors."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any, TypeVar

from pliant._core import (
    Axis,
    Compensation,
    ConfigError,
    NullSpace,
    PliantError,
    Settings,
    Task,
    TorqueLimits,
    Tracking,
)
from pliant.config._messages import suggest
from pliant.functional import PaperOptions

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


T = TypeVar("T")

#: Presets; `soft` also needs axes.
PRESETS = ("paper", "firm", "door", "drawer", "hand_guiding", "hand_over", "plug", "soft", "wipe")
#: Groups of settings, each a table of its own.
GROUPS: dict[str, Callable[..., Any]] = {
    "tracking": Tracking,
    "null_space": NullSpace,
    "compensation": Compensation,
    "torque_limits": TorqueLimits,
    "paper_options": PaperOptions,
}
#: Fields on which the meaning of others depends; if one is wrong, the others are not checked.
FIRST = ("task", "law")


def check_preset(preset: str | dict[str, Any] | None) -> None:
    """Check that a preset exists.

    Raises:
        ValueError: Unknown preset.
    """
    name, _ = _preset(preset)
    if name not in (None, *PRESETS):
        raise ValueError(f"there is no preset {name!r}; {suggest(str(name), PRESETS)}")


def resolve(
    fields: Mapping[str, Any], preset: str | dict[str, Any] | None, rate: float
) -> tuple[Settings | None, list[str]]:
    """Create settings, or return all errors.

    A wrong field is removed and the rest tried again, until the rest is valid or an error names no
    field that can be removed.

    Args:
        fields: The table `settings` as read.
        preset: Name of a preset, or a table with its name and arguments.
        rate: Loop rate [Hz], used if the fields have none.

    Returns:
        The settings or None, and the errors, one sentence each.
    """
    left, wrong = dict(fields), list[str]()
    if "axes" in left:
        left["axes"] = _axes(left["axes"], wrong)
    if isinstance(left.get("task"), dict):
        try:
            left["task"] = Task(**left["task"])
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
    """Create settings from fields with parsed axes."""
    values = {"rate": rate, **fields}
    name, arguments = _preset(preset)
    if name is None:
        return Settings(**values)
    if name == "soft":
        if "axes" not in arguments:
            raise ConfigError('preset "soft" needs its axes: { name = "soft", axes = "y yaw" }')
        return Settings.soft(arguments.pop("axes"), **arguments, **values)
    made: Settings = getattr(Settings, name)(**arguments, **values)
    return made


def _preset(preset: str | dict[str, Any] | None) -> tuple[Any, dict[str, Any]]:
    """Return name and arguments of the preset."""
    if isinstance(preset, dict):
        arguments = dict(preset)
        return arguments.pop("name", "(without a name)"), arguments
    return preset, {}


def _axes(table: Any, wrong: list[str]) -> dict[str, Axis]:
    """Return the valid axes; append the errors of the others to `wrong`."""
    if not isinstance(table, dict):
        wrong.append(f"axes is a table of axis keys, got {table!r}")
        return {}
    return {key: axis for key, value in table.items() if (axis := _axis(key, value, wrong))}


def _axis(key: str, value: Any, wrong: list[str]) -> Axis | None:
    """Return one axis, or None with an error appended to `wrong`."""
    if not isinstance(value, dict):
        wrong.append(f"axes.{key} is a table such as {{ soft = 4.0 }}, got {value!r}")
        return None
    left = {k: tuple(v) if isinstance(v, list) else v for k, v in value.items()}
    # `Axis` does not know its name.
    return _build(Axis, left, "Axis.", f"axes.{key}: ", wrong)


def _group(name: str, table: Any, wrong: list[str]) -> Any:
    """Return a group of settings, or None with an error appended to `wrong`."""
    if not isinstance(table, dict):
        wrong.append(f"{name} is a table such as [settings.{name}], got {table!r}")
        return None
    return _build(GROUPS[name], dict(table), f"{name}.", f"{name}.", wrong)


def _build(
    make: Callable[..., T], left: dict[str, Any], own: str, place: str, wrong: list[str]
) -> T | None:
    """Make an object from its fields; None if one is wrong.

    Args:
        make: The constructor.
        left: The fields.
        own: Beginning of the constructor's messages, replaced by `place`.
        place: Place in the file.
        wrong: Gets all errors.
    """
    good = True
    while True:
        try:
            made = make(**left)
        except (PliantError, TypeError) as error:
            message = str(error).removeprefix(own)
            wrong.append(f"{place}{message}")
            good = False
            if not _leave_out(left, message):
                return None
        else:
            return made if good else None


def _leave_out(left: dict[str, Any], message: str) -> bool:
    """Remove the field that an error names; return True if the rest can be checked."""
    name, _, rest = message.partition(".")
    axes = left.get("axes")
    if name == "axes" and axes:
        key = re.split(r"[:.]", rest)[0]
        # The error names one axis, but the key applies to several: removing one does not help.
        left["axes"] = {k: v for k, v in axes.items() if k != key} if key in axes else {}
        return True
    found = re.match(r"\w+", message)
    name = found[0] if found else ""
    return name not in FIRST and left.pop(name, None) is not None
