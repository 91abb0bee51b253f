"""Guided identification of an arm's servos, payload and delay."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError, Model, ServoError, Servos
from pliant._validation import instance, number
from pliant.identify._excitation import Excitation
from pliant.identify._poses import SPAN, SWING, check_poses, pose_list
from pliant.identify._regression import Priors, Solution, fit_delay, solve
from pliant.identify._segments import bare_gravity, find_segments, payload_rows
from pliant.identify.procedure import Procedure, guided, run_procedure
from pliant.identify.result import Identification

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike

    from pliant._typing import Array
    from pliant.identify._excitation import Record
    from pliant.identify._regression import Delay
    from pliant.identify.procedure import Arm, Steps, Tick


#: Swing in slow motion on top of the amplitude, as a multiple of friction over stiffness [1].
FRICTION_SWING = 4.0
#: Largest swing [rad], and how often it may grow if friction is higher than assumed.
MAX_SWING, MAX_WIDENINGS = 0.4, 2
#: Periods [s] and numbers of swings: at every pose, and at two more speeds at the first pose.
SLOW_SWING, FASTER_SWINGS = (2.6, 1.75), ((1.8, 2.25), (5.0, 1.25))
#: Periods [s] and numbers of swings of one joint driven by its limit.
LIMIT_SWINGS = ((1.8, 2.25), (5.0, 1.25))
#: Steps of each joint's goal.
STEP_COUNT = 7


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
    """Make the procedure of `identify_servos`.

    Args:
        model: Description of the arm.
        servos: Assumed servo table; None for the model's.
        period: Control period [s].
        poses: Number of poses to choose within `span`, or postures (K, n) [rad].
        span: Largest distance of chosen poses from the present one, per joint [rad].
        amplitude: Swing about each pose [rad], without the part that friction takes.
        torque_share: Torque allowed on top of gravity, as a share of the usable torque.
        limit_error: Relative standard deviation of the true torque at a torque limit.

    Raises:
        ConfigError: There is no servo table. OutOfRangeError: A number is out of range.
    """
    own = instance(model, Model, "model").servos
    assumed = own if servos is None else instance(servos, Servos, "servos")
    if assumed is None:
        raise ConfigError(
            "identification needs a servo table: give servos=pliant.Servos(kp=…, max_torque=…)"
        )
    rig = Excitation(model, assumed, period, torque_share=torque_share)
    numbers = (
        number(span, "span", 0.0, SPAN, "rad"),
        number(amplitude, "amplitude", *SWING, "rad"),
        number(limit_error, "limit_error", 1e-3, 1.0),
    )
    chosen = check_poses(poses, rig.n)
    return Procedure(lambda q: _identify(rig, q, chosen, numbers), rig.n)


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
    """Identify stiffness, friction, damping, payload and delay on the arm; about 1.5 minutes.

    It swings all joints slowly at a few poses, then each joint by the torque of its limit, then
    steps each goal. Do not touch the arm. Arguments as `identify_servos.procedure`.

    Args:
        arm: The arm, at rest, simulated or connected and enabled.
        model: Its description.
        servos: Assumed servo table; None for the model's.
        poses: Number of poses to choose within `span`, or postures (K, n) [rad].
        span: Largest distance of chosen poses from the present one, per joint [rad].
        amplitude: Swing about each pose [rad], without the part that friction takes.
        rate: Control rate [Hz]; None for the arm's, or 100.
        loop: Ticks of a loop of your own; None: a loop at this rate.
        **options: As `identify_servos.procedure`.

    Raises:
        OutOfRangeError: The motion would leave the position limits. Nothing is sent.
        ServoError: A joint does not follow. The arm keeps holding its position.
    """
    own = rate if rate is not None else getattr(arm, "rate", 100.0)
    period = 1.0 / number(own, "rate", 10.0, 1000.0, "Hz")
    procedure = _make_procedure(
        model, servos, period=period, poses=poses, span=span, amplitude=amplitude, **options
    )
    return run_procedure(arm, procedure, loop, rate=1.0 / period)


def swing(rig: Excitation, amplitude: float) -> Array:
    """Return the swing of each joint that overcomes its friction (n,) [rad]."""
    return amplitude + FRICTION_SWING * rig.friction / rig.kp


def widen_swing(rig: Excitation, q: Array, amplitude: float) -> Steps[tuple[Array, Array]]:
    """Swing near q, wider until every joint moves by the amplitude; return swing and positions.

    A goal that reverses must first cross the friction of the joint, 2 f/k_p, before the joint
    moves.

    Raises:
        OutOfRangeError: The swing would leave the position limits.
    """
    start, size = q.copy(), swing(rig, amplitude)
    for _ in range(MAX_WIDENINGS + 1):
        pose = rig.fit_within_limits(start, size)
        rig.start_record()
        q = yield from rig.travel(q, start, pose)
        record = rig.start_record()
        q = yield from rig.sweep(q, pose, size, *SLOW_SWING)
        moved = np.array(record.q)[-round(SLOW_SWING[0] / rig.period) :]
        deficit = amplitude - 0.5 * (moved.max(axis=0) - moved.min(axis=0))
        rig.start_record()
        q = yield from rig.travel(q, pose, start)
        if (deficit < 0.3 * amplitude).all():
            break
        rig.records.remove(record)
        size = np.minimum(size + 1.5 * np.maximum(deficit, 0.0), MAX_SWING)
    return size, q


def swing_at_poses(rig: Excitation, q: Array, route: list[Array], size: Array) -> Steps[Array]:
    """Swing slowly at each pose of the route, in order."""
    at = route[0]
    for pose in route:
        rig.start_record()
        q = yield from rig.travel(q, at, pose)
        rig.start_record()
        q = yield from rig.sweep(q, pose, size, *SLOW_SWING)
        at = pose
    return q


def _identify(
    rig: Excitation, q: Array, poses: int | Array, numbers: tuple[float, float, float]
) -> Steps[Identification]:
    span, amplitude, limit_error = numbers
    start = q
    size, q = yield from widen_swing(rig, q, amplitude)
    route = pose_list(rig, rig.fit_within_limits(start, size), poses, span, size)
    q = yield from rig.travel(q, start, route[-1])
    q = yield from swing_at_poses(rig, q, route[::-1], size)
    home = route[0]
    for seconds, turns in FASTER_SWINGS:
        rig.start_record()
        q = yield from rig.sweep(q, home, size, seconds, turns)
    rig.start_record()
    q = yield from rig.travel(q, home, home)

    first = _fit(rig, Priors(limit=limit_error))
    table = rig.kp, rig.friction
    rig.kp = np.clip(first.value["kp"], 0.3 * rig.kp, 3.0 * rig.kp)
    rig.friction = np.maximum(first.value["friction"], 0.0)
    rig.extra_torque = holding_torque(rig, home, first) - np.asarray(rig.model.gravity(home))
    for joint in range(rig.n):
        for pace in LIMIT_SWINGS:
            rig.start_record(joint)
            q = yield from rig.push(q, home, joint, float(size[joint]), pace)
            rig.start_record()
            q = yield from rig.travel(q, home, home)
    steps = []
    for joint in range(rig.n):
        steps.append(rig.start_record())
        q = yield from rig.steps(q, home, joint, float(size[joint]), STEP_COUNT)
    rig.kp, rig.friction = table
    return fit_all(rig, home, steps, limit_error)


def fit_all(
    rig: Excitation, home: Array, steps: list[Record], limit_error: float
) -> Identification:
    """Fit all unknowns to all records."""
    first_fit = _fit(rig, Priors(limit=limit_error, load=0.3))
    by_load = first_fit.value["load"] + first_fit.value["motor"]
    significant = by_load > 3.0 * np.hypot(first_fit.sigma["load"], first_fit.sigma["motor"])
    solution = _fit(rig, Priors(limit=limit_error, load=np.where(significant, 0.3, 0.0)))
    delay: Delay = fit_delay(rig, steps, solution, holding_torque(rig, home, solution))
    return Identification.of(rig, home, solution, delay)


def holding_torque(rig: Excitation, q: Array, solution: Solution) -> Array:
    """Return the torques that hold the arm with the identified payload (n,) [N·m]."""
    return bare_gravity(rig.model, q) + payload_rows(rig.model, q) @ solution.payload


def _fit(rig: Excitation, priors: Priors) -> Solution:
    rows = [segment for record in rig.records for segment in find_segments(rig, record)]
    if not rows:
        raise ServoError(
            "no joint ever moved steadily: raise amplitude, or look whether the servos are enabled"
        )
    return solve(rig, rows, priors)
