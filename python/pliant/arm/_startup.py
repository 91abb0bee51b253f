"""Start of an arm: checks before torque comes on, first goals and limits, servo stiffness.

The lead of a joint is goal minus position [rad]; a servo turns it into torque.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import SUPPORT, ServoError, ServoTimeoutError
from pliant.arm._checks import CHECK_WEIGHT, longest_command_age, outside

if TYPE_CHECKING:
    from pliant._core import ArmPoints, Model, Servos
    from pliant._typing import Array, Mask
    from pliant.arm._io import ArmIO


#: Number of read cycles within which every joint must answer before torque is switched on.
ATTEMPTS = 10
#: Largest first lead (goal minus position) of a joint with torque on whose goal register is unknown
#: [rad].
MAX_FIRST_LEAD = 0.1
#: First lead (goal minus position) of a joint, as a multiple of limit over assumed stiffness: with
#: 2, a servo of half the assumed stiffness also exerts its limit.
LEAD_FACTOR = 2.0
#: `FIRST_LEAD` is added to the lead of `LEAD_FACTOR`, for the motion until the next goal [rad];
#: `LARGEST_LEAD` bounds the sum [rad].
FIRST_LEAD, LARGEST_LEAD = 0.03, 0.8
#: Motion of a joint as torque comes on above which the user is warned [rad].
MAX_DISPLACEMENT = 0.15
#: Ratio of measured to assumed servo stiffness, or inverse ratio, above which the user is warned.
MISMATCH = 1.5
#: Ratio, or inverse ratio, up to which a servo has the assumed stiffness: friction explains it.
#: Larger ratios are clipped to `RATIO_BOUNDS`.
SAME, RATIO_BOUNDS = 1.25, (0.4, 2.5)
#: Load that friction may hide from the balance, as a multiple of the friction of each joint.
HIDDEN = 2.0
#: Load above which the user is told [kg].
TOLD_LOAD = 0.03
#: Largest quotient of the ratios of servos that agree.
AGREEMENT = 1.5
#: Weight over friction of a joint above which its motion and its lead tell about the weight.
CLEAR_WEIGHT = 3.0
#: Lead of a joint, as a share of the lead that its weight needs, below which it carries none of it.
LEAST_SHARE = 0.1
#: Gravity torque over usable torque of a joint above which torque stays off: servos at full torque
#: would throw an arm upward that is so much lighter than its model.
LARGEST_WEIGHT = 2.0
#: Largest distance of the surface of a link from the points of the arm [m].
LINK_RADIUS = 0.03
#: Number of timed readings, and largest share of `longest_command_age` that the fastest of them may
#: take: the rest is for the program and for other requests.
READINGS, READING_SHARE = 3, 0.7


def wait_for_all(io: ArmIO, rate: float) -> float:
    """Read all joints at `rate` [Hz] until every joint has answered once.

    Returns:
        Time that the last reading took [s].

    Raises:
        ServoTimeoutError: Joints have not answered in `ATTEMPTS` cycles; the message names them.
    """
    positions, joints = io.positions, io.joints
    positions.reset()
    for _ in range(ATTEMPTS):
        duration = _time_reading(io)
        silent = [joints.names[i] for i in np.flatnonzero(np.isnan(positions.position))]
        if not silent:
            return duration
        io.clock.wait_until(io.clock.now() + 1.0 / rate)
    raise ServoTimeoutError(
        f"no answer from {', '.join(silent)}: torque stays off; check their power, cable and id"
    )


def _time_reading(io: ArmIO) -> float:
    """Read all joints once, and return the time that this took [s]."""
    begin = io.clock.now()
    io.sample()
    return io.clock.now() - begin


def check_reading_time(io: ArmIO, duration: float, rate: float, *, required: bool) -> str | None:
    """Check that all joints can be read at `rate` [Hz].

    The fastest of `READINGS` readings counts, because other programs may delay one.

    Args:
        io: Read access to the arm.
        duration: Time that the last reading took [s].
        rate: Rate of the loops [Hz].
        required: True: raise an error if a loop could send no command.

    Returns:
        A warning if a reading takes longer than a period, else None.

    Raises:
        ServoError: A reading takes so long that a loop would reject every command.
    """
    for _ in range(READINGS - 1):
        if duration <= 1.0 / rate:
            return None
        duration = min(duration, _time_reading(io))
    longest = READING_SHARE * longest_command_age(rate)
    if required and duration > longest:
        raise ServoError(
            f"reading all joints takes {duration * 1e3:.0f} ms, at most {longest * 1e3:.0f} ms are "
            f"allowed at {rate:g} Hz: torque stays off. Often the latency timer of the adapter is "
            "16 ms: set it to 1 ms (docs/troubleshooting.md; `pliant servos doctor ARM` reports "
            f"it), or reduce the rate, [loop] rate or pliant.connect(rate=...), to "
            f"{0.5 / duration:.2g} Hz"
        )
    if duration <= 1.0 / rate:
        return None
    return (
        f"reading all joints takes {duration * 1e3:.0f} ms, a period at {rate:g} Hz "
        f"{1e3 / rate:.0f} ms: the loop is slower than that. The arm may sink by centimetres as "
        "torque comes on, keep a hand under it, and reacts to a push or a contact later. Set the "
        "latency timer of the adapter to 1 ms (16 ms is FTDI's default), and the servos to a "
        "higher baud rate if theirs is low; `pliant servos doctor ARM` measures the reading "
        "(docs/troubleshooting.md)"
    )


def check_within_limits(io: ArmIO, on: Mask) -> None:
    """Check before torque is switched on that every joint of the chain is within its limits.

    A position far outside the limits means that the zero of the joint is wrong, and with it gravity
    torques and paths. `on` is the mask (n,) of joints with torque on.

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


