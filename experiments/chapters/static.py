"""Chapter 2 of the report: a hand drags the arm along y or yaw and releases it (Figs 4 and 5)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from experiments import controllers, metrics
from experiments.chapters.common import (
    LAW_COLOURS,
    RELEASE,
    RETURN_TOLERANCE,
    Options,
    drag,
    names,
    pad_y_range,
    return_speed,
    return_time,
    shade,
)
from experiments.poses import AXES
from experiments.report import (
    Chapter,
    Figure,
    Numbers,
    Statement,
    at_least,
    at_most,
    band,
    between,
    mm,
)
from experiments.runner import Job
from pliant._report.page import Table
from pliant._report.style import (
    AXIS_COLOURS,
    INK,
    MUTED,
    WIDE,
    canvas,
    label_end,
    save,
    thin,
)
from pliant.sim.hand import DRAG_15N, TWIST_3NM, Drag, Twist

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from experiments.disturbances import DragResult, Law
    from experiments.simulation import Trace


NUMBER = 2
TITLE = "A hand moves the arm out of its pose"
ETAS = (0.0, 0.9, 0.999)
LAWS: Mapping[str, Callable[..., Law]] = {
    "paper": partial(controllers.paper, 10.0),
    "cap": controllers.cap,
}
#: Duration of a run [s], long enough for the slowest return of the arm to its target.
DURATION = 12.0


def key(axis: str, law: str, eta: float, sign: int) -> str:
    """Return the key of a run: axis, law, target adaptation η, and sign of the direction."""
    return f"{axis} {law} {eta:g} {sign:+d}"


def hand(axis: str, sign: int) -> Drag | Twist:
    """Return the hand that drags an axis in the direction `sign`.

    For y, it drags the wrist by 0.25 m with at most 15 N; for yaw, it turns the tool by 0.8 rad
    with at most 3 N·m.
    """
    if axis == "yaw":
        return replace(TWIST_3NM, angle=sign * TWIST_3NM.angle)
    return replace(DRAG_15N, distance=sign * DRAG_15N.distance)


def jobs(options: Options) -> list[Job]:
    """Return the runs: axis y and yaw, each law, each target adaptation η, both directions.

    With option `quick`, only y toward + is run.
    """
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


def measure(outcomes: Mapping[str, DragResult]) -> Numbers:
    """Return forces, deviations and return times by axis, law, η and direction."""
    numbers: dict[str, dict[str, dict[str, dict[str, dict[str, float | None]]]]] = {}
    for name, run in outcomes.items():
        axis, law, eta, sign = name.split()
        entry = numbers.setdefault(axis, {}).setdefault(law, {}).setdefault(eta, {})
        entry["toward +" if sign == "+1" else "toward -"] = _one(run, AXES.index(axis))
    return numbers


def _one(run: DragResult, axis: int) -> dict[str, float | None]:
    trace = run.trace
    letting_go, end = trace.at(RELEASE), trace.t.size - 1
    compliance = trace.compliance[trace.between(*metrics.PULLING), axis]
    is_late = trace.t > trace.t[-1] - 1.0
    late_moved = trace.moved[is_late, axis]
    return {
        "moved": run.moved,
        "before": run.before,
        "force": run.force,
        "held": abs(run.held),
        "drift": run.drift,
        "position": run.position,
        "rotation": run.rotation,
        "least_c": float(np.min(compliance)),
        "returned": return_time(trace, axis),
        "return_speed": return_speed(trace, axis),
        "left": abs(float(trace.error[end, axis])),
        "crept": abs(float(trace.moved[end, axis] - trace.moved[letting_go, axis])),
        "still_moving": abs(float(late_moved[-1] - late_moved[0]))
        / float(np.ptp(trace.t[is_late])),
    }


def chapter(numbers: Numbers) -> Chapter:
    """Return the chapter with the paper's statements about Figs 4 and 5."""
    figures = [figure for axis in numbers for figure in axis_figures(axis, numbers[axis])]
    headline = []
    for axis in numbers:
        for eta in numbers[axis]["cap"]:
            times = return_times(axis, numbers[axis]["cap"][eta])
            headline.append((f"cap, {axis} compliant, η {eta}, return", times))
    return Chapter(
        number=NUMBER,
        title=TITLE,
        lead="One axis is made compliant, the target stands still, and a hand pulls the arm away "
        "and lets go. How far does it follow, what do the other axes do, and does it come back?",
        figures=tuple(figures),
        tables=tuple(return_table(axis, numbers[axis]) for axis in numbers),
        numbers={"back_below": {"m": RETURN_TOLERANCE[0], "rad": RETURN_TOLERANCE[1]}, **numbers},
        headline=tuple(headline),
    )


