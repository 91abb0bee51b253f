"""Any arm: its servos, pose and task axes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

import pliant
from experiments import laws
from experiments.setups import AXES
from pliant import ConfigError, robots
from pliant.sim._parameters import ARMATURE_SHARE, DAMPING_SHARE, FRICTION_SHARE, FULL_EFFORT_ERROR
from pliant.sim.postures import task_axes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: Number of poses searched for a good one, and the inner share of the joint ranges they come from.
POSES, INNER = 512, 0.6
#: Assumed effort where none is known: this multiple of the largest torque that holds the arm, at
#: least [N·m].
STRONG_ENOUGH, LEAST_EFFORT = 4.0, 0.5
#: Distance of the soft axis, as a share of the reach, within [m].
WAY_SHARE, WAY_RANGE = 0.2, (0.03, 0.15)
#: Steps in which a motion is checked beforehand.
STEPS = 12
#: Share of the usable torque that gravity may take in a chosen pose.
GRAVITY_SHARE = 0.6


@dataclass(frozen=True)
class Source:
    """Source of an arm: a built-in one by name, or a URDF with base and tip."""

    name: str = ""
    urdf: str = ""
    base: str | None = None
    tip: str | None = None


@dataclass(frozen=True)
class Arm:
    """An arm ready for the experiments.

    Attributes:
        model: The arm.
        servos: Its servos, known or guessed.
        axes: Task axes that its joints can control.
        soft: The compliant axis.
        pose: Joint positions (n,) [rad] of the experiments.
        way: Distance that the soft axis can move from there, both ways [m].
        notes: Assumptions that were made.
    """

    model: pliant.Model
    servos: pliant.Servos
    axes: tuple[str, ...]
    soft: str
    pose: Array
    way: float
    notes: tuple[str, ...]

    @property
    def rows(self) -> list[int]:
        """Indices of the task axes in a 6-vector."""
        return [AXES.index(name) for name in self.axes]

    @property
    def where(self) -> str:
        """The pose as text."""
        angles = ", ".join(f"{angle:.2f}" for angle in self.pose)
        return (
            f"pose ({angles}) rad, the best conditioned of {POSES} random ones that hold "
            "themselves easily and let the soft axis move"
        )

    def law(self, *, soft: str | None = None, eta: float = 0.0, **more: Any) -> pliant.Settings:
        """Law cap with the defaults of this arm."""
        task = pliant.Task(axes=" ".join(self.axes))
        return laws.cap(soft=self.soft if soft is None else soft, eta=eta, task=task, **more)


@cache
def load(source: Source) -> Arm:
    """Load an arm, guess unknown servo parameters, and find a pose.

    Args:
        source: Source of the arm.

    Returns:
        The arm.

    Raises:
        PliantError: The URDF is rejected, or no pose lets the soft axis move.
    """
    model, servos, notes = _built_in(source.name) if source.name else _from_urdf(source)
    if model.n < 2:
        raise ConfigError(f"the chain has {model.n} joint; the experiments need at least 2")
    axes = task_axes(model.n)
    soft = "y" if "y" in axes else "x"
    way = float(np.clip(WAY_SHARE * _reach(model), *WAY_RANGE))
    pose, way = _find_pose(model, servos, axes, soft, way)
    return Arm(model, servos, axes, soft, pose, way, tuple(notes))


def _built_in(name: str) -> tuple[pliant.Model, pliant.Servos, list[str]]:
    model = robots.load(name)
    if model.servos is None:
        raise ConfigError(f"the built-in arm {name!r} has no servos")
    return model, model.servos, []


def _from_urdf(source: Source) -> tuple[pliant.Model, pliant.Servos, list[str]]:
    """Load the user's arm and guess its servos from its efforts."""
    model = pliant.Model.from_urdf(source.urdf, base=source.base, tip=source.tip)
    effort = np.array(model.effort_limit, dtype=np.float64)
    unknown = ~(effort > 0.0)
    notes = [
        "No servo data: stiffness, friction, damping and rotor inertia are guessed from the effort "
        f"limits of the URDF (k_p = effort / {FULL_EFFORT_ERROR} rad, friction "
        f"{FRICTION_SHARE:.0%}, damping {DAMPING_SHARE:.0%} s/rad of the effort). The numbers show "
        "what the law does with such servos, not what this arm does."
    ]
    if unknown.any():
        effort[unknown] = np.maximum(STRONG_ENOUGH * _holding(model)[unknown], LEAST_EFFORT)
        names = ", ".join(name for name, odd in zip(model.joint_names, unknown, strict=True) if odd)
        notes.append(
            f"No effort limit either for {names}: {STRONG_ENOUGH:g} times the largest torque that "
            "holds the arm was taken."
        )
    kp = effort / FULL_EFFORT_ERROR
    servos = pliant.Servos(
        kp=kp,
        max_torque=effort,
        friction=FRICTION_SHARE * effort,
        damping=DAMPING_SHARE * effort,
        armature=ARMATURE_SHARE * kp,
        stiffness_known=True,
    )
    return model, servos, notes


