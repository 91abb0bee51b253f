"""An arm on the simulator without a configuration file: no table, no rest pose."""

from typing import Any

import pliant
from pliant.config.factory import ARM_OPTIONS
from pliant.sim import Plant, SimDrive


def bare_arm(
    robot: str = "arm7", *, q: Any = None, real_time: bool = False, **options: Any
) -> pliant.Arm:
    """Return a built-in model on the simulator.

    Args:
        robot: Name of the built-in model.
        q: Initial joint positions (n,) [rad]; None: the middle of the ranges.
        real_time: Run in real time.
        **options: Options of `pliant.Arm` and `pliant.sim.Plant`.
    """
    model = pliant.robots.load(robot)
    own = {name: value for name, value in options.items() if name in ARM_OPTIONS}
    plant = Plant(model, **{k: v for k, v in options.items() if k not in own or k == "rate"})
    if q is not None:
        plant.reset(q)
    return pliant.Arm(model, SimDrive(plant, real_time=real_time), **own)
