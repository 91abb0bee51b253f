"""Parts of a body in a MuJoCo specification: joints with gears, mass, drawn shape, servos."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import Servos
from pliant.sim._mujoco import mujoco
from pliant.sim.gains import DAMPING_SHARE, FULL_EFFORT_ERROR, resolve
from pliant.sim.tree import as_matrix, kind_of, locked_angle, unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pliant.sim.gains import Gains
    from pliant.sim.spec import Build
    from pliant.sim.tree import Group, Matrix, Robot

#: Mass [kg] and inertia [kg·m²] of a moving group without inertial data.
LEAST_MASS, LEAST_INERTIA = 1e-4, 1e-7
#: Effort [N·m] of an off-chain joint without an effort in the description.
OFF_CHAIN_EFFORT = 1.0
#: Armature of an off-chain servo [kg·m²] per N·m of effort, and of a mimic joint [kg·m²].
OFF_CHAIN_ARMATURE, FOLLOWER_ARMATURE = 2e-3, 1e-4
#: Share of a joint's rotor inertia and damping on the link side of the backlash.
PLAY_SHARE = 0.02
#: Tooth contact: time constant [s] and MuJoCo's solimp.
PLAY_TIME, PLAY_IMPEDANCE = 0.003, (0.99, 0.999, 1e-4)
#: Time constant [s] of the equality constraint of a mimic joint.
MIMIC_TIME = 0.005


def add_joint(
    out: Build,
    body: mujoco.MjsBody,
    index: int,
    gains: Gains,
    *,
    backlash: NDArray[np.float64],
    creep: float,
) -> None:
    """Add the joint that moves a group, its gears, and the backlash between gears and link."""
    joint = out.model.joints[index]
    sliding = kind_of(joint) == "prismatic"
    mj = body.add_joint(name=joint.name, axis=unit(joint.axis))
    mj.type = mujoco.mjtJoint.mjJNT_SLIDE if sliding else mujoco.mjtJoint.mjJNT_HINGE
    i = joint.q_index if joint.mimic is None else None
    if i is None:
        _limit(mj, joint.lower, joint.upper)
        _loose_joint(out, mj, joint)
        return
    _limit(mj, out.model.lower[i], out.model.upper[i])
    mj.armature = gains.armature[i]
    mj.frictionloss = gains.friction[i]
    mj.solimp_friction[:2] = sticking(creep)
    set_damping(mj, gains.damping[i])
    if backlash[i] > 0.0:
        play = body.add_joint(name=f"play:{joint.name}", axis=unit(joint.axis), type=mj.type)
        _limit(play, -backlash[i] / 2, backlash[i] / 2)
        play.solref_limit = (PLAY_TIME, 1.0)
        play.solimp_limit[:3] = PLAY_IMPEDANCE
        play.armature = PLAY_SHARE * gains.armature[i]
        set_damping(play, PLAY_SHARE * gains.damping[i])
        out.backlash.append(joint.name)


def sticking(creep: float) -> tuple[float, float]:
    """Return the least and largest impedance d (MuJoCo's solimp) of friction for this creep.

    A joint held by friction against a torque τ slides at (1 - d)/d · τ/I · ½ d_max t. With
    t = 0.02 s and MuJoCo's own d = 0.9, d_max = 0.95 this is 1.06 ms · τ/I. `creep` scales
    (1 - d)/d.
    """
    d = 9.0 / (9.0 + creep)
    return d, max(d, 0.95)


def _loose_joint(out: Build, mj: mujoco.MjsJoint, joint: Any) -> None:
    """Set up an off-chain joint: with a servo that holds its locked angle, or as a mimic joint."""
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
    angle = locked_angle(joint)
    limited = mj.limited == mujoco.mjtLimited.mjLIMITED_TRUE
    out.held[joint.name] = float(np.clip(angle, *mj.range)) if limited else angle


def off_chain_servo(effort: float | None) -> Servos:
    """Return the servo of an off-chain joint from its effort alone [N·m]."""
    torque = effort or OFF_CHAIN_EFFORT
    return Servos(
        kp=[torque / FULL_EFFORT_ERROR],
        max_torque=[torque],
        damping=[DAMPING_SHARE * torque],
        armature=[OFF_CHAIN_ARMATURE * torque],
    )


def _limit(mj: mujoco.MjsJoint, lower: float | None, upper: float | None) -> None:
    """Set the end stops of a joint, unless one is missing or infinite."""
    if lower is None or upper is None or not np.isfinite([lower, upper]).all():
        mj.limited = mujoco.mjtLimited.mjLIMITED_FALSE
    else:
        mj.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        mj.range = (lower, upper)


def add_mass(
    model: Robot,
    body: mujoco.MjsBody,
    group: Group,
    moving: bool,
    payload: tuple[float, NDArray[np.float64]] | None,
) -> None:
    """Add up the inertials of a group and its payloads, known and unknown to the controller."""
    parts: list[tuple[float, Matrix, Matrix]] = []
    for index, pose in group.members:
        inertial = model.links[index].inertial
        if inertial is not None:
            turn = pose[:3, :3] @ np.asarray(inertial.rotation, dtype=np.float64)
            spread = turn @ np.asarray(inertial.inertia, dtype=np.float64) @ turn.T
            parts.append(
                (
                    float(inertial.mass),
                    pose[:3, :3] @ np.asarray(inertial.com) + pose[:3, 3],
                    spread,
                )
            )
        if model.links[index].name == model.tip:
            loads = [payload, own_payload(model)]
            parts += [
                (m, pose[:3, :3] @ c + pose[:3, 3], np.zeros((3, 3)))
                for m, c in filter(None, loads)
            ]
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


def own_payload(model: Robot) -> tuple[float, NDArray[np.float64]] | None:
    """Return mass [kg] and centre (3,) [m] of the model's payload, None without one."""
    load = getattr(model, "payload", None)
    return None if load is None else (float(load.mass), np.asarray(load.com, dtype=np.float64))


def add_skin(model: Robot, body: mujoco.MjsBody, group: Group) -> None:
    """Draw a group as capsules from its joint to its child joints."""
    members = dict(group.members)
    ends = [members[j.parent] @ as_matrix(j.origin) for j in model.joints if j.parent in members]
    reach = [float(np.linalg.norm(end[:3, 3])) for end in ends]
    thick = float(np.clip(0.12 * max(reach, default=0.0), 0.008, 0.035))
    for end, length in zip(ends, reach, strict=True):
        if length > thick:
            geom = body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=(thick, 0.0, 0.0), contype=0, conaffinity=0
            )
            geom.fromto = (0.0, 0.0, 0.0, *end[:3, 3])
            geom.rgba = (0.75, 0.77, 0.80, 1.0)


