"""Arms for tests: without a configuration file, or with one that leaves torque on at exit."""

from pathlib import Path
from typing import Any

import pliant
from pliant.config.factory import ARM_OPTIONS
from pliant.sim import Plant, SimDrive


def left_enabled(folder: Path) -> str:
    """Write the file of an SO-101 whose torque stays on at exit, and return its path.

    A descent would take as long as on a real arm. The reply timeout is long, because a busy machine
    may delay replies.
    """
    loop = "[loop]\nreply_timeout_min = 0.2\ncomm_timeout = 10.0\n\n"
    life = f'{loop}[life]\non_exit = "leave_enabled"\n'
    file = folder / "arm.toml"
    file.write_text(pliant.config.loader.builtin_text("so101").replace("[life]\n", life))
    return str(file)


def bare_arm(
    robot: str = "arm7", *, q: Any = None, real_time: bool = False, **options: Any
) -> pliant.Arm:
    """Return a simulated arm of a built-in model, without a table and without a rest pose.

    Args:
        robot: Name of the built-in model.
        q: Initial joint positions (n,) [rad]; None: the middle of the ranges.
        real_time: True: the simulation runs in real time.
        **options: Options of `pliant.Arm` and `pliant.sim.Plant`.
    """
    model = pliant.robots.load(robot)
    arm_options = {name: value for name, value in options.items() if name in ARM_OPTIONS}
    plant = Plant(
        model, **{k: v for k, v in options.items() if k not in arm_options or k == "rate"}
    )
    if q is not None:
        plant.reset(q)
    return pliant.Arm(model, SimDrive(plant, real_time=real_time), **arm_options)
