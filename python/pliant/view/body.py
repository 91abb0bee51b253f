"""The drawn arm: a MuJoCo model, and its coordinates at joint positions."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant.sim import Plant
from pliant.view.visuals import visuals

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from pliant._core import Model
    from pliant._typing import Array
    from pliant.arm import Arm


class Body:
    """The drawn figure of an arm, real or simulated.

    A simulated arm is drawn in its true state with its scene, a real one by its joint readings.

    Attributes:
        plant: The simulation; for a real arm, a simulation that never runs.
        simulated: True if the arm is simulated.
        visuals: Shapes of the arm's URDF that can be drawn.
    """

    def __init__(self, arm: Arm, urdf: Path | None = None) -> None:
        """Find the simulation, or build one for drawing; `urdf` is the arm's file, if any."""
        plant = getattr(arm.drive, "plant", None)
        self.simulated = plant is not None
        self.plant: Plant = plant if plant is not None else Plant(arm.model)
        self._model = arm.model
        mj = self.plant.mj_model
        self.visuals = visuals(arm.model, mj, urdf)
        self._at = {mj.joint(i).name: int(mj.jnt_qposadr[i]) for i in range(mj.njnt)}

    def pose(self, q: Array, extra: Mapping[str, float]) -> Array:
        """Return the figure's coordinates; joints (n,) and off-chain joints [rad] of a real arm."""
        if self.simulated:
            return np.array(self.plant.mj_data.qpos)
        out: Array = self.plant.mj_model.qpos0.copy()
        known = {**dict(zip(self._model.joint_names, q.tolist(), strict=True)), **extra}
        for name, angle in {**known, **_followers(self._model, known)}.items():
            if name in self._at:
                out[self._at[name]] = angle
        return out

    def mocap(self) -> tuple[Array, Array]:
        """Return positions (m, 3) [m] and quaternions wxyz (m, 4) of the mocap bodies."""
        data = self.plant.mj_data
        return data.mocap_pos.copy(), data.mocap_quat.copy()


def _followers(model: Model, known: Mapping[str, float]) -> dict[str, float]:
    """Return the angles of mimic joints whose drivers are known."""
    out = {}
    for joint in model.joints:
        rule = joint.mimic
        if rule is not None and (driver := model.joints[rule.joint].name) in known:
            out[joint.name] = rule.multiplier * known[driver] + rule.offset
    return out
