"""Physics goals of the package in one table, each row with the preset that reaches it.

Two columns of conditions: 100 Hz without delay and everything known, and a tick of delay each way
with friction and damping known to 30 % (the worst of assuming 0.7, 1 and 1.3 times the true ones).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from experiments import cap_accuracy, controllers, disturbances, doors, program, tracking
from experiments.poses import AXES
from experiments.simulation import NOMINAL, Conditions
from pliant import Tracking
from pliant.functional import PaperOptions
from pliant.sim import LIGHT, STRONG, YAW

if TYPE_CHECKING:
    from collections.abc import Mapping


Figures = Mapping[str, float]
Measure = Callable[[Conditions], Figures]


def hold(conditions: Conditions) -> Figures:
    """Hold the grasp pose with every axis stiff."""
    law = controllers.cap(soft="")
    return {"error [mm]": 1e3 * disturbances.idle(law, conditions=conditions).error}


def strong(law: disturbances.Law) -> Measure:
    """Return a measurement in which a strong hand moves one soft axis."""

    def measure(conditions: Conditions) -> Figures:
        seen = disturbances.drag(law, STRONG, conditions=conditions)
        return {"force [N]": seen.force, "drift [mm]": 1e3 * seen.drift}

    return measure


def light(law: disturbances.Law) -> Measure:
    """Return a measurement in which a hand of at most 15 N moves the wrist."""

    def measure(conditions: Conditions) -> Figures:
        seen = disturbances.drag(law, LIGHT, conditions=conditions)
        return {"force [N]": seen.force, "drift [mm]": 1e3 * seen.drift}

    return measure


def capped(conditions: Conditions) -> Figures:
    """Move an axis with a cap of 15 N by a strong hand."""
    seen = disturbances.drag(controllers.cap(eta=0.0), STRONG, conditions=conditions)
    left = 1e3 * seen.end
    return {"held [N]": abs(seen.held), "drift [mm]": 1e3 * seen.drift, "left after 4 s [mm]": left}


def kept(conditions: Conditions) -> Figures:
    """Measure kept caps: in 200 poses if everything is known, else in a seeded tenth of them."""
    poses = 200 if conditions == NOMINAL else 20
    runs = [
        (case, cap_accuracy.keep(case, guided=guided, conditions=conditions).kept)
        for case in cap_accuracy.cases(poses)
        for guided in (False, True)
    ]
    clear = [kept for case, kept in runs if case.clear]
    return {
        "kept, all poses [%]": 100.0 * float(np.mean([kept for _, kept in runs])),
        "kept, joints clear of stops [%]": 100.0 * float(np.mean(clear)),
    }


def yaw(conditions: Conditions) -> Figures:
    """Let a hand turn the tool about yaw, the soft axis."""
    seen = disturbances.drag(controllers.cap(soft="yaw"), YAW, conditions=conditions)
    return {
        "torque [N·m]": seen.force,
        "position [mm]": 1e3 * seen.position,
        "leaves its place [rad]": seen.stays,
    }


def sinusoids(law: Callable[..., disturbances.Law]) -> Measure:
    """Return a measurement that swings each axis while it is compliant; figures are the worst."""

    def measure(conditions: Conditions) -> Figures:
        seen = [tracking.track(law(soft=a, eta=0.0), a, conditions=conditions) for a in AXES]
        return {
            "rms / amplitude": max(one.share for one in seen),
            "other positions [mm]": 1e3 * max(one.position for one in seen),
        }

    return measure


def door(scene: str, law: Callable[..., disturbances.Law] = controllers.cap) -> Measure:
    """Return a measurement in which the arm opens a rigidly gripped door."""

    def measure(conditions: Conditions) -> Figures:
        seen = doors.open_door(law, scene, "rigid", conditions=conditions)
        return {"angle [deg]": seen.angle, "force [N]": seen.force}

    return measure


def bumps(conditions: Conditions) -> Figures:
    """Run into walls; return the worst of all 18."""
    seen = [
        disturbances.bump(controllers.cap, way, speed=speed, stiffness=k, conditions=conditions)
        for way in disturbances.DIRECTIONS
        for k in disturbances.STIFFNESSES
        for speed in disturbances.SPEEDS
    ]
    return {
        "peak beyond cap + v√(km) [N]": max(one.peak - one.allowed for one in seen),
        "after 0.3 s [N]": max(one.later for one in seen),
    }


def dead(conditions: Conditions) -> Figures:
    """Push after a host loss; return the worst of four directions."""
    pushes = ("+y", "-y", "-x", "-z")
    law = controllers.cap(eta=0.0)
    return {"force [N]": max(disturbances.die(law, p, conditions=conditions).force for p in pushes)}


# --- Physics goals of the package in one table, each row with the preset that reaches it ---

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
        preset: The settings that reached it, as a call in `controllers`.
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
    """Return the value that is farthest outside the goal, or nearest to a bound if none is outside.

    Return the largest value if the goal has no bounds.
    """
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
        measure=hold,
        goals={"error [mm]": _most(0.5, 0.5)},
    ),
    _Entry(
        scenario="strong hand, η 0.999",
        preset="cap()",
        measure=strong(controllers.cap()),
        goals={"force [N]": _most(4.5, 5.5), "drift [mm]": _most(2.5, 3.0)},
    ),
    _Entry(
        scenario="strong hand, η 0.999",
        preset="cap(tracking.gain=6.0)",
        measure=strong(controllers.cap(tracking=Tracking(gain=6.0))),
        goals={"drift [mm]": _most(2.0)},
    ),
    _Entry(
        scenario="strong hand, η 0.999",
        preset='cap(follow="hold")',
        measure=strong(controllers.cap(paper_options=PaperOptions(follow="hold"))),
        goals={"drift [mm]": _most(2.0)},
    ),
    _Entry(
        scenario="15 N hand, η 0.999",
        preset="cap()",
        measure=light(controllers.cap()),
        goals={"force [N]": _most(5.6, 7.5), "drift [mm]": (Goal(high=2.3), _FREE)},
    ),
    # K_x h = 1.2, the bound with a tick each way: 3.3 instead of 4.04 mm of drift with
    # overestimated friction, for 0.1 N. No single value keeps all four bounds: at 1.1 it is 2.32 mm
    # with everything known, from 1.15 on 5.61 N.
    _Entry(
        scenario="15 N hand, η 0.999",
        preset="cap(tracking.gain=4.8)",
        measure=light(controllers.cap(tracking=Tracking(gain=4.8))),
        goals={
            "force [N]": (_FREE, Goal(high=7.5)),
            "drift [mm]": (_FREE, Goal(high=4.0)),
        },
    ),
    _Entry(
        scenario="15 N hand",
        preset="impedance()",
        measure=light(controllers.impedance()),
        goals={"force [N]": (Goal(high=5.6), _FREE), "drift [mm]": (_FREE, _FREE)},
    ),
    _Entry(
        scenario="strong hand, η 0, cap 15 N",
        preset="cap(eta=0.0)",
        measure=capped,
        goals={
            "held [N]": (Goal(low=14.0, high=16.0), Goal(low=14.0, high=16.0)),
            "drift [mm]": _most(3.0, 3.0),
            "left after 4 s [mm]": _most(3.0, 3.0),
        },
    ),
    _Entry(
        scenario="promised cap, random poses",
        preset="Axis(soft=F, firm=F)",
        measure=kept,
        goals={
            "kept, all poses [%]": (Goal(low=97.0), Goal(low=95.0)),
            "kept, joints clear of stops [%]": (Goal(low=97.0), Goal(low=95.0)),
        },
    ),
    _Entry(
        scenario="yaw, η 0.999",
        preset='cap(soft="yaw")',
        measure=yaw,
        goals={
            "torque [N·m]": _most(0.85, 1.4),
            "position [mm]": _most(6.0),
            "leaves its place [rad]": _most(0.04),
        },
    ),
    _Entry(
        scenario="sinusoids, worst axis",
        preset="cap(eta=0.0)",
        measure=sinusoids(controllers.cap),
        goals={"rms / amplitude": _most(0.045, 0.13), "other positions [mm]": _most(6.5, 8.0)},
    ),
    _Entry(
        scenario="sinusoids, worst axis",
        preset="cap_tracking()",
        measure=sinusoids(controllers.cap_tracking),
        goals={"rms / amplitude": _most(0.045, 0.13), "other positions [mm]": _most(6.5, 8.0)},
    ),
    _Entry(
        scenario="sinusoids, worst axis",
        preset="rec(eta=0.0)",
        measure=sinusoids(controllers.rec),
        goals={"rms / amplitude": _most(0.02), "other positions [mm]": _most(2.0)},
    ),
    _Entry(
        scenario="door, rigid grip",
        preset='cap(soft="y yaw", null_space.gain=1.0)',
        measure=door("door"),
        goals={"angle [deg]": (Goal(low=67.0), Goal(low=66.0)), "force [N]": _most(24.5, 30.0)},
    ),
    _Entry(
        scenario="door, rigid grip",
        preset='impedance(soft="y yaw", null_space.gain=1.0)',
        measure=door("door", controllers.impedance),
        goals={"angle [deg]": (Goal(low=65.0), None), "force [N]": (Goal(high=16.0), _FREE)},
    ),
    *(
        _Entry(
            scenario=f"{scene}, rigid grip",
            preset=f'cap(soft="{doors.SCENES[scene].soft}", null_space.gain=1.0)',
            measure=door(scene),
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
        measure=bumps,
        goals={"peak beyond cap + v√(km) [N]": _most(3.0), "after 0.3 s [N]": _most(20.0)},
    ),
    _Entry(
        scenario="host dead, then a hand",
        preset="cap(eta=0.0)",
        measure=dead,
        goals={"force [N]": (Goal(high=13.0), _FREE)},
    ),
)


def creeping(conditions: Conditions, creep: float) -> Conditions:
    """Return the same conditions with this creep speed of joints held by dry friction."""
    return conditions if creep == 1.0 else conditions.with_plant(friction_creep=creep)


def table(only: str = "", creep: float = 1.0) -> list[Row]:
    """Measure every row whose scenario contains `only`; about ten minutes for all of them."""
    return [row for entry in _ENTRIES if only in entry.scenario for row in entry.rows(creep)]


def text(rows: list[Row]) -> str:
    """Return the table for a terminal or a Markdown page."""
    columns = (
        "scenario",
        "preset",
        "figure",
        "goal",
        "reached",
        "goal, uncertain",
        "reached",
        "met",
    )
    lines = []
    for row in rows:
        second = "" if row.goal_uncertain is None else str(row.goal_uncertain)
        value = "" if row.goal_uncertain is None else f"{row.reached_uncertain:.3g}"
        first = (row.scenario, f"`{row.preset}`", row.figure, row.goal, f"{row.reached:.3g}")
        lines.append((*first, second, value, "yes" if row.met else "NO"))
    return program.markdown(columns, lines)


# --- Drag and door at every rate, delay and assumption: the basis of the goals' two columns ---

#: Control rates [Hz], ticks of delay each way, and assumed over true friction and damping.
RATES, TICKS, BELIEVED = (100.0, 200.0), (0, 1), (0.7, 1.0, 1.3)
RATE_SCENES = {
    "15 N hand, η 0.999": light(controllers.cap()),
    "door, rigid grip, `cap`": door("door"),
    "door, rigid grip, `impedance`": door("door", controllers.impedance),
}


def rate_conditions() -> list[Conditions]:
    """Return all combinations of rate, delay and assumption, in the table's order."""
    return [
        Conditions(rate=rate, delay=(ticks, ticks), believed=believed)
        for rate, ticks, believed in product(RATES, TICKS, BELIEVED)
    ]


