"""Chapter 6 of the report: accuracy of force caps in random poses of three arms.

The runs are a part of those of `experiments.campaign`, which defines the terms.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments import campaign as table
from experiments.arms import AXES, load
from experiments.campaign import UNDISTURBED
from experiments.campaign import Job as Poses
from experiments.report import Chapter, Figure, Numbers, at_least, band
from experiments.runner import Job
from pliant._report.page import Table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from experiments.campaign import Promise
    from experiments.chapters.common import Options

NUMBER = 6
TITLE = "Are the caps kept?"
#: Number of poses of each arm; they are the first poses of the campaign.
POSES = {"arm7": 12, "so101": 6, "koch": 6}
#: Arm and pose index of the only run with option `quick`; all joints are clear of their stops.
QUICK = ("arm7", 2)
#: Attributes of `campaign.Row` that the report shows.
FIGURES = ("poses", "cases", "refused", "kept", "kept_clear", "stopped", "median", "p95")


def promises(arm: str, pose: int) -> list[Promise]:
    """Return the results of all pushes on one arm in one pose, without a disturbance."""
    return Poses(arm, UNDISTURBED, pose).run()


def jobs(options: Options) -> list[Job]:
    """Return one job for each arm and pose."""
    poses = [(arm, i) for arm, count in POSES.items() for i in range(min(count, _drawn(arm)))]
    if options.quick:
        poses = [QUICK]
    return [Job(f"{arm} {pose}", promises, (arm, pose)) for arm, pose in poses]


def _drawn(arm: str) -> int:
    return len(load(arm).poses(POSES[arm]))


def _by_arm(outcomes: Mapping[str, Sequence[Promise]]) -> dict[str, list[Promise]]:
    by_arm: dict[str, list[Promise]] = {}
    for key, results in outcomes.items():
        by_arm.setdefault(key.split()[0], []).extend(results)
    return by_arm


def measure(outcomes: Mapping[str, Sequence[Promise]]) -> Numbers:
    """Return the attributes `FIGURES` of the statistics (`campaign.Row`) of each arm."""
    rows = {a: table.summary(a, "nominal", results) for a, results in _by_arm(outcomes).items()}
    return {arm: {name: getattr(row, name) for name in FIGURES} for arm, row in rows.items()}


def chapter(numbers: Numbers) -> Chapter:
    """Return the chapter with statements about the accuracy of the caps."""
    arm7 = numbers["arm7"]
    clear_band = band(
        claim="With no joint near its stop the push-back is the cap, within 15 % and what the "
        "joints' friction hides, in 97 of 100 cases.",
        outcome=f"{100.0 * arm7['kept_clear']:.1f} % of the cases on arm7; median error of all "
        f"{100.0 * arm7['median']:.1f} % of the cap.",
        checks=(at_least("in band, clear of stops", 100.0 * arm7["kept_clear"], 97.0, "%"),),
    )
    limits = band(
        claim="Forces outside the band come from position limits: with the force of the stop and "
        "the friction of the other joints they are in band.",
        outcome=f"{100.0 * arm7['kept']:.1f} % of all cases on arm7 are in band, "
        f"{100.0 * arm7['stopped']:.1f} % provably stopped by a position limit.",
        checks=(
            at_least("in band or stopped", 100.0 * (arm7["kept"] + arm7["stopped"]), 95.0, "%"),
        ),
    )
    figure = Figure(
        file="6-caps",
        title="Promised and measured forces",
        done="In random poses, no axis near singular, a hand moves the tool along one axis, with "
        "the other axes free and with springs that hold them. The axis yields with a cap; what "
        "the hand feels at rest is compared with the cap, or with what the axis' own spring gives "
        "at that distance. Caps that the servos cannot hold in a pose are refused beforehand.",
        caption="Thick: the middle half. Left: arm7 by axis; right: by arm. The whole campaign, "
        "with disturbances and real robots, is `python -m experiments.campaign`.",
        statements=(clear_band, limits),
    )
    rows = tuple(
        (
            arm,
            str(figures["poses"]),
            str(figures["cases"]),
            *(f"{100.0 * figures[name]:.1f} %" for name in FIGURES[2:]),
        )
        for arm, figures in numbers.items()
    )
    columns = ("arm", "poses", "cases", "refused", "in band", "clear of stops", "by a limit")
    return Chapter(
        number=NUMBER,
        title=TITLE,
        lead="A cap is the largest force with which an axis may push back. This chapter compares "
        "caps with the force on a hand in random poses.",
        figures=(figure,),
        tables=(Table(caption="Per arm", columns=(*columns, "median", "95 %"), rows=rows),),
        numbers=numbers,
        headline=(("caps in band, arm7", f"{100.0 * arm7['kept']:.1f} %"),),
    )


def draw(outcomes: Mapping[str, Sequence[Promise]], options: Options) -> None:
    """Draw the distributions of the force errors, by axis on `arm7` and by arm."""
    from experiments import campaign

    by_arm = _by_arm(outcomes)
    axes = {axis: [p for p in by_arm["arm7"] if p.axis == axis] for axis in AXES}
    campaign.draw_errors({"arm7, by axis": axes, "By arm": by_arm}, options.figures, "6-caps")
