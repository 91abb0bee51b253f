"""Identification of an arm's servos, payload and delay by slow motions of its joints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError, Model, ServoError, Servos
from pliant._validation import instance, number
from pliant.identify._excitation import Excitation
from pliant.identify._poses import AMPLITUDE_RANGE, SPAN_RANGE, check_poses, pose_list
from pliant.identify._regression import Priors, Solution, fit_delay, solve
from pliant.identify._segments import all_segments, bare_gravity, force_rows, payload_rows
from pliant.identify.procedure import Procedure, guided, run_procedure
from pliant.identify.result import Identification

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike

    from pliant._typing import Array
    from pliant.identify._excitation import Record
    from pliant.identify._regression import Delay
    from pliant.identify.procedure import Arm, Steps, Tick


#: Excess of a goal's amplitude over the amplitude of its joint, which overcomes the friction, in
#: units of friction / stiffness [1].
FRICTION_EXCESS = 4.0
#: Largest amplitude of a goal [rad].
MAX_SWING = 0.4
#: Largest number of times that the amplitude of the goals is increased.
MAX_WIDENINGS = 2
#: Period [s] and number of the oscillations about every pose.
SLOW_SWING = (2.6, 1.75)
#: Periods [s] and numbers of further oscillations about the first pose.
FURTHER_SWINGS = ((1.8, 2.25), (5.0, 1.25))
#: Periods [s] and numbers of the oscillations in which the torque limit drives a joint.
LIMIT_SWINGS = ((1.8, 2.25), (5.0, 1.25))
#: Number of step changes of each joint's goal, from which the delay is identified.
STEP_COUNT = 7
#: Distance by which such a step moves the tool [m], and smallest distance of tool and joint axis
#: for which it does [m].
STEP_LENGTH, MIN_REACH = 0.015, 0.1


def _make_procedure(
    model: Model,
    servos: Servos | None = None,
    *,
    period: float = 0.01,
    poses: int | ArrayLike = 5,
    span: float = 0.1,
    amplitude: float = 0.05,
    torque_share: float = 0.6,
    limit_error: float = 0.05,
) -> Procedure[Identification]:
    """Return the `Procedure` that `identify_servos` runs; another control loop can step it.

    Args:
        model: Model of the arm.
        servos: Assumed servo parameters; None: those of the model.
        period: Control period [s].
        poses: Number of poses to choose within `span`, or joint positions of poses (K, n) [rad].
        span: Maximum distance of chosen poses from the present pose, per joint [rad], 0.05 to 0.5;
            the swings about the poses come on top.
        amplitude: Amplitude of the joints about each pose [rad]; the goals move more, because
            friction absorbs a part.
        torque_share: Torque allowed in addition to gravity, as a share of the maximum torque [1].
        limit_error: Assumed standard deviation of the ratio of true to commanded torque limit [1].

    Raises:
        ConfigError: Neither `servos` nor the model gives servo parameters.
        OutOfRangeError: A number is out of range.
    """
    defaults = instance(model, Model, "model").servos
    assumed = defaults if servos is None else instance(servos, Servos, "servos")
    if assumed is None:
        raise ConfigError(
            "identification needs a servo table: give servos=pliant.Servos(kp=…, max_torque=…)"
        )
    rig = Excitation(model, assumed, period, torque_share=torque_share)
    numbers = (
        number(span, "span", *SPAN_RANGE, "rad"),
        number(amplitude, "amplitude", *AMPLITUDE_RANGE, "rad"),
        number(limit_error, "limit_error", 1e-3, 1.0),
    )
    checked_poses = check_poses(poses, rig.n)
    return Procedure(lambda q: _identify(rig, q, checked_poses, numbers), rig.n)


@guided(_make_procedure)
def identify_servos(
    arm: Arm,
    model: Model,
    servos: Servos | None = None,
    *,
    poses: int | ArrayLike = 5,
    span: float = 0.1,
    amplitude: float = 0.05,
    rate: float | None = None,
    loop: Iterable[Tick] | None = None,
    **options: float,
) -> Identification:
    """Identify stiffness, friction, damping, payload and delay on the arm, in about 2 minutes.

    All joints oscillate slowly about a few poses. Then each joint is moved by changing its torque
    limit. Finally, the goal of each joint makes small steps. Do not touch the arm.

    Args:
        arm: The arm, at rest, simulated or connected and enabled.
        model: Model of the arm.
        servos: Assumed servo parameters; None: those of the model.
        poses: Number of poses to choose within `span`, or joint positions of poses (K, n) [rad].
        span: Maximum distance of chosen poses from the present pose, per joint [rad], 0.05 to 0.5;
            the swings about the poses come on top.
        amplitude: Amplitude of the joints about each pose [rad]; the goals move more, because
            friction absorbs a part.
        rate: Control rate [Hz]; None: the rate of the arm, or 100 Hz if it has none.
        loop: Your own control loop, which yields its ticks; None: a loop at this rate.
        **options: `torque_share` and `limit_error` of `identify_servos.procedure`.

    Returns:
        Servo parameters, delay and payload, with standard deviations. A constant horizontal force
        at the tool, as of a cable, is identified too, and does not change the other values.

    Raises:
        ConfigError: Neither `servos` nor the model gives servo parameters.
        OutOfRangeError: A number is out of range, or the motion would leave the position limits.
        ServoError: A joint does not follow its goal (the arm keeps holding its position), or no
            joint moved steadily.
    """
    rate = rate if rate is not None else getattr(arm, "rate", 100.0)
    period = 1.0 / number(rate, "rate", 10.0, 1000.0, "Hz")
    procedure = _make_procedure(
        model, servos, period=period, poses=poses, span=span, amplitude=amplitude, **options
    )
    return run_procedure(arm, procedure, loop, rate=1.0 / period)


def goal_amplitude(rig: Excitation, amplitude: float) -> Array:
    """Return the amplitude of the goals (n,) [rad] that moves the joints by `amplitude` [rad]."""
    return amplitude + FRICTION_EXCESS * rig.friction / rig.kp


def widen_swing(rig: Excitation, q: Array, amplitude: float) -> Steps[tuple[Array, Array]]:
    """Oscillate all joints near q, more and more, until they move by about ±`amplitude` [rad].

    A goal must move more than its joint: after a reversal, the joint moves only when the goal has
    moved by 2 f/k_p, with the friction f [N·m] and the servo stiffness k_p [N·m/rad].

    Returns:
        Amplitude of the goals (n,) [rad] and the last positions (n,) [rad].

    Raises:
        OutOfRangeError: The motion would leave the position limits.
    """
    start, size = q.copy(), goal_amplitude(rig, amplitude)
    for _ in range(MAX_WIDENINGS + 1):
        pose = rig.fit_within_limits(start, size)
        rig.start_record()
        q = yield from rig.travel(q, pose)
        record = rig.start_record()
        q = yield from rig.sweep(q, pose, size, *SLOW_SWING)
        positions = np.array(record.q)[-round(SLOW_SWING[0] / rig.period) :]
        deficit = amplitude - 0.5 * (positions.max(axis=0) - positions.min(axis=0))
        rig.start_record()
        q = yield from rig.travel(q, start)
        if (deficit < 0.3 * amplitude).all():
            break
        rig.records.remove(record)
        size = np.minimum(size + 1.5 * np.maximum(deficit, 0.0), MAX_SWING)
    return size, q


def swing_at_poses(rig: Excitation, q: Array, route: list[Array], size: Array) -> Steps[Array]:
    """Oscillate all joints slowly about each pose of a route; return the last positions (n,) [rad].

    `size` is the amplitude of the goals (n,) [rad].
    """
    for pose in route:
        rig.start_record()
        q = yield from rig.travel(q, pose)
        rig.start_record()
        q = yield from rig.sweep(q, pose, size, *SLOW_SWING)
    return q


def _identify(
    rig: Excitation, q: Array, poses: int | Array, numbers: tuple[float, float, float]
) -> Steps[Identification]:
    span, amplitude, limit_error = numbers
    start = q
    size, q = yield from widen_swing(rig, q, amplitude)
    route = pose_list(rig, rig.fit_within_limits(start, size), poses, span, size)
    q = yield from rig.travel(q, route[-1])
    q = yield from swing_at_poses(rig, q, route[::-1], size)
    home = route[0]
    for seconds, swings in FURTHER_SWINGS:
        rig.start_record()
        q = yield from rig.travel(q, home)
        rig.start_record()
        q = yield from rig.sweep(q, home, size, seconds, swings)
    rig.start_record()
    q = yield from rig.travel(q, home)

    first = _fit(rig, Priors(limit=limit_error))
    assumed = rig.kp, rig.friction
    rig.kp = np.clip(first.value["kp"], 0.3 * rig.kp, 3.0 * rig.kp)
    rig.friction = np.maximum(first.value["friction"], 0.0)
    rig.extra_torque = holding_torque(rig, home, first) - np.asarray(rig.model.gravity(home))
    for joint in range(rig.n):
        for pace in LIMIT_SWINGS:
            rig.start_record(joint)
            q = yield from rig.drive_by_limit(q, home, joint, float(size[joint]), pace)
            rig.start_record()
            q = yield from rig.travel(q, home)
    steps, step_size = [], _step_size(rig, home, size)
    for joint in range(rig.n):
        steps.append(rig.start_record())
        q = yield from rig.steps(q, home, joint, float(step_size[joint]), STEP_COUNT)
    rig.kp, rig.friction = assumed
    return fit_all(rig, home, steps, limit_error)


def _step_size(rig: Excitation, q: Array, size: Array) -> Array:
    """Return half the height of the goal steps (n,) [rad], which move the tool by `STEP_LENGTH`.

    The goal steps by 2 f/k_p more than the joint, with the friction f [N·m] and the stiffness k_p
    [N·m/rad] found so far. `size` (n,) [rad] are upper bounds.
    """
    reach = np.linalg.norm(np.asarray(rig.model.jacobian(q))[:3], axis=0)
    moved = STEP_LENGTH / np.maximum(reach, MIN_REACH)
    out: Array = np.minimum(rig.friction / rig.kp + 0.5 * moved, size)
    return out


def fit_all(
    rig: Excitation, home: Array, steps: list[Record], limit_error: float
) -> Identification:
    """Return the fit of servo parameters, payload and delay to all records.

    Growth of friction with load is fitted only for joints where it is significant.
    """
    first_fit = _fit(rig, Priors(limit=limit_error, load=0.3))
    by_load = first_fit.value["load"] + first_fit.value["motor"]
    significant = by_load > 3.0 * np.hypot(first_fit.sigma["load"], first_fit.sigma["motor"])
    solution = _fit(rig, Priors(limit=limit_error, load=np.where(significant, 0.3, 0.0)))
    delay: Delay = fit_delay(rig, steps, solution, holding_torque(rig, home, solution))
    return Identification.of(rig, home, solution, delay)


def holding_torque(rig: Excitation, q: Array, solution: Solution) -> Array:
    """Return the torques that hold the arm at q with identified payload and force (n,) [N·m]."""
    out: Array = bare_gravity(rig.model, q) + payload_rows(rig.model, q) @ solution.payload
    return out + force_rows(rig.model, q) @ solution.force


def _fit(rig: Excitation, priors: Priors) -> Solution:
    rows = all_segments(rig)
    if not rows:
        raise ServoError(
            "no joint ever moved steadily: raise amplitude, or look whether the servos are enabled"
        )
    return solve(rig, rows, priors)
