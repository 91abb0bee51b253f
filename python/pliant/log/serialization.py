"""Conversion of models, settings and servos to JSON and back, without loss of precision."""

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

#: Errors that the parser of malformed text or of a malformed file can raise.
PARSE_ERRORS = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
#: Classes of objects that `write` converts to JSON and `read` restores, by class name.
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
    """Return a value as JSON text; `read` restores it.

    The value is a number, a string, an array, an object of `_TYPES`, or a container of such values.

    Raises:
        ConfigError: A value has a type that is not supported.
    """
    return json.dumps(_to_json(value), ensure_ascii=False)


def read(text: str) -> Any:
    """Return the value in a JSON text written by `write`; arrays become lists.

    Raises:
        ConfigError: The text is invalid.
    """
    try:
        return _from_json(json.loads(text))
    except PARSE_ERRORS as error:
        raise ConfigError(f"not the description of a run: {error}") from error


def model(source: Any) -> Model:
    """Return the robot model that `describe` has described.

    Raises:
        ConfigError, UrdfError: The description is invalid.
    """
    try:
        return Model.from_urdf_str(source["urdf"], **source["options"])
    except (AttributeError, LookupError, TypeError, ValueError) as error:
        if isinstance(error, PliantError):
            raise
        raise ConfigError(f"not the description of a model: {error}") from error


def describe(robot_model: Model) -> dict[str, Any]:
    """Return the URDF text and the options of a robot model, from which `model` recreates it."""
    text, options = robot_model.source
    return {"urdf": text, "options": options}


def _to_json(value: Any) -> Any:
    name = type(value).__name__
    if name in _TYPES and isinstance(value, _TYPES[name]):
        if isinstance(value, Payload):
            return {"type": name, "fields": {"mass": value.mass, "com": value.com.tolist()}}
        fields = value.__getnewargs_ex__()[1]
        return {"type": name, "fields": {key: _to_json(item) for key, item in fields.items()}}
    if isinstance(value, dict):
        return {"table": [[_to_json(key), _to_json(item)] for key, item in value.items()]}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, tuple):
        return {"tuple": [_to_json(item) for item in value]}
    if isinstance(value, list):
        return [_to_json(item) for item in value]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if hasattr(value, "items"):
        return _to_json(dict(value))
    raise ConfigError(f"cannot write a {name} into a log")


def _from_json(value: Any) -> Any:
    if isinstance(value, list):
        return [_from_json(item) for item in value]
    if not isinstance(value, dict):
        return value
    if "tuple" in value:
        return tuple(_from_json(item) for item in value["tuple"])
    if "table" in value:
        return {_from_json(key): _from_json(item) for key, item in value["table"]}
    return _TYPES[value["type"]](**_from_json({"table": list(value["fields"].items())}))