def check_weight(io: ArmIO, on: Mask) -> None:
    """Check before torque is switched on that the model is not far too heavy for its servos.

    Joints with torque on, of the mask `on` (n,), whose goals and limits are known are not checked:
    taking them over must not fail. A simulated arm has torque on from the start, without goals.

    Raises:
        ServoError: Joints need more than `LARGEST_WEIGHT` times their usable torque to hold the
            present pose; the message names each, with the remedy.
    """
    weight, usable = np.abs(io.gravity()), np.asarray(io.servos.max_torque)
    goals, limits = io.stored_commands()
    taken = on & np.isfinite(goals + limits)
    found = [
        f"{io.model.joint_names[i]} needs {weight[i]:.3g} N·m, its servo has {usable[i]:.3g} N·m"
        for i in np.flatnonzero(~taken & (weight > LARGEST_WEIGHT * usable))
    ]
    if found:
        raise ServoError(
            f"to hold its weight in this pose {'; '.join(found)}: torque stays "
            f"{'as it is' if on.any() else 'off'}. "
            f"{CHECK_WEIGHT}; or move the arm by hand into a pose that needs less"
        )


def initial_commands(io: ArmIO, on: Mask) -> tuple[Array, Array, Array, Mask]:
    """Return first goals, limits, leads (n,), and a mask (n,) of joints taken over.

    Goals and leads are in rad, limits in N·m. Joints without torque get their present positions as
    goals, and a lead: with known stiffness the lead that holds the weight, otherwise one with which
    they exert their limit, about the gravity torque. Without a lead, they would sink until the
    first goal of the weight transfer. Joints with torque have no lead and are taken over: they keep
    the goals and limits in their registers. If the registers are unknown, a joint with torque is
    not taken over, and gets a limit of about the gravity torque.

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
    lead = weight / kp if servos.stiffness_known else full_lead(weight, kp)
    return goal, limit, np.where(on, 0.0, lead), taken


def full_lead(torque: Array, kp: Array) -> Array:
    """Return the leads (n,) [rad] with which servos exert limits of |torque| (n,) [N·m].

    `kp` is the assumed stiffness (n,) [N·m/rad], see `LEAD_FACTOR`.
    """
    size = LEAD_FACTOR * np.abs(torque) / kp + FIRST_LEAD
    return np.sign(torque) * np.minimum(size, LARGEST_LEAD)


def displacement(io: ArmIO, start_q: Array) -> str | None:
    """Return which joints torque did not hold near `start_q` (n,), or None."""
    moved = zip(io.model.joint_names, io.q - start_q, strict=True)
    found = [f"{name} by {x:+.2f} rad" for name, x in moved if abs(x) > MAX_DISPLACEMENT]
    return f"torque did not hold {', '.join(found)}" if found else None


def unit_load(model: Model, q: Array) -> Array:
    """Return the torques (n,) [N·m] that hold 1 kg at the tool at q (n,) [rad]."""
    return -np.asarray(model.gravity_vector) @ np.asarray(model.jacobian(q))[:3]


def unloaded(io: ArmIO, leads: Array) -> str | None:
    """Return which joints carry none of their weight, or None, for an arm away from all objects.

    Their `leads` (n,) [rad] are NaN, or below `LEAST_SHARE` of those that they need.
    """
    servos, weight = io.servos, io.gravity()
    least = LEAST_SHARE * np.abs(weight) / np.asarray(servos.kp)
    clear = np.abs(weight) > CLEAR_WEIGHT * np.asarray(servos.friction)
    resolved = (np.abs(leads) < least) & (least > np.asarray(servos.encoder_step))
    found = np.flatnonzero(clear & (np.isnan(leads) | resolved))
    if not found.size:
        return None
    return (
        f"{', '.join(io.model.joint_names[i] for i in found)}: no weight on the servo. A hand or "
        "an object carries it, or its id is that of another servo"
    )


def may_lie_on(table: float | None, points: ArmPoints, q: Array) -> bool:
    """Return True if a point of the arm at q (n,) [rad] is within `LINK_RADIUS` of the table.

    `table` is the height of the table in base axes [m]; None: there is no table.
    """
    return table is not None and bool(points.position(q)[:, 2].min() < table + LINK_RADIUS)


def stiffness_ratio(io: ArmIO, leads: Array, *, is_supported: bool = False) -> Array:
    """Return stiffness over assumed stiffness of each servo (n,); NaN where it is not measured.

    The lead (goal minus position) that holds a joint is gravity torque over servo stiffness; the
    gravity torque includes the load `io.load`. A joint is measured if its gravity torque is large
    against friction, and its lead large against the encoder step and a fiftieth of the expected
    lead. The ratio is negative if the lead has the wrong direction.

    Args:
        io: Read access to the arm, at rest.
        leads: Leads that hold the joints, from `transfer_weight` (n,) [rad].
        is_supported: True if the arm may lie on an object, which supports part of its weight. Only
            leads that are too large are then measurements.
    """
    servos, weight = io.servos, io.gravity() + io.load * unit_load(io.model, io.q)
    expected = weight / np.asarray(servos.kp)
    smallest = np.maximum(3.0 * np.asarray(servos.encoder_step), 0.02 * np.abs(expected))
    clear = (np.abs(weight) > CLEAR_WEIGHT * np.asarray(servos.friction)) & (
        np.abs(leads) > smallest
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = expected / leads
        if is_supported:
            clear &= (ratio > 0.0) & (ratio < 1.0)
        return np.where(clear & np.isfinite(ratio), ratio, np.nan)


def measured_servos(io: ArmIO, ratio: Array) -> Servos:
    """Return the servos with the stiffness that `ratio` (n,) of `stiffness_ratio` gives.

    A soft servo is assumed to carry a load that friction hides: with too small a k_p, goals lead
    too far. Ratios near 1 count as 1. A servo without a measured ratio gets the median of the
    others if these agree, or the root of a single one, because servos of an arm may differ.
    """
    weight = np.abs(io.gravity() + io.load * unit_load(io.model, io.q))
    hidden = 1.0 + HIDDEN * np.asarray(io.servos.friction) / np.maximum(weight, 1e-9)
    ratio = np.where(ratio < 1.0, np.minimum(hidden * ratio, 1.0), ratio)
    ratio = np.clip(np.where(ratio > 0.0, ratio, np.nan), *RATIO_BOUNDS)
    ratio = np.where((ratio > 1.0 / SAME) & (ratio < SAME), 1.0, ratio)
    found = ratio[np.isfinite(ratio)]
    typical = 1.0
    if found.size and found.max() < AGREEMENT * found.min():
        typical = float(np.median(found)) ** (0.5 if found.size == 1 else 1.0)
    kp = np.asarray(io.servos.kp) * np.where(np.isfinite(ratio), ratio, typical)
    return io.servos.replace(kp=kp)


def stiffness_mismatch(io: ArmIO, ratio: Array) -> str | None:
    """Return a warning about joints with a `stiffness_ratio` (n,) far from 1, or None."""
    differs = np.isfinite(ratio) & ((ratio > MISMATCH) | (ratio < 1.0 / MISMATCH))
    if not differs.any():
        return None
    names = io.model.joint_names
    wrong = [names[i] for i in np.flatnonzero(differs & (ratio < 0.0))]
    reversed_leads = (
        f"{', '.join(wrong)} {'push' if len(wrong) > 1 else 'pushes'} opposite to what its weight "
        "needs: check sign and zero of the servo, or a load or an object lifts the arm"
    )
    found = [f"{names[i]} {ratio[i]:.2g} x" for i in np.flatnonzero(differs & (ratio > 0.0))]
    if not found:
        return reversed_leads
    return (f"{reversed_leads}; " if wrong else "") + (
        f"servos are stiffer or softer than their table, or weights or zeros are wrong: "
        f"{', '.join(found)} the assumed k_p, or a hand carried the arm (then switch torque off "
        "and on): make controllers after torque on, and measure k_p with "
        "pliant.identify.identify_servos(arm, model)"
    )
