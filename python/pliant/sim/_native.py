"""Physics of a control period in one call of MuJoCo, for arms that hold one object."""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING, Any

import numpy as np

from pliant.sim._mujoco import mujoco

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pliant._typing import Array
    from pliant.sim.plant import Plant


class NativeArms:
    """Runs the physics of several `Plant` objects, one after another, without Python between steps.

    The plants have no delays, losses, encoder steps, dead bands, hands or `Friction`. The scene of
    each plant is one `GraspedObject` with one joint, whose records stay empty.

    Args:
        count: Number of arms N.
        n: Number of joints of an arm.

    Attributes:
        goal: Goals of the servos (N, n) [rad]; read in each period.
        limits: Least and largest torque of each servo (N, n, 2) [N·m]; read in each period.
        q: Joint positions (N, n) [rad].
        travel: Position of the object's joint since the reset (N,) [rad] or [m].
        force: Norm of the force in the grip (N,) [N].
    """

    def __init__(self, count: int, n: int) -> None:
        self.goal, self.limits = np.zeros((count, n)), np.zeros((count, n, 2))
        self._position, self.force = np.zeros((count, n + 1)), np.zeros(count)
        self.q, self.travel = self._position[:, :n], self._position[:, n]
        # Views of MuJoCo's memory and of the arrays above, one tuple per arm: access through
        # attributes is slow after the physics of all other arms. Copies between memoryviews take a
        # third of the time of copies between arrays.
        self._arms: list[Any] = [None] * count

    def put(self, row: int, plant: Plant) -> None:
        """Replace the plant of an arm by another plant, after its `reset`."""
        model, data, n = plant.mj_model, plant.mj_data, plant.n
        dof, servo = plant._bank.addresses
        if not (np.array_equal(dof, np.arange(n)) and np.array_equal(servo, np.arange(n))):
            raise AssertionError("the joints of the chain come first in the physics model")
        if model.neq != 1 or data.qpos.size != n + 1:
            raise AssertionError("a grip is the only constraint, the object has one joint")
        self._position[row], self.force[row] = data.qpos, 0.0
        self._arms[row] = (
            _flat(model.actuator_forcerange[:n]), _flat(self.limits[row]),
            _flat(data.ctrl[:n]), _flat(self.goal[row]), model, data, plant.steps,
            _flat(self._position[row]), _flat(data.qpos),
        )  # fmt: skip

    def advance(self, rows: Iterable[int]) -> None:
        """Run one control period of the arms `rows`."""
        arms, force, step = self._arms, self.force, mujoco.mj_step
        for row in rows:
            torque, limits, servo, goal, model, data, steps, position, state = arms[row]
            torque[:], servo[:] = limits, goal
            step(model, data, steps)
            position[:] = state
            # The constraint forces of the grip come first, in base axes.
            constraint = data.efc_force
            force[row] = hypot(constraint[0], constraint[1], constraint[2])


def _flat(array: Array) -> memoryview[float]:
    """Return the numbers of a contiguous array as a view of its memory."""
    return array.data.cast("B").cast("d")
