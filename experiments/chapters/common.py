"""Shared code of the chapters: picklable calls, and figures of a trace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments import hands, tracking

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from experiments.episode import Trace
    from experiments.hands import Law

    Array = NDArray[np.float64]

#: Deviation below which an axis counts as back at its target: [m], [rad].
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


def drag(law: Callable[[], Law], *args: Any, **kwargs: Any) -> hands.Dragged:
    """Run `hands.drag` with a law that is made in the process that uses it."""
    return hands.drag(law(), *args, **kwargs)


def track(law: Callable[[], Law], *args: Any, **kwargs: Any) -> tracking.Tracked:
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
    """Format a time, or state that the axis stays."""
    return "stays" if time is None else f"{time:.1f} s"