def draw(outcomes: Mapping[str, DragResult], options: Options) -> None:
    """Draw for each dragged axis one overview, and one figure of all deviations per law."""
    traces = {name: run.trace for name, run in outcomes.items()}
    for axis in dict.fromkeys(name.split()[0] for name in outcomes):
        draw_overview(traces, axis, options.figures)
        for law in LAWS:
            draw_deviations(traces, axis, law, options.figures)


# --- The paper's statements on Figs 4 and 5, and the results of a run ---

#: Deviation d⁻ at which the compliance of the axis starts to fall from 1, and d⁺ at which it is 0:
#: y [m], yaw [rad].
RANGE = {"y": (0.01, 0.10), "yaw": (0.04, 0.40)}
#: Largest speed of a return to the target that counts as slow: y [m/s], yaw [rad/s].
SLOW = {"y": 0.2, "yaw": 0.8}
#: Distance of the hand's motion: y [m], yaw [rad].
PULL = {"y": 0.25, "yaw": 0.8}
NUMBER_OF_FIGURE = {"y": "Fig. 4", "yaw": "Fig. 5"}


def amount(axis: str) -> Callable[[float], str]:
    """Return the function that formats a deviation of an axis, in mm or rad."""
    return (lambda value: f"{value:.2f} rad") if axis == "yaw" else mm


def worst(runs: Numbers, name: str) -> float:
    """Return the largest value of the number `name` over the runs in both directions."""
    return float(max(run[name] for run in runs.values()))


def least(runs: Numbers, name: str) -> float:
    """Return the smallest value of the number `name` over the runs in both directions."""
    return float(min(run[name] for run in runs.values()))


def axis_figures(axis: str, numbers: Numbers) -> tuple[Figure, ...]:
    """Return the figures of a dragged axis with their texts and statements.

    They are the overview of both laws, and one figure per law with all six deviations.
    """
    of, push = (
        amount(axis),
        "at most 3 N·m at the tool" if axis == "yaw" else "at most 15 N at the wrist",
    )
    title = NUMBER_OF_FIGURE[axis]
    common = (
        f"{axis} is compliant, d⁻ = {of(RANGE[axis][0])}, d⁺ = {of(RANGE[axis][1])}. A hand of "
        f"{push} pulls by {of(PULL[axis])} within 2 to 3.5 s, holds on until 5 s and lets go; the "
        "grey band marks it."
    )
    overview = Figure(
        file=f"2-static-{axis}",
        title=f"Pushed in {axis}: the paper's law and the default law side by side ({title})",
        done=f"{common} Once with the paper's law as printed, without a gravity model and with a "
        "budget of 10 N·m on every axis, once with the default law cap, which promises forces. "
        "Both directions, three rates η of target adaptation.",
        caption="Solid: pushed toward +, dashed: toward −. Middle: the farthest of the other "
        "positions. Below: what the hand feels.",
        paper="Without adaptation the arm gives way a little and then resists, and other axes are "
        "dragged along; with strong adaptation it follows the hand and the other axes keep to "
        "their targets. Let go, it moves back slowly, or, at η = 0.999, to where gravity and "
        "servos balance.",
        statements=(*_paper(axis, numbers["paper"]), *_study(axis, numbers["cap"])),
    )
    details = tuple(
        Figure(
            file=f"2-static-{axis}-{law}",
            title=f"All deviations and the compliance c, {name} ({title})",
            done=f"The runs of the overview, as {title} prints them: deviation of all six axes "
            "from the target and compliance c, for η = 0 (left), 0.9 and 0.999 (right). Two runs "
            "in a row: pushed toward +, then toward −.",
            caption=f"Grey: the hand, and where it pulls. c is of {axis}, from the adapted "
            "deviation.",
        )
        for law, name in (("paper", "the paper's law without gravity model"), ("cap", "law cap"))
        if law in numbers
    )
    return (overview, *details)


