"""The way down with wrong beliefs: servos, load, friction, encoder and delay are not as believed.

``python -m pliant.experiments.descent [--arms arm7,so101] [--poses 50] [--jobs 2]`` prints, per
arm, the worst of torque on and of `lower` over poses at random, each with a mix of errors of its
own, in free air and over a table, and the poses that were worst.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from pliant.arm.arm import Arm
from pliant.arm.simulated import SimDrive
from pliant.experiments.campaign_arms import BESIDE, ROBOTS, load
from pliant.experiments.parallel import parallel
from pliant.sim import Plant, table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from pliant import Model

    Array = NDArray[np.float64]

#: Arms of the table.
ARMS = ("arm7", "so101", "koch", "vx300s")
#: True over believed stiffness of a joint, and true over believed friction.
STIFFNESS, FRICTION = (0.5, 2.5), (0.5, 2.0)
#: Unknown loads at the tool [kg], encoder steps [deg] and delays of a cycle [ticks].
LOAD, STEPS, DELAYS = 0.5, (0.09, 0.3), (0, 1, 2, 3)
#: Table below the lower of tool and wrist [m].
TABLE = 0.10
#: Share of the usable torque that holding the arm and its load may take.
HOLDS = 0.85
#: How long the arm holds before it is lowered, and is watched after its torque is off [s].
BEFORE, AFTER = 0.3, 1.0


@dataclass(frozen=True, kw_only=True)
class Truth:
    """What an arm is really like, where its belief is the servo table and no load.

    Attributes:
        stiffness, friction: True over believed (n,).
        load: At the tool [kg].
        step: Of the encoders [rad].
        delay: Ticks from sampling to read, and from write to the servo.
    """

    stiffness: tuple[float, ...]
    friction: float
    load: float
    step: float
    delay: tuple[int, int]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """Torque on and one descent.

    Attributes:
        apart: Largest ratio between true stiffness of a joint and the one that the arm believed.
        moved: Farthest that the tool was from where it stood while the arm was taken over from
            a program that had held it there [m].
        jerk: Highest speed of the tool meanwhile [m/s].
        woken, stir: The same, where torque came on at the end of the descent [m], [m/s].
        rise: How far the tool rose above its start on the way down [m].
        speed: Highest speed of the tool on the way down [m/s].
        after: Highest speed within the second after torque was off [m/s].
        force: Largest mean over a tick of the force on one point of the table [N].
        resting: Force on the table a second after torque was off [N].
        seconds: How long the descent took.
        height: How far the tool came down [m].
    """

    apart: float
    moved: float
    jerk: float
    woken: float
    stir: float
    rise: float
    speed: float
    after: float
    force: float
    resting: float
    seconds: float
    height: float


@dataclass(frozen=True, kw_only=True)
class Job:
    """One arm, one pose, one truth.

    Attributes:
        arm: Its name.
        number: Of pose and truth.
        over_table: Whether there is a table under it.
        q: Pose (n,) [rad].
        truth: What the arm is really like.
    """

    arm: str
    number: int
    over_table: bool
    q: tuple[float, ...] = field(repr=False)
    truth: Truth

    def run(self) -> Outcome:
        """Enable the arm, wait, lower it, and watch."""
        model, truth = robot(self.arm), self.truth
        plant = Plant(
            model,
            delay=truth.delay,
            count=truth.step,
            kp_scale=truth.stiffness,
            friction_scale=truth.friction,
            payload=(truth.load, (0.0, 0.0, 0.0)) if truth.load else None,
        )
        plant.reset(self.q)
        if self.over_table:
            plant.set_hands(table(min(plant.tool[2, 3], plant.wrist[2]) - TABLE))
        assert model.servos is not None
        drive = SimDrive(plant, servos=model.servos.replace(kp_known=False))
        robot_arm = Arm(model, drive, signals=False)
        speeds: list[float] = []
        places: list[Array] = []
        forces: list[float] = [0.0]

        def look() -> None:
            speeds.append(float(np.linalg.norm(plant.truth.frame("tool").twist()[:3])))
            places.append(plant.tool[:3, 3].copy())
            forces.extend(float(np.linalg.norm(felt.force)) for felt in plant.hands)

        # A program that knew the arm holds it.
        weight = (
            model.gravity(self.q) - truth.load * model.gravity_vector @ model.jacobian(self.q)[:3]
        )
        lead = weight / plant.gains.kp
        usable = drive.servos.torque
        drive.write(
            np.concatenate((self.q + lead, drive.read().position[model.n :])), np.asarray(usable)
        )
        drive.clock.wait_until(plant.time + BEFORE)
        drive.clock.on_tick = look
        moved, jerk = self._enable(robot_arm, plant, speeds, places)
        forces.clear()
        forces.append(0.0)
        begin, high = plant.time, float(plant.tool[2, 3])
        robot_arm.lower()
        seconds, speed, force = plant.time - begin, max(speeds), max(forces)
        rise = max(float(place[2]) for place in places) - high
        height = high - float(plant.tool[2, 3])
        speeds.clear()
        drive.clock.wait_until(plant.time + AFTER)
        after = max(speeds)
        resting = sum(float(np.linalg.norm(felt.force)) for felt in plant.hands)
        woken, stir = self._enable(robot_arm, plant, speeds, places)
        ratio = np.log(plant.gains.kp / np.asarray(robot_arm.servos.kp))
        return Outcome(
            apart=float(np.exp(np.abs(ratio).max())),
            moved=moved,
            jerk=jerk,
            woken=woken,
            stir=stir,
            rise=rise,
            speed=speed,
            after=after,
            force=force,
            resting=resting,
            seconds=seconds,
            height=height,
        )

    @staticmethod
    def _enable(
        arm: Arm, plant: Plant, speeds: list[float], places: list[Array]
    ) -> tuple[float, float]:
        """Torque on; return how far [m] and how fast [m/s] the tool moved."""
        speeds.clear()
        places.clear()
        start = plant.tool[:3, 3].copy()
        arm.enable()
        arm.clock.wait_until(plant.time + BEFORE)
        out = _farthest(places, start), max(speeds)
        speeds.clear()
        places.clear()
        return out


def _farthest(places: Sequence[Array], start: Array) -> float:
    return max(float(np.linalg.norm(place - start)) for place in places)


def _hanging(model: Model, q: Array, mass: float) -> Array:
    """Torques (n,) [N·m] that a load at the tool needs at q (n,) [rad]."""
    needed: Array = -mass * model.gravity_vector @ model.jacobian(q)[:3]
    return needed


@cache
def robot(name: str) -> Model:
    """A built-in arm, or a real robot's description where it lies beside the project."""
    return load(name).model


