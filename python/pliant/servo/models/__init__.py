"""Servo tables by name. Adding a servo is adding a row: docs/adding-a-servo.md."""

from __future__ import annotations

import difflib

from pliant._core import ConfigError
from pliant.servo.models import feetech, protocol1, protocol2
from pliant.servo.models.base import Block, Family, Register, ServoModel

__all__ = ["Block", "Family", "Register", "ServoModel", "by_number", "get_model", "list_models"]

_MODELS: dict[str, ServoModel] = {
    row.name: row for row in (*feetech.MODELS, *protocol1.MODELS, *protocol2.MODELS)
}
_KEYS = {key.upper(): row for row in _MODELS.values() for key in (row.name, *row.aliases)}


def list_models() -> tuple[str, ...]:
    """Names of all servo models there are."""
    return tuple(_MODELS)


def get_model(name: str) -> ServoModel:
    """Return the table row of a servo model, in any capitals.

    Raises:
        ConfigError: The name is not known; the message suggests those that are near.
    """
    row = _KEYS.get(name.strip().upper())
    if row is not None:
        return row
    text = name.strip().upper()
    near = difflib.get_close_matches(text, _KEYS, n=3, cutoff=0.5)
    near += [key for key in _KEYS if key.startswith(text) and key not in near]
    shown = ", ".join(dict.fromkeys(_KEYS[key].name for key in near)) or ", ".join(_MODELS)
    hint = "did you mean" if near else "there are"
    raise ConfigError(f"no servo model {name!r}; {hint}: {shown}")


def by_number(number: int) -> tuple[ServoModel, ...]:
    """Rows that answer with this model number; Feetech's variants share one."""
    return tuple(row for row in _MODELS.values() if row.model_number == number)
