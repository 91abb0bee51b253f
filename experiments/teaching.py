"""Accuracy and forces of teaching and replaying: ``python -m experiments.teaching``.

A simulated hand guides the tool sideways and up, and the arm replays this motion. In further runs a
hand holds the tool for 3 s during the replay; the replayed motion either waits for the tool or
continues. The encoder step is 0.088°, and the true k_p is as assumed or 20 % lower.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

import pliant
from experiments import command_line, markdown
from experiments.arms import load
from experiments.runner import Job, run_by_key
from pliant.sim import Drag, ForceProfile, Plant, SimDrive
from pliant.teach import Motion, Replay, record

if TYPE_CHECKING:
    from collections.abc import Iterable


#: Encoder step [rad].
COUNT = float(np.deg2rad(0.088))
#: By arm: start pose [rad], distance by which the hand guides the tool in y and in z [m], and
#: cap of a soft axis during the replay [N].
ARMS = {
    "arm7": ([-0.1326, -0.6005, 0.7160, -1.7376, 0.9268, 0.6788, -0.1657], 0.15, 0.06, 5.0),
    "so101": ([0.0, -0.3, 0.3, 0.9, 0.0], 0.08, 0.03, 2.0),
}
#: Start and duration of the motion of the hand that teaches [s]; it starts after the initial swing.
HAND_START, HAND_DURATION = 14.0, 3.0
#: Stiffness [N/m] and largest force [N] of every hand.
STIFFNESS, LIMIT = 2000.0, 60.0
#: Time span in which a hand holds the tool, in the time of the simulation that replays [s].
BLOCK_SPAN = (2.2, 5.2)
#: Argument `wait` of `Replay` with which the replayed motion never waits: deviations [m], [rad]
#: that the tool does not reach.
NEVER_WAIT = (10.0, 10.0)


def teaching(name: str, kp_scale: float) -> Motion:
    """Return the motion that a simulated hand teaches the arm `name`.

    Args:
        name: Name of the arm.
        kp_scale: Ratio of the true to the assumed servo stiffness [1].
    """
    q, sideways, height, _ = ARMS[name]
    course = ForceProfile(
        start=HAND_START, rise=HAND_DURATION, end=HAND_START + HAND_DURATION + 0.5
    )
    hands = [
        Drag(
            axis=axis, distance=distance, stiffness=STIFFNESS, limit=LIMIT, at="tool", course=course
        )
        for axis, distance in (("y", sideways), ("z", height))
    ]
    with _connect(name, q, kp_scale, hands) as arm:
        return record(arm, idle_timeout=1.0)


def _connect(name: str, q: Iterable[float], kp_scale: float, scene: list[Drag]) -> pliant.arm.Arm:
    model: pliant.Model = pliant.robots.load(name)
    plant = Plant(model, scene=scene, kp_scale=kp_scale, encoder_step=COUNT)
    plant.reset(np.array(list(q)))
    return pliant.Arm(model, SimDrive(plant), on_exit="leave_enabled")


@dataclass(frozen=True)
class ReplayResult:
    """Result of one replay.

    Attributes:
        worst, median, end: Largest, median and final distance of the tool from the point of the
            replayed motion at the same time [m].
        path: Largest distance of the tool from the nearest point of the taught path [m].
        force: Median force of the hand that holds the tool, in the last second of its hold [N]; 0
            without a hand.
        peak: Largest force of the hand that holds the tool [N]; 0 without a hand.
        after: Largest speed of the tool after the hand has released it [m/s]; 0 without a hand.
        took: Duration of the replay [s].
    """

    worst: float
    median: float
    end: float
    path: float
    force: float
    peak: float
    after: float
    took: float


def replay(name: str, kp_scale: float, soft: bool, speed: float, *held: bool) -> ReplayResult:
    """Teach a motion, replay it and measure the result.

    Args:
        name: Name of the arm.
        kp_scale: Ratio of the true to the assumed servo stiffness [1].
        soft: True if the y axis is soft during the replay.
        speed: Ratio of the replay's speed to that of teaching.
        *held: No value: no hand holds the tool. One value: a hand holds the tool during
            `BLOCK_SPAN`, and the replayed motion waits for the tool (True) or continues (False).
    """
    block, wait = bool(held), all(held)
    motion, cap = teaching(name, kp_scale), ARMS[name][3]
    model = load(name).model
    task = "xyz rpy" if model.n > 5 else "xyz"
    axes = {"y": pliant.Axis(soft=cap, profile="constant")} if soft else {}
    course = ForceProfile(start=BLOCK_SPAN[0], rise=0.0, end=BLOCK_SPAN[1])
    hand = Drag(axis="y", distance=0.0, stiffness=STIFFNESS, limit=LIMIT, at="tool", course=course)
    scene = [hand] if block else []
    rows = []
    with _connect(name, motion.q[0], kp_scale, scene) as arm:
        assert isinstance(arm.drive, SimDrive)
        plant = arm.drive.plant
        controller = pliant.Controller(arm.model, pliant.Settings(task=task, axes=axes), arm.servos)
        options = {"speed": speed} if wait else {"speed": speed, "wait": NEVER_WAIT}
        replay = Replay(controller, motion, **options)
        has_position = False
        for tick in pliant.Loop(arm, controller, duration=40.0):
            tick.write(replay.step(tick.q, dt=tick.dt), replay.extra(arm))
            now = tick.began  # the scene's hand uses the plant's clock
            if block and not has_position and now >= BLOCK_SPAN[0] - 0.02:
                plant.ground_truth.remember()  # makes the hand hold the tool's present position
                has_position = True
            force = float(np.linalg.norm(plant.hands[0].force)) if block else 0.0
            expected = model.forward_kinematics(motion.at(replay.time))[:3, 3]
            rows.append((now, replay.time, force, *plant.tool[:3, 3], *expected))
            if replay.done and now > BLOCK_SPAN[1] + 4.0 * block:
                break
    data = np.array(rows)
    time, clock, forces, tool, expected = np.split(data, [1, 2, 3, 6], axis=1)
    time, clock, forces = time[:, 0], clock[:, 0], forces[:, 0]
    is_playing = clock > 0.0
    error = np.linalg.norm(tool - expected, axis=1)
    taught_path = np.array([model.forward_kinematics(q)[:3, 3] for q in motion.q])
    path = np.linalg.norm(tool[is_playing, None] - taught_path[None], axis=2).min(axis=1)
    speeds = np.linalg.norm(np.diff(tool, axis=0), axis=1) / np.diff(time)
    is_late = (time > BLOCK_SPAN[1] - 1.0) & (time < BLOCK_SPAN[1])
    is_released = time[1:] > BLOCK_SPAN[1]
    return ReplayResult(
        worst=float(error[is_playing].max()),
        median=float(np.median(error[is_playing])),
        end=float(error[-1]),
        path=float(path.max()),
        force=float(np.median(forces[is_late])) if block else 0.0,
        peak=float(forces.max()),
        after=float(speeds[is_released].max()) if block else 0.0,
        took=float(time[-1] - time[0]),
    )


def main(jobs: int = 2) -> None:
    """Measure teaching and replaying.

    Args:
        jobs: Number of processes.
    """
    free = [
        (name, kp, soft, speed)
        for name in ARMS
        for kp in (1.0, 0.8)
        for soft, speed in ((False, 1.0), (True, 1.0), (True, 0.5), (True, 2.0))
    ]
    held_cases = [
        (name, 1.0, soft, 1.0, wait)
        for name in ARMS
        for soft in (False, True)
        for wait in (True, False)
    ]
    results = run_by_key([Job(str(case), replay, case) for case in (*free, *held_cases)], jobs)
    rows: list[tuple[str, ...]] = []
    for case in free:
        name, kp, soft, speed = case
        run = results[str(case)]
        error = f"{1e3 * run.worst:.1f} ({1e3 * run.median:.1f})"
        path = f"{1e3 * run.path:.1f}"
        rows.append((name, f"{kp:g}", _stiffness(name, soft), f"{speed:g}", error, path))
    columns = ["arm", "k_p ×", "y", "speed", "off the clock, worst (median) [mm]"]
    print(markdown.table([*columns, "off the path [mm]"], rows))
    rows = []
    for held in held_cases:
        name, _, soft, _, wait = held
        run = results[str(held)]
        force, peak, end = f"{run.force:.1f}", f"{run.peak:.1f}", f"{1e3 * run.end:.1f}"
        motion = "waits" if wait else "runs on"
        rows.append((name, _stiffness(name, soft), motion, force, peak, f"{run.after:.2f}", end))
    columns = ["arm", "y", "the motion", "force held [N]", "peak [N]", "tool after [m/s]"]
    print()
    print(markdown.table([*columns, "end [mm]"], rows))


def _stiffness(name: str, soft: bool) -> str:
    return f"{ARMS[name][3]:g} N" if soft else "stiff"


if __name__ == "__main__":
    command_line.start(main)
