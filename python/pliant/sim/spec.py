"""From a `pliant.Model` to a MuJoCo specification.

Links that never move against each other become one body; every link of the description stays as a site of its own name,
so that frames (a fixed tool frame above all, which MuJoCo's own URDF import drops) can be read and pushed. Meshes are
not needed: the arm is drawn as capsules between its joints.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from pliant import ConfigError
from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant.sim.gains import Gains

    #: A `pliant.Model`: the simulator reads its tree (`links`, `joints`) and its chain (`joint_names`, `base`, `tip`).
    Robot = Any

    Matrix = NDArray[np.float64]

OffChain = Literal["held", "welded"]

#: Mass [kg] and inertia [kg·m²] given to a moving group for which the description knows none: MuJoCo needs some.
LEAST_MASS, LEAST_INERTIA = 1e-4, 1e-7
#: Effort [N·m] of an off-chain joint whose description names none.
OFF_CHAIN_EFFORT = 1.0
#: Time constant [s] of the equality that makes a mimic joint follow.
MIMIC_TIME = 0.005


@dataclass
class Build:
    """A specification under construction, and the names the plant needs to find things again.

    Attributes:
        spec: The MuJoCo specification; scene objects add their bodies to it.
        model: The robot.
        bodies: Body name by link name.
        chain: MuJoCo joint per chain coordinate, length n.
        held: MuJoCo joint by name of an off-chain joint with an actuator of its own, and its angle at rest.
        backlash: MuJoCo joint of the play behind each gear, empty without backlash.
    """

    spec: mujoco.MjSpec
    model: Robot
    bodies: dict[str, mujoco.MjsBody] = field(default_factory=dict)
    chain: list[str] = field(default_factory=list)
    held: dict[str, float] = field(default_factory=dict)
    backlash: list[str] = field(default_factory=list)


@dataclass
class _Group:
    """A rigid group of links: one MuJoCo body whose frame is that of the link behind the moving joint."""

    link: int
    joint: int | None
    parent: int | None
    pose: Matrix
    members: list[tuple[int, Matrix]] = field(default_factory=list)


def build(
    model: Robot,
    gains: Gains,
    *,
    dt: float,
    off_chain: OffChain = "held",
    payload: tuple[float, NDArray[np.float64]] | None = None,
    backlash: NDArray[np.float64] | None = None,
) -> Build:
    """Make the specification of an arm with one torque-limited position servo per chain joint.

    The world frame is the model's base frame. Off-chain joints that ride on the chain (a gripper) are `held` by
    actuators of their own at the model's locked angle, or `welded`; the others (another arm) are always welded.

    Args:
        model: The robot.
        gains: Servos of the n chain joints.
        dt: Physics step [s].
        off_chain: What becomes of joints beyond the chain.
        payload: Mass [kg] and centre (3,) [m] in the tool frame of a load that is fixed to the tool.
        backlash: Full play behind each gear (n,) [rad], or None.

    Returns:
        The specification and its names; contacts are off, the integrator is `implicitfast`.

    Raises:
        ConfigError: The tree has a joint the simulator cannot represent.
    """
    spec = mujoco.MjSpec()
    spec.modelname = str(getattr(model, "name", "arm") or "arm")
    spec.option.timestep = dt
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.disableflags = int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    gravity = getattr(model, "gravity_vector", None)
    spec.option.gravity = (0.0, 0.0, -9.81) if gravity is None else np.asarray(gravity, dtype=np.float64)
    spec.compiler.balanceinertia = True
    spec.compiler.degree = False

    out = Build(spec, model)
    groups = _groups(model, off_chain)
    made: list[mujoco.MjsBody] = []
    for group in groups:
        parent = spec.worldbody if group.parent is None else made[group.parent]
        body = parent.add_body(name=f"body:{model.links[group.link].name}", pos=group.pose[:3, 3], quat=_quat(group.pose))
        made.append(body)
        moving = group.joint is not None
        if group.joint is not None:
            _add_joint(out, body, group.joint, gains, backlash)
        _add_mass(model, body, group, moving, payload)
        for index, pose in group.members:
            link = model.links[index]
            body.add_site(name=link.name, pos=pose[:3, 3], quat=_quat(pose), size=(0.004, 0.0, 0.0), group=4)
            out.bodies[link.name] = body
        _add_skin(model, body, group)
    _add_mimics(out, groups)
    _add_servos(out, gains)
    return out


def _groups(model: Robot, off_chain: OffChain) -> list[_Group]:
    """Cut the tree into rigid groups, parents first."""
    children: dict[int, list[int]] = {}
    for index, joint in enumerate(model.joints):
        children.setdefault(joint.parent, []).append(index)
    root = next(i for i, link in enumerate(model.links) if link.parent_joint is None)
    base = next(i for i, link in enumerate(model.links) if link.name == model.base)
    groups = [_Group(root, None, None, np.eye(4))]
    stack = [(root, 0, np.eye(4), False)]
    base_pose = np.eye(4)
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
                groups.append(_Group(joint.child, index, group, at))
                stack.append((joint.child, len(groups) - 1, np.eye(4), rides))
            else:
                stack.append((joint.child, group, at @ _moved(joint), rides))
    groups[0].pose = np.linalg.inv(base_pose)
    return groups


def _moves(model: Robot, joint: Any, carried: bool, off_chain: OffChain) -> bool:  # noqa: ANN401 (see Robot)
    """Whether a joint stays a joint in the simulation."""
    kind = kind_of(joint)
    if kind == "fixed":
        return False
    if kind not in {"revolute", "continuous", "prismatic"}:
        raise ConfigError(f"joint {joint.name!r} is {kind!r}; the simulator knows revolute, continuous, prismatic, fixed")
    if joint.q_index is not None:
        return True
    if joint.mimic is not None and not carried:
        return False
    return carried and off_chain == "held"


def _moved(joint: Any) -> Matrix:  # noqa: ANN401 (see Robot)
    """Displacement of a welded joint at its locked angle."""
    pose = np.eye(4)
    angle = float(getattr(joint, "locked_at", None) or 0.0)
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


def _add_joint(
    out: Build, body: mujoco.MjsBody, index: int, gains: Gains, backlash: NDArray[np.float64] | None
) -> None:
    """Add the joint a group moves about, with its gears; play sits between the gears and the link."""
    joint = out.model.joints[index]
    sliding = kind_of(joint) == "prismatic"
    mj = body.add_joint(name=joint.name, axis=unit(joint.axis))
    mj.type = mujoco.mjtJoint.mjJNT_SLIDE if sliding else mujoco.mjtJoint.mjJNT_HINGE
    if joint.lower is not None and joint.upper is not None and np.isfinite([joint.lower, joint.upper]).all():
        mj.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        mj.range = (joint.lower, joint.upper)
    if joint.q_index is not None and joint.mimic is None:
        i = joint.q_index
        lower, upper = float(out.model.lower[i]), float(out.model.upper[i])
        if np.isfinite([lower, upper]).all():
            mj.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            mj.range = (lower, upper)
        else:
            mj.limited = mujoco.mjtLimited.mjLIMITED_FALSE
        mj.armature = gains.armature[i]
        mj.frictionloss = gains.friction[i]
        set_damping(mj, gains.damping[i])
        if backlash is not None and backlash[i] > 0.0:
            play = body.add_joint(name=f"play:{joint.name}", axis=unit(joint.axis), type=mj.type)
            play.limited = mujoco.mjtLimited.mjLIMITED_TRUE
            play.range = (-backlash[i] / 2, backlash[i] / 2)
            play.armature = 0.02 * gains.armature[i]
            set_damping(play, 0.01 * gains.damping[i])
    elif joint.mimic is None:
        effort = joint.effort or OFF_CHAIN_EFFORT
        mj.armature = 2e-3 * effort
        set_damping(mj, 0.1 * effort)
        angle = float(getattr(joint, "locked_at", None) or 0.0)
        if mj.limited == mujoco.mjtLimited.mjLIMITED_TRUE:
            angle = float(np.clip(angle, joint.lower, joint.upper))
        out.held[joint.name] = angle
    else:
        mj.armature = 1e-4


def _add_mass(
    model: Robot, body: mujoco.MjsBody, group: _Group, moving: bool, payload: tuple[float, NDArray[np.float64]] | None
) -> None:
    """Sum the inertials of a group, of the model's own payload and of an unknown one, about the common centre."""
    parts: list[tuple[float, Matrix, Matrix]] = []
    for index, pose in group.members:
        inertial = model.links[index].inertial
        if inertial is not None:
            turn = pose[:3, :3] @ np.asarray(inertial.rotation, dtype=np.float64)
            spread = turn @ np.asarray(inertial.inertia, dtype=np.float64) @ turn.T
            parts.append((float(inertial.mass), pose[:3, :3] @ np.asarray(inertial.com) + pose[:3, 3], spread))
        if model.links[index].name == model.tip:
            loads = [payload, _own_payload(model)]
            parts += [(m, pose[:3, :3] @ c + pose[:3, 3], np.zeros((3, 3))) for m, c in filter(None, loads)]
    mass = sum(m for m, _, _ in parts)
    if mass < LEAST_MASS:
        if not moving:
            return
        parts.append((LEAST_MASS, np.zeros(3), np.zeros((3, 3))))
        mass += LEAST_MASS
    com = sum(m * c for m, c, _ in parts) / mass
    inertia = np.zeros((3, 3))
    for m, c, spread in parts:
        r = c - com
        inertia += spread + m * (r @ r * np.eye(3) - np.outer(r, r))
    if np.linalg.eigvalsh(inertia)[0] < LEAST_INERTIA:
        inertia += LEAST_INERTIA * np.eye(3)
    body.explicitinertial = True
    body.mass = mass
    body.ipos = com
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _own_payload(model: Robot) -> tuple[float, NDArray[np.float64]] | None:
    """Mass and centre of the load the model knows about."""
    load = getattr(model, "payload", None)
    return None if load is None else (float(load.mass), np.asarray(load.com, dtype=np.float64))


