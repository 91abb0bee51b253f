"""Physics goals of the package in one table, each row with the preset that reaches it.

Two columns of conditions: 100 Hz without delay and everything known, and a tick of delay each way
with friction and damping known to 30 % (the worst of assuming 0.7, 1 and 1.3 times the true ones).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from experiments import doors, laws, merits, rates
from experiments.conditions import NOMINAL, Conditions
from pliant import Tracking
from pliant.functional import PaperOptions

if TYPE_CHECKING:
    from collections.abc import Mapping

    from experiments.merits import Figures, Measure

UNCERTAIN = tuple(Conditions(delay=(1, 1), believed=share) for share in (0.7, 1.0, 1.3))


@dataclass(frozen=True, kw_only=True)
class Goal:
    """Range of a figure.

    Attributes:
        low, high: Bounds, both included.
    """

    low: float = -np.inf
    high: float = np.inf

    def __contains__(self, value: float) -> bool:
        """Return True if a value lies within the bounds."""
        return self.low <= value <= self.high

    def __str__(self) -> str:
        """Return the bounds as text."""
        if np.isinf(self.low) and np.isinf(self.high):
            return "report"
        if np.isinf(self.low):
            return f"≤ {self.high:g}"
        if np.isinf(self.high):
            return f"≥ {self.low:g}"
        return f"{self.low:g}…{self.high:g}"


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of the table.

    Attributes:
        scenario: The experiment.
        preset: The settings that reached it, as a call in `laws`.
        figure: The measured figure, with its unit.
        reached, goal: Without delay, everything known.
        reached_uncertain, goal_uncertain: A tick each way, friction known to 30 %; NaN and None
            without a goal.
    """

    scenario: str
    preset: str
    figure: str
    reached: float
    goal: Goal
    reached_uncertain: float = np.nan
    goal_uncertain: Goal | None = None

    @property
    def met(self) -> bool:
        """True if every goal of the line is reached."""
        second = self.goal_uncertain
        return self.reached in self.goal and (second is None or self.reached_uncertain in second)


@dataclass(frozen=True, kw_only=True)
class _Entry:
    """One experiment: its measurement, and the goals of its figures in both columns."""

    scenario: str
    preset: str
    measure: Measure
    goals: Mapping[str, tuple[Goal, Goal | None]]

    def rows(self, creep: float) -> list[Row]:
        """Run it under the conditions that have a goal."""
        nominal = self.measure(creeping(NOMINAL, creep))
        uncertain: list[Figures] = []
        if any(second is not None for _, second in self.goals.values()):
            uncertain = [self.measure(creeping(conditions, creep)) for conditions in UNCERTAIN]
        rows = []
        for figure, (first, second) in self.goals.items():
            worst = np.nan
            if second is not None:
                worst = _worst([figures[figure] for figures in uncertain], second)
            rows.append(
                Row(
                    scenario=self.scenario,
                    preset=self.preset,
                    figure=figure,
                    reached=nominal[figure],
                    goal=first,
                    reached_uncertain=worst,
                    goal_uncertain=second,
                )
            )
        return rows


def _worst(values: list[float], goal: Goal) -> float:
    """Return the value farthest outside a goal, or closest to its edge; else the largest."""
    if np.isinf(goal.low) and np.isinf(goal.high):
        return max(values)
    return max(values, key=lambda value: max(goal.low - value, value - goal.high))


_FREE = Goal()


def _most(nominal: float, uncertain: float | None = None) -> tuple[Goal, Goal | None]:
    return Goal(high=nominal), None if uncertain is None else Goal(high=uncertain)


