"""The promised cap, measured: the push-back of an axis in random poses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from experiments.arms import capacity
from experiments.controllers import UNBLURRED
from experiments.poses import AXES, arm, servos
from experiments.simulation import NOMINAL, run
from pliant import Axis, Settings
from pliant.sim import SpringConstraint
from pliant.sim.hand import Drag, ForceProfile, Twist

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from experiments.poses import Array
    from experiments.simulation import Conditions, Trace
    from pliant import Model, Servos
    from pliant.sim import Hand


#: Caps: 15, 30, 60 % of the arm's median force capacity [N], 7, 14 % of its torque capacity [N·m].
FORCES, TORQUES = (5.0, 10.0, 20.0), (0.5, 1.0)
#: The hand moves WAY times the distance at which the cap is reached, plus MORE [m], for rotations
#: [rad].
WAY, MORE = 1.25, (0.005, 0.03)
#: The force is averaged from SETTLED, when the hand holds still, to END [s].
SETTLED, END = 2.5, 3.0
#: Poses with a smallest singular value below this share of the median are left out.
LEAST_SIGMA = 0.65
#: A pose is clear if all joints are farther than this from their stops [rad]. Otherwise a stop may
#: take part of the push.
CLEAR = 0.15


@dataclass(frozen=True, kw_only=True)
class Case:
    """Push to measure: pose, axis, direction and cap."""

    q: Array
    axis: str
    sign: float
    cap: float

    @property
    def clear(self) -> bool:
        """True if every joint is clear of its stops."""
        room = np.minimum(self.q - arm().lower, np.asarray(arm().upper) - self.q)
        return bool(room.min() >= CLEAR)


@dataclass(frozen=True, kw_only=True)
class CapResult:
    """One axis pushed in one pose: the promise and the force on the hand [N or N·m].

    Attributes:
        axis, sign: Axis and direction of the push.
        cap: Cap of the axis.
        promise: min(F, K_x h (1 - η)|e| / C_jj) at the measured deviation.
        measured: Force on the hand.
        friction: Σ_i |J⁺_ij| τ_f,i, the part that the joints' friction may hide.
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


def evaluate(
    trace: Trace,
    model: Model,
    table: Servos,
    *,
    rows: Sequence[int],
    row: int,
    sign: float,
    cap: float,
) -> CapResult:
    """Compare the force on the hand from 2.5 to 3 s of a push with the promise of a cap.

    Args:
        trace: The push.
        model: The arm.
        table: Its servos.
        rows: Task axes.
        row: Row of the pushed axis.
        sign: Direction.
        cap: Setting [N or N·m].
    """
    still = trace.between(SETTLED, END)
    felt = (trace.force if row < 3 else trace.moment)[still, row % 3]
    jacobian = np.asarray(model.jacobian(trace.q[-1]))
    compliance = float(jacobian[row] ** 2 @ (1.0 / np.asarray(table.kp)))
    inverse = np.linalg.pinv(jacobian[list(rows)])[:, rows.index(row)]
    return CapResult(
        axis=AXES[row],
        sign=sign,
        cap=cap,
        promise=min(cap, abs(float(trace.error[-1, row])) / compliance),
        measured=sign * float(felt.mean()),
        friction=float(np.abs(inverse) @ np.asarray(table.friction)),
    )


def _sigma(q: Array) -> float:
    return float(np.linalg.svd(arm().jacobian(q), compute_uv=False)[-1])


def _compliance(q: Array, axis: int) -> float:
    """Return C_jj, the compliance of an axis by its servos at q (7,) [m/N or rad/(N·m)]."""
    row = arm().jacobian(q)[axis]
    return float(row**2 @ (1.0 / np.asarray(servos().kp)))


@cache
def poses(count: int, margin: float = 0.0, seed: int = 0) -> tuple[Array, ...]:
    """Return random poses (7,) [rad], away from singular ones, by a margin from the stops."""
    model, rng = arm(), np.random.default_rng(seed)
    low, high = np.asarray(model.lower) + margin, np.asarray(model.upper) - margin
    sample = rng.uniform(low, high, (512, model.n))
    sigmas = np.array([_sigma(q) for q in sample])
    good = sample[sigmas > LEAST_SIGMA * np.median(sigmas)]
    return tuple(good[:count])


def cases(count: int, margin: float = 0.0, seed: int = 0) -> Iterator[Case]:
    """Yield promises for `count` poses: every axis and sign, a random cap that the servos can hold.

    Args:
        count: Number of poses.
        margin: Distance of every joint from its stops [rad].
        seed: Random seed.

    Yields:
        One case for each axis and sign.
    """
    rng = np.random.default_rng(seed + 1)
    for q in poses(count, margin, seed):
        for index, axis in enumerate(AXES):
            for sign in (1.0, -1.0):
                cap = float(rng.choice(FORCES if index < 3 else TORQUES))
                if capacity(arm(), servos(), q, index, sign) >= cap:
                    yield Case(q=q, axis=axis, sign=sign, cap=cap)


def keep(case: Case, *, guided: bool = False, conditions: Conditions = NOMINAL) -> CapResult:
    """Drag one axis away from its target, hold it still, and compare the force with the promise.

    Args:
        case: Pose, axis, side and cap.
        guided: True: springs hold the other axes.
        conditions: Loop, bus and assumptions.

    Returns:
        The promise and the force.
    """
    index = AXES.index(case.axis)
    course = ForceProfile(start=0.5, rise=1.0, end=np.inf)
    way = case.sign * (WAY * case.cap * _compliance(case.q, index) + MORE[index // 3])
    hand: Hand
    if index < 3:
        hand = Drag(
            axis=case.axis, distance=way, stiffness=3000.0, limit=80.0, at="tool", course=course
        )
    else:
        hand = Twist(axis=case.axis, angle=way, stiffness=60.0, limit=8.0, course=course)
    scene: list[Hand] = [hand]
    if guided:
        scene.append(SpringConstraint(axes=" ".join(name for name in AXES if name != case.axis)))
    soft = Axis(soft=case.cap, firm=case.cap)
    settings = Settings(axes={case.axis: soft}, **UNBLURRED)
    target = arm().forward_kinematics(case.q)
    trace = run(conditions.build(*scene), conditions.controller(settings), target, END, q=case.q)
    return evaluate(trace, arm(), servos(), rows=range(6), row=index, sign=case.sign, cap=case.cap)
