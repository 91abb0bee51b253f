"""Jobs of the cap campaign, pose by pose, in one process or several."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import groupby
from typing import TYPE_CHECKING

from experiments.campaign_arms import load
from experiments.campaign_bench import (
    DISTURBANCES,
    NOMINAL,
    Bench,
    Disturbance,
    Promise,
)
from experiments.parallel import parallel
from pliant.sim.friction import MX64, MX106, STS3215, Friction

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    #: Arm and disturbance by name.
    Key = tuple[str, str]

#: Number of poses of `arm7` and of the other arms; share of the former under each disturbance.
POSES, OTHER_POSES, TENTH = 200, 50, 10
#: Names of the identified gears, by arm.
REAL_GEARS = {"arm7": Friction.of([MX106] * 4 + [MX64] * 3), "so101": STS3215}


@dataclass(frozen=True)
class Job:
    """One pose of one arm under one disturbance."""

    arm: str
    disturbance: Disturbance
    pose: int

    def run(self) -> list[Promise]:
        """Measure all promises of the pose."""
        bench = _bench(self.arm, self.disturbance.name)
        return bench.promises(self.pose, bench.arm.poses(self.pose + 1)[self.pose])


def gears(arm: str) -> tuple[Disturbance, Disturbance]:
    """Return the identified friction by speed and load, unknown and known to the controller.

    Raises:
        KeyError: The gears are not identified.
    """
    unknown = replace(NOMINAL, name="gears as they are", gears=REAL_GEARS[arm])
    return unknown, replace(unknown, name="gears as they are, identified", gears_known=True)


@lru_cache(maxsize=2)
def _bench(arm: str, disturbance: str) -> Bench:
    """Return the bench of this process; jobs come arm by arm, disturbance by disturbance."""
    known = {one.name: one for one in (NOMINAL, *DISTURBANCES)}
    if disturbance not in known:
        known |= {one.name: one for one in gears(arm)}
    return Bench(load(arm), known[disturbance])


def jobs(
    arms: Sequence[str], poses: int, *, disturbed: bool = True, friction: bool = False
) -> list[Job]:
    """Return all jobs of a campaign.

    Args:
        arms: Names.
        poses: Number for `arm7`; other arms have a quarter, each disturbance a tenth.
        disturbed: True: `arm7` also runs under disturbances.
        friction: True: identified gears are included, on a tenth of the poses.
    """
    out: list[Job] = []
    for name in arms:
        main = name == "arm7"
        count = len(load(name).poses(poses if main else -(-poses * OTHER_POSES // POSES)))
        out += [Job(name, NOMINAL, pose) for pose in range(count)]
        tenth = max(1, count // TENTH)
        if main and disturbed:
            out += [Job(name, one, pose) for one in DISTURBANCES for pose in range(tenth)]
        if friction and name in REAL_GEARS:
            out += [Job(name, one, pose) for one in gears(name) for pose in range(tenth)]
    return out


def run(work: Sequence[Job], processes: int = 1) -> Iterator[tuple[Key, list[Promise]]]:
    """Run jobs, in parallel if joblib is installed.

    Args:
        work: Jobs, arm by arm and disturbance by disturbance.
        processes: Number of processes.

    Yields:
        Arm and disturbance with all their promises, as they complete.
    """
    done = parallel(work, processes, "campaign")
    pairs = zip(work, done, strict=True)
    for key, group in groupby(pairs, key=lambda pair: (pair[0].arm, pair[0].disturbance.name)):
        yield key, [promise for _, promises in group for promise in promises]
