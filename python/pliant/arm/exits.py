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

#: A bus that has carried nothing at all for so long is given up [s].
GONE = 2.0


def descend(
    cycle: Cycle,
    points: Points,
    rest: Array | None,
    rate: float,
    unwanted: Callable[[], bool],
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

    Returns:
        Whether the limits have fallen to nothing.

    Raises:
        ServoError: The bus is gone.
    """
    clock, model = cycle.clock, cycle.model
    lowering = Lowering(model, cycle.servos, cycle.q, goal=cycle.goal, rest=rest, points=points)
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
        order = lowering.step(cycle.q, now - before, ok)
        if order is None:
            return True
        with contextlib.suppress(ServoError):
            cycle.send(*order, lowering.velocity)
        before, deadline = now, max(deadline + 1.0 / rate, now)
        clock.wait_until(deadline)
    return False


def settle(cycle: Cycle) -> None:
    """Goals and limits that carry the arm where it is, for ever, and no watchdog."""
    kp, gravity = np.asarray(cycle.servos.kp), cycle.gravity()
    push = margin(cycle.servos, gravity)
    need = cycle.q + gravity / kp
    lead = np.clip(cycle.goal - need, -push / kp, push / kp)
    cycle.send(need + lead, SUPPORT * np.abs(gravity) + push)
    cycle.guard(0.0)
