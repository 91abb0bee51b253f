"""Host loss: the servos keep their last goals and limits, and a hand comes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from experiments import metrics
from experiments.conditions import NOMINAL
from experiments.episode import Trace, run
from experiments.setups import AXES, arm, servos, tool
from pliant.sim.hand import STRONG, Course
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from experiments.conditions import Conditions
    from experiments.hands import Law

    Array = NDArray[np.float64]

#: Time at which the bus falls silent, and duration of the hand's motion [s].
DEATH, RISE = 1.9, 7.5


@dataclass(frozen=True, kw_only=True)
class Survived:
    """Force on a hand that moved an arm after a host loss.

    Attributes:
        force: Largest force against the hand, mean over a tick [N].
        formula: min over the joints of (L + τ_f + s g)/|a|, a = Jᵀd, at the pose of that force [N].
        moved: Motion of the tool between the host loss and the hand, or without a hand at all [m].
        trace: The run.
    """

    force: float
    formula: float
    moved: float
    trace: Trace


def static_force(q: Array, limit: Array, direction: Array) -> float:
    """Return the push at the tool under which the first joint gives way.

    Args:
        q: Posture (n,) [rad].
        limit: Torque limits (n,) [N·m].
        direction: Of the push, a unit vector (3,) in base axes.

    Returns:
        The force [N].
    """
    model = arm()
    _, jacobian = model.kinematics(q)
    lever = jacobian[:3].T @ direction
    friction = np.asarray(servos().friction)
    room = limit + friction + np.sign(lever) * model.gravity(q)
    felt = np.abs(lever) > 1e-9
    return float((room[felt] / np.abs(lever[felt])).min())


def die(law: Law, push: str | None = "+y", *, conditions: Conditions = NOMINAL) -> Survived:
    """Silence the bus at 1.9 s, then let a strong hand move the tool by 0.15 m within 7.5 s.

    Args:
        law: Settings of a controller, or a baseline.
        push: Sign and axis of the hand, None for no hand.
        conditions: Loop, bus and assumptions.

    Returns:
        The figures and the run.
    """
    silent = conditions.with_plant(silent=(DEATH, np.inf))
    hands = []
    direction = np.zeros(3)
    if push is not None:
        direction[AXES.index(push[1:])] = -1.0 if push[0] == "-" else 1.0
        course = Course(start=2.0, rise=RISE, end=np.inf)
        hands.append(replace(STRONG, axis=tuple(direction), course=course))
    trace = run(
        silent.build(*hands), silent.controller(law), tool(VERTICAL), 2.0 + RISE, q=VERTICAL
    )
    felt = trace.force @ direction
    worst = int(np.argmax(felt))
    death = trace.at(DEATH)
    limit = trace.limit[death]
    alone = trace.between(DEATH, 2.0 if push is not None else np.inf)
    return Survived(
        force=float(felt[worst]),
        formula=static_force(trace.q[worst], limit, direction) if push is not None else np.inf,
        moved=metrics.largest(trace.moved[alone, :3] - trace.moved[death, :3]),
        trace=trace,
    )
