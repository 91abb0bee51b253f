"""Target steps of 10 cm: speed and overshoot of the tool.

``python -m experiments.steps --robot so101`` steps the target of an arm with stiff axes by 10 cm,
from random poses in several directions, with every law and two limits of the tool speed. It prints
the largest tool speed (averaged over 50 ms), the largest overshoot along the step and the distance
to the target after 4 s. With `--disturbed`, the true servos differ from the assumed ones. With
`--soft` some axes are soft, and with `--singular` poses may be near a singularity; the table then
has the speed only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

import pliant
from experiments import command_line, markdown
from experiments.arms import BESIDE, ROBOTS, Arm
from experiments.runner import run_jobs
from experiments.simulation import closed_loop
from pliant import robots
from pliant.config import list_arms
from pliant.sim import Plant

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from experiments.poses import Array


Law = Literal["cap", "impedance", "paper"]
LAWS: tuple[Law, ...] = ("cap", "impedance", "paper")
SPEEDS = (0.1, 0.25)  # [m/s]
STEP_LENGTH = 0.1  # [m]
RATE = 100.0  # [Hz]
#: Time before the step, time after the step, and averaging time of the tool speed [s].
BEFORE, AFTER, WINDOW = 0.5, 4.0, 0.05
#: Requirements on all poses of a step's path: smallest distance of a joint to its limits [rad],
#: largest share of a servo's usable torque for gravity, smallest singular value of the Jacobian as
#: a share of its median over random poses, smallest height of the tool [m].
ROOM, LOAD, SIGMA, HEIGHT = 0.3, 0.6, 0.65, 0.03
#: Allowed tool speed ``FACTOR v + MORE`` at the speed limit v [m/s], and allowed overshoot [m].
FACTOR, MORE, OVERSHOOT = 1.2, 0.02, 0.005
#: Simulated arms that differ from the nominal one: name, true over assumed stiffness k_p, true over
#: assumed friction, and delay of readings and of commands [ticks], known to the controller.
DISTURBED = (
    ("friction x 0.7", 1.0, 0.7, 0),
    ("friction x 1.3", 1.0, 1.3, 0),
    ("k_p x 0.75", 0.75, 1.0, 0),
    ("k_p x 1.25", 1.25, 1.0, 0),
    ("a tick each way", 1.0, 1.0, 1),
)


@cache
def arm(name: str) -> Arm:
    """Return an arm by name: a built-in arm, or a built-in configuration with an available URDF.

    Raises:
        ConfigError: The name is unknown.
        FileNotFoundError: The URDF is not available.
    """
    if name in robots.names():
        return Arm(name, robots.load(name))
    if name not in BESIDE or name not in list_arms():
        known = ", ".join((*robots.names(), *sorted(set(BESIDE) & set(list_arms()))))
        raise pliant.ConfigError(f"no arm {name!r} here; there are {known}")
    file, base, tip = BESIDE[name]
    path = ROBOTS / file
    if not path.exists():
        raise FileNotFoundError(f"{file} does not lie beside this checkout")
    servos = pliant.connect(name, urdf=path, backend="emulator").servos
    return Arm(name, pliant.Model.from_urdf(path, base=base, tip=tip, servos=servos))


@dataclass(frozen=True)
class Step:
    """Target step: start pose and displacement.

    Attributes:
        q: Start pose (n,) [rad].
        way: Displacement of the target (3,) [m].
    """

    q: tuple[float, ...]
    way: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class StepResult:
    """Result of one step.

    Attributes:
        fastest: Largest speed of the tool, averaged over 50 ms [m/s].
        overshoot: Largest distance of the tool beyond the target in the direction of the step [m];
            negative if the tool does not reach the target.
        left: Distance to the target at the end [m].
        seconds: Time until the tool stays within 10 mm of its target [s]; infinite if it does not.
    """

    fastest: float
    overshoot: float
    left: float
    seconds: float

    def kept(self, speed: float) -> bool:
        """Return True if speed and overshoot are within the bounds for a speed limit [m/s].

        `FACTOR`, `MORE` and `OVERSHOOT` define the bounds.
        """
        return self.fastest <= FACTOR * speed + MORE and self.overshoot <= OVERSHOOT


def steps(name: str, count: int, seed: int = 1, *, singular: bool = False) -> list[Step]:
    """Return `count` random steps of the target along paths that are `_passable`.

    With `singular`, poses may be near a singularity.
    """
    it = arm(name)
    model, chance = it.model, np.random.default_rng(seed)
    accepted: list[Step] = []
    low, high = np.maximum(model.lower, -np.pi), np.minimum(model.upper, np.pi)
    median = float(np.median(it.sigma(it.drawn)))
    min_sigma = 0.0 if singular else SIGMA * median
    while len(accepted) < count:
        q = chance.uniform(low, high)
        direction = chance.normal(size=3) if len(accepted) % 3 == 2 else np.zeros(3)
        if not direction.any():
            direction[chance.integers(3)] = chance.choice((-1.0, 1.0))
        direction *= STEP_LENGTH / np.linalg.norm(direction)
        if _passable(it, q, direction, min_sigma):
            x, y, z = direction
            accepted.append(Step(tuple(q), (x, y, z)))
    return accepted


def _passable(it: Arm, q: Array, direction: Array, min_sigma: float) -> bool:
    """Return True if all poses on a straight path meet the requirements `ROOM` to `HEIGHT`.

    Args:
        it: The arm.
        q: Start pose (n,) [rad].
        direction: Displacement of the tool (3,) [m].
        min_sigma: Smallest allowed singular value.
    """
    model, q = it.model, q.copy()
    start = np.array(model.forward_kinematics(q))
    max_torque = np.asarray(it.servos.max_torque)
    for share in np.linspace(0.0, 1.0, 21):
        for _ in range(20):
            pose, jacobian = model.kinematics(q)
            target = start.copy()
            target[:3, 3] += share * direction
            error = np.asarray(pliant.functional.pose_error(pose, target))[it.rows]
            rows = jacobian[it.rows]
            pull = np.linalg.solve(rows @ rows.T + 1e-6 * np.eye(len(rows)), error)
            q += np.clip(rows.T @ pull, -0.1, 0.1)
            if np.abs(error).max() < 1e-4:
                break
        is_reached = np.abs(error).max() < 1e-3
        is_inside = np.all(
            (q > np.asarray(model.lower) + ROOM) & (q < np.asarray(model.upper) - ROOM)
        )
        is_held = np.all(np.abs(model.gravity(q)) < LOAD * max_torque)
        if not (
            is_reached and is_inside and is_held and it.sigma(q) > min_sigma and pose[2, 3] > HEIGHT
        ):
            return False
    return True


def settings(name: str, law: Law, speed: float, soft: str = "") -> pliant.Settings:
    """Return settings of a law for an arm, with soft axes and a tool speed limit [m/s]."""
    options: dict[str, Any] = {
        "task": " ".join(arm(name).axes),
        "law": law,
        "max_tool_speed": speed,
    }
    return pliant.Settings.soft(soft, **options) if soft else pliant.Settings.firm(**options)


def run(
    name: str, step: Step, settings: pliant.Settings, plant: Mapping[str, Any] | None = None
) -> StepResult:
    """Simulate one step of the target, and return the result.

    Args:
        name: Name of the arm.
        step: The step.
        settings: Settings of the controller.
        plant: Further options of `pliant.sim.Plant`.
    """
    model = arm(name).model
    options = {"encoder_step": np.asarray(arm(name).servos.encoder_step), **(plant or {})}
    controller = pliant.Controller(model, settings)
    simulated = Plant(model, rate=RATE, **options)
    if "delay" in options:
        controller.set_delay(sum(options["delay"]) / RATE)
    simulated.reset(step.q)
    start, target = simulated.tool, simulated.tool
    start_tick = round(BEFORE * RATE)
    positions = [simulated.tool[:3, 3] for _ in closed_loop(simulated, controller, target, BEFORE)]
    target[:3, 3] += step.way
    positions += [simulated.tool[:3, 3] for _ in closed_loop(simulated, controller, target, AFTER)]
    path = np.array(positions)[start_tick - 1 :]
    window = round(WINDOW * RATE)
    speeds = np.linalg.norm(path[window:] - path[:-window], axis=1) / WINDOW
    direction = target[:3, 3] - start[:3, 3]
    error = path - target[:3, 3]
    far_ticks = np.flatnonzero(np.linalg.norm(error, axis=1) > 0.01)
    settled_tick = far_ticks[-1] + 1 if far_ticks.size else 0
    return StepResult(
        fastest=float(speeds.max()),
        overshoot=float((error @ direction).max() / np.linalg.norm(direction)),
        left=float(np.linalg.norm(error[-1])),
        seconds=float(settled_tick / RATE) if settled_tick < len(path) else np.inf,
    )


@dataclass(frozen=True)
class Job:
    """All steps of one row of the table.

    Attributes:
        robot: Name of the arm.
        law: Law of the controller.
        speed: Speed limit [m/s].
        count: Number of steps.
        case: One of `DISTURBED`, or the nominal one.
        soft: Names of the soft axes.
        singular: True if poses may be near a singularity.
    """

    robot: str
    law: Law
    speed: float
    count: int
    case: tuple[str, float, float, int] = ("as assumed", 1.0, 1.0, 0)
    soft: str = ""
    singular: bool = False

    def run(self) -> list[StepResult]:
        """Run all steps and return their results."""
        _, stiffness, friction, ticks = self.case
        plant = {"kp_scale": stiffness, "friction_scale": friction, "delay": (ticks, ticks)}
        of = settings(self.robot, self.law, self.speed, self.soft)
        all_steps = steps(self.robot, self.count, singular=self.singular)
        return [run(self.robot, step, of, plant) for step in all_steps]


def rows(
    robot: str,
    count: int,
    *,
    with_disturbances: bool = False,
    soft: str = "",
    singular: bool = False,
) -> list[Job]:
    """Return the jobs of a robot, one for each row of the table."""
    cases = DISTURBED if with_disturbances else (("as assumed", 1.0, 1.0, 0),)
    return [
        Job(robot, law, v, count, case, soft, singular)
        for case in cases
        for law in LAWS
        for v in SPEEDS
    ]


def table(jobs: Sequence[Job], outcomes: Sequence[Sequence[StepResult]]) -> str:
    """Return a Markdown table with worst value and median of each row."""
    columns = ("arm", "plant", "law", "set [m/s]", "fastest [m/s]", "allowed", "overshoot [mm]")
    rows = []
    for job, results in zip(jobs, outcomes, strict=True):
        kept_count = sum(result.kept(job.speed) for result in results)
        rows.append(
            (
                job.robot,
                job.case[0],
                f"`{job.law}`",
                f"{job.speed:g}",
                markdown.worst((result.fastest for result in results), 2),
                f"{FACTOR * job.speed + MORE:.2f}",
                markdown.worst((result.overshoot for result in results), 1, 1e3),
                markdown.worst((result.left for result in results), 1, 1e3),
                markdown.worst((result.seconds for result in results), 1),
                f"{kept_count} of {len(results)}",
            )
        )
    return markdown.table((*columns, "left [mm]", "within 10 mm after [s]", "kept"), rows)


def main(
    *,
    robot: str = "so101",
    poses: int = 12,
    disturbed: bool = False,
    soft: str = "",
    singular: bool = False,
    jobs: int = 1,
) -> None:
    """Print speed and overshoot of target steps.

    Args:
        robot: A built-in arm, or vx300s if its URDF is available.
        poses: Number of steps per row.
        disturbed: True uses servos that differ from the assumed ones.
        soft: Names of the soft axes, such as "x y"; default: none.
        singular: True allows poses near a singularity.
        jobs: Number of processes.
    """
    todo = rows(robot, poses, with_disturbances=disturbed, soft=soft, singular=singular)
    print(table(todo, list(run_jobs(todo, jobs, "steps"))))


if __name__ == "__main__":
    command_line.start(main)
