"""Start of an arm: wait for all joints, then transfer the arm's weight to the servos.

The lead of a joint is goal minus position [rad]; a servo turns it into torque.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import SUPPORT, ServoError, ServoTimeoutError, torque_margin
from pliant.arm._checks import outside
from pliant.arm._io import RAMP_TIME

if TYPE_CHECKING:
    from pliant._typing import Array, Mask
    from pliant.arm._io import ArmIO


#: Number of read cycles within which every joint must answer before torque is switched on.
ATTEMPTS = 10
#: Largest first lead (goal minus position) of a joint with torque on whose goal register is unknown
#: [rad].
MAX_FIRST_LEAD = 0.1
#: Ratio of the first lead (goal minus position) of a joint to the lead that carries its weight at
#: the assumed stiffness; 2 suffices for a servo of half that stiffness.
LEAD_FACTOR = 2.0
#: Times of the weight transfer [s]: the leads (goal minus position) rise until `RISE`, stay
#: constant until `STAY`, and then shrink to zero within `SHRINK`.
RISE, STAY, SHRINK = 0.04, 0.2, 1.2
#: Delay until the sinking of a joint is detected [s].
DETECTION_DELAY = 0.1
#: Time in which the torque limit of a sinking joint rises from zero to the servo's maximum [s].
LIMIT_RISE = 0.1
#: Time of this rise for a joint that does not sink but stays below its first position [s].
SLOW_LIMIT_RISE = 1.0
#: Downward displacement from which on a joint counts as sinking [rad] (at least two counts), and
#: from which on a joint that still sinks gets more torque [rad] (at least three counts).
SINK_START, SINK_LARGE = 0.002, 0.005
#: Gain [1/s] and largest speed [rad/s] of the return of a joint to its first position.
RETURN_GAIN, RETURN_SPEED = 8.0, 0.1
#: Time constant of the mean position that is drawn back [s]: drawing back an arm that swings on its
#: servos would swing it further.
MEAN_TIME = 0.3
#: Displacement below which a joint has returned [rad] (at least 0.6 counts), and time after which
#: the transfer does not wait for joints to return [s].
RETURNED, MAX_TIME = 1.5e-4, 3.0
#: Time without a position of a joint after which the weight transfer ends with an error [s].
MAX_SILENCE = 0.5
#: Ratio of measured to assumed servo stiffness, or inverse ratio, above which the user is warned.
MISMATCH = 1.5


def wait_for_all(io: ArmIO, rate: float) -> None:
    """Read all joints at `rate` [Hz] until every joint has answered once.

    Raises:
        ServoTimeoutError: Joints have not answered in `ATTEMPTS` cycles; the message names them.
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
    """Check before torque is switched on that every joint of the chain is within its limits.

    A position far outside the position limits means that the zero of the joint is wrong, and that
    gravity torques and paths would be wrong too. `on` is the mask (n,) of joints with torque on.

    Raises:
        ServoError: Joints are outside their limits; the message names each, with the remedy.
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

    Joints without torque get their present positions as goals. Joints with torque are taken over:
    they keep the goals and limits in their registers. Joints with unknown registers get a limit of
    about the gravity torque.

    Args:
        io: Read and write access to the arm.
        on: Mask (n,) of joints whose torque is on already.
    """
    servos, q, weight = io.servos, io.q, io.gravity()
    kp, usable = np.asarray(servos.kp), np.asarray(servos.max_torque)
    friction = np.asarray(servos.friction)
    trusted = SUPPORT * np.abs(weight) + 2.0 * friction
    limit = trusted if servos.stiffness_known else np.abs(weight) + 0.5 * friction
    limit = np.minimum(limit, usable)
    factor = 1.0 if servos.stiffness_known else LEAD_FACTOR
    goal = q + np.where(on, np.clip(factor * weight / kp, -MAX_FIRST_LEAD, MAX_FIRST_LEAD), 0.0)
    goals, limits = io.stored_commands()
    taken = on & np.isfinite(goals) & np.isfinite(limits)
    limit = np.where(taken, np.minimum(limits, usable), limit)
    max_lead = LEAD_FACTOR * limit / kp
    goal = np.where(taken, q + np.clip(goals - q, -max_lead, max_lead), goal)
    return goal, limit, taken