def is_here(name: str) -> bool:
    """Whether an arm's description can be had."""
    return name not in BESIDE or (ROBOTS / BESIDE[name][0]).is_file()


def truths(name: str, count: int, *, seed: int = 0) -> list[tuple[Array, Truth]]:
    """Poses (n,) [rad] at random that the true servos can hold, each with a truth of its own.

    The first truths have all servos too stiff, too soft, and turns of both.
    """
    model = robot(name)
    assert model.servos is not None
    n, usable = model.n, np.asarray(model.servos.torque)
    low = np.where(np.isfinite(model.lower), model.lower, -np.pi)
    high = np.where(np.isfinite(model.upper), model.upper, np.pi)
    rng = np.random.default_rng(seed)
    corners = [
        np.full(n, STIFFNESS[1]),
        np.full(n, STIFFNESS[0]),
        np.where(np.arange(n) % 2, *STIFFNESS),
        np.where(np.arange(n) % 2, *STIFFNESS[::-1]),
        np.ones(n),
    ]
    found: list[tuple[Array, Truth]] = []
    while len(found) < count:
        k = len(found)
        drawn = np.exp(rng.uniform(np.log(STIFFNESS[0]), np.log(STIFFNESS[1]), n))
        stiffness = drawn if k >= len(corners) else corners[k]
        truth = Truth(
            stiffness=tuple(stiffness.tolist()),
            friction=float(np.exp(rng.uniform(np.log(FRICTION[0]), np.log(FRICTION[1])))),
            load=float(rng.uniform(0.0, LOAD)) if k % 5 else LOAD * (k % 2),
            step=float(np.deg2rad(STEPS[k % 2])),
            delay=((k % 4) // 2, (k % 4 + 1) // 2),
        )
        for _ in range(200):
            q = rng.uniform(low, high)
            gravity = model.gravity(q) + _hanging(model, q, truth.load)
            if np.all(np.abs(gravity) < HOLDS * usable):
                found.append((q, truth))
                break
    return found


def jobs(name: str, count: int, *, seed: int = 0) -> list[Job]:
    """The runs of one arm: every pose in free air, then over a table."""
    drawn = truths(name, count, seed=seed)
    return [
        Job(arm=name, number=k, over_table=over, q=tuple(q.tolist()), truth=truth)
        for over in (False, True)
        for k, (q, truth) in enumerate(drawn)
    ]


def rows(name: str, work: Sequence[Job], seen: Sequence[Outcome]) -> list[str]:
    """Two lines of the table: worst (median), and in brackets the number of the worst pose."""
    lines = []
    for over in (False, True):
        pairs = [(job, one) for job, one in zip(work, seen, strict=True) if job.over_table == over]
        columns = [
            ("moved", 1e3, 0),
            ("jerk", 1.0, 2),
            ("woken", 1e3, 0),
            ("stir", 1.0, 2),
            ("rise", 1e3, 0),
            ("speed", 1.0, 2),
            ("after", 1.0, 2),
            ("force", 1.0, 1),
            ("resting", 1.0, 1),
            ("seconds", 1.0, 0),
        ]
        cells = []
        for what, unit, digits in columns:
            values = np.array([unit * getattr(one, what) for _, one in pairs])
            worst = int(values.argmax())
            cells.append(
                f"{values[worst]:.{digits}f} ({np.median(values):.{digits}f}) "
                f"#{pairs[worst][0].number}"
            )
        lines.append(f"| {name}, {'table' if over else 'free'} | {' | '.join(cells)} |")
    return lines


HEAD = (
    "| arm | taken over: moved [mm] | speed [m/s] | from rest: moved [mm] | speed [m/s] | lowered: "
    "rises [mm] | speed [m/s] | after torque off [m/s] | force on the table [N] | of which rests "
    "[N] | takes [s] |\n" + "|---" * 11 + "|"
)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", default=",".join(ARMS))
    parser.add_argument("--poses", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--each", action="store_true", help="also print every run")
    options = parser.parse_args()
    print(HEAD, flush=True)
    for name in options.arms.split(","):
        if not is_here(name):
            print(f"{name}: no description beside the project, skipped")
            continue
        work = jobs(name, options.poses, seed=options.seed)
        seen = list(parallel(work, options.jobs, f"descent of {name}"))
        print("\n".join(rows(name, work, seen)), flush=True)
        if options.each:
            for job, one in zip(work, seen, strict=True):
                print(f"    {job.number}{'t' if job.over_table else ' '} {one}")


if __name__ == "__main__":
    # Other processes find this module's jobs by its name, not as `__main__`.
    from pliant.experiments import descent  # noqa: PLW0406 -- by name

    descent.main()
