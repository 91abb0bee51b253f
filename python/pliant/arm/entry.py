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
#: Speed of a joint on the way back to where it stood before it sank [rad/s].
RETURN = 0.2


def hear_all(cycle: Cycle, rate: float) -> None:
    """Read at `rate` [Hz] until every joint has answered once.

    Raises:
        ServoTimeout: Joints do not answer; names them.
    """
    belief, roster = cycle.belief, cycle.roster
    belief.forget()
    for _ in range(ATTEMPTS):
        cycle.sample()
        silent = [roster.names[i] for i in np.flatnonzero(np.isnan(belief.position))]
        if not silent:
            return
        cycle.clock.wait_until(cycle.clock.now() + 1.0 / rate)
    raise ServoTimeout(
        f"no answer from {', '.join(silent)}: torque stays off; check their power, cable and id"
    )


def take_up(cycle: Cycle, start: Array, stood: Array, rate: float) -> None:
    """Goals go from `start` to where they carry the weight of an arm that stands where it stood.

    A goal does not lead by more than its limit can use, and what it gives up it takes back slowly:
    an arm with a load that nobody told it of sinks until the limits have risen, and is not thrown
    back up.

    Args:
        cycle: The arm, torque on.
        start: First goals (n,) [rad].
        stood: Where it stood before torque came on (n,) [rad].
        rate: Of this loop [Hz].
    """
    servos, clock = cycle.servos, cycle.clock
    kp, least = np.asarray(servos.kp), 2.0 * np.asarray(servos.friction)
    place, lead = stood.copy(), start - stood
    begin = clock.now()
    while (passed := clock.now() - begin) < EASE:
        clock.wait_until(clock.now() + 1.0 / rate)
        cycle.sample()
        gravity = cycle.gravity()
        share = min(2.0 * passed / EASE, 1.0)
        limit = SUPPORT * np.abs(gravity) + np.maximum(share * margin(servos, gravity), least)
        carried = lead + share * (gravity / kp - lead)
        place += np.clip(stood - place, -RETURN / rate, RETURN / rate)
        place = cycle.q + np.clip(place + carried - cycle.q, -limit / kp, limit / kp) - carried
        cycle.send(place + carried, limit)
    cycle.ease()
