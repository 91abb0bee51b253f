"""Torque on and `lower` over real bytes from many poses, with an unknown load, over a table.

``python -m experiments.bus_lower [poses] [family]`` prints highest speeds and forces, the sag of
the arm as torque comes on, the duration of descents, and the force on the table pose by pose. With
one pose it is the grasp pose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from experiments import program
from experiments.emulated_arm import FAMILIES, configuration, stepped
from experiments.faults import RATE, Watcher
from experiments.lifecycle import AFTER, LOAD, TABLE, pose_table, postures
from pliant.sim import table
from pliant.sim.postures import VERTICAL

if TYPE_CHECKING:
    from experiments.poses import Array


#: Rows of the table: name, unknown load at the tool [kg], True if there is a table under the arm.
CASES = (
    ("no obstacle", 0.0, False),
    ("unknown load of 0.3 kg", LOAD, False),
    ("unknown load, table", LOAD, True),
)


@dataclass(frozen=True, kw_only=True)
class LowerResult:
    """Result of one torque-on and descent.

    Attributes:
        sank: Sag of the tool when torque is switched on [m].
        left: Remaining sag after `enable` [m].
        lifted: Highest speed of the tool during `enable` [m/s].
        speed: Highest speed of the tool during the descent [m/s].
        force: Largest mean over a tick of the force on one point of the table [N].
        resting: Weight on the table once torque is off [N].
        seconds: Duration of the descent.
    """

    sank: float
    left: float
    lifted: float
    speed: float
    force: float
    resting: float
    seconds: float


def lower(family: str, q: Array, *, load: float = 0.0, over_table: bool = False) -> LowerResult:
    """Enable the arm in q (n,) [rad] and lower it.

    Args:
        family: `sts`, `x` or `p1`.
        q: Posture (n,) [rad].
        load: Unknown mass at the tool [kg].
        over_table: True: a table 0.10 m below the lower of tool and wrist.

    Returns:
        The result.
    """
    plant = {"payload": (load, (0.0, 0.0, 0.0))} if load else {}
    with stepped(family, q=q, arm={"rate": RATE}, plant=plant) as (bus, arm):
        if over_table:
            low = min(bus.plant.tool[2, 3], bus.plant.wrist[2]) - TABLE
            bus.plant.set_hands(table(low))
        on = Watcher(bus)
        on.begin()
        arm.enable()
        left = on.start - float(bus.plant.tool[2, 3])
        on.end()
        down = Watcher(bus)
        down.begin()
        begun = bus.plant.time
        arm.lower()
        seconds, force = bus.plant.time - begun, down.force
        bus.advance(AFTER)
        resting = sum(float(np.linalg.norm(felt.force)) for felt in bus.plant.hands)
    return LowerResult(
        sank=on.start - on.lowest,
        left=left,
        lifted=on.speeds[False],
        speed=down.speeds[False],
        force=force,
        resting=resting,
        seconds=seconds,
    )


def fits(family: str, q: Array) -> bool:
    """Return True if servos of a family can reach a pose (n,) [rad]."""
    model = configuration(family).model()
    return bool(np.all((model.lower < q) & (q < model.upper)))


def poses(family: str, count: int) -> list[Array]:
    """Return the grasp pose and random ones (n,) [rad] that the servos of a family can reach."""
    return [q for q in [VERTICAL, *postures(4 * count)] if fits(family, q)][:count]


def main(
    count: Annotated[int, tyro.conf.arg(name="poses"), tyro.conf.Positional] = 10,
    family: tyro.conf.Positional[str] = "p1",
) -> None:
    """Print the tables: worst (median) over the poses, and the table pose by pose.

    Args:
        count: Number of poses.
        family: Servos: sts, x or p1.
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
    print(program.head(columns))
    seen: list[LowerResult] = []
    for name, load, over_table in CASES:
        seen = [lower(family, q, load=load, over_table=over_table) for q in starts]
        cells = (
            program.worst((one.sank for one in seen), 0, 1e3),
            program.worst((one.left for one in seen), 0, 1e3),
            program.worst((one.lifted for one in seen), 2),
            program.worst((one.speed for one in seen), 2),
            program.worst((one.force for one in seen), 1) if over_table else "",
            program.worst((one.resting for one in seen), 1) if over_table else "",
            program.worst((one.seconds for one in seen), 0),
        )
        print(program.row((name, *cells)), flush=True)
    print(f"\n{pose_table(seen)}")


if __name__ == "__main__":
    program.start(main)
