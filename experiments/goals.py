"""Table of the package's goals for simulated results, each with the settings that reach it.

The goals apply to two sets of conditions, both at 100 Hz. The first has no delay and no errors. The
second has a delay of one tick for readings and one for commands, and an error of 30 % in friction
and damping: the worst result with 0.7, 1 and 1.3 times the true values as assumed values counts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from experiments import (
    cap_accuracy,
    command_line,
    controllers,
    disturbances,
    doors,
    markdown,
    tracking,
)
from experiments.poses import AXES
from experiments.simulation import NOMINAL, Conditions
from pliant import Tracking
from pliant.functional import PaperOptions
from pliant.sim import DRAG_15N, DRAG_80N, TWIST_3NM

if TYPE_CHECKING:
    from pliant.sim import Drag


Figures = Mapping[str, float]
Measure = Callable[[Conditions], Figures]


def hold(conditions: Conditions) -> Figures:
    """Hold the grasp pose with every axis stiff; return the tool's distance from its target."""
    law = controllers.cap(soft="")
    return {"error [mm]": 1e3 * disturbances.idle(law, conditions=conditions).error}


def measure_drag(law: disturbances.Law, hand: Drag) -> Measure:
    """Return a function that measures force and drift while a hand drags the arm along soft y.

    The function returns the largest force of the hand and the drift of the other positions.
    """

    def measure(conditions: Conditions) -> Figures:
        result = disturbances.drag(law, hand, conditions=conditions)
        return {"force [N]": result.force, "drift [mm]": 1e3 * result.drift}

    return measure


def hold_strong_hand(conditions: Conditions) -> Figures:
    """Measure soft y with a cap of 15 N, along which a hand of at most 80 N drags the tool.

    Return the force of the resting hand, the drift of the other positions, and the distance of y
    from its start 4 s after the release.
    """
    result = disturbances.drag(controllers.cap(eta=0.0), DRAG_80N, conditions=conditions)
    error = 1e3 * result.end
    return {
        "held [N]": abs(result.held),
        "drift [mm]": 1e3 * result.drift,
        "left after 4 s [mm]": error,
    }


def count_kept_caps(conditions: Conditions) -> Figures:
    """Return the share of kept caps (`CapResult.kept`), in all poses and in those clear of stops.

    200 random poses are measured under `NOMINAL` conditions, and 20 under all others.
    """
    poses = 200 if conditions == NOMINAL else 20
    runs = [
        (case, cap_accuracy.keep(case, guided=is_guided, conditions=conditions).kept)
        for case in cap_accuracy.cases(poses)
        for is_guided in (False, True)
    ]
    clear_kept = [is_kept for case, is_kept in runs if case.clear]
    return {
        "kept, all poses [%]": 100.0 * float(np.mean([is_kept for _, is_kept in runs])),
        "kept, joints clear of stops [%]": 100.0 * float(np.mean(clear_kept)),
    }


def yaw(conditions: Conditions) -> Figures:
    """Measure a hand that turns the tool about the soft axis yaw and releases it.

    Return its largest torque, the largest displacement of the tool, and how far yaw moves back.
    """
    result = disturbances.drag(controllers.cap(soft="yaw"), TWIST_3NM, conditions=conditions)
    return {
        "torque [N·m]": result.force,
        "position [mm]": 1e3 * result.position,
        "leaves its place [rad]": result.stays,
    }


def sinusoids(law: Callable[..., disturbances.Law]) -> Measure:
    """Return a function that measures sinusoidal tracking along each axis, with this axis soft.

    The function returns the worst results over the axes.
    """

    def measure(conditions: Conditions) -> Figures:
        result = [tracking.track(law(soft=a, eta=0.0), a, conditions=conditions) for a in AXES]
        return {
            "rms / amplitude": max(run.share for run in result),
            "other positions [mm]": 1e3 * max(run.position for run in result),
        }

    return measure


def door(scene: str, law: Callable[..., disturbances.Law] = controllers.cap) -> Measure:
    """Return a function that measures how the arm opens a rigidly gripped door.

    The function returns the largest opening and the largest force at the handle.
    """

    def measure(conditions: Conditions) -> Figures:
        result = doors.open_door(law, scene, "rigid", conditions=conditions)
        return {"angle [deg]": result.angle, "force [N]": result.force}

    return measure


