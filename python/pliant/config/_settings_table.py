"""Conversion of a file's table `settings` and preset to `pliant.Settings`; collects all errors."""

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

#: Names of the presets of `Settings`; `soft` also needs axes.
PRESETS = ("paper", "firm", "door", "drawer", "hand_guiding", "hand_over", "plug", "soft", "wipe")
#: Class of each group of settings; a group is a table such as [settings.tracking] in the file.
GROUPS: dict[str, Callable[..., Any]] = {
    "tracking": Tracking,
    "null_space": NullSpace,
    "compensation": Compensation,
    "torque_limits": TorqueLimits,
    "paper_options": PaperOptions,
}
#: Fields of `Settings` on which other fields depend; an error in one of them ends the validation.
FIRST = ("task", "law")


def check_preset(preset: str | dict[str, Any] | None) -> None:
    """Check that a preset of the configuration file exists.

    Raises:
        ValueError: No preset has the given name.
    """
    name, _ = _preset(preset)
    if name not in (None, *PRESETS):
        raise ValueError(f"there is no preset {name!r}; {suggest(str(name), PRESETS)}")


def resolve(
    fields: Mapping[str, Any], preset: str | dict[str, Any] | None, rate: float
) -> tuple[Settings | None, list[str]]:
    """Return the settings of a configuration file, and all errors in them.

    An invalid field is removed and the remaining fields are validated again, until they are valid
    or the error does not name a field that can be removed.

    Args:
        fields: The table `settings` of the file.
        preset: Name of a preset, or a table with its name and arguments.
        rate: Loop rate [Hz], used if the fields contain no rate.

    Returns:
        The settings, None if there are errors; and a list with one sentence per error.
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
    """Return the settings of a preset, with the values in `fields` in place of its own.

    `fields` holds groups and axes as objects (`Tracking`, `Axis`, ...), not as tables.
    """
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
    """Return the name of the preset (None without a preset), and its arguments."""
    if isinstance(preset, dict):
        arguments = dict(preset)
        return arguments.pop("name", "(without a name)"), arguments
    return preset, {}


def _axes(table: Any, wrong: list[str]) -> dict[str, Axis]:
    """Return the valid entries of the table `axes`; append errors of the others to `wrong`."""
    if not isinstance(table, dict):
        wrong.append(f"axes is a table of axis keys, got {table!r}")
        return {}
    return {key: axis for key, value in table.items() if (axis := _axis(key, value, wrong))}


def _axis(key: str, value: Any, wrong: list[str]) -> Axis | None:
    """Return one entry of the table `axes`.

    If it is invalid, append its errors to `wrong` and return None.
    """
    if not isinstance(value, dict):
        wrong.append(f"axes.{key} is a table such as {{ soft = 4.0 }}, got {value!r}")
        return None
    left = {k: tuple(v) if isinstance(v, list) else v for k, v in value.items()}
    # Errors of `Axis` do not name the axis: prefix them with the key of the axis.
    return _build(Axis, left, "Axis.", f"axes.{key}: ", wrong)


def _group(name: str, table: Any, wrong: list[str]) -> Any:
    """Return a group of settings, such as `Tracking`, from its table in the file.

    If the table is invalid, append its errors to `wrong` and return None.
    """
    if not isinstance(table, dict):
        wrong.append(f"{name} is a table such as [settings.{name}], got {table!r}")
        return None
    return _build(GROUPS[name], dict(table), f"{name}.", f"{name}.", wrong)


def _build(
    make: Callable[..., T], left: dict[str, Any], own: str, place: str, wrong: list[str]
) -> T | None:
    """Return an object constructed from fields; None if a field is invalid.

    Args:
        make: Constructor of the object.
        left: The fields; invalid ones are removed.
        own: Prefix of the constructor's error messages, replaced by `place`.
        place: Key of the object in the file, as prefix of the errors.
        wrong: List to which all errors are appended.
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
    """Remove the field that an error names from `left`; return True if the rest can be checked."""
    name, _, rest = message.partition(".")
    axes = left.get("axes")
    if name == "axes" and axes:
        key = re.split(r"[:.]", rest)[0]
        # A key for several axes differs from the single axis in the error: then remove all axes.
        left["axes"] = {k: v for k, v in axes.items() if k != key} if key in axes else {}
        return True
    found = re.match(r"\w+", message)
    name = found[0] if found else ""
    return name not in FIRST and left.pop(name, None) is not None