def transfer_weight(io: ArmIO, start_q: Array, taken: Mask, rate: float) -> Array:
    """Transfer the weight of a standing arm to its servos, and measure the leads that carry it.

    The lead of a joint is goal minus position. With a large lead, a servo exerts its torque limit,
    independent of its stiffness. The leads are first twice those that carry the weight at the
    assumed stiffness (if it is not known), and the limits are about the gravity torques, so that
    joints neither rise nor sink. Then the leads shrink until a joint begins to sink. The lead at
    this time carries the joint, and the limit of the joint may rise. A joint that does not sink
    rests on an object. A joint that sinks before its lead shrinks carries a load that the model
    does not include: its limit rises at once, and the joint returns slowly.

    Args:
        io: Read and write access to the arm, with torque on.
        start_q: Joint positions before torque on (n,) [rad].
        taken: Mask (n,) of joints whose present goals and limits already carry them.
        rate: Rate of the control loop of the transfer [Hz].

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
    still, far = np.maximum(SINK_START, 2.0 * count), np.maximum(SINK_LARGE, 3.0 * count)
    returned = np.maximum(RETURNED, 0.6 * count)
    weight = io.gravity()
    down = -np.sign(weight)
    trusted = servos.stiffness_known
    full = (1.0 if trusted else LEAD_FACTOR) * weight / kp
    lead, first = io.goal - start_q, io.limit
    led, limit = lead, first
    more, pull = np.zeros(start_q.size), np.zeros(start_q.size)
    before, level, mean = start_q, start_q, start_q
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
        mean = mean + min((heard - now) / MEAN_TIME, 1.0) * (q - mean)
        if passed < STAY:
            rise = min(passed / RISE, 1.0) * (full - lead)
            lead = lead + np.where(taken, 0.0, rise)
            level = q
        elif trusted:
            found = np.where(np.isnan(found), lead, found)
        away = (q - start_q) * down
        moves = (q - before) * down
        # Give a joint that continues to sink more torque, and a rising joint less.
        change = usable / (LIMIT_RISE * rate)
        more += np.where((away > far) & (moves > 0.0), change, 0.0)
        fast = moves < -np.maximum(RETURN_SPEED / rate, 0.5 * count)
        # Raise the limit slowly if the servo at its limit holds the joint below its first position.
        stays = np.isfinite(found) & (away > returned) & (kp * np.abs(led) > 0.9 * limit)
        more += np.where(stays & (moves >= 0.0), change * LIMIT_RISE / SLOW_LIMIT_RISE, 0.0)
        more = np.maximum(more - np.where(fast, change, 0.0), 0.0)
        shrinking = np.isnan(found) & (passed >= STAY)
        held = shrinking & ((q - level) * down > still) & (moves >= 0.0)
        step = (np.abs(full) + more / kp) / SHRINK
        # Go back to the lead at the time when the joint began to sink, before this was detected.
        lead = np.where(held, lead + np.sign(lead) * DETECTION_DELAY * step, lead)
        found = np.where(held, lead, found)
        left = np.maximum(np.abs(lead) - step / rate, 0.0)
        lead = np.where(shrinking & ~held, np.sign(lead) * left, lead)
        # A joint that sank earlier is held by the stiffness of its servo at lead 0.
        found = np.where(shrinking & (lead == 0.0) & (away > 0.5 * still), 0.0, found)
        known = np.isfinite(found) | (lead == 0.0)
        spare = np.where(known | trusted, torque_margin(servos, weight), 0.5 * friction)
        firm = np.abs(weight) + spare
        firm = np.where(
            taken, first + min(passed / STAY, 1.0) * np.maximum(firm - first, 0.0), firm
        )
        limit = np.minimum(firm + more, usable)
        # The smaller of displacement and its mean, 0 if their signs differ.
        sunk = np.where(
            (q - start_q) * (mean - start_q) > 0.0,
            np.sign(start_q - q) * np.minimum(np.abs(start_q - q), np.abs(start_q - mean)),
            0.0,
        )
        returning = np.isfinite(found) & (np.abs(sunk) > returned)
        speed = np.clip(RETURN_GAIN * sunk, -RETURN_SPEED, RETURN_SPEED)
        pull += np.where(returning, speed, 0.0) / rate
        # Anti-windup: bound the lead, because a larger one would not increase the limited torque.
        max_lead = LEAD_FACTOR * limit / kp
        pull = np.clip(lead + pull, q - start_q - max_lead, q - start_q + max_lead) - lead
        led = start_q + lead + pull - q
        io.send(start_q + lead + pull, limit)
        before = q
        arrived = not returning.any() or passed > MAX_TIME
        if passed >= RAMP_TIME and bool(known.all()) and arrived:
            break
    io.ramp_limits(limit)
    return np.where(np.isfinite(found), io.goal - io.q, np.nan)


def _joint_names(io: ArmIO, joints: Mask) -> str:
    return ", ".join(io.model.joint_names[i] for i in np.flatnonzero(joints))


def stiffness_mismatch(io: ArmIO, leads: Array) -> str | None:
    """Return a warning about joints whose lead does not match the assumed stiffness, or None.

    The lead (goal minus position) that carries a joint is gravity torque over servo stiffness.
    Joints are ignored unless gravity torque is large against friction and lead against the encoder
    step.

    Args:
        io: Read access to the arm, at rest.
        leads: Leads that carry the joints, from `transfer_weight` (n,) [rad].
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
