"""`Arm.enable` and `Arm.lower` with emulated servos, with an unknown load, and over a table.

``python -m experiments.bus_lower [poses] [family]`` switches torque on in several poses of `arm7`
and lowers the arm. It prints the sag of the arm as torque comes on, the largest speeds of the tool,
the duration of the descents, and the force on the table. The first pose is the grasp pose; the
others are random.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from experiments import command_line, markdown
from experiments.emulated_arm import FAMILIES, configuration, stepped
from experiments.faults import RATE, PeakRecorder
from experiments.lifecycle import AFTER, LOAD, TABLE, postures
from pliant.sim import table
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from experiments.poses import Array


#: Rows of the printed table: name, unknown load at the tool [kg], True with a table under the arm.
CASES = (
    ("no obstacle", 0.0, False),
    ("unknown load of 0.3 kg", LOAD, False),
    ("unknown load, table", LOAD, True),
)


@dataclass(frozen=True, kw_only=True)
class LowerResult:
    """Result of one torque-on and descent.

    Attributes:
        sank: Largest sag of the tool during `enable`, which switches torque on [m].
        left: Sag of the tool at the end of `enable` [m].
        enable_speed: Largest speed of the tool during `enable` [m/s].
        speed: Largest speed of the tool during the descent [m/s].
        force: Largest force on one point of the table, averaged over 10 ms [N].
        resting: Sum of the forces on all points of the table, 1 s after torque off [N].
        seconds: Duration of the descent [s].
    """

    sank: float
    left: float
    enable_speed: float
    speed: float
    force: float
    resting: float
    seconds: float


def lower(family: str, q: Array, *, load: float = 0.0, over_table: bool = False) -> LowerResult:
    """Enable the arm in a pose, lower it, and return the result.

    Args:
        family: Servo family: `sts`, `x` or `p1`.
        q: Start pose (n,) [rad].
        load: Unknown mass at the tool [kg].
        over_table: True adds a table 0.10 m below the tool or the wrist, whichever is lower.
    """
    plant = {"payload": (load, (0.0, 0.0, 0.0))} if load else {}
    with stepped(family, q=q, arm={"rate": RATE}, plant=plant) as (bus, arm):
        if over_table:
            low = min(bus.plant.tool[2, 3], bus.plant.wrist[2]) - TABLE
            bus.plant.set_hands(table(low))
        enable_peaks = PeakRecorder(bus)
        enable_peaks.begin()
        arm.enable()
        sag = enable_peaks.start - float(bus.plant.tool[2, 3])
        enable_peaks.end()
        descent_peaks = PeakRecorder(bus)
        descent_peaks.begin()
        start = bus.plant.time
        arm.lower()
        seconds, force = bus.plant.time - start, descent_peaks.force
        bus.advance(AFTER)
        rest_force = sum(float(np.linalg.norm(hand.force)) for hand in bus.plant.hands)
    return LowerResult(
        sank=enable_peaks.start - enable_peaks.lowest,
        left=sag,
        enable_speed=enable_peaks.speeds[False],
        speed=descent_peaks.speeds[False],
        force=force,
        resting=rest_force,
        seconds=seconds,
    )


def fits(family: str, q: Array) -> bool:
    """Return True if pose q (n,) [rad] is within the position limits of a family's servos."""
    model = configuration(family).model()
    return bool(np.all((model.lower < q) & (q < model.upper)))


def poses(family: str, count: int) -> list[Array]:
    """Return the grasp pose and random poses (n,) [rad] within the servos' position limits.

    At most `count` poses are returned.
    """
    return [q for q in [VERTICAL, *postures(4 * count)] if fits(family, q)][:count]


def main(
    count: Annotated[int, tyro.conf.arg(name="poses"), tyro.conf.Positional] = 10,
    family: tyro.conf.Positional[str] = "p1",
) -> None:
    """Print a table with the worst value and the median over the poses in each cell.

    A second table has the force on the table in each pose.

    Args:
        count: Number of poses.
        family: Servo family: sts, x or p1.
    """
    starts = poses(family, count)
    columns = (
        f"{FAMILIES[family].title}, {len(starts)} poses",
        "sinks [mm]",
        "stands lower by [mm]",
        "meanwhile [m/s]",
        "lowered at [m/s]",
        "force on the table [N]",
        "of which rests [N]",
        "takes [s]",
    )
    print(markdown.head(columns))
    results: list[LowerResult] = []
    for name, load, over_table in CASES:
        results = [lower(family, q, load=load, over_table=over_table) for q in starts]
        cells = (
            markdown.worst((result.sank for result in results), 0, 1e3),
            markdown.worst((result.left for result in results), 0, 1e3),
            markdown.worst((result.enable_speed for result in results), 2),
            markdown.worst((result.speed for result in results), 2),
            markdown.worst((result.force for result in results), 1) if over_table else "",
            markdown.worst((result.resting for result in results), 1) if over_table else "",
            markdown.worst((result.seconds for result in results), 0),
        )
        print(markdown.row((name, *cells)), flush=True)
    rows = [
        ("force", *(f"{result.force:.1f}" for result in results)),
        ("rests", *(f"{result.resting:.1f}" for result in results)),
    ]
    print("\n" + markdown.table(("pose", *(str(k) for k in range(len(results)))), rows))


if __name__ == "__main__":
    command_line.start(main)
