"""Torque on: every joint is heard first, then takes up its weight, whatever its stiffness is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant import ServoError, ServoTimeoutError
from pliant.arm.checks import outside
from pliant.arm.cycle import EASE
from pliant.arm.lowering import SUPPORT, margin

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant.arm.cycle import Cycle

    Array = NDArray[np.float64]

#: Cycles within which every joint must have answered before torque goes on.
ATTEMPTS = 10
#: Largest lead of a first goal whose joint is carried by orders that are not known [rad].
LEAD = 0.1
#: Lead of the first goals over what the believed stiffness needs: enough for half of it.
AHEAD = 2.0
#: Time in which leads rise to that, for which they stay, and in which they shrink to nothing [s].
RISE, STAY, SHRINK = 0.04, 0.2, 1.2
#: How long before it is seen a joint begins to sink [s].
SEEN = 0.1
#: Time in which the limit of a joint that sinks rises from nothing to all that its servo has [s].
RAISED = 0.1
#: The same where it stays below where it stood [s].
HELD = 1.0
#: A joint begins to sink that is farther down than this, or two counts, and has sunk that is
#: farther than the second, or three counts [rad].
SINKS, SUNK = 0.002, 0.005
#: How fast a joint is drawn back to where it stood, per rad that it is away [1/s], and at most
#: [rad/s].
BACK, RETURN = 8.0, 0.1
#: A joint is back that is this near, or 0.6 of a count [rad]; torque on takes no longer [s].
HOME, LONGEST = 1.5e-4, 3.0
#: Longest silence of a joint while torque comes on [s].
SILENT = 0.5
#: Stiffness over the believed one, or its inverse, from which on the arm says so.
OFF = 1.5


def hear_all(cycle: Cycle, rate: float) -> None:
    """Read at `rate` [Hz] until every joint has answered once.

    Raises:
        ServoTimeoutError: Joints do not answer; names them.
    """
    belief, roster = cycle.belief, cycle.roster
    belief.forget()
    for _ in range(ATTEMPTS):
        cycle.sample()
        silent = [roster.names[i] for i in np.flatnonzero(np.isnan(belief.position))]
        if not silent:
            return
        cycle.clock.wait_until(cycle.clock.now() + 1.0 / rate)
    raise ServoTimeoutError(
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
            "calibration is wrong: `pliant servos doctor ARM --watch` shows the angles while a "
            "hand moves the joints; or it was pushed there: move it by hand into its range"
            + (" (joints have torque: support the arm, switch its supply off)" if on.any() else "")
        )


def first_orders(cycle: Cycle, on: NDArray[np.bool_]) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return goals (n,) [rad] and limits (n,) [N·m] to begin with, and which are taken over (n,).

    Joints without torque begin where they stand. Joints that have torque keep the orders that stand
    in their servos, which carry them; where these are not known, the servo exerts the weight.

    Args:
        cycle: The arm, heard.
        on: Which joints of the chain have torque already (n,).
    """
    servos, q, weight = cycle.servos, cycle.q, cycle.gravity()
    kp, usable = np.asarray(servos.kp), np.asarray(servos.max_torque)
    friction = np.asarray(servos.friction)
    trusted = SUPPORT * np.abs(weight) + 2.0 * friction
    limit = trusted if servos.stiffness_known else np.abs(weight) + 0.5 * friction
    limit = np.minimum(limit, usable)
    ahead = 1.0 if servos.stiffness_known else AHEAD
    goal = q + np.where(on, np.clip(ahead * weight / kp, -LEAD, LEAD), 0.0)
    goals, limits = cycle.standing()
    taken = on & np.isfinite(goals) & np.isfinite(limits)
    limit = np.where(taken, np.minimum(limits, usable), limit)
    most = AHEAD * limit / kp
    goal = np.where(taken, q + np.clip(goals - q, -most, most), goal)
    return goal, limit, taken


