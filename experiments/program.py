"""Shared code of the experiments' programs: command line, Markdown tables, `results.json`."""

from __future__ import annotations

import json
import math
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import tyro

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from pathlib import Path

#: Type of a command-line option that names an arm and can be repeated.
Arms = Annotated[tuple[str, ...], tyro.conf.UseAppendAction]


def start(main: Callable[..., None]) -> None:
    """Run the `main` function of a module that Python runs as `__main__`.

    The parameters of `main` become command-line options, and its docstring their help. The module
    is imported again by its full name, because other processes import the jobs by this name.

    Args:
        main: Function `main` of the module.
    """
    module = import_module(main.__globals__["__spec__"].name)
    tyro.cli(getattr(module, main.__name__))


def row(cells: Iterable[object]) -> str:
    """Return a row of a Markdown table with these cells."""
    return f"| {' | '.join(str(cell) for cell in cells)} |"


def head(columns: Sequence[str]) -> str:
    """Return heading and separator line of a Markdown table with these columns."""
    return f"{row(columns)}\n{'|---' * len(columns)}|"


def markdown(columns: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a Markdown table with these headings and rows of cells."""
    return "\n".join([head(columns), *(row(cells) for cells in rows)])


def worst(values: Iterable[float], digits: int, scale: float = 1.0) -> str:
    """Return the largest value and, in brackets, the median as text; `scale` multiplies both."""
    scaled = scale * np.array(list(values))
    return f"{scaled.max():.{digits}f} ({np.median(scaled):.{digits}f})"


def write_results(folder: Path, content: Mapping[str, Any]) -> Path:
    """Write `results.json` into a folder, which is created if missing.

    Args:
        folder: Target folder.
        content: Numbers, texts, sequences and maps; NaN and infinity are written as null.

    Returns:
        Path of the file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "results.json"
    text = json.dumps(_plain(content), indent=1, allow_nan=False, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")
    return path


def _plain(value: Any) -> Any:
    """Return the value converted to JSON types, with None for NaN and infinity."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
