"""Force on a hand after a host loss, and its prediction: ``python -m experiments.host_loss``.

In random poses an arm follows a moving target; in half of the poses a hand pushes the soft axis.
Then the host is lost: the servos keep their last goals and torque limits. A hand drags the tool
along every task axis in both directions, by 0.15 m or 0.4 rad, or until it reaches its largest
force. The largest force on the hand is compared with `AxisReport.host_loss_force` that
`Controller.report` returned for the last step.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import pliant
from experiments import command_line, markdown
from experiments.arms import AXES, Arm, load
from experiments.results import write_results
from experiments.runner import run_jobs
from experiments.simulation import closed_loop
from experiments.spring_hand import OF_CAPACITY, Grip
from pliant import robots
from pliant.sim import Plant

if TYPE_CHECKING:
    from collections.abc import Sequence


#: Distance of the drag, which `host_loss_force` assumes too: translations [m], rotations [rad]; and
#: duration of the drag [s].
DRAG_DISTANCE, DRAG_TIME = (0.15, 0.4), 6.0
#: Speed of the target [m/s], and range of the random duration of its motion before the host loss
#: [s].
SPEED, MOTION_TIME = 0.1, (0.6, 1.2)
#: Displacement by the hand that pushes the soft axis before the host loss [m], and time between the
#: host loss and the drag [s].
PUSH_DISTANCE, WAIT_AFTER_LOSS = 0.04, 0.5
#: Largest force [N] and torque [N·m] of the hand on `arm7`. For another arm, both are multiplied by
#: the ratio of its median static capacity (`Arm.median_capacity`) to that of `arm7`.
HAND = (80.0, 6.0)
#: Number of poses of `arm7`, and of every other arm.
POSES, OTHER_POSES = 24, 8
#: Allowed excess of the measured over the reported force: translations [N], rotations [N·m].
ALLOWED_EXCESS = (3.0, 0.3)


@dataclass(frozen=True, kw_only=True)
class HostLossPush:
    """Result of one drag after a host loss.

    Attributes:
        arm: Name of the arm.
        pose: Index among the arm's poses.
        axis: Name of the dragged axis.
        sign: Direction of the drag, 1 or -1.
        is_pushed: True if a hand pushed the arm along the soft axis before the host loss.
        reported: `AxisReport.host_loss_force`, as reported after the last step [N or N·m].
        measured: Largest measured force on the hand [N or N·m].
        at: Distance by which the tool had moved at the largest force [m or rad].
        hand: Force at which the hand ends the drag [N or N·m].
    """

    arm: str
    pose: int
    axis: str
    sign: float
    is_pushed: bool
    reported: float
    measured: float
    at: float
    hand: float

    @property
    def is_limited(self) -> bool:
        """True if both measured and reported force reach the force `hand`, which ends the drag."""
        return self.measured >= self.hand and self.reported >= self.hand

    @property
    def ratio(self) -> float:
        """Ratio of measured to reported force."""
        return self.measured / self.reported

    @property
    def above(self) -> float:
        """Measured minus reported force [N or N·m]."""
        return self.measured - self.reported

    @property
    def allowed(self) -> bool:
        """True if the measured force exceeds the reported one by at most `ALLOWED_EXCESS`."""
        return self.above <= ALLOWED_EXCESS[AXES.index(self.axis) // 3]


class Bench:
    """Simulated arm, hand and controller, for any pose of the arm."""

    def __init__(self, arm: Arm, settings: pliant.Settings | None = None) -> None:
        """Build simulated arm, hand and controller.

        The default settings make y soft, or x on an arm whose task has no y.
        """
        self.arm = arm
        scale = arm.median_capacity[0] / OF_CAPACITY
        self.grip = Grip(scale)
        self.hand = (scale * HAND[0], scale * HAND[1])
        self.plant = Plant(arm.model, arm.servos, scene=[self.grip])
        self.soft = "y" if "y" in arm.axes else "x"
        task = " ".join(arm.axes)
        cap = arm.caps(AXES.index(self.soft))
        axis = pliant.Axis(soft=cap[0], firm=cap[1])
        self.settings = settings or pliant.Settings(task=task, axes={self.soft: axis})
        self.controller = pliant.Controller(arm.model, self.settings, arm.servos)

    def pushes(self, pose: int) -> list[HostLossPush]:
        """Return the results of drags along every task axis, in both directions."""
        return [self.push(pose, axis, sign) for axis in self.arm.axes for sign in (1.0, -1.0)]

    def push(self, pose: int, axis: str, sign: float) -> HostLossPush:
        """Follow a moving target, stop the host, drag the tool along one axis; return the result.

        Args:
            pose: Index of the pose. If it is odd, a hand pushes the soft axis before the host loss.
            axis: Name of the dragged axis.
            sign: Direction of the drag, 1 or -1.
        """
        is_pushed = bool(pose % 2)
        report = self._work(pose, is_pushed=is_pushed)
        row, kind = AXES.index(axis), AXES.index(axis) // 3
        side = int(sign > 0.0)
        force, distance = self.drag(row, sign * DRAG_DISTANCE[kind])
        return HostLossPush(
            arm=self.arm.name,
            pose=pose,
            axis=axis,
            sign=sign,
            is_pushed=is_pushed,
            reported=report.axes[axis].host_loss_force[side],
            measured=force,
            at=distance,
            hand=self.hand[kind],
        )

    def _work(self, pose: int, *, is_pushed: bool) -> pliant.feasibility.PoseReport:
        """Follow a moving target until the host loss; return the report after the last step.

        With `is_pushed`, a hand pushes the soft axis meanwhile.
        """
        rng = np.random.default_rng((pose, 7))
        motion, loss_time, push_distance = (
            rng.standard_normal(3),
            rng.uniform(*MOTION_TIME),
            rng.choice((-PUSH_DISTANCE, PUSH_DISTANCE)),
        )
        q = self.arm.poses(pose + 1)[pose]
        plant, controller, grip = self.plant, self.controller, self.grip
        plant.reset(q)
        controller.reset(q)
        soft = AXES.index(self.soft)
        grip.hold([soft] if is_pushed else [])
        target = plant.tool

        def work(now: float, plant: Plant) -> None:
            target[:3, 3] += SPEED * plant.period * motion / np.linalg.norm(motion)
            grip.move(soft, push_distance / loss_time if is_pushed else 0.0)

        goal = target if any(row > 2 for row in self.arm.rows) else target[:3, 3]
        for _ in closed_loop(plant, controller, goal, loss_time, on_tick=work):
            pass
        return controller.report()

    def drag(self, row: int, distance: float) -> tuple[float, float]:
        """Drag the tool along one axis, with constant goals and torque limits of the servos.

        Args:
            row: Index of the axis among x, y, z, roll, pitch, yaw.
            distance: Signed distance [m or rad].

        Returns:
            Largest force of the hand [N or N·m], and the distance by which the tool had moved when
            the force was largest [m or rad].
        """
        plant, grip = self.plant, self.grip
        grip.hold([])
        plant.advance(round(WAIT_AFTER_LOSS / plant.dt))
        grip.place(plant)
        grip.hold([row])
        largest, displacement, moved, start = -np.inf, 0.0, 0.0, plant.tool
        while abs(moved) < abs(distance) and largest < self.hand[row // 3]:
            # The spring of the hand stretches: move until the tool has covered `distance`.
            grip.move(row, distance / DRAG_TIME)
            plant.advance()
            moved = float(pliant.functional.pose_error(start, plant.tool)[row])
            force = float(np.sign(distance)) * grip.force(row)
            if force > largest:
                largest, displacement = force, abs(moved)
            if plant.time > 4.0 * DRAG_TIME:
                break
        return largest, displacement


@lru_cache(maxsize=2)
def _bench(arm: str) -> Bench:
    return Bench(load(arm))


@dataclass(frozen=True)
class Job:
    """All drags of one arm in one pose."""

    arm: str
    pose: int

    def run(self) -> list[HostLossPush]:
        """Run all drags and return their results."""
        return _bench(self.arm).pushes(self.pose)


def text(pushes: Sequence[HostLossPush]) -> str:
    """Return a Markdown table per arm, with separate rows for translations and rotations."""
    columns = (
        *("arm", "pushes", "cannot be moved, as reported"),
        *("felt/reported: 5th %", "median", "95th %", "largest"),
    )
    rows = []
    for arm in dict.fromkeys(push.arm for push in pushes):
        for kind, unit in enumerate(("N", "N·m")):
            selected = [m for m in pushes if m.arm == arm and AXES.index(m.axis) // 3 == kind]
            if not selected:
                continue
            not_walled = [m for m in selected if not m.is_limited]
            low, middle, high = np.quantile([m.ratio for m in not_walled], (0.05, 0.5, 0.95))
            above, walled = [m.above for m in not_walled], len(selected) - len(not_walled)
            ratios = (low, middle, high, max(m.ratio for m in not_walled))
            excess = (np.quantile(above, 0.95), max(above))
            cells = [*(f"{push:.2f}" for push in ratios), *(f"{push:+.2f}" for push in excess)]
            share = f"{100 * np.mean([m.allowed for m in not_walled]):.1f}"
            rows.append((f"{arm}, {unit}", len(selected), walled, *cells, share))
    last_columns = ("felt − reported: 95th %", "largest", "within the allowance %")
    return markdown.table((*columns, *last_columns), rows)


def main(
    *, poses: int = POSES, arm: command_line.Arms = (), jobs: int = 2, out: Path | None = None
) -> None:
    """Drag arms after a host loss.

    Args:
        poses: Number of poses of arm7; other arms have a third.
        arm: Names of the arms; default: the built-in arms.
        jobs: Number of processes.
        out: Folder for results.json with every drag; default: no file.
    """
    work = [
        Job(name, pose)
        for name in arm or robots.names()
        for pose in range(poses if name == "arm7" else -(-poses * OTHER_POSES // POSES))
    ]
    pushes = [push for result in run_jobs(work, jobs, "host loss") for push in result]
    print(text(pushes))
    if out is not None:
        write_results(out, {"pushes": [asdict(push) for push in pushes]})


if __name__ == "__main__":
    command_line.start(main)