def rates_text(only: str = "") -> str:
    """Measure every scene whose name contains `only`, as a table in Markdown."""
    under = rate_conditions()
    names = [
        f"{one.rate:g} Hz{', 1+1' if one.delay[0] else ''}, × {one.believed:g}" for one in under
    ]
    measures = {scene: measure for scene, measure in RATE_SCENES.items() if only in scene}
    return comparison(measures, dict(zip(names, under, strict=True)))


def comparison(measures: Mapping[str, Measure], under: Mapping[str, Conditions]) -> str:
    """Measure every scene under all conditions, a column each, as a table in Markdown."""
    rows: list[tuple[str, ...]] = []
    for scene, measure in measures.items():
        found = [measure(one) for one in under.values()]
        rows += [(scene, name, *(f"{one[name]:.3g}" for one in found)) for name in found[0]]
    return program.markdown(("scene", "figure", *under), rows)


def main(only: Annotated[str, tyro.conf.Positional] = "", creep: float = 1.0) -> None:
    """Measure the goals.

    Args:
        only: Rows whose scenario contains this.
        creep: Creep speed of joints held by friction, relative to MuJoCo's default; except for 1,
            caps are measured in a tenth of the poses, and rates are left out.
    """
    print(text(table(only, creep)))
    if creep == 1.0:
        print("\nDrag and door by rate, ticks of delay each way, and assumed over true friction:\n")
        print(rates_text(only))


if __name__ == "__main__":
    program.start(main)
