"""Conversion of a `pliant.Model` to a MuJoCo specification.

Links without relative motion become one MuJoCo body. Every link becomes a site with the link's
name, so that hands and controllers can refer to all frames; MuJoCo's URDF import would drop fixed
tool frames. Meshes are not needed: the arm is drawn as capsules between its joints.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from pliant._core import ConfigError, Servos
from pliant.sim._mujoco import mujoco
from pliant.sim._parameters import DAMPING_SHARE, FULL_EFFORT_ERROR, resolve

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pliant._core import Joint, Model
    from pliant._typing import Array
    from pliant.sim._parameters import Gains


OffChain = Literal["held", "welded"]


@dataclass
class Group:
    """Rigid group: links without relative motion, which become one MuJoCo body.

    Attributes:
        link: Index of the first link, whose frame is the frame of the body.
        joint: Index of the joint that moves the group; None for the root.
        parent: Index of the parent group; None for the root.
        pose: Pose (4, 4) of the group's body in the body of the parent group.
        members: Index of each link of the group, and its pose (4, 4) in the body of the group.
    """

    link: int
    joint: int | None
    parent: int | None
    pose: Array
    members: list[tuple[int, Array]] = field(default_factory=list)


def rigid_groups(model: Model, off_chain: OffChain) -> list[Group]:
    """Return the groups of links without relative motion, each parent before its children.

    `off_chain` is `held` (grippers are links of their own) or `welded` (grippers do not move).
    """
    children: dict[int, list[int]] = {}
    for index, joint in enumerate(model.joints):
        children.setdefault(joint.parent, []).append(index)
    root = next(i for i, link in enumerate(model.links) if link.parent_joint is None)
    base = next(i for i, link in enumerate(model.links) if link.name == model.base)
    groups = [Group(root, None, None, np.eye(4))]
    stack = [(root, 0, np.eye(4), False)]
    base_pose: Array = np.eye(4)
    while stack:
        link, group, pose, carried = stack.pop()
        groups[group].members.append((link, pose))
        if link == base:
            base_pose = pose
        for index in reversed(children.get(link, [])):
            joint = model.joints[index]
            joint_pose = pose @ joint.origin.matrix
            is_carried = carried or joint.q_index is not None
            if _is_joint(model, joint, carried, off_chain):
                groups.append(Group(joint.child, index, group, joint_pose))
                stack.append((joint.child, len(groups) - 1, np.eye(4), is_carried))
            else:
                child_pose = joint_pose @ _locked_displacement(model, joint)
                stack.append((joint.child, group, child_pose, is_carried))
    groups[0].pose = np.asarray(np.linalg.inv(base_pose), dtype=np.float64)
    return groups


def _is_joint(model: Model, joint: Joint, carried: bool, off_chain: OffChain) -> bool:
    """Return True if a joint can move in the simulation; False if it is locked.

    `carried` is True if a joint of the chain moves this joint, as it moves a gripper.
    """
    if joint.kind == "fixed":
        return False
    if joint.kind == "other":
        raise ConfigError(
            f"joint {joint.name!r} is {joint.kind!r}; "
            "the simulator knows revolute, continuous, prismatic and fixed"
        )
    if joint.q_index is not None:
        return True
    if joint.mimic is not None and not carried:
        return False
    return carried and off_chain == "held"


def _locked_displacement(model: Model, joint: Joint) -> Array:
    """Return the displacement (4, 4) of a locked joint from its position 0."""
    pose = np.eye(4)
    angle = joint.locked_at or 0.0
    if joint.mimic is not None:
        driver = model.joints[joint.mimic.joint]
        angle = joint.mimic.offset + joint.mimic.multiplier * (driver.locked_at or 0.0)
    if joint.kind == "fixed" or angle == 0.0:
        return pose
    if joint.kind == "prismatic":
        pose[:3, 3] = angle * joint.axis
    else:
        quat, matrix = np.zeros(4), np.zeros(9)
        mujoco.mju_axisAngle2Quat(quat, joint.axis, angle)
        mujoco.mju_quat2Mat(matrix, quat)
        pose[:3, :3] = matrix.reshape(3, 3)
    return pose


def quat_of(pose: Array) -> Array:
    """Return the quaternion (w, x, y, z) of the rotation of a pose (4, 4)."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(pose[:3, :3]).reshape(9))
    return quat


