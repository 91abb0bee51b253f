"""Estimation of the payload at the tool from slow oscillations of the joints in several poses."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant._core import ConfigError, Controller, ServoError
from pliant._validation import instance, number
from pliant.identify._excitation import Excitation
from pliant.identify._poses import AMPLITUDE_RANGE, SPAN_RANGE, check_poses, pose_list
from pliant.identify._regression import Priors, solve
from pliant.identify._segments import all_segments
from pliant.identify.procedure import Procedure, guided, run_procedure
from pliant.identify.result import PayloadEstimate
from pliant.identify.servos import swing_at_poses, widen_swing

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike

    from pliant._typing import Array
    from pliant.identify.procedure import Arm, Steps, Tick


#: Assumed relative standard deviation of the servo stiffness [1], with `stiffness_known` True and
#: False.
KNOWN_STIFFNESS_SIGMA, UNKNOWN_STIFFNESS_SIGMA = 0.05, 0.3


def _make_procedure(
    controller: Controller,
    *,
    poses: int | ArrayLike = 5,
    span: float = 0.3,
    amplitude: float = 0.05,
) -> Procedure[PayloadEstimate]:
    """Return the `Procedure` that `estimate_payload` runs; another control loop can step it."""
    servos = instance(controller, Controller, "controller").servos
    if servos is None:
        raise ConfigError(
            "the estimate of a payload needs servos: Controller(model, settings, servos=…)"
        )
    rig = Excitation(controller.model, servos, 1.0 / controller.settings.rate)
    numbers = (
        number(span, "span", *SPAN_RANGE, "rad"),
        number(amplitude, "amplitude", *AMPLITUDE_RANGE, "rad"),
    )
    checked_poses = check_poses(poses, rig.n)
    return Procedure(lambda q: _estimate(rig, controller, q, checked_poses, numbers), rig.n)


@guided(_make_procedure)
def estimate_payload(
    arm: Arm,
    controller: Controller,
    *,
    poses: int | ArrayLike = 5,
    span: float = 0.3,
    amplitude: float = 0.05,
    loop: Iterable[Tick] | None = None,
) -> PayloadEstimate:
    """Estimate the payload at the tool; if one is found, set it in the controller.

    The joints oscillate slowly about every pose for a few seconds and pass it in both directions,
    so that friction and delay cancel. Do not touch the arm.

    Args:
        arm: The arm, at rest; simulated or connected and enabled.
        controller: Controller, whose payload is replaced by the estimate if one is found. The
            controller is reset at the final positions in any case.
        poses: Number of poses to choose within `span`, or joint positions of poses (K, n) [rad].
        span: Maximum distance of chosen poses from the present pose, per joint [rad], 0.05 to 0.5;
            the swings about the poses come on top.
        amplitude: Amplitude of the joints about each pose [rad]; the goals move more, because
            friction absorbs a part.
        loop: Your own control loop, which yields its ticks; None: a loop at the controller's rate.

    Returns:
        Mass and centre of mass, with standard deviations.

    Raises:
        ConfigError: The controller has no servo parameters.
        OutOfRangeError: The motion would leave the position limits, or the servos cannot hold the
            payload.
        ServoError: A joint does not follow its goal (the arm keeps holding its position), or no
            joint moved steadily.
    """
    procedure = _make_procedure(controller, poses=poses, span=span, amplitude=amplitude)
    return run_procedure(arm, procedure, loop, rate=controller.settings.rate)


def _estimate(
    rig: Excitation,
    controller: Controller,
    q: Array,
    poses: int | Array,
    numbers: tuple[float, float],
) -> Steps[PayloadEstimate]:
    span, amplitude = numbers
    start = q
    size, q = yield from widen_swing(rig, q, amplitude)
    route = pose_list(rig, rig.fit_within_limits(start, size), poses, span, size)
    rig.start_record()
    q = yield from rig.travel(q, route[-1])
    q = yield from swing_at_poses(rig, q, route[::-1], size)
    rows = all_segments(rig)
    if not rows:
        raise ServoError("no joint ever moved steadily: raise amplitude")
    kp = KNOWN_STIFFNESS_SIGMA if rig.servos.stiffness_known else UNKNOWN_STIFFNESS_SIGMA
    estimate = PayloadEstimate.of(solve(rig, rows, Priors(kp=kp)))
    if estimate.found:
        controller.set_payload(estimate.mass, estimate.com)
    controller.reset(q)
    return estimate
