"""Motion into a wall: impact, and remaining force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from experiments.conditions import NOMINAL
from experiments.episode import Trace, run
from experiments.setups import pull, tool
from pliant.sim import Wall
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from collections.abc import Callable

    from experiments.conditions import Conditions
    from experiments.hands import Law
    from pliant.sim import Plant

#: Directions into the wall: the axis that is soft, and the sign.
DIRECTIONS = {"+x": ("x", 1.0), "+y": ("y", 1.0), "-z": ("z", -1.0)}
STIFFNESSES = (2e3, 2e4)
SPEEDS = (0.05, 0.10, 0.25)
#: Distance of the wall, and of the target behind its surface [m].
GAP, BEHIND = 0.05, 0.10


@dataclass(frozen=True, kw_only=True)
class Bumped:
    """Forces on the wall.

    Attributes:
        peak: Largest force of any physics step [N].
        later: Largest mean over a tick from 0.3 s after the first touch on [N].
        final: Mean force of the last half second [N].
        allowed: cap + v √(k m), of a mass m that meets a spring k at speed v [N].
        mass: Effective mass m of the arm along the wall's normal, rotors included [kg].
        trace: The run.
    """

    peak: float
    later: float
    final: float
    allowed: float
    mass: float
    trace: Trace


def effective_mass(plant: Plant, axis: int) -> float:
    """Return the effective mass [kg] along a base axis: 1 / (n J M⁻¹ Jᵀ nᵀ), with rotors."""
    model, data = plant.mj_model, plant.mj_data
    mujoco.mj_forward(model, data)
    inertia = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, inertia)
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, plant.ground_truth.frame("tool").site)
    row = jacobian[axis]
    return float(1.0 / (row @ np.linalg.solve(inertia, row)))


def bump(
    law: Callable[..., Law],
    direction: str = "+x",
    *,
    speed: float = 0.10,
    stiffness: float = 2e4,
    cap: float = 15.0,
    conditions: Conditions = NOMINAL,
) -> Bumped:
    """Run into a wall 0.05 m away with a target that continues for another 0.10 m.

    Args:
        law: Makes the settings from the soft axis, `soft`, and `eta`.
        direction: One of `DIRECTIONS`.
        speed: Of the target [m/s].
        stiffness: Of the wall [N/m].
        cap: Force that the law promises at a large deviation [N].
        conditions: Loop, bus and assumptions.

    Returns:
        The figures and the run.
    """
    axis, sign = DIRECTIONS[direction]
    index = "xyz".index(axis)
    wall = Wall(into=tuple(sign * np.eye(3)[index]), distance=GAP, stiffness=stiffness)
    plant = conditions.build(wall)
    plant.reset(VERTICAL)
    mass = effective_mass(plant, index)
    target = pull(tool(VERTICAL), GAP + BEHIND, axis=axis, speed=sign * speed)
    duration = 1.0 + (GAP + BEHIND) / speed + 3.0
    trace = run(plant, conditions.controller(law(soft=axis, eta=0.0)), target, duration, q=VERTICAL)
    force = np.abs(trace.force[:, index])
    touched = float(trace.t[int(np.argmax(force > 0.0))])
    return Bumped(
        peak=plant.hands[0].peak_force,
        later=float(force[trace.t > touched + 0.3].max()),
        final=float(force[trace.t > duration - 0.5].mean()),
        allowed=cap + speed * float(np.sqrt(stiffness * mass)),
        mass=mass,
        trace=trace,
    )