def last_moving(model: Model) -> str:
    """Return the name of the child link of the chain's last joint, used as wrist centre."""
    link = next(i for i, item in enumerate(model.links) if item.name == model.tip)
    while (parent := model.links[link].parent_joint) is not None:
        joint = model.joints[parent]
        if joint.q_index is not None:
            break
        link = joint.parent
    return model.links[link].name


#: Smallest mass [kg] and inertia [kg·m²] of a moving body, because MuJoCo needs positive values.
MIN_MASS, MIN_INERTIA = 1e-4, 1e-7
#: Assumed effort limit of an off-chain joint without one in the URDF [N·m].
OFF_CHAIN_EFFORT = 1.0
#: Assumed armature (rotor inertia) of an off-chain servo, divided by its effort limit [s²].
OFF_CHAIN_ARMATURE = 2e-3
#: Assumed armature of a mimic joint [kg·m²].
FOLLOWER_ARMATURE = 1e-4
#: Time constant of the constraint that makes a mimic joint follow its driving joint [s].
MIMIC_TIME = 0.005


def add_joint(out: Build, body: mujoco.MjsBody, index: int, gains: Gains, creep: float) -> None:
    """Add the joint with this index to the body that it moves, with limits and friction.

    `creep` is the creep of a joint that friction holds, relative to MuJoCo's default.
    """
    joint = out.model.joints[index]
    mj = body.add_joint(name=joint.name, axis=joint.axis)
    is_sliding = joint.kind == "prismatic"
    mj.type = mujoco.mjtJoint.mjJNT_SLIDE if is_sliding else mujoco.mjtJoint.mjJNT_HINGE
    i = joint.q_index if joint.mimic is None else None
    if i is None:
        _limit(mj, joint.lower, joint.upper)
        _set_up_off_chain(out, mj, joint)
        return
    _limit(mj, out.model.lower[i], out.model.upper[i])
    mj.armature = gains.armature[i]
    mj.frictionloss = gains.friction[i]
    mj.solimp_friction[:2] = friction_impedance(creep)
    set_damping(mj, gains.damping[i])


def friction_impedance(creep: float) -> tuple[float, float]:
    """Return impedances d and d_max of MuJoCo's `solimp_friction` for a given creep of a joint.

    In MuJoCo a joint of inertia I that friction holds against a torque τ creeps at the speed
    (1 - d)/d · τ/I · ½ d_max t, with the time constant t = 0.02 s of the friction constraint. For
    the defaults d = 0.9 and d_max = 0.95 this is 1.06 ms · τ/I. `creep` scales (1 - d)/d; 1 gives
    the defaults.
    """
    d = 9.0 / (9.0 + creep)
    return d, max(d, 0.95)


def _set_up_off_chain(out: Build, mj: mujoco.MjsJoint, joint: Joint) -> None:
    """Set inertia, friction and damping of an off-chain joint, and its servo unless it mimics."""
    if joint.mimic is not None:
        mj.armature = FOLLOWER_ARMATURE
        return
    table = out.extra.get(joint.name)
    if table is None:
        table = out.extra[joint.name] = off_chain_servo(joint.effort)
    gains = resolve(table)
    mj.armature = gains.armature[0]
    mj.frictionloss = gains.friction[0]
    set_damping(mj, gains.damping[0])
    angle = joint.locked_at or 0.0
    limited = mj.limited == mujoco.mjtLimited.mjLIMITED_TRUE
    out.held[joint.name] = float(np.clip(angle, *mj.range)) if limited else angle


def off_chain_servo(effort: float | None) -> Servos:
    """Return servo parameters of an off-chain joint, estimated from its effort limit [N·m].

    If the limit is None or 0, `OFF_CHAIN_EFFORT` is assumed.
    """
    torque = effort or OFF_CHAIN_EFFORT
    return Servos(
        kp=[torque / FULL_EFFORT_ERROR],
        max_torque=[torque],
        damping=[DAMPING_SHARE * torque],
        armature=[OFF_CHAIN_ARMATURE * torque],
    )


def _limit(mj: mujoco.MjsJoint, lower: float | None, upper: float | None) -> None:
    """Set the position limits of a joint, unless a limit is missing or infinite."""
    if lower is None or upper is None or not np.isfinite([lower, upper]).all():
        mj.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    else:
        mj.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        mj.range = (lower, upper)


