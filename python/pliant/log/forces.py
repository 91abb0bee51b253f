"""Estimation of the forces on the tool in a logged run.

The log contains no forces, but all inputs of the controller: a new controller and a
`ContactEstimator` run on the same inputs and yield the forces.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant import feasibility
from pliant._core import Axis, ConfigError, ContactEstimator, Controller
from pliant._validation import AXES
from pliant.log.verify import steps
from pliant.loop import PRIME

if TYPE_CHECKING:
    from pliant._typing import Array
    from pliant.log.reader import Log


#: Rotation that counts as much as a translation of one metre when deviations of different axes are
#: compared [rad/m].
RADIANS_PER_METRE = 4.0


@dataclass(frozen=True)
class ForceEstimates:
    """Estimated forces in the N ticks of a log, along k task axes.

    Attributes:
        force: External force on the tool (N, k) [N, N·m].
        bound: Uncertainty of the force (N, k) [N, N·m]; infinite if it cannot be estimated.
        worst: Index of the tick with the largest deviation of any axis.
        report: Forces that the arm could exert at the tick `worst` (`Controller.report`).
        strengths: Settings of each axis at the tick of the axis' largest deviation, by axis name.
    """

    force: Array
    bound: Array
    worst: int
    report: feasibility.PoseReport
    strengths: dict[str, Axis]


def estimate_forces(log: Log) -> ForceEstimates | None:
    """Estimate the forces in a log by running its controller again with a `ContactEstimator`.

    Returns:
        The forces; None if the log does not have exactly one step of the controller per tick.

    Raises:
        ConfigError: The log has no controller or no ticks, or is of another version of pliant.
    """
    axes, ticks = log.run["axes"], len(log)
    if not axes or not ticks:
        raise ConfigError("the log has no ticks of a controller, so no forces can be estimated")
    deviation = np.abs(log.deviation)
    farthest = deviation.argmax(axis=0)
    weight = [1.0 if name in "xyz" else 1.0 / RADIANS_PER_METRE for name in axes]
    worst = int((deviation * weight).max(axis=1).argmax())
    priming_steps = _priming_steps(log)
    force = np.zeros((ticks, len(axes)))
    bound = np.full_like(force, np.inf)
    strengths: dict[str, Axis] = {}
    report: feasibility.PoseReport | None = None
    contact: ContactEstimator | None = None
    tick = 0

    def before(call: Any, controller: Controller) -> None:
        nonlocal contact
        if contact is None:
            contact = ContactEstimator(controller)
        elif call.sequence in priming_steps:
            contact.reset()
        if call.sequence not in priming_steps and tick < ticks:
            estimate = contact.update(np.array(call.q), dt=None if np.isnan(call.dt) else call.dt)
            rows = [AXES.index(name) for name in axes]
            force[tick], bound[tick] = estimate.force[rows], estimate.uncertainty[rows]

    for call, controller, _ in steps(log, before=before):
        if call.sequence in priming_steps or tick >= ticks:
            tick += call.sequence not in priming_steps
            continue
        if tick in farthest:
            names = [name for name, peak in zip(axes, farthest, strict=True) if peak == tick]
            strengths.update((n, axis) for n, axis in controller.axes.items() if n in names)
        if tick == worst:
            report = controller.report()
        tick += 1
    if report is None or tick != ticks:
        return None
    return ForceEstimates(force, bound, worst, report, strengths)


def _priming_steps(log: Log) -> set[int]:
    """Return the sequence numbers of controller steps that belong to no tick of the loop.

    After a reset, a loop makes one or more long steps, whose commands are not sent, until the goals
    have the lead that holds the arm. They have `dt = PRIME` and a zero gradient, which tells them
    from the first tick of a loop with this period.
    """
    out: set[int] = set()
    follows_reset = False
    for call in log.calls:
        is_priming = call.what == "step" and call.dt == PRIME and len(call.gradient) > 0
        is_priming = is_priming and not np.any(call.gradient)
        follows_reset = call.what == "reset" or (follows_reset and is_priming)
        if follows_reset and is_priming:
            out.add(call.sequence)
    return out
