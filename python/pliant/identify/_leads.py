"""Leads (goal minus position) that hold an arm, from slow oscillations; stiffness by a known mass.

The mean of the leads in upward and downward motion is free of friction. Joint i has the lead λ
before, and λ' after the mass m was hung on the tool:

    k_p λ = g + y M,        k_p λ' = g' + y' (M + m)

with the gravity torque g of the model and the torque y per mass at the tool, both at the measured
positions. The unknowns are k_p of each joint, and the mass M that the model lacks, common to all
joints.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pliant.identify._excitation import Excitation
from pliant.identify._segments import all_segments
from pliant.identify.procedure import Procedure
from pliant.identify.servos import widen_swing

if TYPE_CHECKING:
    from pliant._core import Model, Servos
    from pliant._typing import Array
    from pliant.identify.procedure import Steps

#: Amplitude of the joints [rad].
AMPLITUDE = 0.05
#: Period [s] and number of the oscillations of all joints.
SWINGS = (2.6, 2.75)
#: k_p of a joint is estimated if its change of lead exceeds this many standard deviations [1].
SIGNIFICANCE = 4.0
#: Iterations for k_p and the missing mass M (see above); each reduces the error about tenfold.
ITERATIONS = 8


class Leads(NamedTuple):
    """Leads near a pose; NaN for a joint that did not move steadily.

    Attributes:
        pose: Middle of the planned oscillations (n,) [rad].
        size: Amplitude of the goals (n,) [rad].
        lead, sigma: Lead of each joint and its standard deviation (n,) [rad].
        gravity: Gravity torque of the model (n,) [N·m].
        row: Torque per mass at the tool (n,) [N·m/kg].
    """

    pose: Array
    size: Array
    lead: Array
    sigma: Array
    gravity: Array
    row: Array


def lead_procedure(
    model: Model, servos: Servos, *, period: float, like: Leads | None = None
) -> Procedure[Leads]:
    """Return a procedure that measures the lead, goal − q, of each joint; it takes 7 to 20 s.

    `period` is the control period [s]. `like` is an earlier measurement, whose pose and amplitude
    are used again; None: the present pose, and a new amplitude.
    """
    rig = Excitation(model, servos, period)
    return Procedure(lambda q: _measure(rig, q, like), model.n)


def _measure(rig: Excitation, q: Array, like: Leads | None) -> Steps[Leads]:
    if like is None:
        start = q
        size, q = yield from widen_swing(rig, q, AMPLITUDE)
        pose = rig.fit_within_limits(start, size)
    else:
        pose, size = like.pose, like.size
    rig.start_record()
    q = yield from rig.travel(q, pose)
    rig.records.clear()
    swing = rig.start_record()
    q = yield from rig.sweep(q, pose, size, *SWINGS)
    rig.start_record()
    yield from rig.travel(q, pose)
    rig.records[:] = [swing]
    means, sigma = np.full((3, rig.n), np.nan), np.full(rig.n, np.nan)
    rows = [(s.joint, s.direction, s.drive, s.gravity, s.payload[0]) for s in all_segments(rig)]
    table = np.array(rows).reshape(-1, 5)
    for i in range(rig.n):
        joint_rows = table[table[:, 0] == i]
        up, down = (joint_rows[sign * joint_rows[:, 1] > 0.0, 2:] for sign in (1.0, -1.0))
        if min(len(up), len(down)) >= 2:
            means[:, i] = 0.5 * (up.mean(axis=0) + down.mean(axis=0))
            noise = sum(side[:, 0].var(ddof=1) / len(side) for side in (up, down))
            sigma[i] = 0.5 * np.sqrt(noise + rig.count[i] ** 2 / 12.0)
    lead, gravity, row = means
    return Leads(pose, size, lead, sigma, gravity, row)


def solve_weight(before: Leads, after: Leads, mass: float) -> tuple[Array, Array, float]:
    """Return k_p, its standard deviation (n,) [N·m/rad], and the mass M [kg] that the model lacks.

    `mass` [kg] was hung on the tool between the two measurements. k_p is NaN for joints whose lead
    it does not change significantly; M is NaN if that is true of all joints.
    """
    change, sigma = after.lead - before.lead, np.hypot(before.sigma, after.sigma)
    change = np.where(np.abs(change) > SIGNIFICANCE * sigma, change, np.nan)
    is_significant, extra = np.isfinite(change), 0.0
    for _ in range(ITERATIONS):
        torque = after.gravity - before.gravity + (after.row - before.row) * extra
        kp = (torque + after.row * mass) / change
        excess = (kp * before.lead - before.gravity)[is_significant]
        weight = 1.0 / (kp * sigma)[is_significant] ** 2
        row = before.row[is_significant]
        extra = float((weight * row) @ excess / ((weight * row) @ row)) if row.size else np.nan
    return kp, np.abs(kp * sigma / change), extra
