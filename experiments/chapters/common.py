"""Shared code of the report's chapters: runs, return time and speed of an axis, plot helpers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments import disturbances, tracking
from pliant._report.style import BLUE, GREEN, MUTED, ORANGE, PURPLE, RED

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from experiments.disturbances import Law
    from experiments.simulation import Trace

    Grid = NDArray[np.object_]

#: An axis counts as returned to its target below this deviation: translations [m],
#: rotations [rad].
RETURN_TOLERANCE = (0.015, 0.06)
#: Time at which the hands release the arm [s].
RELEASE = 5.0


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of the demo.

    Attributes:
        quick: True makes only a few runs, which execute all code once.
        figures: Folder for the pictures.
    """

    quick: bool = False
    figures: Path


def drag(law: Callable[[], Law], *args: Any, **kwargs: Any) -> disturbances.DragResult:
    """Run `disturbances.drag` with the result of the factory `law`; return its result.

    The factory is called in the process that runs the job.
    """
    return disturbances.drag(law(), *args, **kwargs)


def track(law: Callable[[], Law], *args: Any, **kwargs: Any) -> tracking.TrackResult:
    """Run `tracking.track` with the result of the factory `law`; return its result.

    The factory is called in the process that runs the job.
    """
    return tracking.track(law(), *args, **kwargs)


def return_time(trace: Trace, axis: int, *, release: float = RELEASE) -> float | None:
    """Return the time from the release until an axis stays at its target [s].

    Args:
        trace: Run in which a hand releases the arm.
        axis: Index of the task axis.
        release: Time of the release [s].

    Returns:
        Time from the release until the deviation is below `RETURN_TOLERANCE` and stays there; None
        if the deviation is above it at the end of the run.
    """
    after = trace.t > release
    is_away = np.abs(trace.error[after, axis]) > RETURN_TOLERANCE[axis // 3]
    times = trace.t[after]
    if not is_away.any():
        return 0.0
    last = int(np.flatnonzero(is_away)[-1])
    return None if last + 1 >= times.size else float(times[last + 1] - release)


def return_speed(trace: Trace, axis: int, *, release: float = RELEASE) -> float:
    """Return the largest speed of a task axis after the release [m/s or rad/s]."""
    after = trace.t > release
    displacement = trace.moved[after, axis]
    period = float(trace.t[1] - trace.t[0])
    return float(np.abs(np.diff(displacement)).max() / period)


def seconds(time: float | None) -> str:
    """Format a return time [s] as text: "stays" for None, which means no return."""
    return "stays" if time is None else f"{time:.1f} s"


# --- Plot helpers ---

#: Colour of each family of control methods in all figures.
LAW_COLOURS = {
    "paper": RED,
    "paper + gravity": ORANGE,
    "cap": BLUE,
    "stiff": MUTED,
    "impedance": GREEN,
    "uniform": PURPLE,
    "admittance": "#8a6d1d",
}


#: Offsets (dx, dy) of a label from its point [pt], in the order in which they are tried.
OFFSETS = tuple((side * 8, dy) for dy in (0, 10, -10, 20, -20, 30, -30) for side in (1, -1))


def label_points(
    ax: Axes, points: Sequence[tuple[float, float, str, str]], *, size: float = 7.5
) -> None:
    """Write a label beside each point, at the first offset of `OFFSETS` without an overlap.

    If the label overlaps something at every offset, it is put to the right of its point. A label
    above or below its point gets a line to the point.

    Args:
        ax: Axes, whose limits must not change afterwards.
        points: x and y of each point in data units, text and colour of its label.
        size: Font size [pt].
    """
    figure = ax.get_figure(root=True)
    if figure is None:
        return
    figure.draw_without_rendering()
    scale = 72.0 / figure.dpi
    spots = [scale * ax.transData.transform((x, y)) for x, y, _, _ in points]
    boxes = [(px - 5, py - 5, px + 5, py + 5) for px, py in spots]
    frame = scale * np.asarray(ax.get_window_extent().extents)
    for (x, y, text, colour), (px, py) in zip(points, spots, strict=True):
        width, high = 0.58 * size * len(text), 1.1 * size
        for dx, dy in OFFSETS:
            x0 = px + dx if dx > 0 else px + dx - width
            box = (x0, py + dy - high / 2, x0 + width, py + dy + high / 2)
            is_inside = frame[0] <= box[0] and box[2] <= frame[2]
            if is_inside and not any(_overlap(box, other) for other in boxes):
                break
        else:
            dx, dy, box = 8, 0, (px + 8, py - high / 2, px + 8 + width, py + high / 2)
        boxes.append(box)
        is_far = abs(dy) > 0
        ax.annotate(
            text,
            (x, y),
            xytext=(dx, dy),
            textcoords="offset points",
            va="center",
            ha="left" if dx > 0 else "right",
            fontsize=size,
            color=colour,
            arrowprops={"arrowstyle": "-", "color": colour, "linewidth": 0.5, "shrinkB": 4}
            if is_far
            else None,
        )


def _overlap(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def pad_y_range(row: Grid, share: float) -> None:
    """Set the common y range of a row of plots: the data's range plus `share` of it at each end."""
    limits = [value for ax in row for value in ax.dataLim.intervaly if np.isfinite(value)]
    low, high = min(limits), max(limits)
    free = share * (high - low)
    row[0].set_ylim(low - free, high + free)


def shade(ax: Axes, start: float, end: float, text: str = "") -> None:
    """Shade the time span from `start` to `end` [s], with an optional text at its top."""
    ax.axvspan(start, end, color=MUTED, alpha=0.10, linewidth=0)
    if text:
        ax.annotate(
            text,
            ((start + end) / 2, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, -3),
            textcoords="offset points",
            ha="center",
            va="top",
            fontsize=7.5,
            color=MUTED,
        )


def names(
    ax: Axes, entries: Sequence[tuple[str, str]], *, right: bool = True, top: bool = True
) -> None:
    """Write coloured texts into a corner of the axes, one per line.

    Args:
        ax: Axes to draw into.
        entries: Text and colour of each line.
        right: True: right corner; False: left corner.
        top: True: upper corner; False: lower corner.
    """
    for row, (text, colour) in enumerate(entries if top else list(reversed(entries))):
        ax.annotate(
            text,
            (0.98 if right else 0.02, 0.98 if top else 0.02),
            xycoords="axes fraction",
            xytext=(0, -11 * row if top else 11 * row),
            textcoords="offset points",
            ha="right" if right else "left",
            va="top" if top else "bottom",
            color=colour,
            fontsize=8.0,
            fontweight="bold",
        )
