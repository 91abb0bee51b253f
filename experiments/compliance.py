"""Force of an axis as a function of its deviation, for soft axes and limited stiff axes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import pliant
from experiments import metrics
from experiments.poses import AXES, arm, displaced, servos, tool
from experiments.simulation import NOMINAL, Trace, run
from pliant.sim import Drag, ForceProfile, Wall
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from experiments.poses import Array
    from experiments.simulation import Conditions
    from pliant.sim import Plant


#: Hand that moves 0.15 m in 6 s, slowly enough to measure the static force.
STEADY = Drag(
    axis="y",
    distance=0.15,
    stiffness=3000.0,
    limit=80.0,
    at="tool",
    course=ForceProfile(start=1.0, rise=6.0, end=7.0),
)
#: Distances in `block` [m]: initial gap between tool and wall, final depth of the target in the
#: wall, and final sideways distance of the target from its start.
GAP, DEPTH, ASIDE = 0.03, 0.07, 0.10
#: Time at which the wall is removed [s].
WALL_END = 6.0


@dataclass(frozen=True, kw_only=True)
class ForceCurve:
    """Force against deviation of one axis.

    Attributes:
        deviation: Displacement of the tool from its constant target along the axis, at each tick
            (N,) [m].
        force: Force on the hand along the axis at each tick (N,) [N].
        trace: Recorded run.
    """

    deviation: Array
    force: Array
    trace: Trace


def answer(law: pliant.Settings, *, conditions: Conditions = NOMINAL) -> ForceCurve:
    """Drag the tool along y by 0.15 m at 0.025 m/s; return force and deviation of the axis y.

    Args:
        law: Settings of the controller.
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.
    """
    trace = run(
        conditions.build(STEADY), conditions.controller(law), tool(VERTICAL), 7.0, q=VERTICAL
    )
    pulling = trace.between(STEADY.course.start, STEADY.course.end)
    return ForceCurve(deviation=trace.moved[pulling, 1], force=trace.force[pulling, 1], trace=trace)


def stiffness(axis: str, q: Array = VERTICAL) -> float:
    """Return the stiffness of the position loops along an axis at q (7,) [N/m or N·m/rad].

    It is 1/C_jj for axis j, with C = J K_p⁻¹ Jᵀ, the Jacobian J and the servos' stiffnesses K_p.
    """
    row = arm().jacobian(q)[AXES.index(axis)]
    return float(1.0 / (row / np.asarray(servos().kp) @ row))


@dataclass(frozen=True, kw_only=True)
class BlockResult:
    """Result of a target behind a wall and to the side, before and after the wall is removed.

    Attributes:
        force: Mean force on the wall in the last second before its removal [N].
        peak: Largest force on the wall [N].
        aside: Mean sideways displacement of the tool in the last second before the removal [m].
        fastest: Largest speed of the tool after the removal [m/s].
        left: Distance of the tool from its target at the end [m].
        limited: Share of the ticks in the last 2 s before the removal at which the diagnostics of
            the controller report `deviation_limited` for an axis.
        trace: Recorded run.
    """

    force: float
    peak: float
    aside: float
    fastest: float
    left: float
    limited: float
    trace: Trace


def block(law: pliant.Settings, *, conditions: Conditions = NOMINAL) -> BlockResult:
    """Move the target along x and y at the same time, with a wall across x until 6 s.

    Args:
        law: Settings of the controller.
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.
    """
    plant = conditions.build(Wall(distance=GAP, stiffness=2e4, damping=50.0))
    controller = conditions.controller(law)
    assert isinstance(controller, pliant.Controller)  # law is Settings
    start = tool(VERTICAL)
    flags: list[bool] = []

    def target(t: float) -> Array:
        share = min(max((t - 1.0) / 2.0, 0.0), 1.0)
        return displaced(displaced(start, "x", share * (GAP + DEPTH)), "y", share * ASIDE)

    def take_away(time: float, plant: Plant) -> None:
        if abs(time - WALL_END) < 0.5 * plant.period:
            plant.set_hands([])
        if WALL_END - 2.0 < time < WALL_END:
            flags.append(bool(controller.diagnostics.deviation_limited.any()))

    trace = run(plant, controller, target, 9.0, q=VERTICAL, on_tick=take_away)
    last, free = trace.between(WALL_END - 1.0, WALL_END), trace.t > WALL_END
    speed = np.linalg.norm(np.diff(trace.position[free], axis=0), axis=1) * conditions.rate
    return BlockResult(
        force=float(-trace.force[last, 0].mean()),
        peak=float(np.abs(trace.force[:, 0]).max()),
        aside=float(trace.moved[last, 1].mean()),
        fastest=float(speed.max()),
        left=float(np.linalg.norm(trace.error[-1, :3])),
        limited=float(np.mean(flags)),
        trace=trace,
    )


@dataclass(frozen=True, kw_only=True)
class JumpResult:
    """Result of a step of the target by 0.10 m in x and in y, without an obstacle.

    Attributes:
        after: Time from the step until the tool stays within 3 mm of the target [s].
        left: Distance from the target at the end [m].
        speed: Rms speed of the joints in the last second [rad/s].
        trace: Recorded run.
    """

    after: float
    left: float
    speed: float
    trace: Trace


def jump(law: pliant.Settings, *, conditions: Conditions = NOMINAL) -> JumpResult:
    """Step the target by 0.10 m in x and in y at 1 s; the run ends at 5 s.

    Args:
        law: Settings of the controller.
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.
    """
    start = tool(VERTICAL)
    target = displaced(displaced(start, "x", 0.10), "y", 0.10)
    plant, controller = conditions.build(), conditions.controller(law)
    trace = run(plant, controller, lambda t: target if t >= 1.0 else start, 5.0, q=VERTICAL)
    distance = np.linalg.norm(trace.error[:, :3], axis=1)
    return JumpResult(
        after=float(trace.t[np.flatnonzero(distance > 3e-3)[-1]]) - 1.0,
        left=float(distance[-1]),
        speed=metrics.speed(trace, 4.0, 5.0),
        trace=trace,
    )
