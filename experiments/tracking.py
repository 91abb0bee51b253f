"""Moving targets: sinusoids, a rotation step, and a path out of reach."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from experiments import metrics
from experiments.poses import (
    AMPLITUDE,
    AT_REACH,
    AXES,
    PERIOD,
    beyond_reach,
    sinusoid,
    tilted,
    tool,
)
from experiments.simulation import NOMINAL, Trace, run
from pliant.sim.postures import HORIZONTAL, VERTICAL

if TYPE_CHECKING:
    from experiments.disturbances import Law
    from experiments.simulation import Conditions


@dataclass(frozen=True, kw_only=True)
class TrackResult:
    """Tracking of a sinusoid by a compliant axis.

    Attributes:
        share: Rms error over amplitude.
        position: Largest deviation of the other positions [m].
        rotation: Largest deviation of the other rotations [rad].
        sunk: Largest loss of height where the tool is beyond x = 0.40 m [m].
        left: Loss of height when the tool is first back at x = 0.38 m after the far half-wave [m].
        trace: The run.
    """

    share: float
    position: float
    rotation: float
    sunk: float
    left: float
    trace: Trace


def track(law: Law, axis: str, *, conditions: Conditions = NOMINAL) -> TrackResult:
    """Move the target sinusoidally along or about one axis from 1 to 17 s, two periods."""
    start = tool(VERTICAL)
    index = AXES.index(axis)
    target = sinusoid(start, axis, AMPLITUDE[axis])
    trace = run(conditions.build(), conditions.controller(law), target, 17.0, q=VERTICAL)
    swing = trace.between(1.0, 17.0)
    error = trace.error[swing]
    # The target of a row is that of its beginning, the state that of its end; compare at the end.
    wish = AMPLITUDE[axis] * np.sin(2.0 * np.pi * (trace.t[swing] - 1.0) / PERIOD)
    sunk = trace.position[:, 2] - start[2, 3]
    far = trace.position[:, 0] > 0.40
    back = trace.at(1.0 + 4.5)
    return TrackResult(
        share=metrics.rms(wish - trace.moved[swing, index]) / AMPLITUDE[axis],
        position=metrics.largest(error[:, metrics.others(index, "xyz")]),
        rotation=metrics.largest(error[:, metrics.others(index, "rpy")]),
        sunk=float(-sunk[far].min()) if far.any() else 0.0,
        left=float(-sunk[back]),
        trace=trace,
    )


@dataclass(frozen=True, kw_only=True)
class TiltResult:
    """Response to a step of the tool's orientation.

    Attributes:
        angle: Remaining angle at 6 s [rad].
        position: Largest deviation of the tool's position during the run [m].
        trace: The run.
    """

    angle: float
    position: float
    trace: Trace


def tilt(law: Law, *, conditions: Conditions = NOMINAL) -> TiltResult:
    """Turn the target of the horizontal grasp at once, by 0.44 rad about an oblique axis."""
    target = tilted(tool(HORIZONTAL))
    trace = run(conditions.build(), conditions.controller(law), target, 6.0, q=HORIZONTAL)
    return TiltResult(
        angle=float(np.linalg.norm(trace.error[-1, 3:])),
        position=float(np.linalg.norm(trace.error[:, :3], axis=1).max()),
        trace=trace,
    )


@dataclass(frozen=True, kw_only=True)
class ReachResult:
    """Result of a target that left the arm's reach and returned.

    Attributes:
        farthest: Largest x of the tool [m].
        speed: Rms speed of the joints at the limit, 7 to 8 s [rad/s].
        fastest: Largest speed of a joint [rad/s].
        error: Distance of the tool from its target at 15 s [m].
        trace: The run.
    """

    farthest: float
    speed: float
    fastest: float
    error: float
    trace: Trace


def leave_reach(law: Law, *, conditions: Conditions = NOMINAL) -> ReachResult:
    """Move the target to x = 0.80 m, where the arm ends at 0.71 m from its shoulder, and back."""
    trace = run(conditions.build(), conditions.controller(law), beyond_reach, 15.0, q=AT_REACH)
    return ReachResult(
        farthest=float(trace.position[:, 0].max()),
        speed=metrics.speed(trace, 7.0, 8.0),
        fastest=metrics.largest(trace.dq),
        error=float(np.linalg.norm(trace.error[-1, :3])),
        trace=trace,
    )
