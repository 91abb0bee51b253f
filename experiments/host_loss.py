"""Force on a hand after a host loss in mid-motion, against the report.

``python -m experiments.host_loss`` lets every arm follow a moving target in random poses, half of
them while a hand leans on the yielding axis, freezes goals and limits, and then drags the tool
along every axis of the task, both ways, by 0.15 m or 0.4 rad. The largest force on the hand is
compared with ``report().host_loss_force`` of the last step.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import pliant
from experiments import program
from experiments.arms import AXES, Arm, load
from experiments.runner import run_jobs
from experiments.simulation import closed_loop
from experiments.spring_hand import OF_CAPACITY, Grip
from pliant import robots
from pliant.sim import Plant

if TYPE_CHECKING:
    from collections.abc import Sequence


#: Distance of the hand as in the report, translations [m] and rotations [rad], and duration [s].
TRAVEL, TAKES = (0.15, 0.4), 6.0
#: The motion: speed of the target [m/s], duration before the host loss [s].
SPEED, WORK = 0.1, (0.6, 1.2)
#: Displacement by a hand that leans on the soft axis before the host loss [m], and time between the
#: host loss and the hand's drag [s].
LEAN, ALONE = 0.04, 0.5
#: Largest force [N] and torque [N·m] of the hand on `arm7`; they scale with other arms' capacity.
HAND = (80.0, 6.0)
#: Number of poses of `arm7`, and of every other arm.
POSES, OTHERS = 24, 8
#: Allowed excess of the felt force over the reported one: translations [N], rotations [N·m].
BEYOND = (3.0, 0.3)


@dataclass(frozen=True, kw_only=True)
class HostLossPush:
    """One push after a host loss.

    Attributes:
        arm: By name.
        pose: Index among the arm's poses.
        axis: Name.
        sign: Direction of the push.
        leaned: True if a hand leaned on the arm at the host loss.
        said: `report().host_loss_force` of the last step [N or N·m].
        felt: Largest measured force on the hand [N or N·m].
        at: Distance of the hand at that force [m or rad].
        hand: Largest force of the hand [N or N·m].
    """

    arm: str
    pose: int
    axis: str
    sign: float
    leaned: bool
    said: float
    felt: float
    at: float
    hand: float

    @property
    def walled(self) -> bool:
        """True if the hand could not move the arm, and the report predicted that."""
        return self.felt >= self.hand and self.said >= self.hand

    @property
    def ratio(self) -> float:
        """Felt over reported."""
        return self.felt / self.said

    @property
    def above(self) -> float:
        """Felt minus reported [N or N·m]."""
        return self.felt - self.said

    @property
    def allowed(self) -> bool:
        """True if the felt force exceeds the reported one by at most the allowance `BEYOND`."""
        return self.above <= BEYOND[AXES.index(self.axis) // 3]


class Bench:
    """Plant, hand and controller of an arm that loses its host; reused for all its poses."""

    def __init__(self, arm: Arm, settings: pliant.Settings | None = None) -> None:
        """Build plant, hand and controller; by default y yields (x on an arm without y)."""
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
        """Push along every axis of the task, both ways."""
        return [self.push(pose, axis, sign) for axis in self.arm.axes for sign in (1.0, -1.0)]

    def push(self, pose: int, axis: str, sign: float) -> HostLossPush:
        """Follow the target, freeze goals and limits, and drag the tool along one axis."""
        leans = bool(pose % 2)
        report = self._work(pose, leans=leans)
        row, kind = AXES.index(axis), AXES.index(axis) // 3
        side = int(sign > 0.0)
        felt, at = self.drag(row, sign * TRAVEL[kind])
        return HostLossPush(
            arm=self.arm.name,
            pose=pose,
            axis=axis,
            sign=sign,
            leaned=leans,
            said=report.axes[axis].host_loss_force[side],
            felt=felt,
            at=at,
            hand=self.hand[kind],
        )

    def _work(self, pose: int, *, leans: bool) -> pliant.feasibility.PoseReport:
        """Follow a moving target until the host loss; return the report of the last step."""
        rng = np.random.default_rng((pose, 7))
        way, death, lean = rng.standard_normal(3), rng.uniform(*WORK), rng.choice((-LEAN, LEAN))
        q = self.arm.poses(pose + 1)[pose]
        plant, controller, grip = self.plant, self.controller, self.grip
        plant.reset(q)
        controller.reset(q)
        soft = AXES.index(self.soft)
        grip.hold([soft] if leans else [])
        target = plant.tool

        def work(now: float, plant: Plant) -> None:
            target[:3, 3] += SPEED * plant.period * way / np.linalg.norm(way)
            grip.move(soft, lean / death if leans else 0.0)

        goal = target if any(row > 2 for row in self.arm.rows) else target[:3, 3]
        for _ in closed_loop(plant, controller, goal, death, on_tick=work):
            pass
        return controller.report()

    def drag(self, row: int, way: float) -> tuple[float, float]:
        """Drag the arm along one axis; return the largest force and its distance."""
        plant, grip = self.plant, self.grip
        grip.hold([])
        plant.advance(round(ALONE / plant.dt))
        grip.place(plant)
        grip.hold([row])
        most, at, gone, start = -np.inf, 0.0, 0.0, plant.tool
        while abs(gone) < abs(way) and most < self.hand[row // 3]:
            # The hand's spring takes part of the distance: it moves on until the tool has covered
            # it.
            grip.move(row, way / TAKES)
            plant.advance()
            gone = float(pliant.functional.pose_error(start, plant.tool)[row])
            force = float(np.sign(way)) * grip.force(row)
            if force > most:
                most, at = force, abs(gone)
            if plant.time > 4.0 * TAKES:
                break
        return most, at


@lru_cache(maxsize=2)
def _bench(arm: str) -> Bench:
    return Bench(load(arm))


@dataclass(frozen=True)
class Job:
    """One pose of one arm."""

    arm: str
    pose: int

    def run(self) -> list[HostLossPush]:
        """Run all pushes."""
        return _bench(self.arm).pushes(self.pose)


def text(found: Sequence[HostLossPush]) -> str:
    """Return figures per arm, translations and rotations apart, as Markdown."""
    columns = ("arm", "pushes", "walled", "felt/said: 5th %", "median", "95th %", "most")
    rows = []
    for arm in dict.fromkeys(one.arm for one in found):
        for kind, unit in enumerate(("N", "N·m")):
            every = [m for m in found if m.arm == arm and AXES.index(m.axis) // 3 == kind]
            if not every:
                continue
            seen = [m for m in every if not m.walled]
            low, middle, high = np.quantile([m.ratio for m in seen], (0.05, 0.5, 0.95))
            above, walled = [m.above for m in seen], len(every) - len(seen)
            ratios = (low, middle, high, max(m.ratio for m in seen))
            beyond = (np.quantile(above, 0.95), max(above))
            cells = [*(f"{one:.2f}" for one in ratios), *(f"{one:+.2f}" for one in beyond)]
            allowed = f"{100 * np.mean([m.allowed for m in seen]):.1f}"
            rows.append((f"{arm}, {unit}", len(every), walled, *cells, allowed))
    more = ("felt − said: 95th %", "most", "within the allowance %")
    return program.markdown((*columns, *more), rows)


def main(
    *, poses: int = POSES, arm: program.Arms = (), jobs: int = 2, out: Path | None = None
) -> None:
    """Drag arms after a host loss.

    Args:
        poses: Poses of arm7; other arms have a third.
        arm: Arms by name; default those that ship with the package.
        jobs: Number of processes.
        out: Folder of results.json with every push; default no file.
    """
    work = [
        Job(name, pose)
        for name in arm or robots.names()
        for pose in range(poses if name == "arm7" else -(-poses * OTHERS // POSES))
    ]
    found = [push for one in run_jobs(work, jobs, "host loss") for push in one]
    print(text(found))
    if out is not None:
        program.write_results(out, {"pushes": [asdict(push) for push in found]})


if __name__ == "__main__":
    program.start(main)
