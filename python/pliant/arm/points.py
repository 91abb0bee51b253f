"""Where the joints and the tool of an arm are, how fast they move, and with what energy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant.arm.bodies import Body, carried, held, path

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from pliant import Model

    Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _Step:
    """One moving joint: index and slope of its coordinate, its axis, what leads to it."""

    index: int
    slides: bool
    slope: float
    offset: float
    axis: Array
    cross: Array
    square: Array
    rotation: Array
    origin: Array


class Points:
    """The origins of the chain's joints and of the tool, base to tip, and the bodies between them.

    One walk down the chain, each joint a rotation by Rodrigues' formula or a shift:
    ``v ← v + ω × (p' − p)``, then ``ω ← ω + u a`` or ``v ← v + u a``. The kinetic energy is
    ``½ Σ (m |v_c|² + ωᵀ I ω) + ½ Σ J u²`` with the rotors' inertia J, seen through their gears.

    Attributes:
        count: How many points there are, m.
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
        self._tool = fixed[:3, 3].copy()
        self._bodies: list[Body] = carried(model, fixed)
        self._armature = np.asarray(armature, dtype=np.float64)
        self.count = len(self._steps) + 1

    def __call__(self, q: Array) -> Array:
        """Positions (m, 3) [m] of the joint origins, then the tool, at q (n,) [rad], base axes."""
        return self.walk(q, np.zeros_like(q))[0]

    def walk(self, q: Array, u: Array) -> tuple[Array, Array, float]:
        """Follow joint velocities u (n,) [rad/s] at q (n,) [rad].

        Returns:
            Positions (m, 3) [m], their velocities (m, 3) [m/s], and the kinetic energy [J].
        """
        position, velocity = np.empty((self.count, 3)), np.empty((self.count, 3))
        p, v, w, turn = np.zeros(3), np.zeros(3), np.zeros(3), np.eye(3)
        twice = float((self._armature * u**2).sum())
        for k, (joint, body) in enumerate(zip(self._steps, self._bodies, strict=True)):
            step = turn @ joint.origin
            p, v = p + step, v + _cross(w, step)
            turn = turn @ joint.rotation
            angle, rate = joint.slope * q[joint.index] + joint.offset, joint.slope * u[joint.index]
            along = turn @ joint.axis
            if joint.slides:
                p, v = p + angle * along, v + rate * along + _cross(w, angle * along)
            else:
                w = w + rate * along
                turn = turn + turn @ (
                    np.sin(angle) * joint.cross + (1.0 - np.cos(angle)) * joint.square
                )
            position[k], velocity[k] = p, v
            centre, spin = v + _cross(w, turn @ body.com), w @ turn
            twice += body.mass * float(centre @ centre) + float(spin @ body.inertia @ spin)
        step = turn @ self._tool
        position[-1], velocity[-1] = p + step, v + _cross(w, step)
        return position, velocity, 0.5 * twice


def _cross(a: Array, b: Array) -> Array:
    """Cross product a × b; NumPy's own takes twenty times as long for three numbers."""
    return np.array(
        (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    )
