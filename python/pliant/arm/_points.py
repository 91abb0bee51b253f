"""Positions, Jacobians and inertia of the points of an arm: joint origins and tool."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pliant._core import Model
    from pliant._typing import Array
    from pliant.model import Joint


@dataclass(frozen=True, kw_only=True)
class Body:
    """One rigid body, in the frame that its joint moves.

    Attributes:
        mass: [kg].
        com: Centre of mass (3,) [m].
        inertia: About the centre of mass (3, 3) [kg·m²].
    """

    mass: float
    com: Array
    inertia: Array


def link_bodies(model: Model, tool: Array) -> list[Body]:
    """Return the body that each moving joint between base and tip carries, in chain order.

    Joints off the chain are fixed at the model's values. The payload is a point mass in the last
    body.

    Args:
        model: The arm.
        tool: Pose (4, 4) of the tool in the frame that the last joint moves.
    """
    moving = [joint for joint in chain_joints(model) if joint.q_index is not None]
    chain = {joint.child: k for k, joint in enumerate(moving)}
    parts: list[list[tuple[float, Array, Array]]] = [[] for _ in moving]
    for index, link in enumerate(model.links):
        found = _attachment(model, index, chain)
        if link.inertial is None or found is None:
            continue
        k, pose = found
        turn = pose[:3, :3] @ np.asarray(link.inertial.rotation)
        com = pose[:3, :3] @ np.asarray(link.inertial.com) + pose[:3, 3]
        inertia = turn @ np.asarray(link.inertial.inertia) @ turn.T
        parts[k].append((link.inertial.mass, com, inertia))
    if model.payload is not None:
        com = tool[:3, :3] @ np.asarray(model.payload.com) + tool[:3, 3]
        parts[-1].append((model.payload.mass, com, np.zeros((3, 3))))
    return [_combine(part) for part in parts]


def chain_joints(model: Model) -> list[Joint]:
    """Return the joints from base to tip, fixed joints included."""
    found: list[Joint] = []
    link = next(item for item in model.links if item.name == model.tip)
    while link.name != model.base and link.parent_joint is not None:
        joint = model.joints[link.parent_joint]
        found.append(joint)
        link = model.links[joint.parent]
    return found[::-1]


def fixed_pose(model: Model, joint: Joint) -> Array:
    """Return the pose (4, 4) of the link below a joint off the chain, in the link above it."""
    here = displacement(np.asarray(joint.axis), joint.kind == "prismatic", _rest(model, joint))
    pose: Array = np.asarray(joint.origin.matrix) @ here
    return pose


def displacement(axis: Array, slides: bool, value: float) -> Array:
    """Return the pose (4, 4) of a joint displaced by `value` [rad or m]."""
    pose = np.eye(4)
    if slides:
        pose[:3, 3] = value * axis
    elif value:
        cross = np.cross(axis, np.eye(3)).T
        pose[:3, :3] += np.sin(value) * cross + (1.0 - np.cos(value)) * (cross @ cross)
    return pose


def _attachment(model: Model, index: int, chain: dict[int, int]) -> tuple[int, Array] | None:
    """Return the chain joint that moves a link, and the link's pose (4, 4) in its frame."""
    pose = np.eye(4)
    while index not in chain:
        above = model.links[index].parent_joint
        if above is None:
            return None
        joint = model.joints[above]
        pose, index = fixed_pose(model, joint) @ pose, joint.parent
    return chain[index], pose


def _combine(parts: list[tuple[float, Array, Array]]) -> Body:
    """Combine rigid parts into one body."""
    mass = sum(part[0] for part in parts)
    if mass <= 0.0:
        return Body(mass=0.0, com=np.zeros(3), inertia=np.zeros((3, 3)))
    com = sum((part[0] * part[1] for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for each, place, own in parts:
        arm = place - com
        inertia += own + each * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Body(mass=mass, com=com, inertia=inertia)


def _rest(model: Model, joint: Joint) -> float:
    """Return the fixed value of a joint off the chain [rad or m]."""
    if joint.mimic is None:
        return joint.locked_at or 0.0
    leader = model.joints[joint.mimic.joint]
    return joint.mimic.offset + joint.mimic.multiplier * (leader.locked_at or 0.0)


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
        for joint in chain_joints(model):
            if joint.q_index is None:
                fixed = fixed @ fixed_pose(model, joint)
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
        bodies = link_bodies(model, fixed)
        self._com = np.array([body.com for body in bodies])
        self._root_mass = np.sqrt([body.mass for body in bodies])[:, None, None]
        # A square root of each body's inertia turns ωᵀIω into a sum of squares.
        self._root_inertia = np.array([_matrix_root(body.inertia).T for body in bodies])
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


def _matrix_root(inertia: Array) -> Array:
    """Return R (3, 3) with R Rᵀ = I for a symmetric, semi-definite I."""
    values, vectors = np.linalg.eigh(inertia)
    root: Array = vectors * np.sqrt(np.maximum(values, 0.0))
    return root
