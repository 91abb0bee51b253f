"""The last orders of an arm: no controller, no target, and a bus that may be sick."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import numpy as np

from pliant import ServoError
from pliant.arm.lowering import SUPPORT, Lowering, margin

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pliant.arm.cycle import Cycle
    from pliant.arm.points import Points

    Array = NDArray[np.float64]

#: How many times stiffer and softer than believed servos may be for a lead to be kept.
STIFFER, SOFTER = 2.5, 2.0
#: A bus that has carried nothing at all for so long is given up [s].
GONE = 2.0
#: Largest number of restarts of a descent whose goals were refused.
ANEW = 2


def descend(
    cycle: Cycle,
    points: Points,
    rest: Array | None,
    rate: float,
    unwanted: Callable[[], bool],
    *,
    on_tick: Callable[[Lowering], None] | None = None,
) -> bool:
    """Lower the arm until its limits have fallen to nothing; torque can go off then.

    Joints beside the chain keep their orders until everything rests. Errors of the bus do not end
    the descent; a bus that is gone for 2 s does: the servos then keep their last goal and limit.

    Args:
        cycle: The arm.
        points: Its points.
        rest: Where to go first (n,) [rad]; None: straight down.
        rate: Of this loop [Hz].
        unwanted: Whether to end it here and now, with torque as it is.
        on_tick: Called once per turn.

    Returns:
        Whether the limits have fallen to nothing.

    Raises:
        ServoError: The bus is gone, or servos refuse goals; torque stays on.
    """
    clock, model = cycle.clock, cycle.model
    # A servo that stops by itself when the bus is silent would refuse the way down.
    with contextlib.suppress(ServoError):
        cycle.guard(0.0)
    refused = 0
    lowering = Lowering(
        model,
        cycle.servos,
        cycle.q,
        goal=cycle.goal,
        limit=cycle.limit,
        rest=rest,
        points=points,
    )
    before = deadline = heard = clock.now()
    while not unwanted():
        now = clock.now()
        ok = np.zeros(model.n, dtype=bool)
        try:
            ok = cycle.sample()
            heard = now
        except ServoError as error:
            if now - heard > GONE:
                raise ServoError(
                    "the bus is gone while the arm was being lowered: servos that have power keep "
                    "their last goal and limit; support the arm before you cut the supply"
                ) from error
        order = lowering.step(cycle.q, now - before, ok, cycle.delay(now))
        if order is None and not cycle.is_refused():
            return True
        if order is None:
            refused += 1
            if refused > ANEW:
                raise ServoError(
                    "servos do not take the goals that lower the arm, and torque stays on: support "
                    "the arm, then cut the supply"
                )
            lowering = Lowering(model, cycle.servos, cycle.q, rest=rest, points=points)
            continue
        if on_tick is not None:
            on_tick(lowering)
        with contextlib.suppress(ServoError):
            cycle.send(*order, lowering.velocity)
        before, deadline = now, max(deadline + 1.0 / rate, now)
        clock.wait_until(deadline)
    return False


def settle(cycle: Cycle) -> None:
    """Goals and limits that carry the arm where it is, for ever, and no watchdog."""
    kp, gravity = np.asarray(cycle.servos.kp), cycle.gravity()
    push, need = margin(cycle.servos, gravity), gravity / kp
    # Servos stiffer or softer than believed carry the weight by less or more lead than it needs.
    ends = np.sort((need / STIFFER, need * SOFTER), axis=0)
    lead = np.clip(cycle.goal - cycle.q, ends[0] - push / kp, ends[1] + push / kp)
    limit = SUPPORT * np.abs(gravity) + push
    # A servo that carries the weight at its limit would be let loose by a higher one.
    full = (kp * np.abs(lead) > cycle.limit) & (cycle.limit >= np.abs(gravity))
    held = np.where(full, np.minimum(cycle.limit, limit), limit)
    cycle.send(cycle.q + lead, held)
    cycle.guard(0.0)
