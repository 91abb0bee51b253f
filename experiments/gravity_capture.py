"""Accuracy of gravity capture: ``python -m experiments.gravity_capture``.

In random poses of every arm with soft y, `capture_gravity` measures the gravity offset and checks
that the arm stays at rest. The true k_p is half to twice the assumed one, and the encoder step is
0.088°. Of all poses, the program prints the share in which the arm stays, the share in which
`capture_gravity` proposes other settings with which it stays, and the share with neither. Of the
poses with either, it prints the share in which the tool moves by less than 5 mm in the 8 s after
the capture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import pliant
from experiments import command_line, markdown
from experiments.arms import load
from experiments.runner import Job, run_by_key
from experiments.simulation import closed_loop
from pliant import identify
from pliant.sim import Plant

ARMS = ("arm7", "so101", "koch")
SCALES = (0.5, 0.8, 1.0, 1.25, 2.0)
COUNT = float(np.deg2rad(0.088))
KINDS = ("stays", "remedied")
#: Time for which the arm is observed after `capture_gravity` and its check have ended [s].
AFTER = 8.0


@dataclass(frozen=True)
class CaptureResult:
    """Result of one gravity capture.

    Attributes:
        stays: True if the arm stayed at rest in the check of `capture_gravity`.
        remedied: True if the check failed and `capture_gravity` found settings with which the arm
            stayed.
        later: Largest displacement of the tool in the 8 s after the capture, with these settings if
            there are any [m].
    """

    stays: bool
    remedied: bool
    later: float


def try_capture(
    name: str, pose: int, kp_scale: float, *, eta: float = 0.999, creep: float = 1.0
) -> CaptureResult:
    """Capture gravity in one random pose of an arm with soft y, and observe the arm for 8 s.

    Args:
        name: Name of the arm.
        pose: Index among the arm's random poses.
        kp_scale: True over assumed stiffness k_p of the servos.
        eta: Target adaptation of the soft axis.
        creep: Creep speed of joints held by friction, relative to MuJoCo's default.
    """
    arm = load(name)
    table = arm.servos.replace(encoder_step=COUNT, stiffness_known=False)
    plant = Plant(arm.model, table, kp_scale=kp_scale, encoder_step=COUNT, friction_creep=creep)
    plant.reset(arm.poses(pose + 1)[pose])
    axes = {"y": pliant.Axis(yields="both", adaptation=eta)}
    settings = pliant.Settings(task=" ".join(arm.axes), axes=axes, accept_high_adaptation=True)
    controller = pliant.Controller(arm.model, settings, table)
    capture = identify.capture_gravity(plant, controller)
    if capture.remedy is not None:
        controller.update(capture.remedy)
    position, motion = plant.tool[:3, 3], 0.0
    target = arm.model.forward_kinematics(plant.read().q)
    for _ in closed_loop(plant, controller, target, AFTER):
        motion = max(motion, float(np.linalg.norm(plant.tool[:3, 3] - position)))
    return CaptureResult(capture.stays, capture.remedy is not None, motion)


def main(
    *,
    arm: command_line.Arms = (),
    poses: int = 20,
    eta: float = 0.999,
    creep: float = 1.0,
    jobs: int = 2,
) -> None:
    """Capture gravity in random poses, and print in how many the arm then stays.

    Args:
        arm: Names of the arms; default: the built-in arms.
        poses: Number of random poses per arm.
        eta: Target adaptation of the soft axis.
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
        stay_share, remedied = (
            float(np.mean([getattr(run, key) for run in runs])) for key in KINDS
        )
        true = [run.later < 5e-3 for run in runs if run.stays or run.remedied]
        neither = max(1.0 - stay_share - remedied, 0.0)
        shares = (stay_share, remedied, neither, float(np.mean(true)) if true else np.nan)
        rows.append((name, f"{kp:g}", *(f"{100.0 * x:.0f}" for x in shares)))
    columns = (
        "arm",
        "k_p ×",
        "stays [%]",
        "with the remedy [%]",
        "neither [%]",
        "of those that stay, below 5 mm for 8 s more [%]",
    )
    print(markdown.table(columns, rows))


if __name__ == "__main__":
    command_line.start(main)
