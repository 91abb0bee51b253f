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
from pliant.config._messages import AT_THE_TOP, suggest
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
        The settings (None if there are errors), and one sentence per error.
    """
    remaining, errors = dict(fields), list[str]()
    if remaining.pop("preset", None) is not None:
        errors.append(AT_THE_TOP.format("preset"))
    if "axes" in remaining:
        remaining["axes"] = _axes(remaining["axes"], errors)
    if isinstance(remaining.get("task"), dict):
        try:
            remaining["task"] = Task(**remaining["task"])
        except (PliantError, TypeError) as error:
            errors.append(f"task.{str(error).removeprefix('task.')}")
            del remaining["task"]
    for name in GROUPS.keys() & remaining.keys():
        group = _group(name, remaining.pop(name), errors)
        if group is not None:
            remaining[name] = group
    while True:
        try:
            settings = _make(remaining, preset, rate)
        except (PliantError, TypeError) as error:
            errors.append(str(error))
            if not _remove_field(remaining, str(error)):
                return None, errors
        else:
            return (None if errors else settings), errors


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
    settings: Settings = getattr(Settings, name)(**arguments, **values)
    return settings


def _preset(preset: str | dict[str, Any] | None) -> tuple[Any, dict[str, Any]]:
    """Return the name of the preset (None without a preset), and its arguments."""
    if isinstance(preset, dict):
        arguments = dict(preset)
        return arguments.pop("name", "(without a name)"), arguments
    return preset, {}


def _axes(table: Any, errors: list[str]) -> dict[str, Axis]:
    """Return the valid entries of the table `axes`; append errors of the others to `errors`."""
    if not isinstance(table, dict):
        errors.append(f"axes is a table of axis keys, got {table!r}")
        return {}
    return {key: axis for key, value in table.items() if (axis := _axis(key, value, errors))}


def _axis(key: str, value: Any, errors: list[str]) -> Axis | None:
    """Return one entry of the table `axes`.

    If it is invalid, append its errors to `errors` and return None.
    """
    if not isinstance(value, dict):
        errors.append(f"axes.{key} is a table such as {{ soft = 4.0 }}, got {value!r}")
        return None
    remaining = {k: tuple(v) if isinstance(v, list) else v for k, v in value.items()}
    # Errors of `Axis` do not name the axis: prefix them with the key of the axis.
    return _build(Axis, remaining, "Axis.", f"axes.{key}: ", errors)


def _group(name: str, table: Any, errors: list[str]) -> Any:
    """Return a group of settings, such as `Tracking`, from its table in the file.

    If the table is invalid, append its errors to `errors` and return None.
    """
    if not isinstance(table, dict):
        errors.append(f"{name} is a table such as [settings.{name}], got {table!r}")
        return None
    return _build(GROUPS[name], dict(table), f"{name}.", f"{name}.", errors)


def _build(
    make: Callable[..., T], remaining: dict[str, Any], prefix: str, key: str, errors: list[str]
) -> T | None:
    """Return an object constructed from fields; None if a field is invalid.

    Args:
        make: Constructor of the object.
        remaining: The fields; invalid ones are removed.
        prefix: Prefix of the constructor's error messages, replaced by `key`.
        key: Key of the object in the file, as prefix of the errors.
        errors: List to which all errors are appended.
    """
    is_valid = True
    while True:
        try:
            result = make(**remaining)
        except (PliantError, TypeError) as error:
            message = str(error).removeprefix(prefix)
            errors.append(f"{key}{message}")
            is_valid = False
            if not _remove_field(remaining, message):
                return None
        else:
            return result if is_valid else None


def _remove_field(remaining: dict[str, Any], message: str) -> bool:
    """Remove the field that an error names; return True if the rest can be checked."""
    name, _, rest = message.partition(".")
    axes = remaining.get("axes")
    if name == "axes" and axes:
        key = re.split(r"[:.]", rest)[0]
        # A key for several axes differs from the single axis in the error: then remove all axes.
        remaining["axes"] = {k: v for k, v in axes.items() if k != key} if key in axes else {}
        return True
    match = re.match(r"\w+", message)
    name = match[0] if match else ""
    return name not in FIRST and remaining.pop(name, None) is not None