def add_mass(
    model: Model,
    body: mujoco.MjsBody,
    group: Group,
    moving: bool,
    payload: tuple[float, Array] | None,
) -> None:
    """Set mass and inertia of a body: the sum over the links of its group and loads on the tool.

    Args:
        model: The robot, which may have a payload.
        body: MuJoCo body of the group.
        group: The rigid group.
        moving: True if a joint moves the group, which then needs a positive mass.
        payload: Mass [kg] and centre (3,) [m] of a further load on the tool; None: no load.
    """
    parts: list[tuple[float, Array, Array]] = []
    for index, pose in group.members:
        inertial = model.links[index].inertial
        if inertial is not None:
            rotation = pose[:3, :3] @ np.asarray(inertial.rotation, dtype=np.float64)
            part = rotation @ np.asarray(inertial.inertia, dtype=np.float64) @ rotation.T
            parts.append(
                (
                    float(inertial.mass),
                    pose[:3, :3] @ np.asarray(inertial.com) + pose[:3, 3],
                    part,
                )
            )
        if model.links[index].name == model.tip:
            known = model.payload
            loads = [payload, known and (known.mass, known.com)]
            parts += [
                (m, pose[:3, :3] @ c + pose[:3, 3], np.zeros((3, 3)))
                for m, c in filter(None, loads)
            ]
    mass = sum(m for m, _, _ in parts)
    if mass < MIN_MASS:
        if not moving:
            return
        parts.append((MIN_MASS, np.zeros(3), np.zeros((3, 3))))
        mass += MIN_MASS
    com = sum(m * c for m, c, _ in parts) / mass
    inertia = np.zeros((3, 3))
    for m, c, part in parts:
        r = c - com
        inertia += part + m * (r @ r * np.eye(3) - np.outer(r, r))
    if np.linalg.eigvalsh(inertia)[0] < MIN_INERTIA:
        inertia += MIN_INERTIA * np.eye(3)
    body.explicitinertial = True
    body.mass = mass
    body.ipos = com
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def add_capsules(model: Model, body: mujoco.MjsBody, group: Group) -> None:
    """Add capsules, as a drawing of the group, from the joint of a group to its child joints."""
    members = dict(group.members)
    ends = [members[j.parent] @ j.origin.matrix for j in model.joints if j.parent in members]
    lengths = [float(np.linalg.norm(end[:3, 3])) for end in ends]
    radius = float(np.clip(0.12 * max(lengths, default=0.0), 0.008, 0.035))
    for end, length in zip(ends, lengths, strict=True):
        if length > radius:
            geom = body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE,
                size=(radius, 0.0, 0.0),
                contype=0,
                conaffinity=0,
            )
            geom.fromto = (0.0, 0.0, 0.0, *end[:3, 3])
            geom.rgba = (0.75, 0.77, 0.80, 1.0)


def add_mimics(out: Build, groups: list[Group]) -> None:
    """Add constraints that make mimic joints follow their driving joints.

    If the driving joint is locked, the mimic joint is held at a constant angle.
    """
    moving = {group.joint for group in groups}
    for index in sorted(j for j in moving if j is not None):
        joint = out.model.joints[index]
        if joint.mimic is None:
            continue
        driver, rule = out.model.joints[joint.mimic.joint], joint.mimic
        constraint = out.spec.add_equality(name=f"mimic:{joint.name}", name1=joint.name)
        constraint.type, constraint.objtype = mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtObj.mjOBJ_JOINT
        offset = rule.offset
        if rule.joint in moving:
            constraint.name2 = driver.name
        else:
            offset += rule.multiplier * (driver.locked_at or 0.0)
        constraint.data[:5] = offset, rule.multiplier, 0.0, 0.0, 0.0
        constraint.solref = (MIMIC_TIME, 1.0)


def add_servos(out: Build, gains: Gains) -> None:
    """Add a position actuator for each chain joint and each held off-chain joint."""
    out.chain = list(out.model.joint_names)
    for name, kp, kv, torque in zip(out.chain, gains.kp, gains.kv, gains.torque, strict=True):
        servo(out.spec, name, kp, kv, torque)
    for name in out.held:
        extra = resolve(out.extra[name])
        servo(out.spec, name, extra.kp[0], extra.kv[0], extra.torque[0])