def bumps(conditions: Conditions) -> Figures:
    """Measure 18 motions into walls.

    Return the largest excess of an impact force over its bound, and the largest force later than
    0.3 s after the contact.
    """
    results = [
        disturbances.bump(
            controllers.cap, direction, speed=speed, stiffness=k, conditions=conditions
        )
        for direction in disturbances.DIRECTIONS
        for k in disturbances.STIFFNESSES
        for speed in disturbances.SPEEDS
    ]
    return {
        "peak beyond cap + v√(km) [N]": max(result.peak - result.allowed for result in results),
        "after 0.3 s [N]": max(result.later for result in results),
    }


def after_host_loss(conditions: Conditions) -> Figures:
    """Measure a hand that moves the tool after a host loss; return its largest force.

    The force is the largest of four directions of the hand.
    """
    pushes = ("+y", "-y", "-x", "-z")
    law = controllers.cap(eta=0.0)
    return {
        "force [N]": max(
            disturbances.lose_host(law, p, conditions=conditions).force for p in pushes
        )
    }


# --- Table of the goals ---

#: Conditions with a delay of one tick each way and errors of friction and damping.
UNCERTAIN = tuple(Conditions(delay=(1, 1), assumed_ratio=share) for share in (0.7, 1.0, 1.3))


@dataclass(frozen=True, kw_only=True)
class Goal:
    """Allowed range of a measured number.

    Attributes:
        low, high: Bounds, inclusive.
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
    """Row of the table: one measured number and its goals.

    Attributes:
        scenario: Name of the experiment.
        preset: Settings, as a call in `controllers`.
        figure: Name and unit of the measured number.
        reached, goal: Result and goal under conditions without delay and errors.
        reached_uncertain, goal_uncertain: Worst result and goal under `UNCERTAIN`; NaN and None if
            there is no such goal.
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
        """True if every goal of the row is reached."""
        second = self.goal_uncertain
        return self.reached in self.goal and (second is None or self.reached_uncertain in second)


