"""Drag and door at every rate, delay and assumption: the basis of the goals' two columns.

Goals never require a higher rate; this shows its effect.
"""

from __future__ import annotations

from itertools import product

from experiments import laws, merits
from experiments.conditions import Conditions

#: Control rates [Hz], ticks of delay each way, and assumed over true friction and damping.
RATES, TICKS, BELIEVED = (100.0, 200.0), (0, 1), (0.7, 1.0, 1.3)
SCENES = {
    "15 N hand, η 0.999": merits.light(laws.cap()),
    "door, rigid grip, `cap`": merits.door("door"),
    "door, rigid grip, `impedance`": merits.door("door", laws.impedance),
}


def conditions() -> list[Conditions]:
    """Return all combinations of rate, delay and assumption, in the table's order."""
    return [
        Conditions(rate=rate, delay=(ticks, ticks), believed=believed)
        for rate, ticks, believed in product(RATES, TICKS, BELIEVED)
    ]


def text(only: str = "") -> str:
    """Measure every scene whose name contains `only`, as a table in Markdown."""
    under = conditions()
    names = [
        f"{one.rate:g} Hz{', 1+1' if one.delay[0] else ''}, × {one.believed:g}" for one in under
    ]
    lines = ["| scene | figure | " + " | ".join(names) + " |", "|---" * (len(names) + 2) + "|"]
    for scene, measure in SCENES.items():
        if only in scene:
            found = [measure(one) for one in under]
            lines += [
                f"| {scene} | {figure} | "
                + " | ".join(f"{one[figure]:.3g}" for one in found)
                + " |"
                for figure in found[0]
            ]
    return "\n".join(lines)