def take_up(cycle: Cycle, stood: Array, taken: NDArray[np.bool_], rate: float) -> Array:
    """Let servos carry an arm that stands where it stood, and measure the leads that carry it.

    A servo whose goal is far ahead exerts its limit, whatever its stiffness. So goals first lead by
    twice what the believed stiffness needs while limits are the weight: joints neither rise nor
    sink. Then leads shrink until a joint begins to sink: that lead carries it, and the limit may
    rise. A joint that rests on something gives its weight back to it. A joint that sinks before
    carries a load that the model does not know: it gets more torque at once, up to all that its
    servo has, and is drawn back slowly.

    Args:
        cycle: The arm, torque on.
        stood: Where it stood before torque came on (n,) [rad].
        taken: Which joints are carried already by the orders sent (n,).
        rate: Of this loop [Hz].

    Returns:
        The leads that carry joints (n,) [rad]; NaN for those that rest on something.

    Raises:
        ServoTimeoutError: A joint was silent for 0.5 s; orders stayed as they were meanwhile.
    """
    servos, clock = cycle.servos, cycle.clock
    kp, usable = np.asarray(servos.kp), np.asarray(servos.max_torque)
    friction = np.asarray(servos.friction)
    count = np.asarray(servos.encoder_step)
    still, far = np.maximum(SINKS, 2.0 * count), np.maximum(SUNK, 3.0 * count)
    home = np.maximum(HOME, 0.6 * count)
    weight = cycle.gravity()
    down = -np.sign(weight)
    trusted = servos.stiffness_known
    full = (1.0 if trusted else AHEAD) * weight / kp
    lead, first = cycle.goal - stood, cycle.limit
    led, limit = lead, first
    more, pull = np.zeros(stood.size), np.zeros(stood.size)
    before, level = stood, stood
    found = np.where(taken, lead, np.nan)
    begin = heard = clock.now()
    while True:
        now = clock.now()
        clock.wait_until(now + 1.0 / rate)
        ok = cycle.sample()
        if not ok.all():
            # Without positions, sinking and rising cannot be told apart: keep goals and limits.
            if clock.now() - heard > SILENT:
                raise ServoTimeoutError(
                    f"no position of {_named(cycle, ~ok)} for {SILENT:g} s while torque came "
                    "on: check their power, cable and id"
                )
            cycle.send(cycle.goal, cycle.limit)
            begin += clock.now() - now
            continue
        heard = clock.now()
        passed, q = heard - begin, cycle.q
        if passed < STAY:
            rise = min(passed / RISE, 1.0) * (full - lead)
            lead = lead + np.where(taken, 0.0, rise)
            level = q
        elif trusted:
            found = np.where(np.isnan(found), lead, found)
        away = (q - stood) * down
        moves = (q - before) * down
        # A joint that goes on sinking lacks torque; one that rises has more than it needs.
        change = usable / (RAISED * rate)
        more += np.where((away > far) & (moves > 0.0), change, 0.0)
        fast = moves < -np.maximum(RETURN / rate, 0.5 * count)
        # One that stays below with its servo at its limit gets more, slowly.
        stays = np.isfinite(found) & (away > home) & (kp * np.abs(led) > 0.9 * limit)
        more += np.where(stays & (moves >= 0.0), change * RAISED / HELD, 0.0)
        more = np.maximum(more - np.where(fast, change, 0.0), 0.0)
        shrinking = np.isnan(found) & (passed >= STAY)
        held = shrinking & ((q - level) * down > still) & (moves >= 0.0)
        step = (np.abs(full) + more / kp) / SHRINK
        # It began to sink a moment before it was seen to.
        lead = np.where(held, lead + np.sign(lead) * SEEN * step, lead)
        found = np.where(held, lead, found)
        left = np.maximum(np.abs(lead) - step / rate, 0.0)
        lead = np.where(shrinking & ~held, np.sign(lead) * left, lead)
        # One that had sunk before hangs in its servo's spring.
        found = np.where(shrinking & (lead == 0.0) & (away > 0.5 * still), 0.0, found)
        known = np.isfinite(found) | (lead == 0.0)
        spare = np.where(known | trusted, margin(servos, weight), 0.5 * friction)
        firm = np.abs(weight) + spare
        firm = np.where(
            taken, first + min(passed / STAY, 1.0) * np.maximum(firm - first, 0.0), firm
        )
        limit = np.minimum(firm + more, usable)
        drawn = np.isfinite(found) & (np.abs(away) > home)
        pull += np.where(drawn, np.clip(BACK * (stood - q), -RETURN, RETURN), 0.0) / rate
        # Beyond what its limit can use a lead would only be wound up.
        most = AHEAD * limit / kp
        pull = np.clip(lead + pull, q - stood - most, q - stood + most) - lead
        led = stood + lead + pull - q
        cycle.send(stood + lead + pull, limit)
        before = q
        arrived = not drawn.any() or passed > LONGEST
        if passed >= EASE and bool(known.all()) and arrived:
            break
    cycle.ease(limit)
    return np.where(np.isfinite(found), cycle.goal - cycle.q, np.nan)


def _named(cycle: Cycle, joints: NDArray[np.bool_]) -> str:
    return ", ".join(cycle.model.joint_names[i] for i in np.flatnonzero(joints))


def strange_leads(cycle: Cycle, leads: Array) -> str | None:
    """Return a sentence on joints that another lead carries than the servo table says, or None.

    Joints whose weight is too small beside their friction and encoder step are left out.

    Args:
        cycle: The arm, standing.
        leads: What `take_up` found (n,) [rad].
    """
    servos, weight = cycle.servos, cycle.gravity()
    believed = weight / np.asarray(servos.kp)
    clear = (np.abs(weight) > 3.0 * np.asarray(servos.friction)) & (
        np.abs(leads) > 3.0 * np.asarray(servos.encoder_step)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = believed / leads
    strange = clear & np.isfinite(ratio) & ((ratio > OFF) | (ratio < 1.0 / OFF))
    if not strange.any():
        return None
    names = cycle.model.joint_names
    found = [f"{names[i]} {ratio[i]:.2g} x" for i in np.flatnonzero(strange)]
    return (
        f"servos are stiffer or softer than their table, or weights differ from the model: "
        f"{', '.join(found)} the believed k_p; forces are wrong by as much: "
        "pliant.identify.identify_servos(arm, model) measures k_p, controller.set_payload tells of "
        "a load"
    )
