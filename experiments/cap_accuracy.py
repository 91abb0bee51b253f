"""Accuracy of force caps: the force of a soft axis on a hand, in random poses of `arm7`."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from experiments.arms import capacity
from experiments.controllers import NO_RATE_LIMITS
from experiments.poses import AXES, arm, servos
from experiments.simulation import NOMINAL, run
from pliant import Axis, Settings
from pliant.sim import SpringConstraint
from pliant.sim.hand import Drag, ForceProfile, Twist

if TYPE_CHECKING:
    from collections.abc import Iterator

    from experiments.poses import Array
    from experiments.simulation import Conditions
    from pliant.sim import Hand


#: Tested caps of translations [N] and rotations [N·m]: 15, 30, 60 % and 7, 14 % of the median
#: static capacity of `arm7` (`experiments.arms.capacity`).
FORCES, TORQUES = (5.0, 10.0, 20.0), (0.5, 1.0)
#: The hand moves by `DISTANCE_FACTOR` times the deviation at which the cap is reached, plus
#: `EXTRA_DISTANCE`: translations [m], rotations [rad].
DISTANCE_FACTOR, EXTRA_DISTANCE = 1.25, (0.005, 0.03)
#: Start and end of the time in which the force is averaged; the hand is then at rest [s].
SETTLED, END = 2.5, 3.0
#: Smallest accepted singular value of the Jacobian of a pose, as a share of the median over random
#: poses.
LEAST_SIGMA = 0.65
#: A pose counts as clear of stops if every joint is at least this far from its stops [rad].
CLEAR = 0.15


@dataclass(frozen=True, kw_only=True)
class Case:
    """One push: pose q (7,) [rad], axis, direction (1 or -1) and cap of the axis [N or N·m]."""

    q: Array
    axis: str
    sign: float
    cap: float

    @property
    def clear(self) -> bool:
        """True if every joint is at least `CLEAR` from its position limits."""
        room = np.minimum(self.q - arm().lower, np.asarray(arm().upper) - self.q)
        return bool(room.min() >= CLEAR)


@dataclass(frozen=True, kw_only=True)
class CapResult:
    """Expected and measured force of a push on one axis in one pose.

    Attributes:
        cap: Cap F of the axis [N or N·m].
        promise: Expected force min(F, |e| / C_jj) at the measured deviation e of the axis j, with
            the compliance C_jj of the servos' position loops along the axis [N or N·m].
        measured: Mean force on the resting hand [N or N·m].
        friction: Force by the joints' dry friction τ_f, Σ_i |J⁺_ij| τ_f,i over the joints i, with
            the pseudo-inverse J⁺ of the Jacobian [N or N·m].
    """

    cap: float
    promise: float
    measured: float
    friction: float

    @property
    def kept(self) -> bool:
        """True if |measured - promise| is at most 0.15 `cap` + `friction`."""
        return abs(self.measured - self.promise) <= 0.15 * self.cap + self.friction


def _sigma(q: Array) -> float:
    return float(np.linalg.svd(arm().jacobian(q), compute_uv=False)[-1])


def _compliance(q: Array, axis: int) -> float:
    """Return the compliance C_jj of the position loops along an axis at q [m/N or rad/(N·m)]."""
    row = arm().jacobian(q)[axis]
    return float(row**2 @ (1.0 / np.asarray(servos().kp)))


@cache
def poses(count: int, margin: float = 0.0, seed: int = 0) -> tuple[Array, ...]:
    """Return up to `count` random poses (7,) [rad] that are not near a singularity.

    Every joint is at least `margin` [rad] from its stops.
    """
    model, rng = arm(), np.random.default_rng(seed)
    low, high = np.asarray(model.lower) + margin, np.asarray(model.upper) - margin
    sample = rng.uniform(low, high, (512, model.n))
    sigmas = np.array([_sigma(q) for q in sample])
    accepted = sample[sigmas > LEAST_SIGMA * np.median(sigmas)]
    return tuple(accepted[:count])


def cases(count: int, margin: float = 0.0, seed: int = 0) -> Iterator[Case]:
    """Yield pushes along every axis, in both directions, in `count` random poses.

    The cap of each push is random, from `FORCES` or `TORQUES`. A push whose cap the servos cannot
    exert in its pose is omitted.

    Args:
        count: Number of poses.
        margin: Smallest distance of every joint from its stops [rad].
        seed: Random seed.

    Yields:
        At most one case for each pose, axis and direction.
    """
    rng = np.random.default_rng(seed + 1)
    for q in poses(count, margin, seed):
        for index, axis in enumerate(AXES):
            for sign in (1.0, -1.0):
                cap = float(rng.choice(FORCES if index < 3 else TORQUES))
                if capacity(arm(), servos(), q, index, sign) >= cap:
                    yield Case(q=q, axis=axis, sign=sign, cap=cap)


def keep(case: Case, *, guided: bool = False, conditions: Conditions = NOMINAL) -> CapResult:
    """Drag the tool along one soft axis with a hand, hold it, and return the forces on the hand.

    Args:
        case: Pose, axis, direction and cap.
        guided: True: springs hold the other axes; False: the hand leaves them free.
        conditions: Control rate, delays, true servo parameters, assumptions of the controller.

    Returns:
        Expected and measured force.
    """
    index = AXES.index(case.axis)
    course = ForceProfile(start=0.5, rise=1.0, end=np.inf)
    distance = case.sign * (
        DISTANCE_FACTOR * case.cap * _compliance(case.q, index) + EXTRA_DISTANCE[index // 3]
    )
    hand: Hand
    if index < 3:
        hand = Drag(
            axis=case.axis,
            distance=distance,
            stiffness=3000.0,
            limit=80.0,
            at="tool",
            course=course,
        )
    else:
        hand = Twist(axis=case.axis, angle=distance, stiffness=60.0, limit=8.0, course=course)
    scene: list[Hand] = [hand]
    if guided:
        scene.append(SpringConstraint(axes=" ".join(name for name in AXES if name != case.axis)))
    soft = Axis(soft=case.cap, firm=case.cap)
    settings = Settings(axes={case.axis: soft}, **NO_RATE_LIMITS)
    target = arm().forward_kinematics(case.q)
    trace = run(conditions.build(*scene), conditions.controller(settings), target, END, q=case.q)
    last, is_still = trace.q[-1], trace.between(SETTLED, END)
    force = (trace.force if index < 3 else trace.moment)[is_still, index % 3]
    inverse = np.linalg.pinv(arm().jacobian(last))[:, index]
    deviation = abs(float(trace.error[-1, index]))
    return CapResult(
        cap=case.cap,
        promise=min(case.cap, deviation / _compliance(last, index)),
        measured=case.sign * float(force.mean()),
        friction=float(np.abs(inverse) @ np.asarray(servos().friction)),
    )
