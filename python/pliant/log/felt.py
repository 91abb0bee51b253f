"""Estimated forces on the tool in a logged run, and the pose report of its controller.

The log holds all inputs of the controller. A new controller with a `ContactEstimator` gets them
again, so no forces need to be recorded.
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


#: Rotation that weighs as much as a deviation of one metre [rad].
RADIANS_PER_METRE = 4.0


@dataclass(frozen=True)
class Felt:
    """Forces along the task axes (N, k), and the controller's report at the largest deviation.

    Attributes:
        force: Force of the surroundings on the tool, positive toward + [N, N·m].
        bound: Uncertainty of the force; infinite if it cannot be estimated.
        worst: Tick of the largest deviation of any axis.
        report: The controller's report at that tick.
        strengths: Settings of each axis at its largest deviation, by axis name.
    """

    force: Array
    bound: Array
    worst: int
    report: feasibility.PoseReport
    strengths: dict[str, Axis]


def feel(log: Log) -> Felt | None:
    """Run the log's controller again with a `ContactEstimator` beside it.

    Returns:
        None if ticks and steps do not correspond: not exactly one step per tick.

    Raises:
        ConfigError: The log has no controller, or is of another version of pliant.
    """
    axes, ticks = log.run["axes"], len(log)
    if not axes or not ticks:
        raise ConfigError("the log has no ticks of a controller, so no forces can be estimated")
    size = np.abs(log.deviation)
    farthest = size.argmax(axis=0)
    weight = [1.0 if name in "xyz" else 1.0 / RADIANS_PER_METRE for name in axes]
    worst = int((size * weight).max(axis=1).argmax())
    primes = _primes(log)
    force = np.zeros((ticks, len(axes)))
    bound = np.full_like(force, np.inf)
    strengths: dict[str, Axis] = {}
    found: feasibility.PoseReport | None = None
    contact: ContactEstimator | None = None
    tick = 0

    def before(call: Any, controller: Controller) -> None:
        nonlocal contact
        if contact is None:
            contact = ContactEstimator(controller)
        elif call.sequence in primes:
            contact.reset()
        if call.sequence not in primes and tick < ticks:
            estimate = contact.update(np.array(call.q), dt=None if np.isnan(call.dt) else call.dt)
            rows = [AXES.index(name) for name in axes]
            force[tick], bound[tick] = estimate.force[rows], estimate.uncertainty[rows]

    for call, controller, _ in steps(log, before=before):
        if call.sequence in primes or tick >= ticks:
            tick += call.sequence not in primes
            continue
        if tick in farthest:
            here = [name for name, at in zip(axes, farthest, strict=True) if at == tick]
            strengths.update((n, axis) for n, axis in controller.axes.items() if n in here)
        if tick == worst:
            found = controller.report()
        tick += 1
    if found is None or tick != ticks:
        return None
    return Felt(force, bound, worst, found, strengths)


def _primes(log: Log) -> set[int]:
    """Return the steps by which a loop primes a controller; they belong to no tick."""
    pairs = zip(log.calls, log.calls[1:], strict=False)
    return {
        after.sequence
        for call, after in pairs
        if call.what == "reset" and after.what == "step" and after.dt == PRIME
    }
