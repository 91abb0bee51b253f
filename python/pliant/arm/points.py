"""Positions, Jacobians and inertia of the points of an arm: joint origins and tool."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant.arm.bodies import carried, held, path

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from pliant._core import Model

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Step:
    """One moving joint: index, slope and offset of its coordinate, axis, and fixed transform."""

    index: int
    slides: bool
    slope: float
    offset: float
    axis: Array
    cross: Array
    square: Array
    rotation: Array
    origin: Array


@dataclass(frozen=True, slots=True)
class Geometry:
    """The arm's points in one posture.

    Attributes:
        position: Origins of the m - 1 moving joints, base to tip, then the tool (m, 3) [m], base
            axes.
        jacobian: Their Jacobians (m, 3, n) [m/rad].
        inertia: Joint-space inertia matrix with the rotors (n, n) [kg·m²].
    """

    position: Array
    jacobian: Array
    inertia: Array

    def velocity(self, u: Array) -> Array:
        """Velocities of the points (m, 3) [m/s] for joint velocities u (n,) [rad/s]."""
        v: Array = self.jacobian @ u
        return v

    def energy(self, u: Array) -> float:
        """Kinetic energy [J] for joint velocities u (n,) [rad/s]."""
        return 0.5 * float(u @ self.inertia @ u)

    def effective_mass(self, velocity: Array) -> Array:
        """Mass (m,) [kg] that each point has along its own velocity (m, 3) [m/s].

        ``1 / (dᵀ J M⁻¹ Jᵀ d)`` with d the direction of the velocity (Khatib 1995); 0 for a point
        with zero velocity.
        """
        speed = np.sqrt((velocity**2).sum(axis=1))
        direction = velocity / np.maximum(speed, 1e-12)[:, None]
        rows = (direction[:, None, :] @ self.jacobian)[:, 0, :]
        mobility = (rows * np.linalg.solve(self.inertia, rows.T).T).sum(axis=1)
        mass: Array = np.where(speed > 1e-9, 1.0 / np.maximum(mobility, 1e-9), 0.0)
        return mass


class Points:
    """The origins of the chain's joints and of the tool, and the bodies between them.

    Attributes:
        count: Number of points m.
    """

    def __init__(self, model: Model, armature: ArrayLike = 0.0) -> None:
        """Collect the joints between base and tip, with the fixed joints between them composed.

        Args:
            model: The arm.
            armature: Inertia of the servos' rotors, seen at the joints (n,) [kg·m²].
        """
        self._steps: list[_Step] = []
        fixed = np.eye(4)
        for joint in path(model):
            if joint.q_index is None:
                fixed = fixed @ held(model, joint)
                continue
            fixed = fixed @ np.asarray(joint.origin.matrix)
            axis = np.asarray(joint.axis, dtype=np.float64)
            rule = joint.mimic
            slope, offset = (1.0, 0.0) if rule is None else (rule.multiplier, rule.offset)
            cross = np.cross(axis, np.eye(3)).T
            slides, turn = joint.kind == "prismatic", (fixed[:3, :3].copy(), fixed[:3, 3].copy())
            of = joint.q_index, slides, slope, offset
            self._steps.append(_Step(*of, axis, cross, cross @ cross, *turn))
            fixed = np.eye(4)
        count = len(self._steps)
        self._tool = fixed[:3, 3].copy()
        bodies = carried(model, fixed)
        self._com = np.array([body.com for body in bodies])
        self._root_mass = np.sqrt([body.mass for body in bodies])[:, None, None]
        # A square root of each body's inertia turns ωᵀIω into a sum of squares.
        self._root_inertia = np.array([_root(body.inertia).T for body in bodies])
        self._armature = np.diag(np.broadcast_to(np.asarray(armature, dtype=np.float64), model.n))
        self._slides = np.array([step.slides for step in self._steps])
        # Coordinates: joints that mimic others share a column.
        self._columns = np.zeros((count, model.n))
        for k, step in enumerate(self._steps):
            self._columns[k, step.index] = step.slope
        self.count = count + 1
        self._moves_point = np.tri(self.count, count)[:, None, :]
        self._moves_body = np.tri(count)[:, None, :]

    def __call__(self, q: Array) -> Geometry:
        """Geometry at q (n,) [rad]."""
        count = len(self._steps)
        position, axes = np.empty((count + 1, 3)), np.empty((count, 3))
        turns = np.empty((count, 3, 3))
        p, turn = np.zeros(3), np.eye(3)
        for k, step in enumerate(self._steps):
            p = p + turn @ step.origin
            turn = turn @ step.rotation
            angle = step.slope * q[step.index] + step.offset
            axes[k] = turn @ step.axis
            if step.slides:
                p = p + angle * axes[k]
            else:
                turn = turn + turn @ (
                    np.sin(angle) * step.cross + (1.0 - np.cos(angle)) * step.square
                )
            position[k], turns[k] = p, turn
        position[-1] = p + turn @ self._tool
        coms = position[:-1] + (turns @ self._com[:, :, None])[:, :, 0]
        jacobian = self._lever(position, position[:-1], axes) * self._moves_point
        of_coms = self._lever(coms, position[:-1], axes) * self._moves_body * self._root_mass
        spin = np.where(self._slides, 0.0, axes.T) * self._moves_body
        of_turns = self._root_inertia @ turns.transpose(0, 2, 1) @ spin
        stacked = np.concatenate((of_coms, of_turns)).reshape(-1, count) @ self._columns
        return Geometry(
            position=position,
            jacobian=jacobian @ self._columns,
            inertia=stacked.T @ stacked + self._armature,
        )

    def _lever(self, at: Array, origins: Array, axes: Array) -> Array:
        """Return velocities (k, 3, joints) of points `at` (k, 3) for unit speed of each joint."""
        arm = at[:, None, :] - origins[None, :, :]
        turning = np.empty_like(arm)
        for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
            turning[..., i] = axes[:, j] * arm[..., k] - axes[:, k] * arm[..., j]
        lever: Array = np.where(self._slides[None, :, None], axes[None, :, :], turning)
        return lever.transpose(0, 2, 1)


def _root(inertia: Array) -> Array:
    """Return R (3, 3) with R Rᵀ = I for a symmetric, semi-definite I."""
    values, vectors = np.linalg.eigh(inertia)
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root
