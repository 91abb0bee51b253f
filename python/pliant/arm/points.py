"""Where the joints and the tool of an arm are, and how fast they would move."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant import Joint, Model

    Array = NDArray[np.float64]


class Points:
    """The origins of the chain's joints and of the tool, base to tip.

    One walk down the chain, each joint a rotation by Rodrigues' formula or a shift:
    ``v ← v + ω × (p' − p)``, then ``ω ← ω + u a`` or ``v ← v + u a``.
    """

    def __init__(self, model: Model) -> None:
        """Collect the joints between base and tip, with the fixed joints between them composed."""
        path: list[Joint] = []
        link = next(item for item in model.links if item.name == model.tip)
        while link.name != model.base and link.parent_joint is not None:
            joint = model.joints[link.parent_joint]
            path.append(joint)
            link = model.links[joint.parent]
        self._steps: list[tuple[int, bool, float, float, Array, Array, Array, Array, Array]] = []
        fixed = np.eye(4)
        for joint in reversed(path):
            fixed = fixed @ np.asarray(joint.origin.matrix)
            axis = np.asarray(joint.axis, dtype=np.float64)
            slides = joint.kind == "prismatic"
            if joint.q_index is None:
                fixed = fixed @ _displacement(axis, slides, _rest(model, joint))
                continue
            rule = joint.mimic
            slope, offset = (1.0, 0.0) if rule is None else (rule.multiplier, rule.offset)
            cross = np.cross(axis, np.eye(3)).T
            turn = fixed[:3, :3].copy(), fixed[:3, 3].copy()
            step = (joint.q_index, slides, slope, offset, axis, cross, cross @ cross, *turn)
            self._steps.append(step)
            fixed = np.eye(4)
        self._tool = fixed[:3, 3].copy()
        self.count = len(self._steps) + 1

    def __call__(self, q: Array) -> Array:
        """Positions (m, 3) [m] of the joint origins, then the tool, at q (n,) [rad], base axes."""
        return self.walk(q, np.zeros_like(q))[0]

    def walk(self, q: Array, u: Array) -> tuple[Array, Array]:
        """Positions (m, 3) [m] and their velocities (m, 3) [m/s] under joint velocities u (n,)."""
        position, velocity = np.empty((self.count, 3)), np.empty((self.count, 3))
        p, v, w, turn = np.zeros(3), np.zeros(3), np.zeros(3), np.eye(3)
        k = 0
        for index, slides, slope, offset, axis, cross, square, rotation, origin in self._steps:
            step = turn @ origin
            p, v = p + step, v + _cross(w, step)
            turn = turn @ rotation
            angle, rate = slope * q[index] + offset, slope * u[index]
            along = turn @ axis
            if slides:
                p, v = p + angle * along, v + rate * along + _cross(w, angle * along)
            else:
                w = w + rate * along
                turn = turn + turn @ (np.sin(angle) * cross + (1.0 - np.cos(angle)) * square)
            position[k], velocity[k] = p, v
            k += 1
        step = turn @ self._tool
        position[k], velocity[k] = p + step, v + _cross(w, step)
        return position, velocity


def _cross(a: Array, b: Array) -> Array:
    """Cross product a × b; NumPy's own takes twenty times as long for three numbers."""
    return np.array(
        (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    )


def _rest(model: Model, joint: Joint) -> float:
    """Where a joint of the chain that no coordinate moves is held [rad or m]."""
    if joint.mimic is None:
        return joint.locked_at or 0.0
    leader = model.joints[joint.mimic.joint]
    return joint.mimic.offset + joint.mimic.multiplier * (leader.locked_at or 0.0)


def _displacement(axis: Array, slides: bool, value: float) -> Array:
    """Pose (4, 4) of a joint at `value`."""
    pose = np.eye(4)
    if slides:
        pose[:3, 3] = value * axis
    elif value:
        cross = np.cross(axis, np.eye(3)).T
        pose[:3, :3] += np.sin(value) * cross + (1.0 - np.cos(value)) * (cross @ cross)
    return pose
