"""Exits of an arm: the descent, and holding the present pose, without a controller."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ServoError
from pliant.arm.lowering import SUPPORT, Lowering, margin

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from pliant.arm.cycle import Cycle
    from pliant.arm.points import Points

    Array = NDArray[np.float64]

#: Factors by which servos may be stiffer or softer than assumed for a lead to be kept.
STIFFER, SOFTER = 2.5, 2.0
#: Silence of the bus after which a descent is given up [s].
GONE = 2.0
#: Largest number of restarts of a descent after refused goals.
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
    """Lower the arm until its limits are zero, so that torque can be switched off.

    Joints off the chain keep their orders until everything rests. Single bus errors do not end the
    descent. A bus that fails for 2 s does; the servos then keep their last goal and limit.

    Args:
        cycle: The arm.
        points: The arm's points.
        rest: Rest pose to move to first (n,) [rad]; None: straight down.
        rate: Rate of this loop [Hz].
        unwanted: Returns True to abort the descent, with torque as it is.
        on_tick: Called once per tick.

    Returns:
        True if the limits are zero; False if the descent was aborted.

    Raises:
        ServoError: The bus is gone, or servos refuse goals; torque stays on.
    """
    clock, model = cycle.clock, cycle.model
    # Disable the watchdog: a servo that it stopped would refuse the goals of the descent.
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
    """Send goals and limits that hold the present pose, and disable the watchdog."""
    kp, gravity = np.asarray(cycle.servos.kp), cycle.gravity()
    push, need = margin(cycle.servos, gravity), gravity / kp
    # Servos stiffer or softer than assumed need a smaller or larger lead for the weight.
    ends = np.sort((need / STIFFER, need * SOFTER), axis=0)
    lead = np.clip(cycle.goal - cycle.q, ends[0] - push / kp, ends[1] + push / kp)
    limit = SUPPORT * np.abs(gravity) + push
    # A servo that carries the weight at its limit would move if the limit rose.
    full = (kp * np.abs(lead) > cycle.limit) & (cycle.limit >= np.abs(gravity))
    held = np.where(full, np.minimum(cycle.limit, limit), limit)
    cycle.send(cycle.q + lead, held)
    cycle.guard(0.0)
