"""Rigid bodies of an arm: for each joint of the chain, all links up to the next joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant._core import Model
    from pliant.model import Joint

    Array = NDArray[np.float64]


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


def carried(model: Model, tool: Array) -> list[Body]:
    """Return the body that each moving joint between base and tip carries, in chain order.

    Joints off the chain are fixed at the model's values. The payload is a point mass in the last
    body.

    Args:
        model: The arm.
        tool: Pose (4, 4) of the tool in the frame that the last joint moves.
    """
    moving = [joint for joint in path(model) if joint.q_index is not None]
    chain = {joint.child: k for k, joint in enumerate(moving)}
    parts: list[list[tuple[float, Array, Array]]] = [[] for _ in moving]
    for index, link in enumerate(model.links):
        found = _seat(model, index, chain)
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
    return [_together(part) for part in parts]


def path(model: Model) -> list[Joint]:
    """Return the joints from base to tip, fixed joints included."""
    found: list[Joint] = []
    link = next(item for item in model.links if item.name == model.tip)
    while link.name != model.base and link.parent_joint is not None:
        joint = model.joints[link.parent_joint]
        found.append(joint)
        link = model.links[joint.parent]
    return found[::-1]


def held(model: Model, joint: Joint) -> Array:
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


def _seat(model: Model, index: int, chain: dict[int, int]) -> tuple[int, Array] | None:
    """Return the chain joint that moves a link, and the link's pose (4, 4) in its frame."""
    pose = np.eye(4)
    while index not in chain:
        above = model.links[index].parent_joint
        if above is None:
            return None
        joint = model.joints[above]
        pose, index = held(model, joint) @ pose, joint.parent
    return chain[index], pose


def _together(parts: list[tuple[float, Array, Array]]) -> Body:
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
