"""Chapter 2: a hand drags the arm out of its pose and lets go, in y and yaw (Figs 4 and 5)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from experiments import laws, metrics
from experiments.chapters import static_text
from experiments.chapters.common import BACK, RELEASE, Options, drag, return_speed, returned
from experiments.result import Chapter, Numbers
from experiments.runner import Job
from experiments.setups import AXES
from pliant.sim.hand import LIGHT, YAW, Drag, Twist

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from experiments.hands import Dragged, Law

NUMBER = 2
TITLE = "A hand moves the arm out of its pose"
ETAS = (0.0, 0.9, 0.999)
LAWS: Mapping[str, Callable[..., Law]] = {"paper": partial(laws.paper, 10.0), "cap": laws.cap}
#: Length of a run [s]: long enough for the slowest return.
DURATION = 12.0


def key(axis: str, law: str, eta: float, sign: int) -> str:
    """Return the name of a run."""
    return f"{axis} {law} {eta:g} {sign:+d}"


def hand(axis: str, sign: int) -> Drag | Twist:
    """Return a hand of at most 15 N at the wrist to 0.25 m, or 3 N·m at the tool to 0.8 rad."""
    if axis == "yaw":
        return replace(YAW, angle=sign * YAW.angle)
    return replace(LIGHT, distance=sign * LIGHT.distance)


def jobs(options: Options) -> list[Job]:
    """Return both laws, three η, both directions, in y and in yaw."""
    axes, signs = (("y",), (1,)) if options.quick else (("y", "yaw"), (1, -1))
    return [
        Job(
            key(axis, law, eta, sign),
            drag,
            (partial(make, soft=axis, eta=eta), hand(axis, sign)),
            {"duration": 9.0 if options.quick else DURATION},
        )
        for axis in axes
        for law, make in LAWS.items()
        for eta in ETAS
        for sign in signs
    ]


def measure(outcomes: Mapping[str, Dragged]) -> Numbers:
    """Return numbers by axis, law, η and direction."""
    numbers: dict[str, dict[str, dict[str, dict[str, dict[str, float | None]]]]] = {}
    for name, run in outcomes.items():
        axis, law, eta, sign = name.split()
        into = numbers.setdefault(axis, {}).setdefault(law, {}).setdefault(eta, {})
        into["toward +" if sign == "+1" else "toward -"] = _one(run, AXES.index(axis))
    return numbers


def _one(run: Dragged, axis: int) -> dict[str, float | None]:
    trace = run.trace
    letting_go, end = trace.at(RELEASE), trace.t.size - 1
    compliance = trace.compliance[trace.between(*metrics.PULLING), axis]
    late = trace.t > trace.t[-1] - 1.0
    late_moved = trace.moved[late, axis]
    return {
        "moved": run.moved,
        "before": run.before,
        "force": run.force,
        "held": abs(run.held),
        "drift": run.drift,
        "position": run.position,
        "rotation": run.rotation,
        "least_c": float(np.min(compliance)),
        "returned": returned(trace, axis),
        "return_speed": return_speed(trace, axis),
        "left": abs(float(trace.error[end, axis])),
        "crept": abs(float(trace.moved[end, axis] - trace.moved[letting_go, axis])),
        "still_moving": abs(float(late_moved[-1] - late_moved[0])) / float(np.ptp(trace.t[late])),
    }


def chapter(numbers: Numbers) -> Chapter:
    """Judge the statements about Figs 4 and 5."""
    figures = [figure for axis in numbers for figure in static_text.figures(axis, numbers[axis])]
    headline = []
    for axis in numbers:
        for eta in numbers[axis]["cap"]:
            times = static_text.times(axis, numbers[axis]["cap"][eta])
            headline.append((f"cap, {axis} compliant, η {eta}, return", times))
    return Chapter(
        number=NUMBER,
        title=TITLE,
        lead="One axis is made compliant, the target stands still, and a hand pulls the arm away "
        "and lets go. How far does it follow, what do the other axes do, and does it come back?",
        figures=tuple(figures),
        tables=tuple(static_text.table(axis, numbers[axis]) for axis in numbers),
        numbers={"back_below": {"m": BACK[0], "rad": BACK[1]}, **numbers},
        headline=tuple(headline),
    )


def draw(outcomes: Mapping[str, Dragged], options: Options) -> None:
    """Draw an overview and all deviations per law, for each axis."""
    from experiments.figures import static

    traces = {name: run.trace for name, run in outcomes.items()}
    for axis in dict.fromkeys(name.split()[0] for name in outcomes):
        static.overview(traces, axis, options.figures)
        for law in LAWS:
            static.deviations(traces, axis, law, options.figures)
