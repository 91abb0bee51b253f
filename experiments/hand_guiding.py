"""Accuracy of hand guiding: ``python -m experiments.hand_guiding``.

In random poses of every arm, `pliant.HandGuiding` makes the arm weightless. The program measures
the drift of the untouched arm in 10 s, the force that guides the arm by hand, and the motion after
the release, at rest or in the middle of the motion. The true k_p is half, one and two times the
assumed one; the servos have an encoder step of 0.088° and a dead band of 0.06°.

With ``--swing``, it measures the initial swing instead: of arms with torque on in random poses,
with true k_p, friction and delay that differ from the assumed ones, and with an unknown load.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

import pliant
from experiments import command_line, descent, markdown
from experiments.arms import load
from experiments.runner import Job, run_by_key
from pliant.identify.hand_guiding import UNKNOWN_STIFFNESS_FACTOR
from pliant.sim import Drag, ForceProfile, Plant

if TYPE_CHECKING:
    from collections.abc import Sequence

    from experiments.poses import Array


#: Creep speed of simulated joints that friction holds, relative to MuJoCo's default. With 1, these
#: joints would creep at several mrad/s, which would dominate the drift of a small arm.
CREEP = 0.1
COUNT, DEADBAND = float(np.deg2rad(0.088)), float(np.deg2rad(0.06))
#: Start and end of the hand's motion, release, and end of the run [s].
HAND_START, HAND_END, RELEASE, END = 22.0, 24.0, 25.0, 35.0
#: Release in the middle of the motion [s].
MOVING_RELEASE = 23.0
#: Distance by which the hand moves the tool of each arm along y [m].
DISTANCES = {"arm7": 0.12, "so101": 0.05, "koch": 0.05}
#: Seed of poses and parameters of the initial swings, unknown loads [kg], and control rate [Hz].
SWING_SEED, SWING_LOADS, RATE = 5, (0.0, 0.1, 0.2), 100.0


@dataclass(frozen=True)
class GuidingResult:
    """Result of one run.

    Attributes:
        idle: Largest displacement of the untouched tool in 10 s [m].
        force: Median force of the hand while it moves the tool, without the first 0.5 s [N].
        led: Largest displacement of the tool by the hand [m].
        sag: Largest displacement of the tool from its position at the release, within 10 s [m].
        later: Largest displacement of the tool from its position 1 s after the release, within the
            9 s that follow [m].
        swing: Largest displacement of the tool back from the point farthest from the release,
            within the rest of these 10 s [m].
    """

    idle: float
    force: float
    led: float
    sag: float
    later: float
    swing: float


def guide(
    name: str,
    pose: int,
    kp_scale: float,
    *,
    known: bool = False,
    creep: float = CREEP,
    release: float = RELEASE,
) -> GuidingResult:
    """Run an arm under hand guiding: untouched for 10 s, then moved along y and released.

    Args:
        name: Name of the arm.
        pose: Index among the arm's random poses.
        kp_scale: True over assumed stiffness k_p of the servos.
        known: True if the servo table states that k_p is known.
        creep: Creep speed of joints held by friction, relative to MuJoCo's default.
        release: Time at which the hand lets go [s].
    """
    arm = load(name)
    q = arm.poses(pose + 1)[pose]
    distance = DISTANCES.get(name, 0.05)
    course = ForceProfile(start=HAND_START, rise=HAND_END - HAND_START, end=release)
    hand = Drag(axis="y", distance=distance, stiffness=2000.0, limit=60.0, at="tool", course=course)
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
    time, position, forces = data[:, 0], data[:, 1:4], data[:, 4]

    def farthest(start: float, seconds: float, origin: float) -> float:
        window = (time > start) & (time <= start + seconds)
        return float(
            np.linalg.norm(position[window] - position[np.searchsorted(time, origin)], axis=1).max()
        )

    is_leading = (time > HAND_START + 0.5) & (time <= min(HAND_END, release))
    after = position[(time > release) & (time <= release + 10.0)]
    start = int(np.argmax(np.linalg.norm(after - position[np.searchsorted(time, release)], axis=1)))
    return GuidingResult(
        idle=farthest(ready, 10.0, ready),
        force=float(np.median(forces[is_leading])),
        led=farthest(HAND_START, release - HAND_START, HAND_START),
        sag=farthest(release, 10.0, release),
        later=farthest(release + 1.0, 9.0, release + 1.0),
        swing=float(np.linalg.norm(after[start:] - after[start], axis=1).max()),
    )


@dataclass(frozen=True)
class SwingResult:
    """Motion of the tool in the initial swing of an arm, and after it.

    Attributes:
        moved, up, down: Largest displacement, rise and drop [m].
        speed: Largest speed [m/s].
        left: Displacement at the end of the swing [m].
        later, fastest: Largest displacement [m] and speed [m/s] in the 10 s that follow.
    """

    moved: float
    up: float
    down: float
    speed: float
    left: float
    later: float
    fastest: float


def swing(name: str, number: int, load: float) -> SwingResult | None:
    """Begin hand guiding after torque on, with wrong assumptions; None if it refuses to go on.

    Args:
        name: Name of the arm.
        number: Number of random pose and true parameters, as in `experiments.descent`.
        load: Load at the tool that the controller does not know [kg].
    """
    q, truth = descent.random_parameters(descent.robot(name), number + 1, seed=SWING_SEED)[number]
    largest = UNKNOWN_STIFFNESS_FACTOR
    stiffness = np.clip(truth.stiffness, 1.0 / largest, largest)
    truth = replace(truth, load=load, stiffness=tuple(stiffness.tolist()))
    case = descent.Case(arm=name, number=number, over_table=False, q=tuple(q), truth=truth)
    with descent.simulated_arm(case) as (arm, recorder):
        arm.enable()
        guiding = pliant.HandGuiding(arm.model, arm.servos)
        recorder.begin()
        lowest, end = 0.0, np.inf
        try:
            for tick in pliant.Loop(arm, guiding, rate=RATE):
                tick.step()
                moved = recorder.plant.tool[:3, 3] - recorder.start
                if end == np.inf:
                    lowest = min(lowest, float(moved[2]))
                    if not guiding.ready:
                        continue
                    peaks, left = recorder.seen, float(np.linalg.norm(moved))
                    recorder.begin()
                    end = tick.time + 10.0
                if tick.time > end:
                    break
        except pliant.ServoError:
            return None
        finally:
            after = recorder.seen
            arm.disable_torque()
    return SwingResult(
        peaks.moved, peaks.rise, -lowest, peaks.speed, left, after.moved, after.speed
    )


def swings(arms: Sequence[str], poses: int, jobs: int) -> str:
    """Return a table of the initial swings: median and largest value over the poses."""
    names = arms or tuple(name for name in descent.ARMS if descent.is_here(name))
    cases = [(name, mass) for name in names for mass in SWING_LOADS]
    work = [
        Job(f"{name} {mass} {pose}", swing, (name, pose, mass))
        for name, mass in cases
        for pose in range(poses)
    ]
    outcomes = run_by_key(work, jobs)
    rows = []
    for name, mass in cases:
        runs = [outcomes[f"{name} {mass} {pose}"] for pose in range(poses)]
        done = [run for run in runs if run is not None]
        texts = [
            _median_and_largest([scale * getattr(run, figure) for run in done], digits)
            for figure, scale, digits in (
                ("moved", 1e3, 0),
                ("up", 1e3, 0),
                ("down", 1e3, 0),
                ("speed", 1.0, 2),
                ("left", 1e3, 1),
                ("later", 1e3, 1),
                ("fastest", 1.0, 2),
            )
        ]
        rows.append((name, f"{mass:g}", *texts, str(len(runs) - len(done))))
    columns = (
        "arm",
        "load [kg]",
        "moves [mm]",
        "up [mm]",
        "down [mm]",
        "speed [m/s]",
        "at the end [mm]",
        "then untouched 10 s [mm]",
        "at most [m/s]",
        "refused",
    )
    return markdown.table(columns, rows)


def main(
    *,
    arm: command_line.Arms = (),
    poses: int = 20,
    jobs: int = 2,
    creep: float = CREEP,
    moving: bool = False,
    swing: bool = False,
) -> None:
    """Measure hand guiding; print median / 95th percentile / largest value over the poses.

    Args:
        arm: Names of the arms; default: the built-in arms.
        poses: Number of random poses per arm.
        jobs: Number of processes.
        creep: Creep speed of joints held by friction, relative to MuJoCo's default.
        moving: True: the hand lets go in the middle of its motion, not at rest.
        swing: True: measure the initial swing instead.
    """
    if swing:
        print(swings(arm, poses, jobs))
        return
    release = MOVING_RELEASE if moving else RELEASE
    cases = [(name, kp) for name in arm or tuple(DISTANCES) for kp in (0.5, 1.0, 2.0)]
    work = [
        Job(f"{name} {kp} {pose}", guide, (name, pose, kp), {"creep": creep, "release": release})
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
        "swings back [mm]",
    )
    rows = []
    for name, kp in cases:
        runs = [outcomes[f"{name} {kp} {pose}"] for pose in range(poses)]
        idle, force, sag, later, back = (
            scale * np.array([getattr(run, figure) for run in runs])
            for figure, scale in (
                ("idle", 1e3),
                ("force", 1.0),
                ("sag", 1e3),
                ("later", 1e3),
                ("swing", 1e3),
            )
        )
        share = f"{100.0 * float(np.mean(idle < 2.0)):.0f}"
        rows.append(
            (name, f"{kp:g}", _spread(idle), share, *map(_spread, (force, sag, later, back)))
        )
    print(markdown.table(columns, rows))


def _median_and_largest(values: Sequence[float], digits: int) -> str:
    """Return median and largest value as text, with this number of decimals."""
    return f"{np.median(values):.{digits}f} / {max(values):.{digits}f}"


def _spread(values: Array) -> str:
    """Return median, 95th percentile and largest value as text."""
    return " / ".join(f"{x:.1f}" for x in np.percentile(values, (50, 95, 100)))


if __name__ == "__main__":
    command_line.start(main)