def ranges(model: pliant.Model) -> tuple[Array, Array]:
    """Return joint limits (n,), ±π for joints without."""
    lower, upper = np.asarray(model.lower), np.asarray(model.upper)
    return np.where(np.isfinite(lower), lower, -np.pi), np.where(np.isfinite(upper), upper, np.pi)


def sample(model: pliant.Model, count: int = POSES, *, inner: float = 1.0, seed: int = 0) -> Array:
    """Return random poses (count, n) from the inner share of the joint ranges."""
    lower, upper = ranges(model)
    middle, half = (lower + upper) / 2, inner * (upper - lower) / 2
    return np.random.default_rng(seed).uniform(middle - half, middle + half, (count, model.n))


def _holding(model: pliant.Model) -> Array:
    torques: Array = np.abs([model.gravity(q) for q in sample(model)]).max(axis=0)
    return torques


def _reach(model: pliant.Model) -> float:
    """Return the largest distance of the tool from the origin of the base in random poses [m]."""
    places = [model.forward_kinematics(q)[:3, 3] for q in sample(model, 128)]
    return float(np.ptp(np.array(places), axis=0).max() / 2)


def sigma(model: pliant.Model, q: Array, axes: tuple[str, ...]) -> float:
    """Return the smallest singular value of the task rows, translations divided by the reach."""
    rows = np.asarray(model.jacobian(q))[[AXES.index(name) for name in axes]].copy()
    rows[[AXES.index(name) < 3 for name in axes]] /= _cached_reach(model)
    return float(np.linalg.svd(rows, compute_uv=False).min())


_REACH: dict[int, float] = {}


def _cached_reach(model: pliant.Model) -> float:
    return _REACH.setdefault(id(model), _reach(model))


def capacity(model: pliant.Model, servos: pliant.Servos, q: Array, axis: int, sign: float) -> float:
    """Return the largest push [N or N·m] along an axis that the servos hold at q (n,)."""
    lever = sign * np.asarray(model.jacobian(q))[axis]
    felt = np.abs(lever) > 1e-6
    if not felt.any():
        return float("inf")
    room = np.asarray(servos.max_torque) + np.sign(lever) * model.gravity(q)
    return float((room[felt] / np.abs(lever[felt])).min())


def _find_pose(
    model: pliant.Model, servos: pliant.Servos, axes: tuple[str, ...], soft: str, way: float
) -> tuple[Array, float]:
    """Return the best conditioned pose that lets the soft axis move both ways."""
    usable = np.asarray(servos.max_torque)
    light = [
        q
        for q in sample(model, inner=INNER)
        if np.all(np.abs(model.gravity(q)) <= GRAVITY_SHARE * usable)
    ]
    ranked = sorted(light, key=lambda q: -sigma(model, q, axes))
    for share in (1.0, 0.6, 0.35):
        for q in ranked[:100]:
            if all(_can_move(model, q, axes, soft, side * share * way) for side in (1.0, -1.0)):
                return q, share * way
    raise ConfigError(
        f"among {POSES} poses none lets {soft} move by {0.35 * way:.3f} m within the joint limits "
        "and torques"
    )


def _can_move(model: pliant.Model, q: Array, axes: tuple[str, ...], soft: str, way: float) -> bool:
    """Return True if the soft axis can move that far within limits, away from singular poses."""
    lower, upper = ranges(model)
    rows = [AXES.index(name) for name in axes]
    least = 0.4 * sigma(model, q, axes)
    motion = np.zeros(len(rows))
    motion[axes.index(soft)] = way / STEPS
    margin = 0.02 * (upper - lower)
    at = q.copy()
    for _ in range(STEPS):
        at = at + np.linalg.pinv(np.asarray(model.jacobian(at))[rows]) @ motion
        if (
            np.any(at < lower + margin)
            or np.any(at > upper - margin)
            or sigma(model, at, axes) < least
        ):
            return False
    return True
