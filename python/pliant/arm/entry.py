"""Torque on: every joint is heard first, and takes its weight up within half a second."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant import ServoTimeout
from pliant.arm.cycle import EASE
from pliant.arm.lowering import SUPPORT, margin

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant.arm.cycle import Cycle

    Array = NDArray[np.float64]

#: Cycles within which every joint must have answered before torque goes on.
ATTEMPTS = 10


def hear_all(cycle: Cycle, rate: float) -> None:
    """Read at `rate` [Hz] until every joint has answered once.

    Raises:
        ServoTimeout: Joints do not answer; names them.
    """
    watch, roster = cycle.watch, cycle.roster
    watch.forget()
    for _ in range(ATTEMPTS):
        cycle.sample()
        silent = [roster.names[i] for i in np.flatnonzero(np.isnan(watch.position))]
        if not silent:
            return
        cycle.clock.wait_until(cycle.clock.now() + 1.0 / rate)
    raise ServoTimeout(
        f"no answer from {', '.join(silent)}: torque stays off; check their power, cable and id"
    )


def take_up(cycle: Cycle, start: Array, rate: float) -> None:
    """Goals go from `start` (n,) [rad] to where they carry the weight; limits rise; at `rate`."""
    servos, clock = cycle.servos, cycle.clock
    full = cycle.q + cycle.gravity() / np.asarray(servos.kp)
    begin = clock.now()
    while (passed := clock.now() - begin) < EASE:
        clock.wait_until(clock.now() + 1.0 / rate)
        cycle.sample()
        gravity = cycle.gravity()
        share = min(2.0 * passed / EASE, 1.0)
        limit = SUPPORT * np.abs(gravity) + share * margin(servos, gravity)
        cycle.send(start + share * (full - start), limit)
    cycle.ease()
