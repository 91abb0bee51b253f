"""The last loop of an arm: it needs no controller, no target, and survives a sick bus."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING

import numpy as np

from pliant import ServoError
from pliant.arm.lowering import Lowering

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant.arm.cycle import Cycle
    from pliant.arm.points import Points

    Array = NDArray[np.float64]

#: A bus that has carried nothing at all for so long is given up [s].
GONE = 2.0


def descend(cycle: Cycle, points: Points, rest: Array | None, rate: float) -> None:
    """Lower the arm until its limits have fallen to nothing; torque can go off then.

    Joints beside the chain keep their orders until everything rests. Errors of the bus do not end
    the descent; a bus that is gone for 2 s does: the servos then keep their last goal and limit.

    Args:
        cycle: The arm.
        points: Its points.
        rest: Where to go first (n,) [rad]; None: straight down.
        rate: Of this loop [Hz].

    Raises:
        ServoError: The bus is gone.
    """
    clock, model = cycle.clock, cycle.model
    lowering = Lowering(model, cycle.servos, cycle.q, goal=cycle.goal, rest=rest, points=points)
    before = deadline = heard = clock.now()
    while True:
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
            return
        with contextlib.suppress(ServoError):
            cycle.send(*order)
        before, deadline = now, max(deadline + 1.0 / rate, now)
        clock.wait_until(deadline)
