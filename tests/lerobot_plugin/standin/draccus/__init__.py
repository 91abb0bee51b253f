"""Stand-in for the package draccus: creates configuration objects by type name."""

from __future__ import annotations

from typing import Any, ClassVar


class ChoiceRegistry:
    """Base class of configuration classes that are registered under a name."""

    _choices: ClassVar[dict[str, type]]

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if ChoiceRegistry in cls.__bases__:
            cls._choices = {}

    @classmethod
    def register_subclass(cls, name: str) -> Any:
        def register(choice: type) -> type:
            cls._choices[name] = choice
            return choice

        return register

    @property
    def type(self) -> str:
        return next(name for name, choice in self._choices.items() if choice is type(self))


def decode(kind: Any, values: dict[str, Any]) -> Any:
    """Return the configuration object for `values`; their entry `type` names the class."""
    rest = dict(values)
    return kind._choices[rest.pop("type")](**rest)