def _paper(axis: str, law: Numbers) -> tuple[Statement, ...]:
    of = amount(axis)
    eta0, eta09, full = (law[eta] for eta in ("0", "0.9", "0.999"))
    fade, end = RANGE[axis]
    ratio = [worst(runs, "drift") / max(least(runs, "moved"), 1e-9) for runs in (eta0, full)]
    return (
        Statement(
            claim="η = 0: the tool gives way only by a fraction of d⁺.",
            outcome=f"It moves by {span(of, eta0, 'moved')}, with d⁺ = {of(end)}.",
            checks=(between("moved", worst(eta0, "moved"), fade / 2, end),),
        ),
        Statement(
            claim="η = 0: compliance falls with the deviation, the limits rise, and the arm "
            "resists.",
            outcome=f"c falls to {span('{:.2f}'.format, eta0, 'least_c')} while the hand pulls "
            f"with up to {worst(eta0, 'force'):.1f} {_unit(axis)}.",
            checks=(at_most("smallest c", worst(eta0, "least_c"), 0.95),),
        ),
        Statement(
            claim="η = 0: other axes deviate too; with strong adaptation they stay near their "
            "targets.",
            outcome=f"The hand drags other positions by {mm(worst(eta0, 'drift'))} at η = 0 for "
            f"{of(least(eta0, 'moved'))} of {axis}, and by {mm(worst(full, 'drift'))} at η = 0.999 "
            f"for {of(least(full, 'moved'))}; the servos' own sag under gravity is not counted.",
            checks=(
                at_least(
                    "deviation per motion, η 0 over η 0.999", ratio[0] / max(ratio[1], 1e-9), 1.5
                ),
            ),
        ),
        Statement(
            claim="η = 0.999: the tool follows the hand all the way.",
            outcome=f"It moves by {of(least(full, 'moved'))} of {of(PULL[axis])}, against at most "
            f"{worst(full, 'force'):.1f} {_unit(axis)}; at η = 0.9 by {of(least(eta09, 'moved'))}.",
            checks=(at_least("moved", least(full, "moved"), 0.9 * PULL[axis]),),
        ),
        Statement(
            claim="Let go, the tool moves back to its target slowly (η = 0 and 0.9).",
            outcome=f"Time until it is back within {of(RETURN_TOLERANCE[axis == 'yaw'])}: "
            f"{return_times(axis, eta0)} (η = 0) and {return_times(axis, eta09)} (η = 0.9), "
            f"{of(worst(eta09, 'left'))} being left; the fastest return goes at "
            f"{max(worst(eta0, 'return_speed'), worst(eta09, 'return_speed')):.2f} "
            f"{_unit(axis, 'speed')}.",
            checks=(
                at_most(
                    "deviation left",
                    max(worst(eta0, "left"), worst(eta09, "left")),
                    RETURN_TOLERANCE[axis == "yaw"],
                ),
                at_most(
                    "speed",
                    max(worst(eta0, "return_speed"), worst(eta09, "return_speed")),
                    SLOW[axis],
                ),
            ),
            because=_why_not_slowly(axis, eta0, eta09),
        ),
        Statement(
            claim="η = 0.999: let go, the arm moves on to a pose where gravity is in balance.",
            outcome=f"Within the rest of the run it moves by another {of(worst(full, 'crept'))} "
            f"and ends {of(worst(full, 'left'))} from its target, moving at "
            f"{1e3 * worst(full, 'still_moving'):.1f} m{_unit(axis, 'speed')}; before the push it "
            f"had already drifted by {of(worst(full, 'before'))}.",
            checks=(
                at_least(
                    "motion after release",
                    worst(full, "crept"),
                    RETURN_TOLERANCE[axis == "yaw"],
                ),
                at_most(
                    "speed at the end",
                    worst(full, "still_moving"),
                    0.005 if axis == "y" else 0.02,
                ),
            ),
            because="it creeps on: with a target that follows, nothing but friction is left to "
            "balance what the missing gravity model leaves over.",
        ),
    )


def _why_not_slowly(axis: str, eta0: Numbers, eta09: Numbers) -> str:
    """Return the known reasons for which law `paper` does not return slowly to the target.

    Args:
        axis: The dragged axis.
        eta0: Numbers of the runs with η = 0.
        eta09: Numbers of the runs with η = 0.9.

    Returns:
        Reasons for a remaining deviation with η = 0.9 and for a fast return; empty if neither
        occurred.
    """
    reasons = []
    if worst(eta09, "left") > RETURN_TOLERANCE[axis == "yaw"]:
        reasons.append(
            "gravity, which this law does not model, keeps it "
            f"{amount(axis)(worst(eta09, 'left'))} off at η = 0.9"
        )
    if max(worst(eta0, "return_speed"), worst(eta09, "return_speed")) > SLOW[axis]:
        reasons.append(
            "stretched servos of this stiffness throw the arm back; the servos' own speed limit, "
            "which Cosero had, is not used here"
        )
    return f"{'; '.join(reasons)}." if reasons else ""


