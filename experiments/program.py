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

#: Option that names an arm, once for each.
Arms = Annotated[tuple[str, ...], tyro.conf.UseAppendAction]


def start(main: Callable[..., None]) -> None:
    """Run the program of a module that Python runs as `__main__`, with options from `sys.argv`.

    Args:
        main: Its function; parameters and docstring become options and their help. It is looked up
            in the module under its own name, because other processes import the jobs by that.
    """
    module = import_module(main.__globals__["__spec__"].name)
    tyro.cli(getattr(module, main.__name__))


def row(cells: Iterable[object]) -> str:
    """Return one row of a table in Markdown."""
    return f"| {' | '.join(str(cell) for cell in cells)} |"


def head(columns: Sequence[str]) -> str:
    """Return headings and rule of a table in Markdown."""
    return f"{row(columns)}\n{'|---' * len(columns)}|"


def markdown(columns: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a table in Markdown."""
    return "\n".join([head(columns), *(row(cells) for cells in rows)])


def worst(values: Iterable[float], digits: int, scale: float = 1.0) -> str:
    """Return the largest value and, in brackets, the median."""
    scaled = scale * np.array(list(values))
    return f"{scaled.max():.{digits}f} ({np.median(scaled):.{digits}f})"


def write_results(folder: Path, content: Mapping[str, Any]) -> Path:
    """Write `results.json` into a folder, which is created if missing.

    Args:
        folder: Target folder.
        content: Numbers, texts, sequences and maps of them; NaN and infinity become null.

    Returns:
        The file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "results.json"
    text = json.dumps(_plain(content), indent=1, allow_nan=False, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")
    return path


def _plain(value: Any) -> Any:
    """Return the value in JSON's types, which have neither NaN nor infinity."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
