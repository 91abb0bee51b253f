"""Tracking experiments: a sinusoidal target, a rotation step, and a target out of reach."""

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
    """Result of tracking a sinusoid with one axis.

    Attributes:
        share: Rms deviation of the moved axis from its target, over the amplitude.
        position: Largest deviation of another position from its target [m].
        rotation: Largest deviation of another rotation from its target [rad].
        sunk: Largest loss of the tool's height while the tool is beyond x = 0.40 m [m]; 0 if it
            never is.
        left: Loss of the tool's height 4.5 s after the start of the motion [m].
        trace: Recorded run.
    """

    share: float
    position: float
    rotation: float
    sunk: float
    left: float
    trace: Trace


def track(law: Law, axis: str, *, conditions: Conditions = NOMINAL) -> TrackResult:
    """Move the target sinusoidally along or about one axis for two periods, from 1 to 17 s.

    Returns:
        Deviations of the tool from its target; the run starts in the vertical grasp pose.
    """
    start = tool(VERTICAL)
    index = AXES.index(axis)
    target = sinusoid(start, axis, AMPLITUDE[axis])
    trace = run(conditions.build(), conditions.controller(law), target, 17.0, q=VERTICAL)
    swing = trace.between(1.0, 17.0)
    error = trace.error[swing]
    # The trace has the state at the end of a tick, but the target of its start.
    target_at_end = AMPLITUDE[axis] * np.sin(2.0 * np.pi * (trace.t[swing] - 1.0) / PERIOD)
    height_change = trace.position[:, 2] - start[2, 3]
    is_far = trace.position[:, 0] > 0.40
    back = trace.at(1.0 + 4.5)
    return TrackResult(
        share=metrics.rms(target_at_end - trace.moved[swing, index]) / AMPLITUDE[axis],
        position=metrics.largest(error[:, metrics.others(index, "xyz")]),
        rotation=metrics.largest(error[:, metrics.others(index, "rpy")]),
        sunk=float(-height_change[is_far].min()) if is_far.any() else 0.0,
        left=float(-height_change[back]),
        trace=trace,
    )


@dataclass(frozen=True, kw_only=True)
class TiltResult:
    """Result of a step of the target's orientation.

    Attributes:
        angle: Angle between the tool's orientation and its target at 6 s [rad].
        position: Largest distance of the tool from its constant target position [m].
        trace: Recorded run.
    """

    angle: float
    position: float
    trace: Trace


def tilt(law: Law, *, conditions: Conditions = NOMINAL) -> TiltResult:
    """Turn the target orientation of the horizontal grasp pose at 1 s by a step of 0.44 rad.

    The axis of the rotation is oblique to the base axes.
    """
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
        speed: Rms speed of the joints from 7 to 8 s, at the limit of the reach [rad/s].
        fastest: Largest speed of a joint [rad/s].
        error: Distance of the tool from its target position at 15 s [m].
        trace: Recorded run.
    """

    farthest: float
    speed: float
    fastest: float
    error: float
    trace: Trace


def leave_reach(law: Law, *, conditions: Conditions = NOMINAL) -> ReachResult:
    """Move the target from x = 0.40 m to 0.80 m, beyond the arm's reach of 0.71 m, and back."""
    trace = run(conditions.build(), conditions.controller(law), beyond_reach, 15.0, q=AT_REACH)
    return ReachResult(
        farthest=float(trace.position[:, 0].max()),
        speed=metrics.speed(trace, 7.0, 8.0),
        fastest=metrics.largest(trace.dq),
        error=float(np.linalg.norm(trace.error[-1, :3])),
        trace=trace,
    )
