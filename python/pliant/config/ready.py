"""Configuration files that ship with the package."""

from __future__ import annotations

from importlib.resources import files
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable

_FOLDER = "arms"


def _all() -> dict[str, Traversable]:
    folder = files("pliant.config").joinpath(_FOLDER)
    found = {f.name.removesuffix(".toml"): f for f in folder.iterdir() if f.name.endswith(".toml")}
    return dict(sorted(found.items()))


def names() -> tuple[str, ...]:
    """Return the names of the ready files."""
    return tuple(_all())


def text(name: str) -> str:
    """Return the text of a ready file."""
    return _all()[name].read_text(encoding="utf-8")


def describe(name: str) -> str:
    """Return the description of a ready file: the comment at its top."""
    lines = []
    for line in text(name).splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.removeprefix("#").strip())
    return " ".join(lines)
