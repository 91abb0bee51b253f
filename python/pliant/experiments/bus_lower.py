"""`lower` over real bytes from many poses, with a load it does not know, over a table.

``python -m pliant.experiments.bus_lower [poses] [family]`` prints highest speeds and forces.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np

from pliant.experiments.bus_arm import FAMILIES, configuration, stepped
from pliant.experiments.faults import RATE, Watcher
from pliant.experiments.lifecycle import LOAD, TABLE, postures
from pliant.experiments.setups import VERTICAL
from pliant.sim import table

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

#: The rows: name, load at the tool that nobody told the arm of [kg], whether there is a table.
CASES = (
    ("nothing in the way", 0.0, False),
    ("0.3 kg it does not know", LOAD, False),
    ("load, and a table", LOAD, True),
)


def lower(family: str, q: Array, *, load: float = 0.0, over_table: bool = False) -> Watcher:
    """Enable the arm in q (n,) [rad] and lower it; return what was seen until torque was off."""
    plant = {"payload": (load, (0.0, 0.0, 0.0))} if load else {}
    with stepped(family, q=q, arm={"rate": RATE}, plant=plant) as (bus, arm):
        if over_table:
            low = min(bus.plant.tool[2, 3], bus.plant.wrist[2]) - TABLE
            bus.plant.set_hands(table(low))
        watcher = Watcher(bus)
        arm.enable()
        watcher.begin()
        arm.lower()
    return watcher


def fits(family: str, q: Array) -> bool:
    """Whether servos of a family can go to a pose (n,) [rad]."""
    model = configuration(family).model()
    return bool(np.all((model.lower < q) & (q < model.upper)))


def main() -> None:
    """Print the table: worst (median) over the poses."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 10
    family = sys.argv[2] if len(sys.argv) > 2 else "p1"
    poses = [q for q in [VERTICAL, *postures(4 * count)] if fits(family, q)][:count]
    print(
        f"| {FAMILIES[family].title}, {len(poses)} poses | tool [m/s] | force [N] |\n|---|---|---|"
    )
    for name, load, over_table in CASES:
        seen = [lower(family, q, load=load, over_table=over_table) for q in poses]
        speeds = [one.speeds[False] for one in seen]
        forces = [one.force for one in seen]
        print(
            f"| {name} | {max(speeds):.2f} ({np.median(speeds):.2f}) | {max(forces):.1f} "
            f"({np.median(forces):.1f}) |",
            flush=True,
        )


if __name__ == "__main__":
    main()
