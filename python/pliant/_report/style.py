"""Common matplotlib style of all figures, with the colour-blind safe palette of Okabe and Ito.

A figure is saved as PNG for slides, and as SVG for the HTML report. The report replaces the colours
in the SVG, so that figures follow its dark mode.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import PliantError
from pliant._extras import missing
from pliant._files import replacing

try:
    import matplotlib
except ImportError as error:
    raise PliantError(missing("a figure", "plot")) from error

from matplotlib.figure import Figure

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from pliant._typing import Array

    Grid = NDArray[np.object_]

#: Colours of text, secondary text, grid lines and background.
INK, MUTED, GRID, CARD = "#1b1f24", "#67707b", "#e3e6ea", "#ffffff"
#: Colours of curves.
BLUE, SKY, GREEN, ORANGE, RED, PURPLE = (
    "#0072b2",
    "#56b4e9",
    "#009e73",
    "#e69f00",
    "#d55e00",
    "#cc79a7",
)
#: Colour of each task axis; a rotation has the colour of the axis that it turns about.
AXIS_COLOURS = {"x": RED, "y": GREEN, "z": BLUE, "roll": RED, "pitch": GREEN, "yaw": BLUE}
#: Width of a figure that fills the width of the report [inch].
WIDE = 11.0
#: Resolution of PNG files [pixels/inch].
PIXELS_PER_INCH = 150

#: Matplotlib parameters (`rcParams`) of the common style.
RC: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": MUTED,
    "axes.linewidth": 0.7,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.facecolor": "none",
    "grid.color": GRID,
    "grid.linewidth": 0.7,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.0,
    "ytick.labelsize": 8.0,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "lines.linewidth": 1.5,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "text.color": INK,
    "figure.facecolor": CARD,
    "svg.fonttype": "path",
    "svg.hashsalt": "pliant",
    "path.simplify_threshold": 0.3,
}


@contextmanager
def canvas(
    rows: int = 1,
    columns: int = 1,
    *,
    size: tuple[float, float] = (WIDE, 4.0),
    **grid: Any,
) -> Iterator[tuple[Figure, Grid]]:
    """Yield a figure in the common style, and the array of its axes (rows, columns).

    Args:
        rows: Number of rows of axes.
        columns: Number of columns of axes.
        size: Width and height of the figure [inch].
        **grid: Arguments of `Figure.subplots` (`sharex`, `width_ratios`, ...).
    """
    with matplotlib.rc_context(RC):
        figure = Figure(figsize=size, layout="constrained")
        yield figure, figure.subplots(rows, columns, squeeze=False, **grid)


def save(figure: Figure, folder: Path, name: str) -> None:
    """Write `name.png` and `name.svg` without dates, so that equal figures give equal files."""
    folder.mkdir(parents=True, exist_ok=True)
    metadata = dict.fromkeys(("Date", "Creator", "Format", "Type"))
    with replacing(folder / f"{name}.png") as file:
        figure.savefig(file, dpi=PIXELS_PER_INCH, metadata={"Software": None})
    # The layout of the PNG serves the SVG too: it takes as long as the drawing.
    figure.set_layout_engine("none")
    with replacing(folder / f"{name}.svg") as file:
        figure.savefig(file, metadata=metadata)


def thin(t: Array, *, rate: float = 25.0) -> slice:
    """Return a slice that selects every k-th sample, so that about `rate` per second remain.

    Args:
        t: Times of the samples (N,) [s], evenly spaced.
        rate: Samples per second to keep [Hz].
    """
    step = 1 if t.size < 2 else max(1, round(1.0 / (rate * float(t[1] - t[0]))))
    return slice(None, None, step)


def label_end(
    ax: Axes, x: float, labels: Sequence[tuple[float, str, str]], *, size: float = 8.0
) -> None:
    """Write labels beside the ends of lines, moved apart so that they do not overlap.

    Args:
        ax: Axes with their final limits.
        x: Position of the line ends in data units.
        labels: y in data units, text and colour of each label.
        size: Font size [pt].
    """
    low, high = ax.get_ylim()
    figure = ax.get_figure(root=True)
    if figure is None:
        return
    height = (
        ax.get_position().height * figure.get_figheight() * 72.0
    )  # [pt], before the constrained layout, which may reduce it
    gap = 1.15 * size * (high - low) / max(height, 1.0)
    order = sorted(labels)
    heights = [np.clip(y, low, high) for y, _, _ in order]
    for _ in range(100):
        has_overlap = False
        for i in range(len(heights) - 1):
            overlap = gap - (heights[i + 1] - heights[i])
            if overlap > 1e-9 * gap:
                heights[i] -= overlap / 2
                heights[i + 1] += overlap / 2
                has_overlap = True
        if not has_overlap:
            break
    for y, (_, text, colour) in zip(heights, order, strict=True):
        ax.annotate(
            text,
            (x, y),
            xytext=(4, 0),
            textcoords="offset points",
            va="center",
            ha="left",
            color=colour,
            fontsize=size,
            annotation_clip=False,
        )


def level(ax: Axes, y: float, text: str = "") -> None:
    """Draw a dashed horizontal line at y (data units), labelled `text` unless that is empty."""
    ax.axhline(y, color=MUTED, linewidth=0.9, linestyle=(0, (4, 3)))
    if text:
        ax.annotate(
            text,
            (0.01, y),
            xycoords=("axes fraction", "data"),
            xytext=(0, 2),
            textcoords="offset points",
            fontsize=7.5,
            color=MUTED,
        )