def _add_skin(model: Robot, body: mujoco.MjsBody, group: _Group) -> None:
    """Draw a group as capsules from its joint to the joints and the tool it carries."""
    members = dict(group.members)
    ends = [members[j.parent] @ as_matrix(j.origin) for j in model.joints if j.parent in members]
    reach = [float(np.linalg.norm(end[:3, 3])) for end in ends]
    thick = float(np.clip(0.12 * max(reach, default=0.0), 0.008, 0.035))
    for end, length in zip(ends, reach, strict=True):
        if length > thick:
            geom = body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(thick, 0.0, 0.0), contype=0, conaffinity=0)
            geom.fromto = (0.0, 0.0, 0.0, *end[:3, 3])
            geom.rgba = (0.75, 0.77, 0.80, 1.0)


def _add_mimics(out: Build, groups: list[_Group]) -> None:
    """Tie followers to their drivers; a follower of a joint that does not move is tied to the offset."""
    moving = {group.joint for group in groups}
    for index in sorted(j for j in moving if j is not None):
        joint = out.model.joints[index]
        if joint.mimic is None:
            continue
        driver = joint.mimic.joint
        tie = out.spec.add_equality(name=f"mimic:{joint.name}", name1=joint.name, type=mujoco.mjtEq.mjEQ_JOINT)
        tie.objtype = mujoco.mjtObj.mjOBJ_JOINT
        if driver in moving:
            tie.name2 = out.model.joints[driver].name
        tie.data[:5] = joint.mimic.offset, joint.mimic.multiplier, 0.0, 0.0, 0.0
        tie.solref = (MIMIC_TIME, 1.0)


