"""Opening doors: a leaf on a hinge, gripped rigidly or by a handle that turns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from experiments.conditions import NOMINAL
from experiments.episode import Trace, run
from experiments.setups import pull, tool
from pliant import NullSpace
from pliant.sim import doors as leaves
from pliant.sim.postures import AT_DOOR, AT_DOOR_HORIZONTAL, AT_OVEN, VERTICAL

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from experiments.conditions import Conditions
    from experiments.hands import Law
    from pliant.sim.doors import Door
    from pliant.sim.grasp import Grip

    Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A door, the arm's start, and the motion that opens it.

    Attributes:
        leaf: Makes the door; takes its attributes.
        start: Posture at the closed door (7,) [rad].
        soft: Axes that give way so that the handle finds its own path.
        distance: Distance by which the target is pulled back, or the base moves [m].
        base: True if the base moves instead of the target.
    """

    leaf: Callable[..., Door]
    start: Array
    soft: str = "y yaw"
    distance: float = 0.28
    base: bool = False


SCENES: Mapping[str, Scene] = {
    "door": Scene(leaf=leaves.door, start=AT_DOOR),
    "fridge": Scene(leaf=leaves.fridge, start=AT_DOOR),
    "horizontal": Scene(leaf=leaves.door, start=AT_DOOR_HORIZONTAL),
    "oven": Scene(leaf=leaves.oven, start=AT_OVEN, soft="z pitch", distance=0.26),
    "base door": Scene(leaf=leaves.door, start=VERTICAL, base=True),
    "base fridge": Scene(leaf=leaves.fridge, start=VERTICAL, base=True),
}


@dataclass(frozen=True, kw_only=True)
class Opened:
    """Result of opening a door.

    Attributes:
        angle: Widest opening [deg].
        force: Largest force at the handle in any physics step [N].
        torque: Largest torque there [N·m]; 0 for a handle that turns in the grip.
        trace: The run.
    """

    angle: float
    force: float
    torque: float
    trace: Trace


def open_door(
    law: Callable[..., Law],
    scene: str = "door",
    grip: Grip = "rigid",
    *,
    conditions: Conditions = NOMINAL,
) -> Opened:
    """Pull a door open for 9.5 s.

    Args:
        law: Makes the settings from the scene's soft axes, `soft`, and a group `null_space`.
        scene: Name of one of `SCENES`.
        grip: `rigid` or `turning`.
        conditions: Loop, bus and assumptions.

    Returns:
        The figures and the run.
    """
    setup = SCENES[scene]
    drive = leaves.Drive(distance=setup.distance) if setup.base else None
    leaf = setup.leaf(grip=grip, drive=drive)
    start = tool(setup.start)
    target = start if setup.base else pull(start, setup.distance)
    settings = law(soft=setup.soft, null_space=NullSpace(gain=1.0))
    trace = run(conditions.build(leaf), conditions.controller(settings), target, 9.5, q=setup.start)
    return Opened(
        angle=float(np.rad2deg(leaf.widest)),
        force=leaf.peak_force,
        torque=leaf.peak_torque,
        trace=trace,
    )
