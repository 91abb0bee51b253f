"""Simulated drawer on a slide, held by the arm at its handle."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._core import ConfigError
from pliant.sim._model_builder import set_damping
from pliant.sim._mujoco import mujoco
from pliant.sim.grasp import SETTLE, GraspedObject

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pliant.sim._model_builder import Build
    from pliant.sim.plant import Plant

#: Size of the box: along the slide, across the slide, height [m].
SIZE = np.array((0.30, 0.30, 0.12))


@dataclass(kw_only=True)
class Drawer(GraspedObject):
    """Box on a slide, held by the arm at its handle; at reset the handle is at the tool.

    Attributes:
        axis: Direction in which the drawer opens, unit vector (3,) in base axes.
        mass: Mass of the box [kg].
        friction: Dry friction of the slide [N].
        binding: Additional friction of the slide per force across the slide [1].
        damping: Viscous damping of the slide [N·s/m].
        stop: Length of the slide between its hard stops [m].
        opening, widest: Present opening, and largest opening since reset [m].
        across: Largest force of the arm on the handle across the slide [N], recorded from 0.5 s
            after reset.
    """

    axis: Sequence[float] = (-1.0, 0.0, 0.0)
    mass: float = 2.0
    friction: float = 3.0
    binding: float = 0.3
    damping: float = 5.0
    stop: float = 0.25
    name: str = "drawer"
    opening: float = field(default=0.0, init=False)
    widest: float = field(default=0.0, init=False)
    across: float = field(default=0.0, init=False)

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        super().__post_init__()
        axis = np.asarray(self.axis, dtype=np.float64)
        if axis.shape != (3,) or abs(float(np.linalg.norm(axis)) - 1.0) > 1e-9:
            raise ConfigError(f"Drawer.axis must be a unit vector (3,), got {self.axis!r}")
        low = min(self.friction, self.binding, self.damping)
        if not (low >= 0.0 and self.mass > 0.0 and self.stop > 0.0):
            raise ConfigError(
                "Drawer needs mass and stop > 0; friction, binding and damping at least 0; "
                f"got {self!r}"
            )

    def add(self, build_spec: Build) -> None:
        """Add slide, box and grip constraint to the MuJoCo specification."""
        axis = np.asarray(self.axis, dtype=np.float64)
        frame = build_spec.spec.worldbody.add_body(name=f"{self.name}:frame", mocap=True)
        box = frame.add_body(name=f"{self.name}:box", gravcomp=1.0)
        slide = box.add_joint(
            name=f"{self.name}:slide", axis=axis, type=mujoco.mjtJoint.mjJNT_SLIDE
        )
        slide.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        slide.range = (0.0, self.stop)
        slide.frictionloss = self.friction
        set_damping(slide, self.damping)
        box.explicitinertial = True
        box.mass = self.mass
        box.ipos = -axis * SIZE[0] / 2
        box.inertia = self.mass / 12 * ((SIZE @ SIZE) - SIZE**2)
        up = np.array((0.0, 0.0, 1.0)) if abs(axis[2]) < 0.9 else np.array((0.0, 1.0, 0.0))
        across = np.cross(up, axis) / np.linalg.norm(np.cross(up, axis))
        quat = np.zeros(4)
        rotation = np.stack([axis, across, np.cross(axis, across)], axis=1)
        mujoco.mju_mat2Quat(quat, rotation.reshape(9))
        for size, position, rgba in (
            (SIZE, -axis * (0.03 + SIZE[0] / 2), (0.55, 0.42, 0.30, 0.55)),
            (np.array((0.015, 0.34, 0.16)), -axis * 0.03, (0.45, 0.33, 0.22, 0.9)),
        ):
            geom = box.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX, size=size / 2, contype=0, conaffinity=0
            )
            geom.pos, geom.quat, geom.rgba = position, quat, rgba
        self.add_grip(build_spec, box, (0.0, 0.0, 0.0))

    def place(self, plant: Plant) -> None:
        """Place the closed drawer so that its handle is at the tool, and clear recorded values."""
        model = plant.mj_model
        frame = int(model.body(f"{self.name}:frame").mocapid[0])
        plant.mj_data.mocap_pos[frame] = plant.tool[:3, 3]
        joint = model.joint(f"{self.name}:slide")
        self._qpos, self._dof = int(joint.qposadr[0]), int(joint.dofadr[0])
        self._axis = np.asarray(self.axis, dtype=np.float64)
        self.place_grip(plant)
        self.opening = self.widest = self.across = 0.0
        self._sideways = 0.0

    def before(self, plant: Plant) -> None:
        """Set the friction of the slide, which grows with the last force across the slide."""
        friction = self.friction + self.binding * self._sideways
        plant.mj_model.dof_frictionloss[self._dof] = friction

    def after(self, plant: Plant) -> None:
        """Record the opening, and the force in the grip across the slide, after a physics step."""
        self.opening = float(plant.mj_data.qpos[self._qpos])
        self.widest = max(self.widest, self.opening)
        super().after(plant)
        side = self.pull - (self.pull @ self._axis) * self._axis
        self._sideways = float(np.sqrt(side @ side))
        if plant.time > SETTLE:
            self.across = max(self.across, self._sideways)


def drawer(**fields: Any) -> Drawer:
    """Return a drawer that opens toward the robot (-x) by 0.25 m, with 2 kg and 3 N friction."""
    return Drawer(**fields)
