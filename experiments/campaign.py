"""The cap campaign: every promised cap against the force on a hand.

``python -m experiments.campaign`` measures every axis, sign and cap in random poses of every arm,
with the other axes free and guided; on `arm7` also one disturbance at a time on a tenth of the
poses. A cap that the torque limits cannot hold in a pose is rejected, by the formula of
`Arm.capacity`. A cap counts as announced if the report states before the push that a joint meets
its position limit on the path, and that the friction of the others exceeds the band. All others
must be in band; the strict count of all runs is printed beside it.

The promise is ``min(F, K_x h (1 - η)|e| / C_jj)``; it is kept within ``0.15 F + Σ_i |J⁺_ij| (τ_f,i
+ d_i |q̇_i|)``, plus ``0.25 F`` where k_p is wrong and not identified.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from experiments import campaign_table, laws, merits
from experiments.campaign_arms import ROBOTS, available
from experiments.campaign_bench import Promise
from experiments.campaign_jobs import POSES, REAL_GEARS, jobs, run
from experiments.conditions import NOMINAL, Conditions


@dataclass(frozen=True)
class Options:
    """Measure every promised cap against the force on a hand.

    Attributes:
        poses: Poses of arm7; other arms have a quarter of them, each disturbance a tenth.
        arm: Arms by name; default all.
        jobs: Number of processes.
        out: Folder for results.json and the picture.
        friction: True: Stribeck and load-dependent friction are included: caps, drag and door.
        disturbed: True: arm7 also runs under disturbances.
    """

    poses: int = POSES
    arm: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    jobs: int = 2
    out: Path = Path("pliant-campaign")
    friction: bool = False
    disturbed: bool = True


def gears_text() -> str:
    """Measure drag and door with the table's friction and with identified gears, unknown and known.

    Returns:
        A table in Markdown; forces in N, drift in mm, the door's opening in deg.
    """
    measures = {
        "15 N hand": merits.light(laws.cap()),
        "strong hand": merits.strong(laws.cap()),
        "door, rigid grip": merits.door("door"),
    }
    gears = REAL_GEARS["arm7"]
    under = {
        "friction of the table": NOMINAL,
        "gears as they are": Conditions(gears=gears),
        "identified": Conditions(gears=gears, gears_known=True),
        "assumed × 0.7": Conditions(gears=gears, gears_known=True, believed=0.7),
        "identified, a tick each way": Conditions(gears=gears, gears_known=True, delay=(1, 1)),
    }
    lines = ["| scene | figure | " + " | ".join(under) + " |", "|---" * (len(under) + 2) + "|"]
    for scene, measure in measures.items():
        found = [measure(one) for one in under.values()]
        lines += [
            f"| {scene} | {name} | " + " | ".join(f"{one[name]:.3g}" for one in found) + " |"
            for name in found[0]
        ]
    return "\n".join(lines)


def main(options: Options) -> None:
    """Run the campaign of these options, print the table, write the files."""
    there, absent = available()
    for name in absent:
        print(f"campaign: SKIPPED {name}: its URDF is not in {ROBOTS}: set PLIANT_ROBOTS")
    arms = list(options.arm) or there
    work = jobs(arms, options.poses, disturbed=options.disturbed, friction=options.friction)
    found: dict[tuple[str, str], list[Promise]] = {}
    rows: list[campaign_table.Row] = []
    for key, promises in run(work, options.jobs):
        found[key] = promises
        rows.append(campaign_table.summary(*key, promises))
        lines = campaign_table.text(rows).splitlines()
        print("\n".join(lines[-1:] if len(rows) > 1 else lines), flush=True)
    if options.friction and "arm7" in arms:
        print(gears_text())
    about = {"poses": options.poses, "arms": arms, "skipped": absent}
    campaign_table.save(options.out, rows, found, about)
    campaign_table.draw(options.out, rows, found)
    print(f"campaign: {options.out / 'results.json'}, {options.out / 'campaign.png'}")


if __name__ == "__main__":
    main(tyro.cli(Options))
