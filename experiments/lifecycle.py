"""Descents, and reactions of an arm to faults: the tables of docs/lifecycle.md.

``python -m experiments.lifecycle [poses]`` prints them.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from experiments.mishaps import MISHAPS, SickDrive, suffer
from pliant import robots
from pliant.arm.arm import Arm
from pliant.sim import Plant, table
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from pliant.sim import Hand

    Array = NDArray[np.float64]

#: Unknown load [kg], and the table below the lower of tool and wrist [m].
LOAD, TABLE = 0.3, 0.10
#: Share of the usable torque that holding arm and load may take in a random pose.
HOLDS = 0.9
#: Observation time after torque off [s].
AFTER = 1.0


@dataclass(frozen=True, kw_only=True)
class Lowered:
    """Result of one descent.

    Attributes:
        speed: Highest speed of the tool until torque was off [m/s].
        rise: Rise of the tool above its start until then [m].
        after: Highest speed within the second after [m/s].
        force: Largest mean over a tick of the force on one point of the table [N].
        resting: Force on the table a second after torque was off: the weight that rests there [N].
        seconds: Duration.
    """

    speed: float
    rise: float
    after: float
    force: float
    resting: float
    seconds: float


def lower(
    q: Array,
    *,
    load: float = 0.0,
    over_table: bool = False,
    ticks: int = 0,
    rest: Array | None = None,
    robot: str = "arm7",
    kp_scale: float = 1.0,
    stiffness_known: bool = True,
    blind: bool = False,
) -> Lowered:
    """Enable an arm in q (n,) [rad], hold it for half a second, and lower it.

    Args:
        q: Posture (n,) [rad].
        load: Unknown mass at the tool [kg].
        over_table: True: a table 0.10 m below the lower of tool and wrist.
        ticks: Delay of readings, and of writes, at 100 Hz.
        rest: First target (n,) [rad].
        robot: A built-in arm.
        kp_scale: True over assumed stiffness of the servos.
        stiffness_known: True if the arm assumes that it is known within 10 %.
        blind: True: no more positions arrive.

    Returns:
        The result.
    """
    model = robots.load(robot)
    plant = Plant(
        model,
        payload=(load, (0.0, 0.0, 0.0)) if load else None,
        delay=(ticks, ticks),
        kp_scale=kp_scale,
    )
    plant.reset(q)
    if over_table:
        scene: Sequence[Hand] = table(min(plant.tool[2, 3], plant.wrist[2]) - TABLE)
        plant.set_hands(scene)
    drive = SickDrive(plant, plant.table.replace(stiffness_known=stiffness_known))
    arm = Arm(model, drive, rest_q=rest, signals=False)
    speeds: list[float] = []
    heights: list[float] = []
    forces: list[float] = [0.0]

    def look() -> None:
        twist = plant.ground_truth.frame("tool").twist()
        speeds.append(float(np.linalg.norm(twist[:3])))
        heights.append(float(plant.tool[2, 3]))
        forces.extend(float(np.linalg.norm(felt.force)) for felt in plant.hands)

    arm.enable()
    drive.clock.on_tick = look
    drive.silent = set(drive.names) if blind else set()
    begin, high = plant.time, float(plant.tool[2, 3])
    arm.lower()
    seconds, speed, force = plant.time - begin, max(speeds), max(forces)
    rise = max(max(heights) - high, 0.0)
    speeds.clear()
    drive.clock.wait_until(plant.time + AFTER)
    resting = sum(float(np.linalg.norm(felt.force)) for felt in plant.hands)
    return Lowered(
        speed=speed,
        rise=rise,
        after=max(speeds),
        force=force,
        resting=resting,
        seconds=seconds,
    )


def postures(count: int, *, seed: int = 0, robot: str = "arm7", load: float = LOAD) -> list[Array]:
    """Return random postures (n,) [rad] in which the arm can hold itself and a load."""
    model, heavy = robots.load(robot), robots.load(robot, payload=(load, (0.0, 0.0, 0.0)))
    assert model.servos is not None
    usable = np.asarray(model.servos.max_torque)
    low = np.where(np.isfinite(model.lower), model.lower, -np.pi)
    high = np.where(np.isfinite(model.upper), model.upper, np.pi)
    rng = np.random.default_rng(seed)
    found: list[Array] = []
    while len(found) < count:
        q = rng.uniform(low, high)
        if np.all(np.abs(heavy.gravity(q)) < HOLDS * usable):
            found.append(q)
    return found


#: The rows of the first table: name, arguments of `lower`.
CASES: tuple[tuple[str, dict[str, object]], ...] = (
    ("no obstacle", {}),
    ("unknown load of 0.3 kg", {"load": LOAD}),
    ("over a table", {"over_table": True}),
    ("load, table, a tick each way", {"load": LOAD, "over_table": True, "ticks": 1}),
    ("table, servos 25 % stiffer than assumed", {"over_table": True, "kp_scale": 1.25}),
    ("table, servos 20 % softer than assumed", {"over_table": True, "kp_scale": 0.8}),
    ("no more positions", {"blind": True, "ticks": 1}),
    ("no positions, unknown load", {"blind": True, "load": LOAD, "ticks": 1}),
    ("no positions, table", {"blind": True, "over_table": True, "ticks": 1}),
    ("to a rest pose", {"rest": np.array((-0.4, -0.1, 0.0, -0.8, 0.0, 0.0, 0.0))}),
)


class Pressed(Protocol):
    """Result of a descent over a table."""

    @property
    def force(self) -> float:
        """Largest mean over a tick of the force on one point of the table [N]."""

    @property
    def resting(self) -> float:
        """Weight on the table once torque is off [N]."""


def lower_table(poses: Iterable[Array]) -> list[str]:
    """Return the first table, as Markdown: worst (median); and over a table pose by pose."""
    poses, pose_by_pose = list(poses), list[str]()
    lines = [
        "| `lower` | tool [m/s] | after torque off [m/s] | force on the table [N] | of which rests "
        "[N] | takes [s] |",
        "|---|---|---|---|---|---|",
    ]
    for name, options in CASES:
        runs = [lower(q, **options) for q in poses]  # type: ignore[arg-type]
        cells = [
            _worst([run.speed for run in runs], 2),
            _worst([run.after for run in runs], 2),
            _worst([run.force for run in runs], 1) if options.get("over_table") else "",
            _worst([run.resting for run in runs], 1) if options.get("over_table") else "",
            _worst([run.seconds for run in runs], 0),
        ]
        lines.append(f"| {name} | {' | '.join(cells)} |")
        if options == {"over_table": True}:
            pose_by_pose = ["", *pose_table(runs)]
    return lines + pose_by_pose


def pose_table(runs: Sequence[Pressed]) -> list[str]:
    """Return force on the table and final weight on it, a column for each pose."""
    return [
        f"| pose | {' | '.join(str(k) for k in range(len(runs)))} |",
        f"|---|{'---|' * len(runs)}",
        f"| force | {' | '.join(f'{run.force:.1f}' for run in runs)} |",
        f"| rests | {' | '.join(f'{run.resting:.1f}' for run in runs)} |",
    ]


def mishap_table() -> list[str]:
    """Return the second table, as Markdown: every fault alone, and with a hand at the tool."""
    lines = [
        "| what happens | the arm | tool meanwhile [m/s] | drop [mm] | tool lowered [m/s] | hand "
        "feels [N] |",
        "|---|---|---|---|---|---|",
    ]
    for mishap in MISHAPS:
        alone, held = suffer(mishap), suffer(mishap, held=True)
        lines.append(
            f"| {mishap.title} | {alone.outcome} | {alone.speed:.2f} | {1e3 * alone.drop:.1f} | "
            f"{alone.descent:.2f} | {held.force:.1f} |"
        )
    return lines


def _worst(values: list[float], digits: int) -> str:
    return f"{max(values):.{digits}f} ({np.median(values):.{digits}f})"


def main() -> None:
    """Print both tables."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    print("\n".join(lower_table([VERTICAL, *postures(count)])), flush=True)
    print()
    print("\n".join(mishap_table()))


if __name__ == "__main__":
    main()
