"""The tree of a robot, cut into rigid groups."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pliant._core import ConfigError
from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Matrix = NDArray[np.float64]

#: A `pliant.Model`: its tree (`links`, `joints`) and its chain (`joint_names`, `base`, `tip`).
Robot = Any

OffChain = Literal["held", "welded"]


@dataclass
class Group:
    """Links without relative motion: one body, whose frame is that of its first link."""

    link: int
    joint: int | None
    parent: int | None
    pose: Matrix
    members: list[tuple[int, Matrix]] = field(default_factory=list)


def groups(model: Robot, off_chain: OffChain) -> list[Group]:
    """Cut the tree into rigid groups, parents first."""
    children: dict[int, list[int]] = {}
    for index, joint in enumerate(model.joints):
        children.setdefault(joint.parent, []).append(index)
    root = next(i for i, link in enumerate(model.links) if link.parent_joint is None)
    base = next(i for i, link in enumerate(model.links) if link.name == model.base)
    groups = [Group(root, None, None, np.eye(4))]
    stack = [(root, 0, np.eye(4), False)]
    base_pose: Matrix = np.eye(4)
    while stack:
        link, group, pose, carried = stack.pop()
        groups[group].members.append((link, pose))
        if link == base:
            base_pose = pose
        for index in reversed(children.get(link, [])):
            joint = model.joints[index]
            at = pose @ as_matrix(joint.origin)
            rides = carried or joint.q_index is not None
            if _moves(model, joint, carried, off_chain):
                groups.append(Group(joint.child, index, group, at))
                stack.append((joint.child, len(groups) - 1, np.eye(4), rides))
            else:
                stack.append((joint.child, group, at @ _moved(model, joint), rides))
    groups[0].pose = np.asarray(np.linalg.inv(base_pose), dtype=np.float64)
    return groups


def _moves(model: Robot, joint: Any, carried: bool, off_chain: OffChain) -> bool:
    """Return True if a joint stays a joint in the simulation."""
    kind = kind_of(joint)
    if kind == "fixed":
        return False
    if kind not in {"revolute", "continuous", "prismatic"}:
        raise ConfigError(
            f"joint {joint.name!r} is {kind!r}; "
            "the simulator knows revolute, continuous, prismatic and fixed"
        )
    if joint.q_index is not None:
        return True
    if joint.mimic is not None and not carried:
        return False
    return carried and off_chain == "held"


def locked_angle(joint: Any) -> float:
    """Return the angle at which the model locks an off-chain joint [rad]."""
    return float(getattr(joint, "locked_at", None) or 0.0)


def _moved(model: Robot, joint: Any) -> Matrix:
    """Return the displacement (4, 4) of a welded joint at its locked angle."""
    pose = np.eye(4)
    angle = locked_angle(joint)
    if joint.mimic is not None:
        driver = model.joints[joint.mimic.joint]
        angle = joint.mimic.offset + joint.mimic.multiplier * locked_angle(driver)
    if kind_of(joint) == "fixed" or angle == 0.0:
        return pose
    axis = unit(joint.axis)
    if kind_of(joint) == "prismatic":
        pose[:3, 3] = angle * axis
    else:
        quat, matrix = np.zeros(4), np.zeros(9)
        mujoco.mju_axisAngle2Quat(quat, axis, angle)
        mujoco.mju_quat2Mat(matrix, quat)
        pose[:3, :3] = matrix.reshape(3, 3)
    return pose


def as_matrix(pose: Any) -> Matrix:
    """Return a pose as a (4, 4) array; accepts arrays and objects with a `matrix`."""
    value = getattr(pose, "matrix", pose)
    return np.asarray(value() if callable(value) else value, dtype=np.float64).reshape(4, 4)


def kind_of(joint: Any) -> str:
    """Return the joint kind in lower case: revolute, continuous, prismatic, fixed or other."""
    return str(joint.kind).rsplit(".", maxsplit=1)[-1].lower()


def unit(axis: Any) -> NDArray[np.float64]:
    """Return the unit vector (3,) of an axis."""
    array = np.asarray(axis, dtype=np.float64)
    return array / np.linalg.norm(array)


def quat_of(pose: Matrix) -> NDArray[np.float64]:
    """Return the quaternion wxyz of a pose (4, 4)."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(pose[:3, :3]).reshape(9))
    return quat


def last_moving(model: Robot) -> str:
    """Return the name of the last link that the chain moves; its origin is the wrist centre."""
    link = next(i for i, item in enumerate(model.links) if item.name == model.tip)
    while model.links[link].parent_joint is not None:
        joint = model.joints[model.links[link].parent_joint]
        if joint.q_index is not None:
            break
        link = joint.parent
    return str(model.links[link].name)
