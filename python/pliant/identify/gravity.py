"""Measurement of the gravity offset: hold the pose stiffly, average the leads, check the result.

The lead is the joint goal minus the joint position [rad]; servo stiffness turns it into torque.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import Compensation, ConfigError, Controller, Settings, Tracking
from pliant._validation import instance, number
from pliant.identify.procedure import Procedure, guided, run_procedure

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pliant._core import Servos
    from pliant._typing import Array, Mask
    from pliant.identify.procedure import Arm, Steps, Tick


#: Integral gain of the goals while the arm is held [1/s].
INTEGRATION_RATE = 4.0
#: Last part of the holding time in which positions and goals are averaged, as a share of it [1].
AVERAGED_SHARE = 0.25
#: If the check fails, it is repeated with these shares of the friction and damping feed-forward
#: [1].
REDUCED_SHARES = (0.5, 0.0)
#: Time for which the arm is held stiffly before each repetition of the check [s].
HOLD_TIME = 0.5
#: Speed of the tool below which the arm counts as at rest [m/s].
REST_SPEED = 2e-3
#: Bounds to which `Controller.capture_gravity` clips the ratio of measured to assumed stiffness.
CLIP_RATIOS = (0.3, 3.0)


@dataclass(frozen=True)
class GravityCapture:
    """Result of `capture_gravity`.

    Attributes:
        stiffness: Stiffness k_g (n,) [N·m/rad] by which the controller now divides the gravity
            torques to get the gravity offset of the goals.
        assumed: Assumed stiffness k_p of the servo parameters (n,) [N·m/rad].
        lead: Goal minus position that held the arm (n,) [rad].
        gravity: Torque that holds the arm, by the model with the controller's payload (n,) [N·m].
        captured: True for joints whose k_g was measured (n,); the others keep the assumed k_p.
        clipped: True for joints whose measured k_g was outside 0.3 to 3 times k_p (n,).
        still: True if the arm was at rest while its leads were read.
        drift: Largest motion of the tool in the check, under the controller's settings [m]; NaN
            without a check. The check ends once the motion exceeds `bound`.
        bound: Maximum allowed motion of the tool in the check [m].
        joint_names: Names of the joints.
        remedy: If the check failed, the settings with less feed-forward of friction and damping
            under which the arm stayed; None if the arm moved under all such settings, or if the
            check passed.
    """

    stiffness: Array
    assumed: Array
    lead: Array
    gravity: Array
    captured: Mask
    clipped: Mask
    still: bool
    drift: float
    bound: float
    joint_names: tuple[str, ...]
    remedy: Settings | None = None

    @property
    def stays(self) -> bool:
        """True if the arm was at rest, no stiffness was clipped, and the check, if any, passed."""
        return self.still and not self.clipped.any() and not self.drift > self.bound

    def summary(self) -> list[str]:
        """Return one sentence per joint, then the result of the check."""
        out = []
        for i, name in enumerate(self.joint_names):
            ratio = self.stiffness[i] / self.assumed[i]
            if self.clipped[i]:
                out.append(
                    f"{name}: a lead of {self.lead[i]:+.4f} rad does not fit "
                    f"{self.gravity[i]:+.2f} N·m of gravity; k_g clipped at {ratio:.1f} × the "
                    "assumed k_p: wrong payload, a hand on the arm, or a servo that does not "
                    "match its table."
                )
            elif self.captured[i]:
                out.append(
                    f"{name}: captured, k_g {self.stiffness[i]:.3g} N·m/rad, {ratio:.2f} × the "
                    f"assumed k_p (lead {self.lead[i]:+.4f} rad at {self.gravity[i]:+.2f} N·m)."
                )
            else:
                out.append(
                    f"{name}: left as assumed; gravity needs only {self.gravity[i]:+.2f} N·m here, "
                    "too close to the friction of the joint."
                )
        if not self.still:
            out.append("the arm did not come to rest: capture again, without touching it.")
        if self.drift > self.bound:
            out.append(
                f"the check failed: the tool moved {1e3 * self.drift:.1f} mm, more than "
                f"{1e3 * self.bound:.1f} mm, and was stopped; {self._advice()}"
            )
        elif np.isfinite(self.drift):
            out.append(f"the check passed: the tool moved {1e3 * self.drift:.1f} mm.")
        return out

    def _advice(self) -> str:
        if self.remedy is None:
            return (
                "weigh the payload, identify the servos or lower `adaptation` before you let it "
                "yield."
            )
        friction, damping = self.remedy.compensation.friction, self.remedy.compensation.damping
        return (
            f"with Compensation(friction={friction:g}, damping={damping:g}) it stays (for a servo "
            "that is stiffer than in its table, the friction feed-forward is too large): "
            "controller.update(found.remedy) until the servos are identified."
        )

    def __str__(self) -> str:
        return "\n".join(self.summary())


def _make_procedure(
    controller: Controller, *, seconds: float = 2.0, check: float = 2.0, bound: float = 2e-3
) -> Procedure[GravityCapture]:
    """Return the `Procedure` that `capture_gravity` runs; another control loop can step it."""
    servos = instance(controller, Controller, "controller").servos
    if servos is None:
        raise ConfigError(
            "capturing gravity needs the assumed k_p: Controller(model, settings, servos=…)"
        )
    numbers = (
        number(seconds, "seconds", 1.0, unit="s"),
        number(check, "check", 0.0, unit="s"),
        number(bound, "bound", 0.0, unit="m"),
    )
    return Procedure(lambda q: _capture(controller, servos, q, numbers), controller.model.n)


@guided(_make_procedure)
def capture_gravity(
    arm: Arm,
    controller: Controller,
    *,
    seconds: float = 2.0,
    check: float = 2.0,
    bound: float = 2e-3,
    loop: Iterable[Tick] | None = None,
) -> GravityCapture:
    """Measure the gravity offset at the present pose. Do not touch the arm.

    The controller holds every task axis with an integrator in the goals, without feed-forward of
    friction and damping (with feed-forward, the integrator would oscillate). The mean positions and
    goals go to `Controller.capture_gravity`. Then the settings are restored, also after an error,
    and the controller holds the arm as a check. If the arm moves, it is stopped, and the check is
    repeated with half of the feed-forward and without feed-forward. All this takes 4 to 9 s by
    default.

    Args:
        arm: The arm, at rest; simulated or connected and enabled.
        controller: Controller that gets the offset; it is reset to the present positions.
        seconds: Time to hold the arm [s], at least 1.
        check: Duration of the check [s]; 0 for no check.
        bound: Maximum motion of the tool in the check [m].
        loop: Your own control loop, which yields its ticks; None: a loop at the controller's rate.

    Returns:
        Measured leads and stiffness of each joint, and the result of the check.

    Raises:
        ConfigError: The controller has no servo parameters.
        OutOfRangeError: A number is out of range.
        TypeError: `arm` or `controller` has the wrong type.
        ShapeError: The number of joints differs from the controller's model.
    """
    procedure = _make_procedure(controller, seconds=seconds, check=check, bound=bound)
    return run_procedure(arm, procedure, loop, rate=controller.settings.rate)


def _capture(
    controller: Controller, servos: Servos, q: Array, numbers: tuple[float, float, float]
) -> Steps[GravityCapture]:
    seconds, check, bound = numbers
    model, settings = controller.model, controller.settings
    stiff = Settings(
        task=settings.task,
        rate=settings.rate,
        delay=settings.delay,
        tracking=Tracking(integrate=INTEGRATION_RATE),
        compensation=Compensation(friction=0.0, damping=0.0),
    )
    controller.reset(q)
    target = model.forward_kinematics(q)
    ticks = round(seconds * settings.rate)
    samples: list[tuple[Array, Array]] = []
    controller.update(stiff)
    try:
        for _ in range(ticks):
            command = controller.step(q, target)
            samples.append((q, command.goal))
            q = yield command
        tail = samples[-max(round(AVERAGED_SHARE * ticks), 1) :]
        mean_q, goal = (np.mean([pair[k] for pair in tail], axis=0) for k in (0, 1))
        stiffness = controller.capture_gravity(mean_q, goal)
        # Payload and gravity of the controller may differ from those of the model.
        gravity = np.array(controller.diagnostics.gravity)
    finally:
        controller.update(settings)
    first, last = (model.forward_kinematics(tail[k][0])[:3, 3] for k in (0, -1))
    resolution = float(np.abs(model.jacobian(mean_q)[:3] * np.asarray(servos.encoder_step)).sum())
    still = float(np.linalg.norm(last - first)) < REST_SPEED * seconds * AVERAGED_SHARE + resolution
    drift, remedy = np.nan, None
    if check > 0.0:
        drift, q = yield from _hold_and_measure(controller, q, round(check * settings.rate), bound)
        if drift > bound:
            remedy = yield from _find_remedy(controller, q, (check, bound), stiff)
    assumed = np.array(servos.kp)
    measured = np.abs(gravity) > 3.0 * np.asarray(servos.friction)
    ratio = stiffness / assumed
    return GravityCapture(
        stiffness=np.asarray(stiffness),
        assumed=assumed,
        lead=goal - mean_q,
        gravity=gravity,
        captured=measured,
        clipped=measured & ((ratio < CLIP_RATIOS[0] * 1.001) | (ratio > CLIP_RATIOS[1] * 0.999)),
        still=still,
        drift=float(drift),
        bound=bound,
        joint_names=tuple(model.joint_names),
        remedy=remedy,
    )


def _find_remedy(
    controller: Controller, q: Array, numbers: tuple[float, float], stiff: Settings
) -> Steps[Settings | None]:
    """Return settings with less feed-forward of friction and damping that keep the arm still.

    Return None if the arm moves with all of `REDUCED_SHARES`. The previous settings of the
    controller are restored at the end.
    """
    check, bound = numbers
    settings = controller.settings
    ticks, rest = round(check * settings.rate), round(HOLD_TIME * settings.rate)
    try:
        for share in REDUCED_SHARES:
            controller.update(stiff)
            _, q = yield from _hold_and_measure(controller, q, rest)
            reduced = settings.replace(
                compensation=Compensation(
                    friction=share * settings.compensation.friction,
                    damping=share * settings.compensation.damping,
                ),
            )
            controller.update(reduced)
            drift, q = yield from _hold_and_measure(controller, q, ticks, bound)
            if drift <= bound:
                return reduced
        controller.update(stiff)
        yield from _hold_and_measure(controller, q, rest)
    finally:
        controller.update(settings)
    return None


def _hold_and_measure(
    controller: Controller, q: Array, ticks: int, bound: float = np.inf
) -> Steps[tuple[float, Array]]:
    """Hold the present pose; return the largest motion of the tool [m] and the last positions.

    The hold ends after `ticks` control cycles, or once the motion exceeds `bound` [m].
    """
    model = controller.model
    target = model.forward_kinematics(q)
    drift = 0.0
    for _ in range(ticks):
        q = yield controller.step(q, target)
        offset = model.forward_kinematics(q)[:3, 3] - target[:3, 3]
        drift = max(drift, float(np.linalg.norm(offset)))
        if drift > bound:
            break
    return drift, q
