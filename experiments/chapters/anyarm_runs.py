"""Runs with any arm, each a picklable call."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import pliant
from experiments import episode, setups
from experiments.chapters import anyarm
from experiments.laws import UNBLURRED
from experiments.setups import AXES
from pliant.sim import Plant
from pliant.sim.hand import Course, Drag, Twist

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from experiments.chapters.anyarm import Arm, Source
    from experiments.episode import Trace
    from pliant.sim import Hand

    Array = NDArray[np.float64]

RATE = 100.0
#: A hand's spring and damper for an arm with caps around 15 N [N/m, N·s/m]; they scale with the
#: caps.
SPRING, DAMPER, USUAL = 2000.0, 30.0, 15.0
#: Distance of the hand in the test of the promise, as a share of the soft axis' range; rotations
#: [rad].
TURN = 0.3
#: Time at which the hand holds still, and the end [s].
STILL, END = 2.5, 3.0
#: Poses of the promise with a smallest singular value below this share of the median are left out.
LEAST_SIGMA = 0.65
#: Promised cap, as a share of the median static capacity, translations and rotations.
CAP_SHARE = (0.30, 0.14)


@dataclass(frozen=True, kw_only=True)
class Strengths:
    """Default strengths of law cap [N]: soft axis at small and large deviation, and when stiff."""

    soft: float
    firm: float
    hold: float


@dataclass(frozen=True, kw_only=True)
class Promise:
    """One axis pushed at one pose: what was promised and what was felt [N or N·m].

    Attributes:
        axis, sign: Of the push.
        cap: Setting.
        promise: min(cap, stiffness × deviation).
        measured: Force on the hand.
        friction: The part that the joints' friction may hide.
    """

    axis: str
    sign: float
    cap: float
    promise: float
    measured: float
    friction: float

    @property
    def kept(self) -> bool:
        """True if the force is within 15 % of the cap and the friction of its promise."""
        return abs(self.measured - self.promise) <= 0.15 * self.cap + self.friction


def _loop(
    arm: Arm,
    settings: pliant.Settings,
    target: Array | episode.Target,
    duration: float,
    *scene: Hand,
    q: Array,
) -> Trace:
    plant = Plant(arm.model, arm.servos, rate=RATE, count=arm.servos.encoder_step, scene=scene)
    controller = pliant.Controller(arm.model, settings.replace(rate=RATE), arm.servos)
    return episode.run(plant, controller, target, duration, q=q)


def activation(source: Source) -> Array:
    """Return the activation matrix (n, k + 1) at the pose."""
    arm = anyarm.load(source)
    controller = pliant.Controller(
        arm.model, arm.law(soft="", tracking=pliant.Tracking(damping=0.0)), arm.servos
    )
    controller.reset(arm.pose)
    controller.step(arm.pose, arm.model.forward_kinematics(arm.pose))
    return np.asarray(controller.diagnostics.activation)


def strengths(source: Source) -> Strengths:
    """Read the default strengths from the controller: near its target, far from it, stiff."""
    arm = anyarm.load(source)
    start = np.asarray(arm.model.forward_kinematics(arm.pose))
    row = arm.axes.index(arm.soft)

    def strength(soft: str, away: float) -> float:
        controller = pliant.Controller(arm.model, arm.law(soft=soft), arm.servos)
        controller.reset(arm.pose)
        controller.step(arm.pose, setups.displaced(start, arm.soft, away))
        return float(controller.diagnostics.axis_strength[row])

    # Far from the target, but within the range allowed for a target.
    far = min(1.0, float(arm.model.reach))
    return Strengths(
        soft=strength(arm.soft, 0.0), firm=strength(arm.soft, far), hold=strength("", 0.0)
    )


def hand(arm: Arm, distance: float, strongest: float) -> Drag:
    """Return a hand that is stiff and strong enough for this arm, at the tool."""
    scale = max(strongest / USUAL, 0.05)
    return Drag(
        axis=arm.soft,
        distance=distance,
        stiffness=SPRING * scale,
        damping=DAMPER * scale,
        limit=8.0 * strongest,
        at="tool",
    )


def drag(source: Source, kind: str, eta: float, sign: int) -> Trace:
    """Drag the soft axis from 2 to 5 s and let go; 9 s.

    Args:
        source: The arm.
        kind: `soft`, or `stiff` for all axes stiff.
        eta: Target adaptation.
        sign: Direction.

    Returns:
        The run.
    """
    arm = anyarm.load(source)
    firm = strengths(source).firm
    settings = arm.law(soft="" if kind == "stiff" else arm.soft, eta=eta)
    target = np.asarray(arm.model.forward_kinematics(arm.pose))
    return _loop(arm, settings, target, 9.0, hand(arm, sign * arm.way, firm), q=arm.pose)


def swing(source: Source) -> Trace:
    """Let the target swing twice along the soft axis, η = 0; 17 s."""
    arm = anyarm.load(source)
    start = np.asarray(arm.model.forward_kinematics(arm.pose))
    target = setups.sinusoid(start, arm.soft, arm.way)
    return _loop(arm, arm.law(), target, 17.0, q=arm.pose)


def poses(source: Source, count: int) -> list[Array]:
    """Return well conditioned random poses that hold themselves."""
    arm = anyarm.load(source)
    sampled = anyarm.sample(arm.model, inner=0.8, seed=1)
    sigmas = np.array([anyarm.sigma(arm.model, q, arm.axes) for q in sampled])
    good = sampled[sigmas > LEAST_SIGMA * np.median(sigmas)]
    return list(good[:count])


def caps(source: Source) -> tuple[float, float]:
    """Return the promised caps [N], [N·m]: shares of the median capacity."""
    arm = anyarm.load(source)
    found = []
    for group, share in enumerate(CAP_SHARE):
        rows = [row for row in arm.rows if row // 3 == group]
        values = [
            anyarm.capacity(arm.model, arm.servos, q, row, sign)
            for q in anyarm.sample(arm.model, 128)
            for row in rows
            for sign in (1.0, -1.0)
        ]
        finite = [v for v in values if np.isfinite(v) and v > 0.0]
        found.append(share * float(np.median(finite)) if finite else 0.0)
    return found[0], found[1]


def promises(source: Source, pose: int, count: int) -> list[Promise]:
    """Push every axis of one of `count` poses both ways and compare with the promise."""
    arm = anyarm.load(source)
    chosen = poses(source, count)
    if pose >= len(chosen):
        return []
    q = chosen[pose]
    limits = caps(source)
    return [
        _promise(arm, q, row, sign, limits[row // 3])
        for row in arm.rows
        for sign in (1.0, -1.0)
        if anyarm.capacity(arm.model, arm.servos, q, row, sign) >= limits[row // 3]
    ]


def _promise(arm: Arm, q: Array, row: int, sign: float, cap: float) -> Promise:
    name = AXES[row]
    course = Course(start=0.5, rise=1.0, end=np.inf)
    if row < 3:
        scale = max(cap / USUAL, 0.05)
        felt_by: Hand = Drag(
            axis=name,
            distance=sign * min(arm.way, 0.08),
            stiffness=SPRING * scale,
            damping=DAMPER * scale,
            limit=8.0 * cap,
            at="tool",
            course=course,
        )
    else:
        felt_by = Twist(
            axis=name,
            angle=sign * TURN,
            stiffness=60.0 * cap,
            damping=cap,
            limit=8.0 * cap,
            course=course,
        )
    settings = pliant.Settings(
        task=pliant.Task(axes=" ".join(arm.axes)),
        axes={name: pliant.Axis(soft=cap, firm=cap)},
        **UNBLURRED,
    )
    target = np.asarray(arm.model.forward_kinematics(q))
    trace = _loop(arm, settings, target, END, felt_by, q=q)
    still = trace.between(STILL, END)
    felt = (trace.force if row < 3 else trace.moment)[still, row % 3]
    jacobian = np.asarray(arm.model.jacobian(trace.q[-1]))
    compliance = float((jacobian[row] ** 2) @ (1.0 / np.asarray(arm.servos.kp)))
    inverse = np.linalg.pinv(jacobian[arm.rows])[:, arm.rows.index(row)]
    return Promise(
        axis=name,
        sign=sign,
        cap=cap,
        promise=min(cap, abs(float(trace.error[-1, row])) / compliance),
        measured=sign * float(felt.mean()),
        friction=float(np.abs(inverse) @ np.asarray(arm.servos.friction)),
    )
