"""Guided capture of the gravity offset: hold stiff, read the lead, check that the arm stays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import pliant
from pliant.identify.seam import Order, Procedure, drive

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from pliant import Command, Controller, Servos
    from pliant.identify.seam import Arm, Steps, Tick

    Array = NDArray[np.float64]

#: Rate at which the goal integrates while holding [1/s], and the share of the time averaged.
INTEGRATE, AVERAGED = 4.0, 0.25
#: Speed of the tool that still counts as standing [m/s].
STANDING = 2e-3
#: Least and largest share of the believed k_p that `Controller.capture_gravity` takes.
CLIP = (0.3, 3.0)


@dataclass(frozen=True)
class Captured:
    """What a capture found, joint by joint.

    Attributes:
        stiffness: k_g (n,) that serves the gravity offset from now on [N·m/rad].
        believed: k_p of the table (n,) [N·m/rad].
        lead: Goal less position that held the arm (n,) [rad].
        gravity: Torque that holds it by the model (n,) [N·m].
        captured: Joints whose k_g was measured (n,).
        clipped: Joints whose measure was outside 0.3 … 3 × the believed k_p (n,).
        still: Whether the arm stood still before its lead was read.
        drift: How far the tool moved in the check, under the settings in force [m]; NaN without.
        bound: How far it might [m].
        joint_names: For the sentences.
    """

    stiffness: NDArray[np.float64]
    believed: NDArray[np.float64]
    lead: NDArray[np.float64]
    gravity: NDArray[np.float64]
    captured: NDArray[np.bool_]
    clipped: NDArray[np.bool_]
    still: bool
    drift: float
    bound: float
    joint_names: tuple[str, ...]

    @property
    def stays(self) -> bool:
        """Whether it stood still, nothing was clipped, and the check moved the tool too little."""
        return self.still and not self.clipped.any() and not self.drift > self.bound

    def sentences(self) -> list[str]:
        """One sentence per joint, then what the check showed."""
        out = []
        for i, name in enumerate(self.joint_names):
            ratio = self.stiffness[i] / self.believed[i]
            if self.clipped[i]:
                out.append(
                    f"{name}: a lead of {self.lead[i]:+.4f} rad does not fit "
                    f"{self.gravity[i]:+.2f} N·m of gravity; k_g clipped at {ratio:.1f} × the "
                    "believed k_p: wrong payload, a hand on the arm, or a servo that is not what "
                    "its table says."
                )
            elif self.captured[i]:
                out.append(
                    f"{name}: captured, k_g {self.stiffness[i]:.3g} N·m/rad, {ratio:.2f} × the "
                    f"believed k_p (lead {self.lead[i]:+.4f} rad at {self.gravity[i]:+.2f} N·m)."
                )
            else:
                out.append(
                    f"{name}: left as believed; gravity asks only {self.gravity[i]:+.2f} N·m here, "
                    "too near to its friction to tell."
                )
        if not self.still:
            out.append("the arm did not come to rest while holding: capture again, untouched.")
        if self.drift > self.bound:
            out.append(
                f"the check failed: the tool moved {1e3 * self.drift:.1f} mm, more than "
                f"{1e3 * self.bound:.1f} mm; weigh the payload or identify the servos."
            )
        elif np.isfinite(self.drift):
            out.append(f"the check passed: the tool moved {1e3 * self.drift:.1f} mm.")
        return out

    def __str__(self) -> str:
        return "\n".join(self.sentences())


def capture(
    arm: Arm,
    controller: Controller,
    *,
    seconds: float = 2.0,
    check: float = 2.0,
    bound: float = 2e-3,
    loop: Iterable[Tick] | None = None,
) -> Captured:
    """Capture the gravity offset where the arm stands; about four seconds, nobody may touch it.

    Holds every axis with an integrating goal and without feed-forward of friction and damping
    (together they ring), averages the lead, hands it to `Controller.capture_gravity`, puts the
    settings back, also after an error, and then lets the controller hold the arm under them.

    Args:
        arm: The arm, at rest; simulated or connected and enabled.
        controller: Gets the offset; is reset to where the arm stands.
        seconds: How long to hold [s], at least 1.
        check: How long to watch afterwards [s]; 0 for not.
        bound: How far the tool may move meanwhile [m].
        loop: Ticks of a loop of one's own; None for one at the right rate.

    Raises:
        ConfigError: The controller knows no stiffness.
        LimitError: A number out of range.
    """
    return drive(
        arm,
        capturing(controller, seconds=seconds, check=check, bound=bound),
        loop,
        rate=controller.settings.rate,
    )


def capturing(
    controller: Controller, *, seconds: float = 2.0, check: float = 2.0, bound: float = 2e-3
) -> Procedure[Captured]:
    """The procedure of `capture`, for a loop of one's own."""
    servos = controller.servos
    if servos is None:
        raise pliant.ConfigError(
            "capturing gravity needs the believed k_p: Controller(model, settings, servos=…)"
        )
    for name, value, low in (
        ("seconds", seconds, 1.0),
        ("check", check, 0.0),
        ("bound", bound, 0.0),
    ):
        if not low <= value < np.inf:
            raise pliant.LimitError(f"{name} must be at least {low:g}, got {value:g}")
    return Procedure(lambda q: _capture(controller, servos, q, (seconds, check, bound)))


