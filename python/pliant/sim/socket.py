"""Peg-in-hole scene: a plug on the tool and a square socket with rigid contacts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError
from pliant.sim._mujoco import mujoco
from pliant.sim.plant import Fixture

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant._typing import Array
    from pliant.sim._model_builder import Build
    from pliant.sim.plant import Plant


#: Bit masks of MuJoCo's contact filter for plug and socket, which collide only with each other.
CONTACT_BITS = {"contype": 2, "conaffinity": 2}
#: MuJoCo's contact parameters: time constant of `solref` [s], and the first three entries of
#: `solimp` (impedances d_0 and d_width [1], width [m]).
CONTACT_TIME, CONTACT_IMPEDANCE = 0.005, (0.95, 0.99, 0.0005)
#: Time constant of the low-pass filter of the contact force, which varies from step to step [s].
FORCE_FILTER = 0.01
#: Length of the plug [m].
LENGTH = 0.08
#: Thickness of the four walls of the hole, and length by which each extends beyond the hole [m].
WALL = 0.03


@dataclass(kw_only=True)
class Socket(Fixture):
    """Square socket under the tool, and a capsule as plug whose tip is the tool's origin.

    The plug is fixed to the tool and points along -z of the tool. At reset the hole has the same
    direction, unless `tilt` turns it. Four walls form the hole, and four boards at 45 deg form its
    chamfer. The floor of the hole is at `depth`.

    Attributes:
        offset: Vector (3,) from the tool to the centre of the mouth at reset, in tool axes [m].
        tilt: Rotation vector (3,) of the hole relative to the tool at reset, in base axes [rad].
        width: Diameter of the plug [m].
        clearance: Gap between plug and hole on each side [m].
        depth: Depth of the hole [m].
        chamfer: Widening of the mouth on each side [m].
        friction: Friction coefficient of the contacts [1].
        name: Prefix of the names of the bodies.
        force: Norm of the present contact force, low-pass filtered [N].
        peak_along, peak_across: Largest contact force along and across the hole since reset [N].
        deepest: Largest depth of the plug's tip below the mouth since reset, along the hole [m].
    """

    offset: Sequence[float] = (0.0, 0.0, -0.02)
    tilt: Sequence[float] = (0.0, 0.0, 0.0)
    width: float = 0.02
    clearance: float = 0.0005
    depth: float = 0.03
    chamfer: float = 0.004
    friction: float = 0.3
    name: str = "socket"
    force: float = field(default=0.0, init=False)
    peak_along: float = field(default=0.0, init=False)
    peak_across: float = field(default=0.0, init=False)
    deepest: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        if np.shape(self.offset) != (3,) or np.shape(self.tilt) != (3,):
            raise ConfigError("Socket.offset and tilt have three entries each")
        low = min(self.clearance, self.chamfer, self.friction)
        if not (self.width > 0.0 and self.depth > self.chamfer and low >= 0.0):
            raise ConfigError(
                "Socket needs width > 0 and depth > chamfer; clearance, chamfer and friction at "
                f"least 0; got {self!r}"
            )

    def add(self, build_spec: Build) -> None:
        """Add the plug to the arm and the socket to the world, and switch contacts on."""
        spec = build_spec.spec
        spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
        radius = self.width / 2.0
        frame = spec.worldbody.add_body(name=f"{self.name}:frame", mocap=True)
        half = radius + self.clearance
        for k in range(4):
            turn = np.array((np.cos(k * np.pi / 4.0), 0.0, 0.0, np.sin(k * np.pi / 4.0)))
            self._wall(frame, turn, half)
        floor = frame.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(half, half, 0.005))
        floor.pos = (0.0, 0.0, -self.depth - 0.005)
        self._finish(floor, (0.35, 0.36, 0.40, 1.0))
        tip = next(site for site in spec.sites if site.name == build_spec.model.tip)
        centre, tip_quat = np.zeros(3), np.asarray(tip.quat, dtype=np.float64)
        mujoco.mju_rotVecQuat(centre, np.array((0.0, 0.0, LENGTH / 2)), tip_quat)
        plug = tip.parent.add_geom(
            name=f"{self.name}:plug",
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=(radius, LENGTH / 2 - radius, 0.0),
            pos=tip.pos + centre,
            quat=tip_quat,
            mass=0.0,
        )
        self._finish(plug, (0.85, 0.35, 0.2, 1.0))

    def _wall(self, frame: mujoco.MjsBody, turn: Array, half: float) -> None:
        """Add one of the four walls: a block beside the hole, with a board at 45 deg on it.

        Args:
            frame: Body of the socket.
            turn: Quaternion (4,) that turns the wall to its side of the hole.
            half: Half the width of the hole [m].
        """
        quat = np.zeros(4)
        position, reach = np.zeros(3), half + WALL
        # Height of the block: it ends below the chamfer, where the board starts.
        low = self.depth - self.chamfer
        block = frame.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(WALL / 2, reach, low / 2))
        mujoco.mju_rotVecQuat(
            position, np.array((half + WALL / 2, 0.0, -self.depth + low / 2)), turn
        )
        block.pos, block.quat = position, turn
        self._finish(block, (0.55, 0.57, 0.62, 1.0))
        if self.chamfer > 0.0:
            thick, long = 0.004, self.chamfer / np.sqrt(2.0)
            slope = np.array((np.cos(-np.pi / 8.0), 0.0, np.sin(-np.pi / 8.0), 0.0))
            mujoco.mju_mulQuat(quat, turn, slope)
            # Centre of the board: centre of its sloping face, minus half its thickness along the
            # normal of this face.
            normal = np.array((-1.0, 0.0, 1.0)) / np.sqrt(2.0)
            middle = np.array((half + self.chamfer / 2, 0.0, -self.chamfer / 2)) - normal * thick
            board = frame.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, size=(long, half + self.chamfer, thick)
            )
            mujoco.mju_rotVecQuat(position, middle, turn)
            board.pos, board.quat = position, quat
            self._finish(board, (0.70, 0.72, 0.76, 1.0))

    def _finish(self, geom: mujoco.MjsGeom, rgba: Sequence[float]) -> None:
        """Set contact parameters and colour of a MuJoCo geom."""
        geom.contype, geom.conaffinity = CONTACT_BITS["contype"], CONTACT_BITS["conaffinity"]
        geom.friction = (self.friction, 0.0, 0.0)
        geom.condim = 3
        geom.solref = (CONTACT_TIME, 1.0)
        geom.solimp[:3] = CONTACT_IMPEDANCE
        geom.rgba = rgba

    def place(self, plant: Plant) -> None:
        """Place the mouth of the socket at `offset` from the tool, and clear recorded values."""
        model, data, tool = plant.mj_model, plant.mj_data, plant.tool
        frame = int(model.body(f"{self.name}:frame").mocapid[0])
        tilt, quat = np.zeros(4), np.zeros(4)
        turn = np.asarray(self.tilt, dtype=np.float64)
        angle = float(np.linalg.norm(turn))
        mujoco.mju_axisAngle2Quat(tilt, turn / max(angle, 1e-12), angle)
        mujoco.mju_mat2Quat(quat, np.ascontiguousarray(tool[:3, :3]).reshape(9))
        mujoco.mju_mulQuat(quat, tilt, quat.copy())
        data.mocap_pos[frame] = self._mouth = tool[:3, 3] + tool[:3, :3] @ self.offset
        data.mocap_quat[frame] = quat
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, quat)
        self._into = -matrix.reshape(3, 3)[:, 2]
        self._plug = int(model.geom(f"{self.name}:plug").id)
        self._wrench, self._mean = np.zeros(6), np.zeros(3)
        self.force = self.peak_along = self.peak_across = self.deepest = 0.0

    def after(self, plant: Plant) -> None:
        """Record contact force and depth of the plug's tip after a physics step."""
        data = plant.mj_data
        total = np.zeros(3)
        for index in range(data.ncon):
            contact = data.contact[index]
            mujoco.mj_contactForce(plant.mj_model, data, index, self._wrench)
            force = contact.frame.reshape(3, 3).T @ self._wrench[:3]
            total += force if contact.geom2 == self._plug else -force
        share = plant.dt / (FORCE_FILTER + plant.dt)
        self._mean += share * (total - self._mean)
        self.force = float(np.sqrt(self._mean @ self._mean))
        along = -float(self._mean @ self._into)
        across = self._mean + along * self._into
        self.peak_along = max(self.peak_along, along)
        self.peak_across = max(self.peak_across, float(np.sqrt(across @ across)))
        tip = plant.tool[:3, 3] - self._mouth
        self.deepest = max(self.deepest, float(tip @ self._into))