@dataclass(frozen=True, kw_only=True)
class _Entry:
    """Experiment of the table: a measuring function, and two goals for each of its numbers.

    The first goal is for conditions without delay and errors, the second for `UNCERTAIN`.
    """

    scenario: str
    preset: str
    measure: Measure
    goals: Mapping[str, tuple[Goal, Goal | None]]

    def rows(self, creep: float) -> list[Row]:
        """Measure under the conditions that have a goal; return one row for each number.

        `creep` is the factor on the speed at which held joints creep, see `creeping`.
        """
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
    """Return the value that exceeds a bound of the goal most.

    If all values lie within the bounds, return the value nearest to a bound; for a goal without
    bounds, return the largest value.
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
        measure=measure_drag(controllers.cap(), DRAG_80N),
        goals={"force [N]": _most(4.5, 5.5), "drift [mm]": _most(2.5, 3.0)},
    ),
    _Entry(
        scenario="strong hand, η 0.999",
        preset="cap(tracking.gain=6.0)",
        measure=measure_drag(controllers.cap(tracking=Tracking(gain=6.0)), DRAG_80N),
        goals={"drift [mm]": _most(2.0)},
    ),
    _Entry(
        scenario="strong hand, η 0.999",
        preset='cap(follow="hold")',
        measure=measure_drag(controllers.cap(paper_options=PaperOptions(follow="hold")), DRAG_80N),
        goals={"drift [mm]": _most(2.0)},
    ),
    _Entry(
        scenario="15 N hand, η 0.999",
        preset="cap()",
        measure=measure_drag(controllers.cap(), DRAG_15N),
        goals={"force [N]": _most(5.6, 7.5), "drift [mm]": (Goal(high=2.3), _FREE)},
    ),
    # A gain K_x of 4.8/s (default: 4/s) serves the goals with delay and errors. With overestimated
    # friction it reduces the drift from 4.04 to 3.3 mm for 0.1 N more force. It is a separate entry
    # because no gain reaches all four goals: without errors, 4.4/s gives 2.32 mm of drift, and
    # 4.6/s gives 5.61 N.
    _Entry(
        scenario="15 N hand, η 0.999",
        preset="cap(tracking.gain=4.8)",
        measure=measure_drag(controllers.cap(tracking=Tracking(gain=4.8)), DRAG_15N),
        goals={
            "force [N]": (_FREE, Goal(high=7.5)),
            "drift [mm]": (_FREE, Goal(high=4.0)),
        },
    ),
    _Entry(
        scenario="15 N hand",
        preset="impedance()",
        measure=measure_drag(controllers.impedance(), DRAG_15N),
        goals={"force [N]": (Goal(high=5.6), _FREE), "drift [mm]": (_FREE, _FREE)},
    ),
    _Entry(
        scenario="strong hand, η 0, cap 15 N",
        preset="cap(eta=0.0)",
        measure=hold_strong_hand,
        goals={
            "held [N]": (Goal(low=14.0, high=16.0), Goal(low=14.0, high=16.0)),
            "drift [mm]": _most(3.0, 3.0),
            "left after 4 s [mm]": _most(3.0, 3.0),
        },
    ),
    _Entry(
        scenario="promised cap, random poses",
        preset="Axis(soft=F, firm=F)",
        measure=count_kept_caps,
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
        measure=after_host_loss,
        goals={"force [N]": (Goal(high=13.0), _FREE)},
    ),
)


def creeping(conditions: Conditions, creep: float) -> Conditions:
    """Return the conditions with `creep` times MuJoCo's default speed at which joints creep.

    Simulated joints creep under load although dry friction holds them, see `friction_creep` of
    `pliant.sim.Plant`.
    """
    return conditions if creep == 1.0 else conditions.with_plant(friction_creep=creep)


def table(only: str = "", creep: float = 1.0) -> list[Row]:
    """Measure and return the rows whose scenario contains `only`.

    All rows take about ten minutes. `creep` is the factor on the speed at which held joints creep,
    see `creeping`.
    """
    return [row for entry in _ENTRIES if only in entry.scenario for row in entry.rows(creep)]


def text(rows: list[Row]) -> str:
    """Return the rows as a Markdown table."""
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
    return markdown.table(columns, lines)


# --- Drag and door experiments at all rates, delays and errors ---

#: Compared control rates [Hz], delays of readings and of commands [ticks], and ratios of assumed to
#: true friction and damping.
RATES, TICKS, ASSUMED_RATIOS = (100.0, 200.0), (0, 1), (0.7, 1.0, 1.3)
RATE_SCENES = {
    "15 N hand, η 0.999": measure_drag(controllers.cap(), DRAG_15N),
    "door, rigid grip, `cap`": door("door"),
    "door, rigid grip, `impedance`": door("door", controllers.impedance),
}


def rate_conditions() -> list[Conditions]:
    """Return the conditions for all combinations of `RATES`, `TICKS` and `ASSUMED_RATIOS`."""
    return [
        Conditions(rate=rate, delay=(ticks, ticks), assumed_ratio=assumed_ratio)
        for rate, ticks, assumed_ratio in product(RATES, TICKS, ASSUMED_RATIOS)
    ]


def rates_text(only: str = "") -> str:
    """Measure the experiments `RATE_SCENES` whose name contains `only`; return a Markdown table.

    Its columns are the conditions of `rate_conditions`.
    """
    conditions = rate_conditions()
    names = [
        f"{each.rate:g} Hz{', 1+1' if each.delay[0] else ''}, × {each.assumed_ratio:g}"
        for each in conditions
    ]
    measures = {scene: measure for scene, measure in RATE_SCENES.items() if only in scene}
    return comparison(measures, dict(zip(names, conditions, strict=True)))


def comparison(measures: Mapping[str, Measure], conditions: Mapping[str, Conditions]) -> str:
    """Measure every experiment under all conditions; return a Markdown table.

    Args:
        measures: Measuring functions by the name of the experiment.
        conditions: Conditions by the heading of their column.

    Returns:
        Table with one row for each number of an experiment.
    """
    rows: list[tuple[str, ...]] = []
    for scene, measure in measures.items():
        figures = [measure(item) for item in conditions.values()]
        rows += [(scene, name, *(f"{item[name]:.3g}" for item in figures)) for name in figures[0]]
    return markdown.table(("scene", "figure", *conditions), rows)


def main(only: Annotated[str, tyro.conf.Positional] = "", creep: float = 1.0) -> None:
    """Measure the goals.

    Args:
        only: Text that selects the rows whose scenario contains it.
        creep: Creep speed of joints held by friction, relative to MuJoCo's default. With a value
            other than 1, caps are measured in a tenth of the poses, and the table of rates is
            omitted.
    """
    print(text(table(only, creep)))
    if creep == 1.0:
        print("\nDrag and door by rate, ticks of delay each way, and assumed over true friction:\n")
        print(rates_text(only))


if __name__ == "__main__":
    command_line.start(main)
