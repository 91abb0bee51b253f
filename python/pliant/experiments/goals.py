"""The physics goals of the package, reached and wanted: one table, each row with the preset that reaches it.

Two columns of conditions: 100 Hz without delay and everything known, and a tick of delay each way with
friction and damping known to 30 % (the worst of believing 0.7, 1 and 1.3 times the true values).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from pliant.experiments import doors, hands, host, laws, promise, tracking, walls
from pliant.experiments.conditions import NOMINAL, Conditions
from pliant.experiments.setups import AXES
from pliant.sim import LIGHT, STRONG, YAW

#: Figures of one experiment by name, forces in N and N·m, distances in mm, angles in deg or rad.
Figures = Mapping[str, float]
Measure = Callable[[Conditions], Figures]

UNCERTAIN = tuple(Conditions(delay=(1, 1), believed=share) for share in (0.7, 1.0, 1.3))


@dataclass(frozen=True, kw_only=True)
class Goal:
    """What a figure is to be.

    Attributes:
        low, high: Bounds, both included.
    """

    low: float = -np.inf
    high: float = np.inf

    def __str__(self) -> str:
        """The bounds as people write them."""
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
        scenario: What was tried.
        preset: The settings that reached it, as a call in `laws`.
        figure: What was measured, with its unit.
        reached, goal: Without delay, everything known.
        reached_uncertain, goal_uncertain: A tick each way, friction known to 30 %; NaN where not measured.
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
        """Whether every goal of the line is reached."""
        ok = self.goal.low <= self.reached <= self.goal.high
        if self.goal_uncertain is not None:
            ok = ok and self.goal_uncertain.low <= self.reached_uncertain <= self.goal_uncertain.high
        return ok


@dataclass(frozen=True, kw_only=True)
class _Entry:
    """One experiment of the table: how it is measured, and the goals of its figures in both columns."""

    scenario: str
    preset: str
    measure: Measure
    goals: Mapping[str, tuple[Goal, Goal | None]]

    def rows(self) -> list[Row]:
        """Run it under the conditions that have a goal."""
        nominal = self.measure(NOMINAL)
        uncertain: list[Figures] = []
        if any(second is not None for _, second in self.goals.values()):
            uncertain = [self.measure(conditions) for conditions in UNCERTAIN]
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
    """The value farthest outside, or nearest to the edge of, a goal."""
    return max(values, key=lambda value: max(goal.low - value, value - goal.high))


def _hold(conditions: Conditions) -> Figures:
    return {"error [mm]": 1e3 * hands.idle(laws.cap(), conditions=conditions).error}


def _strong(law: hands.Law) -> Measure:
    def measure(conditions: Conditions) -> Figures:
        seen = hands.drag(law, STRONG, conditions=conditions)
        return {"force [N]": seen.force, "drift [mm]": 1e3 * seen.drift}

    return measure


def _light(conditions: Conditions) -> Figures:
    seen = hands.drag(laws.cap(), LIGHT, conditions=conditions)
    return {"force [N]": seen.force, "drift [mm]": 1e3 * seen.drift}


def _capped(conditions: Conditions) -> Figures:
    seen = hands.drag(laws.cap(eta=0.0), STRONG, conditions=conditions)
    left = 1e3 * seen.end
    return {"held [N]": abs(seen.held), "drift [mm]": 1e3 * seen.drift, "left after 4 s [mm]": left}


def _promise(conditions: Conditions) -> Figures:
    kept = [
        promise.keep(case, guided=guided, conditions=conditions).kept
        for case in promise.cases(200)
        for guided in (False, True)
    ]
    return {"kept [%]": 100.0 * float(np.mean(kept))}


def _yaw(conditions: Conditions) -> Figures:
    seen = hands.drag(laws.cap(soft="yaw"), YAW, conditions=conditions)
    return {
        "torque [N·m]": seen.force,
        "position [mm]": 1e3 * seen.position,
        "leaves its place [rad]": seen.stays,
    }


def _sinusoids(law: Callable[..., hands.Law]) -> Measure:
    def measure(conditions: Conditions) -> Figures:
        seen = [tracking.track(law(soft=a, eta=0.0), a, conditions=conditions) for a in AXES]
        return {
            "rms / amplitude": max(one.share for one in seen),
            "other positions [mm]": 1e3 * max(one.position for one in seen),
        }

    return measure


def _door(scene: str) -> Measure:
    def measure(conditions: Conditions) -> Figures:
        seen = doors.open_door(laws.cap, scene, "rigid", conditions=conditions)
        return {"angle [deg]": seen.angle, "force [N]": seen.force}

    return measure


def _walls(conditions: Conditions) -> Figures:
    seen = [
        walls.bump(laws.cap, way, speed=speed, stiffness=k, conditions=conditions)
        for way in walls.DIRECTIONS
        for k in walls.STIFFNESSES
        for speed in walls.SPEEDS
    ]
    return {
        "peak beyond cap + v√(km) [N]": max(one.peak - one.allowed for one in seen),
        "after 0.3 s [N]": max(one.later for one in seen),
    }


def _dead(conditions: Conditions) -> Figures:
    pushes = ("+y", "-y", "-x", "-z")
    law = laws.cap(eta=0.0)
    return {"force [N]": max(host.die(law, p, conditions=conditions).force for p in pushes)}


_FREE = Goal()


def _most(nominal: float, uncertain: float | None = None) -> tuple[Goal, Goal | None]:
    return Goal(high=nominal), None if uncertain is None else Goal(high=uncertain)


_ENTRIES = (
    _Entry(scenario="hold the grasp pose", preset="cap()", measure=_hold, goals={"error [mm]": _most(0.5, 0.5)}),
    _Entry(
        scenario="strong hand, η 0.999",
        preset="cap()",
        measure=_strong(laws.cap()),
        goals={"force [N]": _most(4.5, 5.5), "drift [mm]": _most(2.5, 3.0)},
    ),
    _Entry(
        scenario="strong hand, η 0.999",
        preset="cap(kx=6.0)",
        measure=_strong(laws.cap(kx=6.0)),
        goals={"drift [mm]": _most(2.0)},
    ),
    _Entry(
        scenario="strong hand, η 0.999",
        preset='cap(follow="hold")',
        measure=_strong(laws.cap(follow="hold")),
        goals={"drift [mm]": _most(2.0)},
    ),
    _Entry(
        scenario="15 N hand, η 0.999",
        preset="cap()",
        measure=_light,
        goals={"force [N]": _most(5.6, 7.5), "drift [mm]": _most(2.3, 4.0)},
    ),
    _Entry(
        scenario="strong hand, η 0, cap 15 N",
        preset="cap(eta=0.0)",
        measure=_capped,
        goals={
            "held [N]": (Goal(low=14.0, high=16.0), Goal(low=14.0, high=16.0)),
            "drift [mm]": _most(3.0, 3.0),
            "left after 4 s [mm]": _most(3.0, 3.0),
        },
    ),
    _Entry(
        scenario="promised cap, random poses",
        preset="Axis(soft=F, firm=F)",
        measure=_promise,
        goals={"kept [%]": (Goal(low=97.0), Goal(low=95.0))},
    ),
    _Entry(
        scenario="yaw, η 0.999",
        preset='cap(soft="yaw")',
        measure=_yaw,
        goals={
            "torque [N·m]": _most(0.85, 1.4),
            "position [mm]": _most(6.0),
            "leaves its place [rad]": _most(0.04),
        },
    ),
    _Entry(
        scenario="sinusoids, worst axis",
        preset="cap(eta=0.0)",
        measure=_sinusoids(laws.cap),
        goals={"rms / amplitude": _most(0.045, 0.13), "other positions [mm]": _most(6.5, 8.0)},
    ),
    _Entry(
        scenario="sinusoids, worst axis",
        preset="rec(eta=0.0)",
        measure=_sinusoids(laws.rec),
        goals={"rms / amplitude": _most(0.02), "other positions [mm]": _most(2.0)},
    ),
    _Entry(
        scenario="door, rigid grip",
        preset='cap(soft="y yaw", alpha=1.0)',
        measure=_door("door"),
        goals={"angle [deg]": (Goal(low=67.0), Goal(low=66.0)), "force [N]": _most(24.5, 30.0)},
    ),
    *(
        _Entry(
            scenario=f"{scene}, rigid grip",
            preset=f'cap(soft="{doors.SCENES[scene].soft}", alpha=1.0)',
            measure=_door(scene),
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
        measure=_walls,
        goals={"peak beyond cap + v√(km) [N]": _most(3.0), "after 0.3 s [N]": _most(20.0)},
    ),
    _Entry(
        scenario="host dead, then a hand",
        preset="cap(eta=0.0)",
        measure=_dead,
        goals={"force [N]": (Goal(high=13.0), _FREE)},
    ),
)


def table(only: str = "") -> list[Row]:
    """Measure every row whose scenario contains `only`; about ten minutes for all of them."""
    return [row for entry in _ENTRIES if only in entry.scenario for row in entry.rows()]


def text(rows: list[Row]) -> str:
    """The table for a terminal or a Markdown page."""
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


if __name__ == "__main__":
    import sys

    print(text(table(" ".join(sys.argv[1:]))))
