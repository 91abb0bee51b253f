"""Gravity capture measured: ``python -m experiments.gravity_capture``.

Random poses of every arm, k_p of the servos half to twice the assumed one, encoder of 0.088°, y
yields: the share of poses in which the check finds that the tool stays, the share of the others in
which less feed-forward helps, and the motion in the 8 s after it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import pliant
from experiments import program
from experiments.arms import load
from experiments.runner import Job, run_by_key
from experiments.simulation import closed_loop
from pliant import identify
from pliant.sim import Plant

ARMS = ("arm7", "so101", "koch")
SCALES = (0.5, 0.8, 1.0, 1.25, 2.0)
COUNT = float(np.deg2rad(0.088))
KINDS = ("stays", "remedied")
#: Observation time after the call's own check [s].
AFTER = 8.0


@dataclass(frozen=True)
class CaptureResult:
    """Result of one capture.

    Attributes:
        stays: True if the check finds that the arm stays.
        remedied: True if it stays only with the proposed settings.
        later: Displacement of the tool in the 8 s after it, with the proposed settings [m].
    """

    stays: bool
    remedied: bool
    later: float


def try_capture(
    name: str, pose: int, kp_scale: float, *, eta: float = 0.999, creep: float = 1.0
) -> CaptureResult:
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
    plant = Plant(arm.model, table, kp_scale=kp_scale, encoder_step=COUNT, friction_creep=creep)
    plant.reset(arm.poses(pose + 1)[pose])
    axes = {"y": pliant.Axis(yields="both", adaptation=eta)}
    settings = pliant.Settings(task=" ".join(arm.axes), axes=axes, accept_high_adaptation=True)
    controller = pliant.Controller(arm.model, settings, table)
    found = identify.capture_gravity(plant, controller)
    if found.remedy is not None:
        controller.update(found.remedy)
    place, later = plant.tool[:3, 3], 0.0
    target = arm.model.forward_kinematics(plant.read().q)
    for _ in closed_loop(plant, controller, target, AFTER):
        later = max(later, float(np.linalg.norm(plant.tool[:3, 3] - place)))
    return CaptureResult(found.stays, found.remedy is not None, later)


def main(
    *,
    arm: program.Arms = (),
    poses: int = 20,
    eta: float = 0.999,
    creep: float = 1.0,
    jobs: int = 2,
) -> None:
    """Capture in random poses.

    Args:
        arm: Arms by name; default all built-in ones.
        poses: Random poses of each.
        eta: Of the axis that yields.
        creep: Creep speed of joints held by friction, relative to MuJoCo's default.
        jobs: Number of processes.
    """
    cases = [(name, kp) for name in arm or ARMS for kp in SCALES]
    work = [
        Job(f"{name} {kp} {pose}", try_capture, (name, pose, kp), {"eta": eta, "creep": creep})
        for name, kp in cases
        for pose in range(poses)
    ]
    outcomes = run_by_key(work, jobs)
    rows = []
    for name, kp in cases:
        runs = [outcomes[f"{name} {kp} {pose}"] for pose in range(poses)]
        stay, remedied = (float(np.mean([getattr(run, key) for run in runs])) for key in KINDS)
        true = [run.later < 5e-3 for run in runs if run.stays or run.remedied]
        neither = max(1.0 - stay - remedied, 0.0)
        shares = (stay, remedied, neither, float(np.mean(true)) if true else np.nan)
        rows.append((name, f"{kp:g}", *(f"{100.0 * x:.0f}" for x in shares)))
    columns = (
        "arm",
        "k_p ×",
        "stays [%]",
        "with the remedy [%]",
        "neither [%]",
        "of those that stay, below 5 mm for 8 s more [%]",
    )
    print(program.markdown(columns, rows))


if __name__ == "__main__":
    program.start(main)
