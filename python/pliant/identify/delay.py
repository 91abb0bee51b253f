"""Estimation of the loop delay from the response of joints to steps of their goals.

A joint that has been at rest is simulated alone,

    M q̈ = clip(k_p (goal(t − T_d) − q) − k_v q̇, ±limit) − d q̇ − f sign(q̇) − g,

for a grid of delays T_d and inertias M. The slides have given D = d + k_v + k_p T_d, so T_d
determines k_v. Damping and delay look the same in slow motion; they differ at the onset of a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pliant.identify.regress import Solution
    from pliant.identify.rig import Record, Rig

    Array = NDArray[np.float64]

#: Longest delay tried [s], physics step [s], and compared length of each response [s].
LONGEST, STEP, COMPARED = 0.08, 0.001, 0.06
#: Inertias tried, as k_p times the square of a time [s].
INERTIAS = np.geomspace(0.008, 0.12, 28) ** 2


@dataclass(frozen=True)
class Delay:
    """A measured delay.

    Attributes:
        seconds: Time from the reading to the arrival of the goal, T_d [s].
        sigma: Its standard deviation [s].
        joints: Delay estimated from each joint alone (n,) [s].
    """

    seconds: float
    sigma: float
    joints: NDArray[np.float64]


def delay(rig: Rig, records: Sequence[Record], solution: Solution, held: Array) -> Delay:
    """Fit the delay to the steps of all joints.

    Args:
        rig: Period and encoder count.
        records: One record of steps per joint, in order.
        solution: Stiffness, friction and damping from the slides.
        held: Torque that holds the arm at the pose of the steps (n,) [N·m].
    """
    grid = np.arange(0.0, LONGEST + STEP / 2, STEP)
    misfit = np.array(
        [
            _misfit(rig, record, j, solution, held=float(held[j]), grid=grid)
            for j, record in enumerate(records)
        ]
    )
    floor = misfit.min(axis=1, keepdims=True)
    # Weight each joint by its best fit.
    total = (misfit / floor).sum(axis=0)
    each = grid[np.argmin(misfit, axis=1)]
    best = _vertex(grid, total)
    middle = np.median(np.abs(each - np.median(each)))
    sigma = max(1.5 * middle / np.sqrt(len(each)), STEP)
    return Delay(best, float(sigma), each)


def _vertex(grid: Array, cost: Array) -> float:
    """Return the minimum of a sampled curve, by a parabola through its lowest three samples."""
    k = int(np.argmin(cost))
    if not 0 < k < len(grid) - 1:
        return float(grid[k])
    a, b, c = cost[k - 1 : k + 2]
    bend = a - 2.0 * b + c
    return (
        float(grid[k] + 0.5 * (a - c) / bend * (grid[1] - grid[0])) if bend > 0 else float(grid[k])
    )


def _misfit(
    rig: Rig, record: Record, joint: int, solution: Solution, *, held: float, grid: Array
) -> Array:
    """Return the mean squared misfit of one joint's steps per delay, at its best inertia."""
    q, goal, limit, _ = (rows[:, joint] for rows in record.arrays())
    value = {name: float(array[joint]) for name, array in solution.value.items()}
    late, inertia = (x.ravel() for x in np.meshgrid(grid, INERTIAS * value["kp"], indexing="ij"))
    outer = max(value["outer"], 0.0)
    inner = np.maximum(value["total"] - outer - value["kp"] * late, 0.0)
    dry = max(value["friction"], 0.0)
    jumps = np.flatnonzero(np.abs(np.diff(goal)) > 0.0) + 1
    cost, ticks = np.zeros(late.size), max(round(COMPARED / rig.period), 5)
    per_tick = max(round(rig.period / STEP), 1)
    dt = rig.period / per_tick
    for k in jumps:
        if k + ticks >= len(q):
            continue
        position, speed = np.full(late.size, q[k]), np.zeros(late.size)
        for tick in range(ticks):
            for sub in range(per_tick):
                now = (tick * per_tick + sub) * dt
                target = np.where(now >= late - 1e-9, goal[k], goal[k - 1])
                torque = value["kp"] * (target - position) - inner * speed
                torque = np.clip(torque, -limit[k], limit[k]) - held
                speed = (speed + dt / inertia * torque) / (1.0 + dt / inertia * outer)
                slip = np.maximum(np.abs(speed) - dt / inertia * dry, 0.0)
                speed = np.sign(speed) * slip
                position = position + dt * speed
            cost += (position - q[k + tick + 1]) ** 2
    cost /= max(len(jumps) * ticks, 1)
    cost += (0.3 * max(rig.count[joint], 1e-4)) ** 2
    best: Array = cost.reshape(grid.size, INERTIAS.size).min(axis=1)
    return best
