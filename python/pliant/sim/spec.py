"""Conversion of a `pliant.Model` to a MuJoCo specification.

Links without relative motion become one body. Every link stays as a site of its own name, so that
frames can be read and pushed, among them fixed tool frames, which MuJoCo's own URDF import drops.
Meshes are not needed: the arm is drawn as capsules between its joints.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pliant.sim import parts
from pliant.sim._mujoco import mujoco
from pliant.sim.tree import groups, quat_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from pliant._core import Servos
    from pliant.sim.gains import Gains
    from pliant.sim.tree import Group, OffChain, Robot


@dataclass
class Build:
    """A specification under construction, and the names by which the plant finds its parts.

    Attributes:
        spec: The MuJoCo specification; scene objects add their bodies to it.
        model: The robot.
        chain: MuJoCo joint of each chain coordinate, length n.
        held: Rest angle of each off-chain joint that has an actuator, by joint name.
        extra: Servo of each off-chain joint, one entry each, by joint name.
        backlash: Joints with backlash behind the gear.
        groups: Groups of links without relative motion, parents first.
        bodies: MuJoCo body of each group.
    """

    spec: mujoco.MjSpec
    model: Robot
    chain: list[str] = field(default_factory=list)
    held: dict[str, float] = field(default_factory=dict)
    extra: dict[str, Servos] = field(default_factory=dict)
    backlash: list[str] = field(default_factory=list)
    groups: list[Group] = field(default_factory=list)
    bodies: list[mujoco.MjsBody] = field(default_factory=list)


def build(
    model: Robot,
    gains: Gains,
    *,
    dt: float,
    off_chain: OffChain = "held",
    payload: tuple[float, NDArray[np.float64]] | None = None,
    backlash: NDArray[np.float64],
    creep: float = 1.0,
    extra: Mapping[str, Servos] | None = None,
) -> Build:
    """Build the specification of an arm with one torque-limited position servo per chain joint.

    The world frame is the model's base frame. Off-chain joints carried by the chain (a gripper)
    are `held` by actuators of their own at the model's locked angle, or `welded`. All others
    (another arm) are welded.

    Args:
        model: The robot.
        gains: Servos of the n chain joints.
        dt: Physics step [s].
        off_chain: Treatment of off-chain joints.
        payload: Mass [kg] and centre (3,) [m] in the tool frame of a load that is fixed to the
            tool.
        backlash: Full backlash behind each gear (n,) [rad].
        creep: Creep of joints held by friction, relative to MuJoCo's default.
        extra: Servos of off-chain joints, one entry each, by name; others are guessed from their
            efforts.

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
    spec.option.gravity = (
        (0.0, 0.0, -9.81) if gravity is None else np.asarray(gravity, dtype=np.float64)
    )
    spec.compiler.balanceinertia = True
    spec.compiler.degree = False

    out = Build(spec, model, extra=dict(extra or {}))
    cut = out.groups = groups(model, off_chain)
    made = out.bodies
    for group in cut:
        parent = spec.worldbody if group.parent is None else made[group.parent]
        body = parent.add_body(
            name=f"body:{model.links[group.link].name}",
            pos=group.pose[:3, 3],
            quat=quat_of(group.pose),
        )
        made.append(body)
        moving = group.joint is not None
        if group.joint is not None:
            parts.add_joint(out, body, group.joint, gains, backlash=backlash, creep=creep)
        parts.add_mass(model, body, group, moving, payload)
        for index, pose in group.members:
            link = model.links[index]
            body.add_site(
                name=link.name, pos=pose[:3, 3], quat=quat_of(pose), size=(0.004, 0.0, 0.0), group=4
            )
        parts.add_skin(model, body, group)
    parts.add_mimics(out, cut)
    parts.add_servos(out, gains)
    return out
