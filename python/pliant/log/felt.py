"""What pushed at the tool during a logged run, and what its controller says of it.

The log has what the controller was told, so a fresh one is told it again with a `ContactEstimator`
beside
it: no force needs to be recorded.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

import pliant
from pliant.log.verify import steps
from pliant.loop import PRIME

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant.log.reader import Log

    Array = NDArray[np.float64]

#: Deviation of a rotation that weighs as much as one metre [rad].
RADIANS_PER_METRE = 4.0


@dataclass(frozen=True)
class Felt:
    """Forces along the axes of the task (N, k), and the controller where an axis was farthest off.

    Attributes:
        force: Of the surroundings on the tool, toward + positive [N, N·m].
        bound: How far that can be off; infinite where nothing can be told.
        worst: Tick of the largest deviation of any axis.
        report: The controller's own report there.
        strengths: Per axis: what was asked of it when it was farthest off.
    """

    force: Array
    bound: Array
    worst: int
    report: pliant.feasibility.PoseReport
    strengths: dict[str, pliant.Axis]


def feel(log: Log) -> Felt | None:
    """Run the log's controller again with a `ContactEstimator` beside it.

    Returns:
        None where ticks and steps do not pair: more or fewer than one step per tick.

    Raises:
        ConfigError: The log has no controller, or is of another version of pliant.
    """
    axes, ticks = log.run["axes"], len(log)
    if not axes or not ticks:
        raise pliant.ConfigError("the log has no ticks of a controller: nothing to feel")
    size = np.abs(log.deviation)
    farthest = size.argmax(axis=0)
    weight = [1.0 if name in "xyz" else 1.0 / RADIANS_PER_METRE for name in axes]
    worst = int((size * weight).max(axis=1).argmax())
    primes = _primes(log)
    force = np.zeros((ticks, len(axes)))
    bound = np.full_like(force, np.inf)
    strengths: dict[str, pliant.Axis] = {}
    found: pliant.feasibility.PoseReport | None = None
    contact: pliant.ContactEstimator | None = None
    tick = 0

    def before(call: Any, controller: pliant.Controller) -> None:
        nonlocal contact
        if contact is None:
            contact = pliant.ContactEstimator(controller)
        elif call.sequence in primes:
            contact.reset()
        if call.sequence not in primes and tick < ticks:
            estimate = contact.update(np.array(call.q), dt=None if np.isnan(call.dt) else call.dt)
            rows = [pliant.AXES.index(name) for name in axes]
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
    """Steps by which a loop lets a controller take up the weight; no tick goes with them."""
    pairs = zip(log.calls, log.calls[1:], strict=False)
    return {
        after.sequence
        for call, after in pairs
        if call.what == "reset" and after.what == "step" and after.dt == PRIME
    }
