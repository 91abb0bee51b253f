"""Gravity capture measured: ``python -m experiments.capturing``.

Random poses of every arm, k_p of the servos half to twice the assumed one, encoder of 0.088°, y
yields: the share of poses in which the check finds that the tool stays, the share of the others in
which less feed-forward helps, and the motion in the 8 s after it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
import tyro

import pliant
from experiments.campaign_arms import load
from experiments.runner import Job, Workers
from pliant import identify
from pliant.sim import Plant

ARMS = ("arm7", "so101", "koch")
SCALES = (0.5, 0.8, 1.0, 1.25, 2.0)
COUNT = float(np.deg2rad(0.088))
KINDS = ("stays", "remedied")
#: Observation time after the call's own check [s].
AFTER = 8.0


@dataclass(frozen=True)
class Tried:
    """Result of one capture.

    Attributes:
        stays: True if the check finds that the arm stays.
        remedied: True if it stays only with the proposed settings.
        later: Displacement of the tool in the 8 s after it, with the proposed settings [m].
    """

    stays: bool
    remedied: bool
    later: float


def tried(
    name: str, pose: int, kp_scale: float, *, eta: float = 0.999, creep: float = 1.0
) -> Tried:
    """Capture in one random pose of an arm, y yielding, and observe.

    Args:
        name: Arm.
        pose: Index among its random poses.
        kp_scale: True over assumed stiffness.
        eta: Of the axis that yields.
        creep: Creep speed of joints held by friction, relative to MuJoCo's default.
    """
    arm = load(name)
    table = arm.servos.replace(encoder_step=COUNT, stiffness_known=False)
    plant = Plant(arm.model, table, kp_scale=kp_scale, count=COUNT, creep=creep)
    plant.reset(arm.poses(pose + 1)[pose])
    axes = {"y": pliant.Axis(yields="both", adaptation=eta)}
    settings = pliant.Settings(task=" ".join(arm.axes), axes=axes, accept_high_adaptation=True)
    controller = pliant.Controller(arm.model, settings, table)
    found = identify.capture_gravity(plant, controller)
    if found.remedy is not None:
        controller.update(found.remedy)
    place, q = plant.tool[:3, 3], plant.read().q
    target, later = arm.model.forward_kinematics(q), 0.0
    for _ in range(round(AFTER * plant.rate)):
        command = controller.step(plant.read().q, target)
        plant.write(command.goal, command.torque_limit)
        plant.advance()
        later = max(later, float(np.linalg.norm(plant.tool[:3, 3] - place)))
    return Tried(found.stays, found.remedy is not None, later)


@dataclass(frozen=True)
class Options:
    """Capture in random poses.

    Attributes:
        arm: Arms by name; default all built-in ones.
        poses: Random poses of each.
        eta: Of the axis that yields.
        creep: Creep speed of joints held by friction, relative to MuJoCo's default.
        jobs: Number of processes.
    """

    arm: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    poses: int = 20
    eta: float = 0.999
    creep: float = 1.0
    jobs: int = 2


def main() -> None:
    """Print the table."""
    options = tyro.cli(Options)
    cases = [(name, kp) for name in options.arm or ARMS for kp in SCALES]
    more = {"eta": options.eta, "creep": options.creep}
    jobs = [
        Job(f"{name} {kp} {pose}", tried, (name, pose, kp), more)
        for name, kp in cases
        for pose in range(options.poses)
    ]
    with Workers(options.jobs) as workers:
        outcomes = workers.run(jobs)
    print("| arm | k_p × | stays [%] | with the remedy [%] | neither [%] | ", end="")
    print("of those that stay, below 5 mm for 8 s more [%] |\n|---|---|---|---|---|---|")
    for name, kp in cases:
        runs = [outcomes[f"{name} {kp} {pose}"] for pose in range(options.poses)]
        stay, remedied = (float(np.mean([getattr(run, key) for run in runs])) for key in KINDS)
        true = [run.later < 5e-3 for run in runs if run.stays or run.remedied]
        neither = max(1.0 - stay - remedied, 0.0)
        shares = (stay, remedied, neither, float(np.mean(true)) if true else np.nan)
        print(f"| {name} | {kp:g} | " + " | ".join(f"{100.0 * x:.0f}" for x in shares) + " |")


if __name__ == "__main__":
    main()
