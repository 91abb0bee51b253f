"""Metrics of a recorded run (`Trace`) in which a hand pulls the arm: displacements, speeds.

Displacements are in m and rad.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from experiments.poses import Array
    from experiments.simulation import Trace


#: Time span in which hands pull the arm, and time span in which the force of a resting hand is
#: averaged [s].
PULLING = (2.0, 5.0)
HELD = (4.4, 4.95)


def largest(values: Array) -> float:
    """Return the largest absolute value of an array; 0 if it is empty."""
    return float(np.abs(values).max()) if values.size else 0.0


def rms(values: Array) -> float:
    """Return the root mean square of all entries of an array."""
    return float(np.sqrt(np.mean(np.square(values))))


def others(axis: int, group: str) -> list[int]:
    """Return the indices of the positions (group `xyz`) or rotations (`rpy`) other than `axis`."""
    return [i for i in (range(3) if group == "xyz" else range(3, 6)) if i != axis]


def moved(trace: Trace, axis: int) -> float:
    """Return the largest displacement of a task axis from the start of the pull, during the pull.

    The value is in m or rad.
    """
    return drift(trace, [axis])


def deviation(trace: Trace, columns: list[int]) -> float:
    """Return the largest displacement of one of these axes from the start of the run.

    Only the time in which the hand pulls counts; `columns` are the indices of the axes.
    """
    return largest(trace.moved[trace.between(*PULLING)][:, columns])


def drift(trace: Trace, columns: list[int]) -> float:
    """Return the largest displacement of one of these axes from the start of the pull.

    Only the time in which the hand pulls counts; `columns` are the indices of the axes.
    """
    before = trace.moved[trace.at(PULLING[0]), columns]
    return largest(trace.moved[trace.between(*PULLING)][:, columns] - before)


def speed(trace: Trace, start: float, end: float) -> float:
    """Return the rms speed of the joints from `start` to `end` [s], over all ticks [rad/s]."""
    return rms(trace.dq[trace.between(start, end)])
