"""Rest, oscillation or drift of arms near a joint limit after a push.

``python -m experiments.joint_limit_rest`` starts in random poses with one joint within 0.06 rad of
its position limit. A hand moves the tool along a soft axis by 5 cm, holds it and releases it. The
program then observes the joints during one second twice: 2.5 s and 8 s after the release.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

import pliant
from experiments import command_line, markdown
from experiments.arms import AXES, LEAST_SIGMA, load
from experiments.controllers import NO_RATE_LIMITS
from experiments.runner import run_jobs
from experiments.simulation import closed_loop
from experiments.spring_hand import OF_CAPACITY, Grip
from pliant import robots
from pliant.sim import Plant

if TYPE_CHECKING:
    from collections.abc import Sequence

    from experiments.arms import Arm
    from experiments.poses import Array


#: Largest distance of one joint from its position limit in the start pose [rad].
ROOM = 0.06
#: Hand: start [s], duration [s] and speed [m/s] of its motion, time of the release [s].
HAND_START, HAND_DURATION, SPEED, RELEASE = 0.1, 0.5, 0.1, 3.0
#: Starts of the two observations after the release, and duration of each [s].
OBSERVATION_STARTS, OBSERVATION_TIME = (2.5, 8.0), 1.0
#: Number of poses per arm.
POSES = 20
#: Cases: delay of readings and, equally, of commands [ticks], and target adaptation η.
CASES = ((0, 0.0), (1, 0.0), (0, 0.9))


@dataclass(frozen=True, kw_only=True)
class Rest:
    """Result of one push.

    Attributes:
        arm: Name of the arm.
        ticks: Delay of readings and of commands [ticks].
        eta: Target adaptation of the soft axis.
        pose: Index among the arm's poses.
        room: Smallest distance of a joint to its limit at the release [rad].
        moves: Largest range of motion of a joint, in each of the two observations [rad].
        turns: Largest number of reversals of a joint that moves at least 5 mrad, in each of the two
            observations.
    """

    arm: str
    ticks: int
    eta: float
    pose: int
    room: float
    moves: tuple[float, float]
    turns: tuple[int, int]


def pose_near_limit(arm: Arm, pose: int) -> Array:
    """Return a random pose (n,) [rad] in which one joint is within `ROOM` of its position limit.

    The servos can hold the arm in the pose, and the pose is not near a singularity. `pose` is the
    random seed.
    """
    rng = np.random.default_rng((pose, 11))
    lower, upper = np.asarray(arm.model.lower), np.asarray(arm.model.upper)
    candidates = arm.poses(len(arm.drawn))
    while True:
        q: Array = candidates[rng.integers(len(candidates))].copy()
        joint, room = rng.integers(arm.model.n), rng.uniform(0.0, ROOM)
        q[joint] = lower[joint] + room if rng.random() < 0.5 else upper[joint] - room
        weakest = min(arm.capacity(q, row, sign) for row in arm.rows for sign in (1.0, -1.0))
        scaled = arm.model.jacobian(q)[arm.rows]
        if weakest > 0.0 and np.linalg.svd(scaled, compute_uv=False)[-1] > LEAST_SIGMA * 0.1:
            return q


@lru_cache(maxsize=2)
def _plant(name: str, ticks: int) -> tuple[Plant, Grip]:
    arm = load(name)
    grip = Grip(arm.median_capacity[0] / OF_CAPACITY)
    return Plant(arm.model, scene=[grip], delay=(ticks, ticks)), grip


@dataclass(frozen=True)
class Job:
    """One push of one arm: pose index, delay each way [ticks], and target adaptation η."""

    arm: str
    pose: int
    ticks: int = 0
    eta: float = 0.0

    def run(self) -> Rest:
        """Push the arm, release it, and return the observed motion."""
        arm, (plant, grip) = load(self.arm), _plant(self.arm, self.ticks)
        rng = np.random.default_rng((self.pose, 12))
        row = int(rng.choice([row for row in arm.rows if row < 3]))
        sign, cap = float(rng.choice((-1.0, 1.0))), arm.caps(row)[1]
        settings = pliant.Settings(
            task=" ".join(arm.axes),
            axes={AXES[row]: pliant.Axis(soft=cap, firm=cap, adaptation=self.eta)},
            delay=2 * self.ticks / plant.rate,
            **NO_RATE_LIMITS,
        )
        controller = pliant.Controller(arm.model, settings, arm.servos)
        q = pose_near_limit(arm, self.pose)
        plant.reset(q)
        controller.reset(q)
        grip.place(plant)
        grip.hold([row])
        target = plant.tool if any(row > 2 for row in arm.rows) else plant.tool[:3, 3]

        def push(now: float, plant: Plant) -> None:
            grip.move(row, sign * SPEED if HAND_START <= now < HAND_START + HAND_DURATION else 0.0)
            if now >= RELEASE:
                grip.hold([])

        end = RELEASE + OBSERVATION_STARTS[-1] + OBSERVATION_TIME
        loop = closed_loop(plant, controller, target, end, on_tick=push)
        angles = np.array([plant.q for _ in loop])
        start_angles = angles[round(RELEASE * plant.rate) - 1]
        room = np.minimum(
            start_angles - arm.model.lower, np.asarray(arm.model.upper) - start_angles
        ).min()
        windows = [
            angles[round((RELEASE + start_time) * plant.rate) :][
                : round(OBSERVATION_TIME * plant.rate)
            ]
            for start_time in OBSERVATION_STARTS
        ]
        first, last = (float(np.ptp(window, axis=0).max()) for window in windows)
        return Rest(
            arm=self.arm,
            ticks=self.ticks,
            eta=self.eta,
            pose=self.pose,
            room=float(room),
            moves=(first, last),
            turns=(_reversals(windows[0]), _reversals(windows[1])),
        )


def _reversals(angles: Array) -> int:
    """Return the largest number of reversals of a joint, from joint positions (N, n) [rad].

    Joints that move by less than 5 mrad do not count.
    """
    going = np.diff(angles[:, np.ptp(angles, axis=0) > 5e-3], axis=0)
    return int((np.diff(np.sign(going), axis=0) != 0).sum(axis=0).max(initial=0))


def text(results: Sequence[Rest]) -> str:
    """Return a Markdown table with a row for each arm and case."""
    columns = (
        *("arm", "ticks each way", "η", "pushes", "at a stop meanwhile"),
        *("2.5 s after, in 1 s: median", "most [mrad]", "turns"),
        *("8 s after: median", "most [mrad]", "turns"),
    )
    rows = []
    for key in dict.fromkeys((result.arm, result.ticks, result.eta) for result in results):
        group = [result for result in results if (result.arm, result.ticks, result.eta) == key]
        cells = [key[0], str(key[1]), f"{key[2]:g}", str(len(group))]
        cells += [str(sum(result.room < ROOM for result in group))]
        for i in range(len(OBSERVATION_STARTS)):
            moves = [1e3 * result.moves[i] for result in group]
            cells += [f"{np.median(moves):.1f}", f"{max(moves):.1f}"]
            cells += [str(max(result.turns[i] for result in group))]
        rows.append(cells)
    return markdown.table(columns, rows)


def main(*, poses: int = POSES, arm: command_line.Arms = (), jobs: int = 2) -> None:
    """Push arms near joint limits, release them, and observe if they come to rest.

    Args:
        poses: Number of poses per arm.
        arm: Names of the arms; default: the built-in arms.
        jobs: Number of processes.
    """
    work = [
        Job(name, pose, ticks, eta)
        for name in arm or robots.names()
        for ticks, eta in CASES
        for pose in range(poses)
    ]
    print(text(list(run_jobs(work, jobs, "rest at joint limits"))))


if __name__ == "__main__":
    command_line.start(main)
