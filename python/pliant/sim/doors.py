"""Simulated hinged doors that the arm holds at the handle: house door, fridge, oven.

When the simulation is reset, the handle is placed at the tool. A `rigid` grip welds the handle to
the tool; a `turning` grip lets the handle rotate in the gripper.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError
from pliant.sim._model_builder import set_damping
from pliant.sim._mujoco import mujoco
from pliant.sim.grasp import GraspedObject

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant._typing import Array
    from pliant.sim._model_builder import Build
    from pliant.sim.plant import Plant

#: Travel of the handle over which the seal force builds up [m], so that it is 0 when the door is
#: closed.
SEAL_ONSET = 5e-5


@dataclass(frozen=True, kw_only=True)
class Drive:
    """Prescribed motion of the door's hinge, which simulates a moving base of the robot.

    Attributes:
        direction: Direction of the motion, unit vector (3,) in base axes.
        speed: Speed of the motion [m/s].
        start: Start time of the motion [s].
        distance: Length of the motion [m].
    """

    direction: Sequence[float] = (1.0, 0.0, 0.0)
    speed: float = 0.05
    start: float = 1.0
    distance: float = 0.28

    def at(self, t: float) -> float:
        """Return by how much the hinge itself is displaced at time t [s], in m."""
        return min(max(self.speed * (t - self.start), 0.0), self.distance)


@dataclass(kw_only=True)
class Door(GraspedObject):
    """Door leaf on a hinge, held by the arm at its handle.

    Attributes:
        hinge: Vector (3,) from the handle to the hinge in base axes [m].
        axis: Hinge axis, unit vector (3,) in base axes; a positive rotation opens the door.
        mass: Mass of the leaf [kg]; its centre is half way between hinge and handle.
        friction: Dry friction of the hinge [N·m].
        damping: Viscous damping of the hinge [N·m·s/rad].
        stop: Largest opening angle [rad].
        seal: Force of a magnetic seal at the handle [N]; it falls linearly to 0 over `seal_way`.
        seal_way: Travel of the handle after which the seal exerts no more force [m].
        balanced: True if a spring balances the weight of the leaf.
        drive: Motion of the hinge; None for a fixed hinge.
        angle, widest: Present opening angle, and largest one since reset [rad].
    """

    hinge: Sequence[float] = (0.0, -0.30, 0.0)
    axis: Sequence[float] = (0.0, 0.0, 1.0)
    mass: float = 3.0
    friction: float = 0.5
    damping: float = 0.3
    stop: float = float(np.deg2rad(120.0))
    seal: float = 0.0
    seal_way: float = 0.004
    balanced: bool = False
    drive: Drive | None = None
    name: str = "door"
    angle: float = field(default=0.0, init=False)
    widest: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        super().__post_init__()
        hinge = np.asarray(self.hinge, dtype=np.float64)
        axis = np.asarray(self.axis, dtype=np.float64)
        is_unit = axis.shape == (3,) and abs(float(np.linalg.norm(axis)) - 1.0) <= 1e-9
        if hinge.shape != (3,) or not is_unit:
            raise ConfigError("Door.hinge has three entries and Door.axis is a unit vector (3,)")
        #: Distance of the handle from the hinge axis [m].
        self.radius = float(np.linalg.norm(hinge - (hinge @ axis) * axis))
        if self.radius < 1e-3:
            raise ConfigError(f"Door.hinge {self.hinge!r} puts the handle on the hinge axis")
        low = min(self.mass, self.friction, self.damping, self.seal, self.stop)
        if not low >= 0.0 or self.mass == 0.0 or not self.seal_way > 0.0:
            raise ConfigError(
                "Door needs mass and seal_way > 0; friction, damping, seal and stop at least 0; "
                f"got {self!r}"
            )

    def add(self, build_spec: Build) -> None:
        """Add the bodies of hinge and leaf and the grip constraint to the MuJoCo specification."""
        spec, arm = build_spec.spec, np.asarray(self.hinge, dtype=np.float64)
        frame = spec.worldbody.add_body(name=f"{self.name}:frame", mocap=True)
        leaf = frame.add_body(name=f"{self.name}:leaf", gravcomp=1.0 if self.balanced else 0.0)
        hinge = leaf.add_joint(
            name=f"{self.name}:hinge", axis=self.axis, type=mujoco.mjtJoint.mjJNT_HINGE
        )
        hinge.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        hinge.range = (0.0, self.stop)
        hinge.frictionloss = self.friction
        set_damping(hinge, self.damping)
        self._weigh(leaf, arm)
        self.add_grip(build_spec, leaf, -arm)

    def _weigh(self, leaf: mujoco.MjsBody, arm: Array) -> None:
        """Set the inertia of the leaf, a plate between hinge and handle, and add its geometry.

        `arm` is the vector (3,) from the handle to the hinge [m].
        """
        axis = np.asarray(self.axis, dtype=np.float64)
        across = -(arm - (arm @ axis) * axis)
        normal = np.cross(across, axis)
        size = np.array((self.radius, 0.60, 0.03))
        rotation = np.stack([across / self.radius, axis, normal / self.radius], axis=1)
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, rotation.reshape(9))
        leaf.explicitinertial = True
        leaf.mass = self.mass
        leaf.ipos = across / 2
        leaf.iquat = quat
        leaf.inertia = self.mass / 12 * ((size @ size) - size**2)
        geom = leaf.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=size / 2, contype=0, conaffinity=0
        )
        geom.pos, geom.quat, geom.rgba = across / 2, quat, (0.55, 0.42, 0.30, 0.55)

    def place(self, plant: Plant) -> None:
        """Place the closed door so that its handle is at the tool, and clear recorded values."""
        model, data = plant.mj_model, plant.mj_data
        tool = plant.tool
        self._frame = int(model.body(f"{self.name}:frame").mocapid[0])
        self._home = tool[:3, 3] + np.asarray(self.hinge)
        data.mocap_pos[self._frame] = self._home
        joint = model.joint(f"{self.name}:hinge")
        self._qpos, self._dof = int(joint.qposadr[0]), int(joint.dofadr[0])
        self.place_grip(plant)
        self.angle = self.widest = 0.0

    def before(self, plant: Plant) -> None:
        """Move the hinge as `drive` prescribes for the present time."""
        if self.drive is not None:
            displacement = self.drive.at(plant.mj_data.time) * np.asarray(self.drive.direction)
            plant.mj_data.mocap_pos[self._frame] = self._home + displacement

    def during(self, plant: Plant) -> None:
        """Apply the force of the magnetic seal to the door in a physics step."""
        if self.seal > 0.0:
            travel = self.radius * float(plant.mj_data.qpos[self._qpos])
            pull = self.seal * min(
                max(1.0 - travel / self.seal_way, 0.0), max(travel / SEAL_ONSET, 0.0), 1.0
            )
            plant.mj_data.qfrc_applied[self._dof] -= pull * self.radius

    def after(self, plant: Plant) -> None:
        """Record the opening angle, and force and torque in the grip, after a physics step."""
        self.angle = float(plant.mj_data.qpos[self._qpos])
        self.widest = max(self.widest, self.angle)
        super().after(plant)


def door(**fields: Any) -> Door:
    """Return a house door: vertical hinge 0.30 m to the right of the handle, 3 kg."""
    return Door(**fields)


def fridge(**fields: Any) -> Door:
    """Return a fridge: a house door of 6 kg with less friction and a magnetic seal of 20 N."""
    return Door(**{"mass": 6.0, "friction": 0.3, "seal": 20.0, "name": "fridge", **fields})


def oven(**fields: Any) -> Door:
    """Return an oven: horizontal hinge 0.30 m below the handle, weight balanced by a spring."""
    hinge = {"hinge": (0.0, 0.0, -0.30), "axis": (0.0, -1.0, 0.0)}
    return Door(**{**hinge, "balanced": True, "name": "oven", **fields})
