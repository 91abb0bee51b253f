"""What the chapters share: calls that another process can make, and figures read off a trace."""

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

#: Below this deviation an axis counts as back at its target: [m], [rad].
BACK = (0.015, 0.06)
#: When the hands let go [s].
RELEASE = 5.0


@dataclass(frozen=True, kw_only=True)
class Options:
    """What the user asked of the demo.

    Attributes:
        quick: Only as many runs as it takes to exercise everything once.
        figures: Folder of the pictures.
    """

    quick: bool = False
    figures: Path


def drag(law: Callable[[], Law], *args: Any, **kwargs: Any) -> hands.Dragged:
    """`hands.drag` with a law that is made where it is used, in whatever process that is."""
    return hands.drag(law(), *args, **kwargs)


def track(law: Callable[[], Law], *args: Any, **kwargs: Any) -> tracking.Tracked:
    """`tracking.track` with a law that is made where it is used."""
    return tracking.track(law(), *args, **kwargs)


def returned(trace: Trace, axis: int, *, release: float = RELEASE) -> float | None:
    """Time after the release until an axis is back for good [s], None if it is not back at the end.

    Args:
        trace: A run in which a hand lets go at `release`.
        axis: Index of the task axis.
        release: When [s].

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
    """Largest speed of a task axis after the release [m/s or rad/s]."""
    after = trace.t > release
    along = trace.moved[after, axis]
    period = float(trace.t[1] - trace.t[0])
    return float(np.abs(np.diff(along)).max() / period)


def seconds(time: float | None) -> str:
    """A time, or that something stays."""
    return "stays" if time is None else f"{time:.1f} s"
