"""Shared code of the chapters.

It has picklable calls of the scenarios, return time and speed computed from a trace, and the style
of the plots: colours of the control laws, labels beside points, and shaded time spans.
"""

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

#: Deviation below which an axis counts as back at its target: translations [m], rotations [rad].
BACK = (0.015, 0.06)
#: Time at which the hands let go [s].
RELEASE = 5.0


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options of the demo.

    Attributes:
        quick: True: the fewest runs that exercise everything once.
        figures: Folder of the pictures.
    """

    quick: bool = False
    figures: Path


def drag(law: Callable[[], Law], *args: Any, **kwargs: Any) -> disturbances.DragResult:
    """Run `disturbances.drag` with a law that is made in the process that uses it."""
    return disturbances.drag(law(), *args, **kwargs)


def track(law: Callable[[], Law], *args: Any, **kwargs: Any) -> tracking.TrackResult:
    """Run `tracking.track` with a law that is made in the process that uses it."""
    return tracking.track(law(), *args, **kwargs)


def returned(trace: Trace, axis: int, *, release: float = RELEASE) -> float | None:
    """Return the time from the release until an axis stays back [s]; None if it does not.

    Args:
        trace: A run in which a hand lets go at `release`.
        axis: Index of the task axis.
        release: Time of the release [s].

    Returns:
        Time until the deviation stays below `BACK`.
    """
    after = trace.t > release
    away = np.abs(trace.error[after, axis]) > BACK[axis // 3]
    times = trace.t[after]
    if not away.any():
        return 0.0
    last = int(np.flatnonzero(away)[-1])
    return None if last + 1 >= times.size else float(times[last + 1] - release)


def return_speed(trace: Trace, axis: int, *, release: float = RELEASE) -> float:
    """Return the largest speed of a task axis after the release [m/s or rad/s]."""
    after = trace.t > release
    along = trace.moved[after, axis]
    period = float(trace.t[1] - trace.t[0])
    return float(np.abs(np.diff(along)).max() / period)


def seconds(time: float | None) -> str:
    """Format a time [s]; for None, state that the axis does not return."""
    return "stays" if time is None else f"{time:.1f} s"


# --- Style of the experiments' figures: colours of the laws, labels beside points, marked spans ---

#: Colours of controllers in all figures.
LAW_COLOURS = {
    "paper": RED,
    "paper + gravity": ORANGE,
    "cap": BLUE,
    "stiff": MUTED,
    "impedance": GREEN,
    "uniform": PURPLE,
    "admittance": "#8a6d1d",
}


#: Offsets of a label from its point (dx, dy) [pt], in the order in which they are tried.
PLACES = tuple((side * 8, dy) for dy in (0, 10, -10, 20, -20, 30, -30) for side in (1, -1))


def label_points(
    ax: Axes, points: Sequence[tuple[float, float, str, str]], *, size: float = 7.5
) -> None:
    """Write a label beside each point, at the first of `PLACES` where it covers nothing.

    A label without such a place is written at the right of its point. A label that is displaced
    vertically gets a line to its point.

    Args:
        ax: Axes whose limits are final.
        points: x and y of the point in data units, text and colour of its label.
        size: Font size [pt].
    """
    figure = ax.get_figure(root=True)
    if figure is None:
        return
    figure.draw_without_rendering()
    scale = 72.0 / figure.dpi
    spots = [scale * ax.transData.transform((x, y)) for x, y, _, _ in points]
    taken = [(px - 5, py - 5, px + 5, py + 5) for px, py in spots]
    frame = scale * np.asarray(ax.get_window_extent().extents)
    for (x, y, text, colour), (px, py) in zip(points, spots, strict=True):
        wide, high = 0.58 * size * len(text), 1.1 * size
        for dx, dy in PLACES:
            left = px + dx if dx > 0 else px + dx - wide
            box = (left, py + dy - high / 2, left + wide, py + dy + high / 2)
            inside = frame[0] <= box[0] and box[2] <= frame[2]
            if inside and not any(_overlap(box, other) for other in taken):
                break
        else:
            dx, dy, box = 8, 0, (px + 8, py - high / 2, px + 8 + wide, py + high / 2)
        taken.append(box)
        far = abs(dy) > 0
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
            if far
            else None,
        )


def _overlap(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def room(row: Grid, share: float) -> None:
    """Widen the y range of axes that share it by `share` of the curves' range at either end."""
    limits = [value for ax in row for value in ax.dataLim.intervaly if np.isfinite(value)]
    low, high = min(limits), max(limits)
    free = share * (high - low)
    row[0].set_ylim(low - free, high + free)


def shade(ax: Axes, start: float, end: float, text: str = "") -> None:
    """Shade the span from `start` to `end` [s], with an optional text at its top."""
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