def _study(axis: str, law: Numbers) -> tuple[Statement, ...]:
    of = amount(axis)
    full = law["0.999"]
    bands = {"y": (0.23, 7.5, 0.005, 0.015), "yaw": (0.75, 1.1, 0.009, 0.04)}[axis]
    statements = [
        band(
            claim=f"Law cap, η = 0.999: follows for at most {bands[1]:g} {_unit(axis)}, other "
            f"positions within {mm(bands[2])}, and stays where it is left.",
            outcome=f"{worst(full, 'force'):.2f} {_unit(axis)}, {mm(worst(full, 'position'))}; "
            f"moves by {of(worst(full, 'crept'))} after the hand has gone.",
            checks=(
                at_least("moved", least(full, "moved"), bands[0]),
                at_most("force", worst(full, "force"), bands[1]),
                at_most("other positions", worst(full, "position"), bands[2]),
                at_most("moves after release", worst(full, "crept"), bands[3]),
            ),
        )
    ]
    if axis == "y":
        eta09 = law["0.9"]
        statements.append(
            band(
                claim="Law cap, η = 0.9: follows beyond 0.2 m for less than 13 N and comes back to "
                "15 mm.",
                outcome=f"Moves by {of(least(eta09, 'moved'))} for {worst(eta09, 'force'):.1f} N; "
                f"after the release back within 15 mm after {return_times(axis, eta09)}.",
                checks=(
                    at_least("moved", least(eta09, "moved"), 0.2),
                    at_most("force", worst(eta09, "force"), 13.0),
                    at_most("left", worst(eta09, "left"), 0.015),
                ),
                because="it is still on its way at the end of the run.",
            )
        )
    return tuple(statements)


def comes_back(axis: str, run: Numbers) -> str:
    """Return as text the time in which the arm returned in a run, or that it did not return.

    Without a return, the text is "stays" if the arm hardly moved after the release, and otherwise
    "not back".
    """
    if run["returned"] is not None:
        return f"{run['returned']:.1f} s"
    return "stays" if run["crept"] <= RETURN_TOLERANCE[axis == "yaw"] else "not back"


def return_times(axis: str, runs: Numbers) -> str:
    """Return the texts of `comes_back` for both directions, as one text."""
    texts = dict.fromkeys(comes_back(axis, run) for run in runs.values())
    return " and ".join(texts)


def span(of: Callable[[float], str], runs: Numbers, name: str) -> str:
    """Return the range of the number `name` over both directions as text, formatted by `of`."""
    low, high = of(least(runs, name)), of(worst(runs, name))
    return low if low == high else f"{low} to {high}"


def _unit(axis: str, kind: str = "force") -> str:
    return {"force": ("N", "N·m"), "speed": ("m/s", "rad/s")}[kind][axis == "yaw"]


def return_table(axis: str, numbers: Numbers) -> Table:
    """Return a table with force, deviations and return time of each law, η and direction."""
    of = amount(axis)
    rows = []
    for law, etas in numbers.items():
        for eta, runs in etas.items():
            for direction, run in runs.items():
                rows.append(
                    (
                        law,
                        eta,
                        direction,
                        of(run["moved"]),
                        f"{run['force']:.2f} {_unit(axis)}",
                        mm(run["position"]),
                        f"{1e3 * run['rotation']:.0f} mrad",
                        comes_back(axis, run),
                        of(run["left"]),
                    )
                )
    limit = "0.06 rad" if axis == "yaw" else "15 mm"
    return Table(
        caption=f"Compliant in {axis}: return time per η. Returned: time from the release until "
        f"the deviation stays below {limit}; left: deviation at the end of the run.",
        columns=(
            "law",
            "η",
            "pushed",
            "moved",
            "force",
            "other positions",
            "other rotations",
            "returned",
            "left",
        ),
        rows=tuple(rows),
    )


# --- Pictures ---

ETA_NAMES = ("0", "0.9", "0.999")
SIGNS = ("+1", "-1")
#: Time at which the hand grips the arm [s].
GRIPPED = 2.0
#: Gap between the curves of two runs that are drawn one after the other on a time axis [s].
PAUSE = 0.6