_ENTRIES = (
    _Entry(
        scenario="hold the grasp pose",
        preset='cap(soft="")',
        measure=merits.hold,
        goals={"error [mm]": _most(0.5, 0.5)},
    ),
    _Entry(
        scenario="strong hand, η 0.999",
        preset="cap()",
        measure=merits.strong(laws.cap()),
        goals={"force [N]": _most(4.5, 5.5), "drift [mm]": _most(2.5, 3.0)},
    ),
    _Entry(
        scenario="strong hand, η 0.999",
        preset="cap(tracking.gain=6.0)",
        measure=merits.strong(laws.cap(tracking=Tracking(gain=6.0))),
        goals={"drift [mm]": _most(2.0)},
    ),
    _Entry(
        scenario="strong hand, η 0.999",
        preset='cap(follow="hold")',
        measure=merits.strong(laws.cap(paper_options=PaperOptions(follow="hold"))),
        goals={"drift [mm]": _most(2.0)},
    ),
    _Entry(
        scenario="15 N hand, η 0.999",
        preset="cap()",
        measure=merits.light(laws.cap()),
        goals={"force [N]": _most(5.6, 7.5), "drift [mm]": (Goal(high=2.3), _FREE)},
    ),
    # K_x h = 1.2, the bound with a tick each way: 3.3 instead of 4.04 mm of drift with
    # overestimated friction, for 0.1 N. No single value keeps all four bounds: at 1.1 it is 2.32 mm
    # with everything known, from 1.15 on 5.61 N.
    _Entry(
        scenario="15 N hand, η 0.999",
        preset="cap(tracking.gain=4.8)",
        measure=merits.light(laws.cap(tracking=Tracking(gain=4.8))),
        goals={
            "force [N]": (_FREE, Goal(high=7.5)),
            "drift [mm]": (_FREE, Goal(high=4.0)),
        },
    ),
    _Entry(
        scenario="15 N hand",
        preset="impedance()",
        measure=merits.light(laws.impedance()),
        goals={"force [N]": (Goal(high=5.6), _FREE), "drift [mm]": (_FREE, _FREE)},
    ),
    _Entry(
        scenario="strong hand, η 0, cap 15 N",
        preset="cap(eta=0.0)",
        measure=merits.capped,
        goals={
            "held [N]": (Goal(low=14.0, high=16.0), Goal(low=14.0, high=16.0)),
            "drift [mm]": _most(3.0, 3.0),
            "left after 4 s [mm]": _most(3.0, 3.0),
        },
    ),
    _Entry(
        scenario="promised cap, random poses",
        preset="Axis(soft=F, firm=F)",
        measure=merits.kept,
        goals={
            "kept, all poses [%]": (Goal(low=97.0), Goal(low=95.0)),
            "kept, joints clear of stops [%]": (Goal(low=97.0), Goal(low=95.0)),
        },
    ),
    _Entry(
        scenario="yaw, η 0.999",
        preset='cap(soft="yaw")',
        measure=merits.yaw,
        goals={
            "torque [N·m]": _most(0.85, 1.4),
            "position [mm]": _most(6.0),
            "leaves its place [rad]": _most(0.04),
        },
    ),
    _Entry(
        scenario="sinusoids, worst axis",
        preset="cap(eta=0.0)",
        measure=merits.sinusoids(laws.cap),
        goals={"rms / amplitude": _most(0.045, 0.13), "other positions [mm]": _most(6.5, 8.0)},
    ),
    _Entry(
        scenario="sinusoids, worst axis",
        preset="cap_tracking()",
        measure=merits.sinusoids(laws.cap_tracking),
        goals={"rms / amplitude": _most(0.045, 0.13), "other positions [mm]": _most(6.5, 8.0)},
    ),
    _Entry(
        scenario="sinusoids, worst axis",
        preset="rec(eta=0.0)",
        measure=merits.sinusoids(laws.rec),
        goals={"rms / amplitude": _most(0.02), "other positions [mm]": _most(2.0)},
    ),
    _Entry(
        scenario="door, rigid grip",
        preset='cap(soft="y yaw", null_space.gain=1.0)',
        measure=merits.door("door"),
        goals={"angle [deg]": (Goal(low=67.0), Goal(low=66.0)), "force [N]": _most(24.5, 30.0)},
    ),
    _Entry(
        scenario="door, rigid grip",
        preset='impedance(soft="y yaw", null_space.gain=1.0)',
        measure=merits.door("door", laws.impedance),
        goals={"angle [deg]": (Goal(low=65.0), None), "force [N]": (Goal(high=16.0), _FREE)},
    ),
    *(
        _Entry(
            scenario=f"{scene}, rigid grip",
            preset=f'cap(soft="{doors.SCENES[scene].soft}", null_space.gain=1.0)',
            measure=merits.door(scene),
            goals={"force [N]": (Goal(high=force), _FREE)},
        )
        for scene, force in (
            ("fridge", 27.0),
            ("horizontal", 26.0),
            ("oven", 19.0),
            ("base door", 41.0),
            ("base fridge", 41.0),
        )
    ),
    _Entry(
        scenario="running into a wall",
        preset="cap(soft=axis, eta=0.0)",
        measure=merits.bumps,
        goals={"peak beyond cap + v√(km) [N]": _most(3.0), "after 0.3 s [N]": _most(20.0)},
    ),
    _Entry(
        scenario="host dead, then a hand",
        preset="cap(eta=0.0)",
        measure=merits.dead,
        goals={"force [N]": (Goal(high=13.0), _FREE)},
    ),
)


def creeping(conditions: Conditions, creep: float) -> Conditions:
    """Return the same conditions with this creep speed of joints held by dry friction."""
    return conditions if creep == 1.0 else conditions.with_plant(creep=creep)


def table(only: str = "", creep: float = 1.0) -> list[Row]:
    """Measure every row whose scenario contains `only`; about ten minutes for all of them."""
    return [row for entry in _ENTRIES if only in entry.scenario for row in entry.rows(creep)]


def text(rows: list[Row]) -> str:
    """Return the table for a terminal or a Markdown page."""
    lines = [
        "| scenario | preset | figure | goal | reached | goal, uncertain | reached | met |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        second = "" if row.goal_uncertain is None else str(row.goal_uncertain)
        value = "" if row.goal_uncertain is None else f"{row.reached_uncertain:.3g}"
        lines.append(
            f"| {row.scenario} | `{row.preset}` | {row.figure} | {row.goal} | {row.reached:.3g} "
            f"| {second} | {value} | {'yes' if row.met else 'NO'} |"
        )
    return "\n".join(lines)


@dataclass(frozen=True)
class Options:
    """Measure the goals.

    Attributes:
        only: Rows whose scenario contains this.
        creep: Creep speed of joints held by friction, relative to MuJoCo's default; except for 1,
            caps are measured in a tenth of the poses, and rates are left out.
    """

    only: Annotated[str, tyro.conf.Positional] = ""
    creep: float = 1.0


def main() -> None:
    """Print the tables."""
    options = tyro.cli(Options)
    print(text(table(options.only, options.creep)))
    if options.creep == 1.0:
        print("\nDrag and door by rate, ticks of delay each way, and assumed over true friction:\n")
        print(rates.text(options.only))


if __name__ == "__main__":
    main()
