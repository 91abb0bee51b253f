"""Simulated hand of `experiments.campaign`, made of MuJoCo actuators for a fast simulation."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.arms import AXES
from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from pliant.sim import Plant
    from pliant.sim._model_builder import Build


#: Stiffness [N/m, N·m/rad] and damping [N·s/m, N·m·s/rad] of the springs for `arm7`, and median
#: static capacity of `arm7` [N] (`Arm.median_capacity`). For other arms, the springs scale with it.
STIFFNESS, DAMPING, OF_CAPACITY = (3000.0, 60.0), (30.0, 0.5), 33.6


class Grip:
    """Fixture with springs between the tool and a rest pose, one spring per base axis.

    Each spring is an actuator of MuJoCo. Its control signal is the speed of its rest position, so
    that the hand moves without steps between control periods.
    """

    passive = True

    def __init__(self, scale: float) -> None:
        """Scale the springs for an arm with `scale` times the median capacity of `arm7`."""
        self.stiffness = np.repeat(np.array(STIFFNESS) * scale, 3)
        self.damping = np.repeat(np.array(DAMPING) * scale, 3)

    def add(self, build_spec: Build) -> None:
        """Add one actuator per base axis to the model; none of them exerts a force yet."""
        # Give the site an arbitrary pose. MuJoCo would compile a site at its body's pose into a
        # constant, which `place` could not change.
        build_spec.spec.worldbody.add_site(name="grip", pos=(1, 2, 3), quat=(0.5, 0.5, 0.5, 0.5))
        for row, name in enumerate(AXES):
            act = build_spec.spec.add_actuator(name=f"grip:{name}", target=build_spec.model.tip)
            act.refsite, act.trntype = "grip", mujoco.mjtTrn.mjTRN_SITE
            act.dyntype = mujoco.mjtDyn.mjDYN_INTEGRATOR
            act.gaintype = mujoco.mjtGain.mjGAIN_FIXED
            act.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            act.gear = np.eye(6)[row]

    def place(self, plant: Plant) -> None:
        """Set the rest pose of all springs to the tool's present pose."""
        model, tool = plant.mj_model, plant.tool
        site = model.site("grip").id
        model.site_pos[site] = tool[:3, 3]
        mujoco.mju_mat2Quat(model.site_quat[site], tool[:3, :3].reshape(9))
        self._ids = np.array([model.actuator(f"grip:{name}").id for name in AXES])
        plant.mj_data.act[model.actuator_actadr[self._ids]] = 0.0
        self._place = plant
        # MuJoCo interprets the gear of an actuator in the axes of the rest pose. Rotate the gears
        # so that each spring acts along a base axis.
        for row, index in enumerate(self._ids):
            block = slice(3 * (row // 3), 3 * (row // 3) + 3)
            model.actuator_gear[index] = 0.0
            model.actuator_gear[index, block] = tool[row % 3, :3]

    def hold(self, rows: list[int]) -> None:
        """Attach the springs of the axes with these indices, and release the other springs."""
        model = self._place.mj_model
        is_held = np.isin(np.arange(6), rows)
        model.actuator_gainprm[self._ids, 0] = np.where(is_held, self.stiffness, 0.0)
        model.actuator_biasprm[self._ids, 1] = np.where(is_held, -self.stiffness, 0.0)
        model.actuator_biasprm[self._ids, 2] = np.where(is_held, -self.damping, 0.0)

    def move(self, row: int, speed: float) -> None:
        """Move the rest position of one axis with a speed [m/s or rad/s]."""
        self._place.mj_data.ctrl[self._ids[row]] = speed

    def force(self, row: int) -> float:
        """Return the present force or torque of the hand along an axis [N or N·m]."""
        return float(self._place.mj_data.actuator_force[self._ids[row]])

    def before(self, plant: Plant) -> None:
        """Do nothing: MuJoCo computes the forces of the springs."""

    during = after = before
