"""Torque on: every joint is heard first, and takes its weight up within half a second."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant import ServoError, ServoTimeout
from pliant.arm.checks import outside
from pliant.arm.cycle import EASE
from pliant.arm.lowering import SUPPORT, margin

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant.arm.cycle import Cycle

    Array = NDArray[np.float64]

#: Cycles within which every joint must have answered before torque goes on.
ATTEMPTS = 10
#: Time in which goals take up the weight, and in which the limit of a joint that sinks rises from
#: nothing to all that its servo has [s].
CARRIED, RAISED = 0.04, 0.1
#: A joint has sunk that is farther away than this, or two counts, and still moves away [rad].
SUNK = 0.004
#: How fast a joint is drawn back to where it stood, per rad that it is away [1/s], and at most
#: [rad/s].
BACK, RETURN = 4.0, 0.2
#: An arm this near to where it stood has arrived [rad], and is waited for no longer than this [s].
ARRIVED, LONGEST = 0.01, 2.0


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


def stand_within(cycle: Cycle, on: NDArray[np.bool_]) -> None:
    """See that every joint of the chain is where it can be, before torque goes on.

    A joint that is far outside of its limits is not there: its zero is wrong, and so are the
    weights and ways that follow from it.

    Args:
        cycle: The arm, heard.
        on: Which joints of the chain have torque already (n,).

    Raises:
        ServoError: Joints are believed to be outside; names each, and what to do.
    """
    found = [
        f"{name} stands at {q:.2f} rad, outside its {low:.2f} to {high:.2f}"
        for name, q, low, high in outside(cycle.model, cycle.q)
    ]
    if found:
        raise ServoError(
            f"{'; '.join(found)}: torque stays as it is. Either its zero, sign, gear or "
            "calibration is wrong: `pliant doctor ARM --watch` shows the angles while a hand moves "
            "the joints; or it was pushed there: move it by hand into its range"
            + (" (joints have torque: support the arm, switch its supply off)" if on.any() else "")
        )


def take_up(cycle: Cycle, start: Array, stood: Array, rate: float) -> None:
    """Goals go from `start` to where they carry the weight of an arm that stands where it stood.

    Limits begin with what carries the arm that the model knows. A joint that sinks all the same
    gets more at once, up to all that its servo has, and the next limits begin with that. A goal
    does not lead by more than its limit can use, and what it gives up it takes back slowly: an arm
    with a load that nobody told it of is brought back to where it stood, and not thrown.

    Args:
        cycle: The arm, torque on.
        start: First goals (n,) [rad].
        stood: Where it stood before torque came on (n,) [rad].
        rate: Of this loop [Hz].
    """
    servos, clock = cycle.servos, cycle.clock
    kp, usable = np.asarray(servos.kp), np.asarray(servos.torque)
    least = 2.0 * np.asarray(servos.friction)
    still = np.maximum(SUNK, 2.0 * np.asarray(servos.count))
    place, lead, before = stood.copy(), start - stood, stood
    pull, more = np.zeros(stood.size), np.zeros(stood.size)
    begin, passed = clock.now(), 0.0
    while passed < EASE or (passed < LONGEST and np.abs(stood - cycle.q).max() > ARRIVED):
        clock.wait_until(clock.now() + 1.0 / rate)
        cycle.sample()
        passed = clock.now() - begin
        gravity, q = cycle.gravity(), cycle.q
        away = q - stood
        sinking = (np.abs(away) > still) & (away * (q - before) > 0.0)
        more += np.where(sinking, usable / (RAISED * rate), 0.0)
        rise = min(2.0 * passed / EASE, 1.0) * margin(servos, gravity)
        firm = np.minimum(SUPPORT * np.abs(gravity) + np.maximum(rise, least), usable)
        limit = np.minimum(firm + more, usable)
        carried = lead + min(passed / CARRIED, 1.0) * (gravity / kp - lead)
        place = q + np.clip(place + carried - q, -firm / kp, firm / kp) - carried
        pull += np.clip(BACK * (stood - q), -RETURN, RETURN) / rate
        pull = np.clip(pull, -more / kp, more / kp)
        cycle.send(place + carried + pull, limit)
        before = q
    cycle.ease(limit)
