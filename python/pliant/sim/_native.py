"""Physics of a control period in one call of MuJoCo, for scenes whose forces MuJoCo computes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from pliant._typing import Array
    from pliant.sim.plant import Plant


class NativeArm:
    """Runs a `Plant` without bus, hands and per-step forces; the interpreter lock is released.

    The plant must have no delays, losses, encoder steps, dead bands, hands or `Friction`. Its
    fixtures record nothing. The arrays are views of the memory of MuJoCo and of the caller, because
    each access through Python attributes costs a microsecond.

    Args:
        plant: Plant after `reset`.
        goal: Goals of the servos (n,) [rad]; read in each period.
        limits: Least and largest torque of each servo (n, 2) [N·m]; read in each period.
        q: Joint positions (n,) [rad]; written in each period.
    """

    def __init__(self, plant: Plant, goal: Array, limits: Array, q: Array) -> None:
        model, data, n = plant.mj_model, plant.mj_data, plant.n
        dof, servo = plant._bank.addresses
        if not (np.array_equal(dof, np.arange(n)) and np.array_equal(servo, np.arange(n))):
            raise AssertionError("the joints of the chain come first in the physics model")
        self._model, self._data, self._steps = model, data, plant.steps
        self._goal, self._limits, self._q = goal, limits, q
        self._range, self._ctrl = model.actuator_forcerange[:n], data.ctrl[:n]
        self._qpos = data.qpos[:n]

    def advance(self) -> None:
        """Run one control period."""
        self._range[:] = self._limits
        self._ctrl[:] = self._goal
        mujoco.mj_step(self._model, self._data, self._steps)
        self._q[:] = self._qpos
