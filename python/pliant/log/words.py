"""Models, settings and servos as JSON and back, bit for bit, without executing code."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from pliant._core import (
    Axis,
    Compensation,
    ConfigError,
    Model,
    NullSpace,
    Payload,
    PliantError,
    Servos,
    Settings,
    Task,
    TorqueLimits,
    Tracking,
)
from pliant.functional import PaperOptions

_TYPES = {
    kind.__name__: kind
    for kind in (
        Settings,
        Tracking,
        NullSpace,
        Compensation,
        TorqueLimits,
        PaperOptions,
        Axis,
        Task,
        Servos,
        Payload,
    )
}


def write(value: Any) -> str:
    """Return JSON of numbers, arrays, settings, axes, tasks, servos, payloads, and lists of them.

    Raises:
        ConfigError: The value has another type.
    """
    return json.dumps(_plain(value), ensure_ascii=False)


def read(text: str) -> Any:
    """Return the value that was given to `write`; arrays come back as lists.

    Raises:
        ConfigError: The text is invalid.
    """
    try:
        return _rich(json.loads(text))
    except (
        ArithmeticError,
        AttributeError,
        LookupError,
        RecursionError,
        TypeError,
        ValueError,
    ) as error:
        raise ConfigError(f"not the description of a run: {error}") from error


def model(source: Any) -> Model:
    """Return the model of a description by `describe`.

    Raises:
        ConfigError, UrdfError: The description is invalid.
    """
    try:
        return Model.from_urdf_str(source["urdf"], **source["options"])
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        if isinstance(error, PliantError):
            raise
        raise ConfigError(f"not the description of a model: {error}") from error


def describe(given: Model) -> dict[str, Any]:
    """Return URDF and options of a model."""
    text, options = given.source
    return {"urdf": text, "options": options}


def _plain(value: Any) -> Any:
    name = type(value).__name__
    if name in _TYPES and isinstance(value, _TYPES[name]):
        if isinstance(value, Payload):
            return {"type": name, "fields": {"mass": value.mass, "com": value.com.tolist()}}
        fields = value.__getnewargs_ex__()[1]
        return {"type": name, "fields": {key: _plain(item) for key, item in fields.items()}}
    if isinstance(value, dict):
        return {"table": [[_plain(key), _plain(item)] for key, item in value.items()]}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, tuple):
        return {"tuple": [_plain(item) for item in value]}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if hasattr(value, "items"):
        return _plain(dict(value))
    raise ConfigError(f"cannot write a {name} into a log")


def _rich(value: Any) -> Any:
    if isinstance(value, list):
        return [_rich(item) for item in value]
    if not isinstance(value, dict):
        return value
    if "tuple" in value:
        return tuple(_rich(item) for item in value["tuple"])
    if "table" in value:
        return {_rich(key): _rich(item) for key, item in value["table"]}
    return _TYPES[value["type"]](**_rich({"table": list(value["fields"].items())}))
