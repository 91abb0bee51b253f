"""Torque on: wait for all joints, then transfer the weight to servos of unknown stiffness."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import SUPPORT, ServoError, ServoTimeoutError, torque_margin
from pliant.arm._checks import outside
from pliant.arm._io import EASE

if TYPE_CHECKING:
    from pliant._typing import Array, Mask
    from pliant.arm._io import ArmIO


#: Number of cycles within which every joint must answer before torque on.
ATTEMPTS = 10
#: Largest lead of the first goal of a powered joint whose present orders are unknown [rad].
LEAD = 0.1
#: Ratio of the first lead to the lead that the weight needs at the assumed stiffness; 2 is enough
#: for a servo of half that stiffness.
AHEAD = 2.0
#: Times of the transfer [s]: leads reach `AHEAD` at `RISE`, stay there until `STAY`, and then
#: shrink to zero within `SHRINK`.
RISE, STAY, SHRINK = 0.04, 0.2, 1.2
#: Delay until the sinking of a joint is detected [s].
DETECTION_DELAY = 0.1
#: Time in which the limit of a sinking joint rises from zero to the servo's maximum [s].
RAISED = 0.1
#: Time of the same rise for a joint that stays below its first position [s].
HELD = 1.0
#: Downward displacement [rad] at which a joint starts to sink (`SINKS`, at least two counts) and
#: at which it gets more torque if it sinks on (`SUNK`, at least three counts).
SINKS, SUNK = 0.002, 0.005
#: A joint returns to its first position at `BACK` times the displacement ([1/s]), at most at
#: `RETURN` [rad/s].
BACK, RETURN = 8.0, 0.1
#: `RETURNED`: displacement below which a joint has returned, at least 0.6 of a count [rad].
#: `LONGEST`: time after which the transfer no longer waits for joints to return [s].
RETURNED, LONGEST = 1.5e-4, 3.0
#: Longest silence of a joint during torque on [s].
MAX_SILENCE = 0.5
#: Ratio of measured to assumed stiffness, or its inverse, from which on there is a warning.
MISMATCH = 1.5


def wait_for_all(io: ArmIO, rate: float) -> None:
    """Read at `rate` [Hz] until every joint has answered once.

    Raises:
        ServoTimeoutError: Joints do not answer; the message names them.
    """
    positions, joints = io.positions, io.joints
    positions.reset()
    for _ in range(ATTEMPTS):
        io.sample()
        silent = [joints.names[i] for i in np.flatnonzero(np.isnan(positions.position))]
        if not silent:
            return
        io.clock.wait_until(io.clock.now() + 1.0 / rate)
    raise ServoTimeoutError(
        f"no answer from {', '.join(silent)}: torque stays off; check their power, cable and id"
    )


def check_within_limits(io: ArmIO, on: Mask) -> None:
    """Check before torque on that every joint of the chain reads within its limits.

    A reading far outside the limits means a wrong zero, so gravity torques and paths would be wrong
    too.

    Raises:
        ServoError: Joints read outside their limits; the message names each, with the remedy.
    """
    found = [
        f"{name} stands at {q:.2f} rad, outside its {low:.2f} to {high:.2f}"
        for name, q, low, high in outside(io.model, io.q)
    ]
    if found:
        raise ServoError(
            f"{'; '.join(found)}: torque stays as it is. Either its zero, sign, gear or "
            "calibration is wrong: `pliant servos doctor ARM --watch` shows the angles while a "
            "hand moves the joints; or it was pushed there: move it by hand into its range"
            + (" (joints have torque: support the arm, switch its supply off)" if on.any() else "")
        )


def initial_commands(io: ArmIO, on: Mask) -> tuple[Array, Array, Mask]:
    """Return first goals (n,) [rad], first limits (n,) [N·m], and a mask (n,) of joints taken over.

    Joints without torque start at their present positions. Joints with torque keep the goals and
    limits stored in their servos, which hold them. If these are unknown, the limit is the weight.
    `on` (n,) marks joints whose torque is on already.
    """
    servos, q, weight = io.servos, io.q, io.gravity()
    kp, usable = np.asarray(servos.kp), np.asarray(servos.max_torque)
    friction = np.asarray(servos.friction)
    trusted = SUPPORT * np.abs(weight) + 2.0 * friction
    limit = trusted if servos.stiffness_known else np.abs(weight) + 0.5 * friction
    limit = np.minimum(limit, usable)
    factor = 1.0 if servos.stiffness_known else AHEAD
    goal = q + np.where(on, np.clip(factor * weight / kp, -LEAD, LEAD), 0.0)
    goals, limits = io.stored_commands()
    taken = on & np.isfinite(goals) & np.isfinite(limits)
    limit = np.where(taken, np.minimum(limits, usable), limit)
    max_lead = AHEAD * limit / kp
    goal = np.where(taken, q + np.clip(goals - q, -max_lead, max_lead), goal)
    return goal, limit, taken


def transfer_weight(io: ArmIO, start_q: Array, taken: Mask, rate: float) -> Array:
    """Transfer the weight of a standing arm to its servos, and measure the leads that carry it.

    A servo with a goal far ahead exerts its limit, whatever its stiffness. So goals first lead by
    twice what the assumed stiffness needs, with limits equal to the weight: joints neither rise nor
    sink. Then the leads shrink until a joint begins to sink. That lead carries the joint, and its
    limit may rise. A joint that rests on an object transfers its weight back to the object. A joint
    that sinks earlier carries a load that the model does not include: its limit rises at once, up
    to the servo's maximum, and the joint is moved back slowly.

    Args:
        io: The arm, torque on.
        start_q: Joint positions before torque on (n,) [rad].
        taken: Mask of joints that the present goals and limits carry already (n,).
        rate: Rate of this loop [Hz].

    Returns:
        Leads that carry the joints (n,) [rad]; NaN for joints that rest on an object.

    Raises:
        ServoTimeoutError: A joint was silent for 0.5 s; goals and limits stayed unchanged
            meanwhile.
    """
    servos, clock = io.servos, io.clock
    kp, usable = np.asarray(servos.kp), np.asarray(servos.max_torque)
    friction = np.asarray(servos.friction)
    count = np.asarray(servos.encoder_step)
    still, far = np.maximum(SINKS, 2.0 * count), np.maximum(SUNK, 3.0 * count)
    returned = np.maximum(RETURNED, 0.6 * count)
    weight = io.gravity()
    down = -np.sign(weight)
    trusted = servos.stiffness_known
    full = (1.0 if trusted else AHEAD) * weight / kp
    lead, first = io.goal - start_q, io.limit
    led, limit = lead, first
    more, pull = np.zeros(start_q.size), np.zeros(start_q.size)
    before, level = start_q, start_q
    found = np.where(taken, lead, np.nan)
    begin = heard = clock.now()
    while True:
        now = clock.now()
        clock.wait_until(now + 1.0 / rate)
        ok = io.sample()
        if not ok.all():
            # Without positions, sinking and rising cannot be told apart: keep goals and limits.
            if clock.now() - heard > MAX_SILENCE:
                raise ServoTimeoutError(
                    f"no position of {_joint_names(io, ~ok)} for {MAX_SILENCE:g} s while torque "
                    "came on: check their power, cable and id"
                )
            io.send(io.goal, io.limit)
            begin += clock.now() - now
            continue
        heard = clock.now()
        passed, q = heard - begin, io.q
        if passed < STAY:
            rise = min(passed / RISE, 1.0) * (full - lead)
            lead = lead + np.where(taken, 0.0, rise)
            level = q
        elif trusted:
            found = np.where(np.isnan(found), lead, found)
        away = (q - start_q) * down
        moves = (q - before) * down
        # A joint that goes on sinking lacks torque; one that rises has more than it needs.
        change = usable / (RAISED * rate)
        more += np.where((away > far) & (moves > 0.0), change, 0.0)
        fast = moves < -np.maximum(RETURN / rate, 0.5 * count)
        # A joint that stays below its first position with its servo at the limit gets more, slowly.
        stays = np.isfinite(found) & (away > returned) & (kp * np.abs(led) > 0.9 * limit)
        more += np.where(stays & (moves >= 0.0), change * RAISED / HELD, 0.0)
        more = np.maximum(more - np.where(fast, change, 0.0), 0.0)
        shrinking = np.isnan(found) & (passed >= STAY)
        held = shrinking & ((q - level) * down > still) & (moves >= 0.0)
        step = (np.abs(full) + more / kp) / SHRINK
        # Compensate the detection delay: the joint began to sink earlier.
        lead = np.where(held, lead + np.sign(lead) * DETECTION_DELAY * step, lead)
        found = np.where(held, lead, found)
        left = np.maximum(np.abs(lead) - step / rate, 0.0)
        lead = np.where(shrinking & ~held, np.sign(lead) * left, lead)
        # A joint that sank earlier is held by the stiffness of its servo.
        found = np.where(shrinking & (lead == 0.0) & (away > 0.5 * still), 0.0, found)
        known = np.isfinite(found) | (lead == 0.0)
        spare = np.where(known | trusted, torque_margin(servos, weight), 0.5 * friction)
        firm = np.abs(weight) + spare
        firm = np.where(
            taken, first + min(passed / STAY, 1.0) * np.maximum(firm - first, 0.0), firm
        )
        limit = np.minimum(firm + more, usable)
        returning = np.isfinite(found) & (np.abs(away) > returned)
        pull += np.where(returning, np.clip(BACK * (start_q - q), -RETURN, RETURN), 0.0) / rate
        # Anti-windup: bound the lead to what the limit can use.
        max_lead = AHEAD * limit / kp
        pull = np.clip(lead + pull, q - start_q - max_lead, q - start_q + max_lead) - lead
        led = start_q + lead + pull - q
        io.send(start_q + lead + pull, limit)
        before = q
        arrived = not returning.any() or passed > LONGEST
        if passed >= EASE and bool(known.all()) and arrived:
            break
    io.ramp_limits(limit)
    return np.where(np.isfinite(found), io.goal - io.q, np.nan)


def _joint_names(io: ArmIO, joints: Mask) -> str:
    return ", ".join(io.model.joint_names[i] for i in np.flatnonzero(joints))


def stiffness_mismatch(io: ArmIO, leads: Array) -> str | None:
    """Return a sentence on joints whose lead differs from that of the servo table, or None.

    Joints with a gravity torque that is small against friction and encoder step are left out.

    Args:
        io: The arm, at rest.
        leads: Leads from `transfer_weight` (n,) [rad].
    """
    servos, weight = io.servos, io.gravity()
    expected = weight / np.asarray(servos.kp)
    clear = (np.abs(weight) > 3.0 * np.asarray(servos.friction)) & (
        np.abs(leads) > 3.0 * np.asarray(servos.encoder_step)
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = expected / leads
    differs = clear & np.isfinite(ratio) & ((ratio > MISMATCH) | (ratio < 1.0 / MISMATCH))
    if not differs.any():
        return None
    names = io.model.joint_names
    found = [f"{names[i]} {ratio[i]:.2g} x" for i in np.flatnonzero(differs)]
    return (
        f"servos are stiffer or softer than their table, or weights differ from the model: "
        f"{', '.join(found)} the assumed k_p; forces are wrong by as much: "
        "pliant.identify.identify_servos(arm, model) measures k_p, controller.set_payload tells of "
        "a load"
    )