def draw_overview(traces: Mapping[str, Trace], axis: str, folder: Path) -> None:
    """Draw an overview of all runs of a dragged axis: three plots over time for each η.

    They show the deviation of the dragged axis from its target, at each time the largest deviation
    of the other positions, and the force or torque of the hand, with one curve per law and
    direction.
    """
    index = AXES.index(axis)
    is_rotation = index > 2
    others = [i for i in range(3) if i != index]
    scale, unit = (1.0, "rad") if is_rotation else (1e3, "mm")
    with canvas(3, 3, size=(WIDE, 6.4), sharex=True, sharey="row") as (figure, axes):
        for column, eta in enumerate(ETA_NAMES):
            for law in ("paper", "cap"):
                for sign in SIGNS:
                    trace = traces.get(f"{axis} {law} {eta} {sign}")
                    if trace is None:
                        continue
                    step = thin(trace.t)
                    line = {
                        "color": LAW_COLOURS[law],
                        "linestyle": "-" if sign == "+1" else (0, (3.5, 2.0)),
                        "linewidth": 1.6 if law == "cap" else 1.3,
                    }
                    t = trace.t[step]
                    effort = (trace.moment if is_rotation else trace.force)[step, index % 3]
                    farthest = np.abs(trace.error[step][:, others]).max(axis=1)
                    axes[0, column].plot(t, -scale * trace.error[step, index], **line)
                    axes[1, column].plot(t, 1e3 * farthest, **line)
                    axes[2, column].plot(t, effort, **line)
            axes[0, column].set_title(f"η = {eta}")
            for row in range(3):
                shade(axes[row, column], GRIPPED, RELEASE, "hand" if row == 0 else "")
            axes[0, column].axhline(0.0, color=MUTED, linewidth=0.7)
            axes[2, column].set_xlabel("time [s]")
        axes[0, 0].set_ylabel(f"{axis}, from its target [{unit}]")
        axes[1, 0].set_ylabel("farthest other position [mm]")
        pad_y_range(axes[0], 0.14)
        pad_y_range(axes[1], 0.14)
        axes[1, 0].set_ylim(bottom=0.0)
        axes[2, 0].set_ylabel(f"hand [{'N·m' if is_rotation else 'N'}]")
        names(
            axes[0, 0],
            [("paper, no gravity model", LAW_COLOURS["paper"]), ("cap", LAW_COLOURS["cap"])],
        )
        save(figure, folder, f"2-static-{axis}")


def draw_deviations(traces: Mapping[str, Trace], axis: str, law: str, folder: Path) -> None:
    """Draw all six deviations, and the compliance of the dragged axis, for one law.

    There is one column per η; the runs of the two directions follow each other on the time axis.
    """
    index = AXES.index(axis)
    with canvas(
        3, 3, size=(WIDE, 6.2), sharex=True, sharey="row", height_ratios=[1.0, 1.0, 0.62]
    ) as (figure, axes):
        ends: list[float] = []
        for column, eta in enumerate(ETA_NAMES):
            start = 0.0
            for sign in SIGNS:
                trace = traces.get(f"{axis} {law} {eta} {sign}")
                if trace is None:
                    continue
                step = thin(trace.t)
                t = start + trace.t[step]
                for k, name in enumerate(AXES):
                    row, scale = (0, 1e3) if k < 3 else (1, 1.0)
                    axes[row, column].plot(
                        t, -scale * trace.error[step, k], color=AXIS_COLOURS[name]
                    )
                axes[2, column].plot(t, trace.compliance[step, index], color=INK)
                for row in range(3):
                    text = f"{'+' if sign == '+1' else '−'}{axis}" if row == 0 else ""
                    shade(axes[row, column], start + GRIPPED, start + RELEASE, text)
                start = float(t[-1]) + PAUSE
            ends.append(start - PAUSE)
            axes[0, column].set_title(f"η = {eta}", pad=14)
            axes[2, column].set_xlabel("time [s]")
            axes[2, column].set_ylim(-0.05, 1.08)
        pad_y_range(axes[0], 0.14)
        axes[0, 0].set_ylabel("positions, from target [mm]")
        axes[1, 0].set_ylabel("rotations, from target [rad]")
        axes[2, 0].set_ylabel("compliance c")
        _end_names(axes, traces, axis, law, max(ends))
        save(figure, folder, f"2-static-{axis}-{law}")


def _end_names(
    axes: NDArray[np.object_], traces: Mapping[str, Trace], axis: str, law: str, end: float
) -> None:
    """Write the names of the six deviations at the right ends of their curves, at time `end` [s].

    The curves are those of the last column, η = 0.999.
    """
    present = [s for s in SIGNS if f"{axis} {law} {ETA_NAMES[2]} {s}" in traces]
    trace = traces[f"{axis} {law} {ETA_NAMES[2]} {present[-1]}"]
    for row, group in ((0, AXES[:3]), (1, AXES[3:])):
        scale = 1e3 if row == 0 else 1.0
        ends = [
            (-scale * float(trace.error[-1, AXES.index(name)]), name, AXIS_COLOURS[name])
            for name in group
        ]
        label_end(axes[row, 2], end, ends)
