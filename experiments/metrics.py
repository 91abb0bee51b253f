"""Figures of a `Trace`. Deviations in m and rad, forces in N and N·m."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from experiments.poses import Array
    from experiments.simulation import Trace


#: Time span in which the hands pull, and the one in which their holding force is averaged [s].
PULLING = (2.0, 5.0)
HELD = (4.4, 4.95)


def largest(values: Array) -> float:
    """Return the largest magnitude; 0 for an empty array."""
    return float(np.abs(values).max()) if values.size else 0.0


def rms(values: Array) -> float:
    """Return the root mean square of all entries."""
    return float(np.sqrt(np.mean(np.square(values))))


def others(axis: int, group: str) -> list[int]:
    """Return the positions (`xyz`) or rotations (`rpy`) other than `axis`."""
    return [i for i in (range(3) if group == "xyz" else range(3, 6)) if i != axis]


def moved(trace: Trace, axis: int) -> float:
    """Return the largest change of an axis since the hand came, while it pulls, unsigned."""
    return drift(trace, [axis])


def deviation(trace: Trace, columns: list[int]) -> float:
    """Return the largest change of these axes since the start while a hand pulls."""
    return largest(trace.moved[trace.between(*PULLING)][:, columns])


def drift(trace: Trace, columns: list[int]) -> float:
    """Return the largest change of these axes since the hand came, while it pulls."""
    before = trace.moved[trace.at(PULLING[0]), columns]
    return largest(trace.moved[trace.between(*PULLING)][:, columns] - before)


def speed(trace: Trace, start: float, end: float) -> float:
    """Return the rms speed within a time span, over all ticks and joints [rad/s]."""
    return rms(trace.dq[trace.between(start, end)])