def add_mimics(out: Build, groups: list[Group]) -> None:
    """Tie mimic joints to their drivers; with a fixed driver, the angle is constant."""
    moving = {group.joint for group in groups}
    for index in sorted(j for j in moving if j is not None):
        joint = out.model.joints[index]
        if joint.mimic is None:
            continue
        driver, rule = out.model.joints[joint.mimic.joint], joint.mimic
        tie = out.spec.add_equality(name=f"mimic:{joint.name}", name1=joint.name)
        tie.type, tie.objtype = mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtObj.mjOBJ_JOINT
        offset = rule.offset
        if rule.joint in moving:
            tie.name2 = driver.name
        else:
            offset += rule.multiplier * locked_angle(driver)
        tie.data[:5] = offset, rule.multiplier, 0.0, 0.0, 0.0
        tie.solref = (MIMIC_TIME, 1.0)


def add_servos(out: Build, gains: Gains) -> None:
    """Add a position actuator per chain joint, and one per held off-chain joint.

    `forcelimited` is fixed at compile time; without it MuJoCo ignores later changes of
    `forcerange`.
    """
    out.chain = list(out.model.joint_names)
    for name, kp, kv, torque in zip(out.chain, gains.kp, gains.kv, gains.torque, strict=True):
        servo(out.spec, name, kp, kv, torque)
    for name in out.held:
        own = resolve(out.extra[name])
        servo(out.spec, name, own.kp[0], own.kv[0], own.torque[0])


def servo(spec: mujoco.MjSpec, joint: str, kp: float, kv: float, torque: float) -> None:
    """Add a position servo ``clip(kp (ctrl - q) - kv dq, ±torque)``."""
    act = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    act.gaintype = mujoco.mjtGain.mjGAIN_FIXED
    act.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    act.gainprm[0] = kp
    act.biasprm[:3] = 0.0, -kp, -kv
    act.forcelimited = mujoco.mjtLimited.mjLIMITED_TRUE
    act.forcerange = (-torque, torque)


def set_damping(joint: mujoco.MjsJoint, value: float) -> None:
    """Set a joint's linear damping: a polynomial in MuJoCo 4, one number in MuJoCo 3."""
    if np.ndim(joint.damping):
        joint.damping = (value, 0.0, 0.0)
    else:
        joint.damping = value
