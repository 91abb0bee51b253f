"""Hand guiding measured: ``python -m experiments.hand_guiding``.

Random poses of every arm, k_p of the servos half, one and two times the assumed one, encoder of
0.088° and dead band of 0.06°: drift of an untouched arm in 10 s, force to guide it, and motion
after the hand has let go.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import pliant
from experiments import program
from experiments.arms import load
from experiments.runner import Job, run_by_key
from pliant.sim import Drag, ForceProfile, Plant

if TYPE_CHECKING:
    from experiments.poses import Array


#: Creep speed of joints held by friction, relative to MuJoCo's default. With the default of 1,
#: joints creep by several mrad/s, which would dominate the drift of a small arm.
CREEP = 0.1
COUNT, DEADBAND = float(np.deg2rad(0.088)), float(np.deg2rad(0.06))
#: Times at which the hand comes, reaches the end of its path, lets go, and the run ends [s].
COMES, THERE, GONE, END = 22.0, 24.0, 25.0, 35.0
#: Distance by which it moves the tool of each arm along y [m].
WAYS = {"arm7": 0.12, "so101": 0.05, "koch": 0.05}


@dataclass(frozen=True)
class GuidingResult:
    """Result of one arm; lengths in m, forces in N.

    Attributes:
        idle: Largest displacement of the tool in the 10 s after the first swing, untouched.
        force: Median force of the hand while it moves the tool.
        led: Distance that the hand moved the tool.
        sag: Largest displacement of the tool in the 10 s after the hand let go.
        later: Same as `sag`, without the first second after the release.
    """

    idle: float
    force: float
    led: float
    sag: float
    later: float


def guide(
    name: str, pose: int, kp_scale: float, *, known: bool = False, creep: float = CREEP
) -> GuidingResult:
    """Run an arm under hand guiding: untouched for 10 s, then moved along y and released.

    Args:
        name: Arm.
        pose: Index among its random poses.
        kp_scale: True over assumed stiffness.
        known: True if the table claims that k_p is known.
        creep: Creep speed of joints held by friction, relative to MuJoCo's default.
    """
    arm = load(name)
    q = arm.poses(pose + 1)[pose]
    way = WAYS.get(name, 0.05)
    course = ForceProfile(start=COMES, rise=THERE - COMES, end=GONE)
    hand = Drag(axis="y", distance=way, stiffness=2000.0, limit=60.0, at="tool", course=course)
    table = arm.servos.replace(encoder_step=COUNT, stiffness_known=known)
    plant = Plant(
        arm.model,
        table,
        kp_scale=kp_scale,
        encoder_step=COUNT,
        deadband=DEADBAND,
        friction_creep=creep,
        scene=[hand],
    )
    plant.reset(q)
    floating = pliant.HandGuiding(arm.model, table)
    rows, ready = [], 0.0
    while plant.time < END:
        order = floating.step(plant.read().q)
        plant.write(order.goal, order.torque_limit)
        plant.advance()
        if not floating.ready:
            ready = plant.time
        force = float(np.linalg.norm(plant.hands[0].force))
        rows.append((plant.time, *plant.tool[:3, 3], force))
    data = np.array(rows)
    time, place, forces = data[:, 0], data[:, 1:4], data[:, 4]

    def farthest(start: float, seconds: float, origin: float) -> float:
        window = (time > start) & (time <= start + seconds)
        return float(
            np.linalg.norm(place[window] - place[np.searchsorted(time, origin)], axis=1).max()
        )

    leading = (time > COMES + 0.5) & (time <= THERE)
    return GuidingResult(
        idle=farthest(ready, 10.0, ready),
        force=float(np.median(forces[leading])),
        led=farthest(COMES, GONE - COMES, COMES),
        sag=farthest(GONE, 10.0, GONE),
        later=farthest(GONE + 1.0, 9.0, GONE + 1.0),
    )


def main(*, arm: program.Arms = (), poses: int = 20, jobs: int = 2, creep: float = CREEP) -> None:
    """Measure hand guiding; figures are median / 95th percentile / worst over the poses.

    Args:
        arm: Arms by name; default all built-in ones.
        poses: Random poses of each.
        jobs: Number of processes.
        creep: Creep speed of joints held by friction, relative to MuJoCo's default.
    """
    cases = [(name, kp) for name in arm or tuple(WAYS) for kp in (0.5, 1.0, 2.0)]
    work = [
        Job(f"{name} {kp} {pose}", guide, (name, pose, kp), {"creep": creep})
        for name, kp in cases
        for pose in range(poses)
    ]
    outcomes = run_by_key(work, jobs)
    columns = (
        "arm",
        "k_p ×",
        "untouched 10 s [mm]",
        "below 2 mm [%]",
        "force to lead [N]",
        "after release [mm]",
        "from 1 s on [mm]",
    )
    rows = []
    for name, kp in cases:
        runs = [outcomes[f"{name} {kp} {pose}"] for pose in range(poses)]
        idle, force, sag, later = (
            scale * np.array([getattr(run, figure) for run in runs])
            for figure, scale in (("idle", 1e3), ("force", 1.0), ("sag", 1e3), ("later", 1e3))
        )
        share = f"{100.0 * float(np.mean(idle < 2.0)):.0f}"
        rows.append((name, f"{kp:g}", _spread(idle), share, *map(_spread, (force, sag, later))))
    print(program.markdown(columns, rows))


def _spread(values: Array) -> str:
    """Return median, 95th percentile and worst."""
    return " / ".join(f"{x:.1f}" for x in np.percentile(values, (50, 95, 100)))


if __name__ == "__main__":
    program.start(main)