def _add_servos(out: Build, gains: Gains) -> None:
    """One position actuator per chain joint, and one per held off-chain joint.

    `forcelimited` is fixed at compile time; without it MuJoCo ignores a `forcerange` that is changed later.
    """
    out.chain = list(out.model.joint_names)
    for name, kp, kv, torque in zip(out.chain, gains.kp, gains.kv, gains.torque, strict=True):
        _servo(out.spec, name, kp, kv, torque)
        if any(j.name == f"play:{name}" for j in out.spec.joints):
            out.backlash.append(f"play:{name}")
    by_name = {joint.name: joint for joint in out.model.joints}
    for name in out.held:
        effort = by_name[name].effort or OFF_CHAIN_EFFORT
        _servo(out.spec, name, effort / 0.07, 0.0, effort)


def _servo(spec: mujoco.MjSpec, joint: str, kp: float, kv: float, torque: float) -> None:
    """Position servo ``clip(kp (ctrl - q) - kv dq, ±torque)``."""
    act = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    act.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    act.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    act.gainprm[0] = kp
    act.biasprm[:3] = 0.0, -kp, -kv
    act.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    act.forcerange = (-torque, torque)


def set_damping(joint: mujoco.MjsJoint, value: float) -> None:
    """Set the linear damping of a joint; MuJoCo 4 keeps a polynomial where MuJoCo 3 has one number."""
    if np.ndim(joint.damping):
        joint.damping = (value, 0.0, 0.0)
    else:
        joint.damping = value


def as_matrix(pose: Any) -> Matrix:  # noqa: ANN401 (an array, or a Pose with a 4x4 accessor)
    """Return a pose as a (4, 4) array; accepts arrays and objects with a `matrix`."""
    value = getattr(pose, "matrix", pose)
    return np.asarray(value() if callable(value) else value, dtype=np.float64).reshape(4, 4)


def kind_of(joint: Any) -> str:  # noqa: ANN401 (see Robot)
    """Joint kind in lower case: revolute, continuous, prismatic, fixed or other."""
    return str(joint.kind).rsplit(".", maxsplit=1)[-1].lower()


def unit(axis: Any) -> NDArray[np.float64]:  # noqa: ANN401 (any 3-sequence)
    """Axis (3,) of length one."""
    array = np.asarray(axis, dtype=np.float64)
    return array / np.linalg.norm(array)


def _quat(pose: Matrix) -> NDArray[np.float64]:
    """Quaternion wxyz of a pose (4, 4)."""
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, np.ascontiguousarray(pose[:3, :3]).reshape(9))
    return quat