def servo(spec: mujoco.MjSpec, joint: str, kp: float, kv: float, torque: float) -> None:
    """Add a position servo ``clip(kp (ctrl - q) - kv dq, ±torque)``.

    `ctrl` is the joint goal [rad], `kp` the stiffness [N·m/rad], `kv` the damping [N·m·s/rad].
    `forcelimited` must be set before compilation: without it MuJoCo ignores later changes of
    `forcerange`, the torque limit.
    """
    act = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    act.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    act.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    act.gainprm[0] = kp
    act.biasprm[:3] = 0.0, -kp, -kv
    act.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    act.forcerange = (-torque, torque)


def set_damping(joint: mujoco.MjsJoint, value: float) -> None:
    """Set the linear damping of a joint [N·m·s/rad; N·s/m if prismatic].

    MuJoCo 4 has the coefficients of a polynomial for it, MuJoCo 3 one number.
    """
    if np.ndim(joint.damping):
        joint.damping = (value, 0.0, 0.0)
    else:
        joint.damping = value


@dataclass
class Build:
    """MuJoCo specification under construction, and the names of its parts.

    Attributes:
        spec: The MuJoCo specification; scene objects add their bodies to it.
        model: The robot.
        chain: Names of the n chain joints.
        held: Rest angle [rad] of each off-chain joint that has an actuator, by joint name.
        extra: Servo table with one entry of each off-chain joint, by joint name.
        rigid_groups: Groups of links without relative motion, parents first.
        bodies: MuJoCo body of each rigid group.
    """

    spec: mujoco.MjSpec
    model: Model
    chain: list[str] = field(default_factory=list)
    held: dict[str, float] = field(default_factory=dict)
    extra: dict[str, Servos] = field(default_factory=dict)
    rigid_groups: list[Group] = field(default_factory=list)
    bodies: list[mujoco.MjsBody] = field(default_factory=list)


def build_spec(
    model: Model,
    gains: Gains,
    *,
    dt: float,
    off_chain: OffChain = "held",
    payload: tuple[float, Array] | None = None,
    creep: float = 1.0,
    extra: Mapping[str, Servos] | None = None,
) -> Build:
    """Build the specification of an arm with one torque-limited position servo per chain joint.

    The world frame is the model's base frame. Off-chain joints that the chain carries (a gripper)
    are `held` by their own actuators at the model's locked angle, or `welded`. Other off-chain
    joints (another arm) are welded.

    Args:
        model: The robot.
        gains: Servo parameters of the n chain joints.
        dt: Physics step [s].
        off_chain: `held` or `welded`, for off-chain joints that the chain carries.
        payload: Mass [kg] and centre (3,) [m] in the tool frame of a load that is fixed to the
            tool.
        creep: Creep of joints held by friction, relative to MuJoCo's default.
        extra: Servo tables with one entry of off-chain joints, by joint name; missing tables are
            estimated from effort limits.

    Returns:
        The specification and the names of its parts. Contacts are off, and the integrator is
        `implicitfast`.

    Raises:
        ConfigError: The tree has a joint type that the simulator does not support.
    """
    spec = mujoco.MjSpec()
    spec.modelname = model.name or "arm"
    spec.option.timestep = dt
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    spec.option.gravity = model.gravity_vector
    spec.compiler.balanceinertia = True
    spec.compiler.degree = False

    out = Build(spec, model, extra=dict(extra or {}))
    groups = out.rigid_groups = rigid_groups(model, off_chain)
    for group in groups:
        parent = spec.worldbody if group.parent is None else out.bodies[group.parent]
        body = parent.add_body(
            name=f"body:{model.links[group.link].name}",
            pos=group.pose[:3, 3],
            quat=quat_of(group.pose),
        )
        out.bodies.append(body)
        moving = group.joint is not None
        if group.joint is not None:
            add_joint(out, body, group.joint, gains, creep)
        add_mass(model, body, group, moving, payload)
        for index, pose in group.members:
            link = model.links[index]
            body.add_site(
                name=link.name, pos=pose[:3, 3], quat=quat_of(pose), size=(0.004, 0.0, 0.0), group=4
            )
        add_capsules(model, body, group)
    add_mimics(out, groups)
    add_servos(out, gains)
    return out
