"""Markdown tables of the experiments' programs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence


def row(cells: Iterable[object]) -> str:
    """Return a row of a Markdown table with these cells."""
    return f"| {' | '.join(str(cell) for cell in cells)} |"


def head(columns: Sequence[str]) -> str:
    """Return heading and separator line of a Markdown table with these columns."""
    return f"{row(columns)}\n{'|---' * len(columns)}|"


def table(columns: Sequence[str], rows: Iterable[Iterable[object]]) -> str:
    """Return a Markdown table with these headings and rows of cells."""
    return "\n".join([head(columns), *(row(cells) for cells in rows)])


def worst(values: Iterable[float], digits: int, scale: float = 1.0) -> str:
    """Return the largest value and, in brackets, the median as text; `scale` multiplies both."""
    scaled = scale * np.array(list(values))
    return f"{scaled.max():.{digits}f} ({np.median(scaled):.{digits}f})"