def _capture(
    controller: Controller, servos: Servos, q: Array, numbers: tuple[float, float, float]
) -> Steps[Captured]:
    seconds, check, bound = numbers
    model, before = controller.model, controller.settings
    stiff = pliant.Settings(
        task=before.task,
        rate=before.rate,
        delay=before.delay,
        integrate=INTEGRATE,
        friction_share=0.0,
        damping_share=0.0,
    )
    controller.reset(q)
    target = model.forward_kinematics(q)
    ticks = round(seconds * before.rate)
    kept: list[tuple[Array, Array]] = []
    controller.update(stiff)
    try:
        for _ in range(ticks):
            order = _order(controller.step(q, target))
            kept.append((q, order.goal))
            q = yield order
        tail = kept[-max(round(AVERAGED * ticks), 1) :]
        where, goal = (np.mean([pair[k] for pair in tail], axis=0) for k in (0, 1))
        stiffness = controller.capture_gravity(where, goal)
    finally:
        controller.update(before)
    first, last = (model.forward_kinematics(tail[k][0])[:3, 3] for k in (0, -1))
    counts = float(np.abs(model.jacobian(where)[:3] * np.asarray(servos.count)).sum())
    still = float(np.linalg.norm(last - first)) < STANDING * seconds * AVERAGED + counts
    drift = np.nan
    if check > 0.0:
        drift, q = yield from _watch(controller, q, round(check * before.rate))
    believed = np.array(servos.kp)
    lead, gravity = goal - where, np.asarray(controller.gravity if check else model.gravity(where))
    measured = np.abs(gravity) > 3.0 * np.asarray(servos.friction)
    ratio = stiffness / believed
    return Captured(
        stiffness=np.asarray(stiffness),
        believed=believed,
        lead=lead,
        gravity=gravity,
        captured=measured,
        clipped=measured & ((ratio < CLIP[0] * 1.001) | (ratio > CLIP[1] * 0.999)),
        still=still,
        drift=float(drift),
        bound=bound,
        joint_names=tuple(model.joint_names),
    )


def _order(command: Command) -> Order:
    """A command as an order of one's own."""
    return Order(np.array(command.goal), np.array(command.torque_limit))


def _watch(controller: Controller, q: Array, ticks: int) -> Steps[tuple[float, Array]]:
    """Hold the present pose under the settings in force; how far the tool moves [m]."""
    model = controller.model
    target = model.forward_kinematics(q)
    drift = 0.0
    for _ in range(ticks):
        q = yield _order(controller.step(q, target))
        away = model.forward_kinematics(q)[:3, 3] - target[:3, 3]
        drift = max(drift, float(np.linalg.norm(away)))
    return drift, q
