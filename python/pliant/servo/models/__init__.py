"""Servo models by name; docs/adding-a-servo.md describes how to add a model."""

from __future__ import annotations

import difflib

from pliant._core import ConfigError
from pliant.servo.models import feetech, protocol1, protocol2
from pliant.servo.models.base import Block, Family, Register, ServoModel

__all__ = ["Block", "Family", "Register", "ServoModel", "by_number", "get_model", "list_models"]

_MODELS: dict[str, ServoModel] = {
    model.name: model for model in (*feetech.MODELS, *protocol1.MODELS, *protocol2.MODELS)
}
_KEYS = {key.upper(): model for model in _MODELS.values() for key in (model.name, *model.aliases)}


def list_models() -> tuple[str, ...]:
    """Return the names of all servo models."""
    return tuple(_MODELS)


def get_model(name: str) -> ServoModel:
    """Return a servo model by its name or alias, ignoring case.

    Raises:
        ConfigError: The name is unknown; the message suggests similar names.
    """
    text = name.strip().upper()
    model = _KEYS.get(text)
    if model is not None:
        return model
    similar = difflib.get_close_matches(text, _KEYS, n=3, cutoff=0.5)
    similar += [key for key in _KEYS if key.startswith(text) and key not in similar]
    names = ", ".join(dict.fromkeys(_KEYS[key].name for key in similar)) or ", ".join(_MODELS)
    hint = "did you mean" if similar else "there are"
    raise ConfigError(f"no servo model {name!r}; {hint}: {names}")


def by_number(number: int) -> tuple[ServoModel, ...]:
    """Return the servo models whose register Model Number has this value.

    There may be several: Feetech's variants share one number.
    """
    return tuple(model for model in _MODELS.values() if model.model_number == number)
