"""Force of an axis by its deviation: profiles of yielding axes, limits of stiff ones."""

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


#: Strong hand that moves 0.15 m in 6 s, slowly enough to measure static force against deviation.
STEADY = Drag(
    axis="y",
    distance=0.15,
    stiffness=3000.0,
    limit=80.0,
    at="tool",
    course=ForceProfile(start=1.0, rise=6.0, end=7.0),
)
#: Distance of the wall from the tool; target behind the wall, and displaced sideways [m].
GAP, BEHIND, ASIDE = 0.03, 0.07, 0.10
#: Time at which the wall is removed from the scene [s].
GONE = 6.0


@dataclass(frozen=True, kw_only=True)
class ForceCurve:
    """Force against deviation of one axis.

    Attributes:
        deviation: Distance of the axis from its target, tick by tick (N,) [m].
        force: Force on the hand along it (N,) [N].
        trace: The run.
    """

    deviation: Array
    force: Array
    trace: Trace


def answer(law: pliant.Settings, *, conditions: Conditions = NOMINAL) -> ForceCurve:
    """Drag the tool along y by 0.15 m at 0.025 m/s.

    Args:
        law: The settings.
        conditions: Loop, bus and beliefs.
    """
    trace = run(
        conditions.build(STEADY), conditions.controller(law), tool(VERTICAL), 7.0, q=VERTICAL
    )
    pulling = trace.between(STEADY.course.start, STEADY.course.end)
    return ForceCurve(deviation=trace.moved[pulling, 1], force=trace.force[pulling, 1], trace=trace)


def stiffness(axis: str, q: Array = VERTICAL) -> float:
    """Return the servos' stiffness along an axis, 1/C_jj with C = J K_p⁻¹ Jᵀ [N/m or N·m/rad]."""
    row = arm().jacobian(q)[AXES.index(axis)]
    return float(1.0 / (row / np.asarray(servos().kp) @ row))


@dataclass(frozen=True, kw_only=True)
class BlockResult:
    """Result of a target behind a wall and to the side, before and after the wall is removed.

    Attributes:
        force: Mean force on the wall in its last second [N].
        peak: Largest force on it [N].
        aside: Sideways motion of the tool in that second [m].
        fastest: Largest speed of the tool after the wall is removed [m/s].
        left: Distance of the tool from its target at the end [m].
        limited: Share of the ticks at the wall in which the controller reported the limit.
        trace: The run.
    """

    force: float
    peak: float
    aside: float
    fastest: float
    left: float
    limited: float
    trace: Trace


def block(law: pliant.Settings, *, conditions: Conditions = NOMINAL) -> BlockResult:
    """Move the target along x and y at once, with a wall across x until 6 s.

    Args:
        law: The settings.
        conditions: Loop, bus and assumptions.
    """
    plant = conditions.build(Wall(distance=GAP, stiffness=2e4, damping=50.0))
    controller = conditions.controller(law)
    assert isinstance(controller, pliant.Controller)  # law is Settings
    start = tool(VERTICAL)
    flags: list[bool] = []

    def target(t: float) -> Array:
        share = min(max((t - 1.0) / 2.0, 0.0), 1.0)
        return displaced(displaced(start, "x", share * (GAP + BEHIND)), "y", share * ASIDE)

    def take_away(time: float, plant: Plant) -> None:
        if abs(time - GONE) < 0.5 * plant.period:
            plant.set_hands([])
        if GONE - 2.0 < time < GONE:
            flags.append(bool(controller.diagnostics.deviation_limited.any()))

    trace = run(plant, controller, target, 9.0, q=VERTICAL, on_tick=take_away)
    last, free = trace.between(GONE - 1.0, GONE), trace.t > GONE
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
    """Result of a target that jumped by 0.10 m in x and in y without obstacle.

    Attributes:
        after: Time from the jump until the tool stays within 3 mm of it [s].
        left: Distance at the end [m].
        speed: Rms speed of the joints in the last second [rad/s].
        trace: The run.
    """

    after: float
    left: float
    speed: float
    trace: Trace


def jump(law: pliant.Settings, *, conditions: Conditions = NOMINAL) -> JumpResult:
    """Let the target jump by 0.10 m in x and in y at 1 s; the run ends at 5 s.

    Args:
        law: The settings.
        conditions: Loop, bus and beliefs.
    """
    start = tool(VERTICAL)
    there = displaced(displaced(start, "x", 0.10), "y", 0.10)
    plant, controller = conditions.build(), conditions.controller(law)
    trace = run(plant, controller, lambda t: there if t >= 1.0 else start, 5.0, q=VERTICAL)
    off = np.linalg.norm(trace.error[:, :3], axis=1)
    return JumpResult(
        after=float(trace.t[np.flatnonzero(off > 3e-3)[-1]]) - 1.0,
        left=float(off[-1]),
        speed=metrics.speed(trace, 4.0, 5.0),
        trace=trace,
    )
