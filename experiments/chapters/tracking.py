"""Chapter 3 of the report: tracking of a sinusoid by a compliant axis (Figs 6 and 7)."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MultipleLocator

from experiments import controllers, metrics
from experiments.chapters.common import LAW_COLOURS, Options, names, track
from experiments.poses import AMPLITUDE, AXES
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
from pliant._report import listed
from pliant._report.page import Table
from pliant._report.style import (
    BLUE,
    INK,
    MUTED,
    ORANGE,
    RED,
    WIDE,
    canvas,
    label_end,
    save,
    thin,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from experiments.disturbances import Law
    from experiments.simulation import Trace
    from experiments.tracking import TrackResult


NUMBER = 3
TITLE = "A compliant axis still tracks"
LAWS: Mapping[str, Callable[..., Law]] = {
    "paper": partial(controllers.paper, 10.0),
    "paper + gravity": controllers.rec,
    "cap": controllers.cap,
}
#: Law of the paper without step limits. With it the tool sinks while the target moves along x.
LITERAL: Callable[..., Law] = partial(controllers.limits_only, 10.0)
#: Largest ratio of rms error to amplitude that counts as "tracking very well" in the paper's sense.
WELL = 0.10
#: Largest accepted ratio of rms error to amplitude with law cap, by tracked axis.
CAP_BANDS = {"x": 0.025, "y": 0.035, "z": 0.06, "roll": 0.025, "pitch": 0.05, "yaw": 0.03}


def jobs(options: Options) -> list[Job]:
    """Return the runs: every axis with each of `LAWS`, and x with `LITERAL`.

    With option `quick`, only x and y with laws `paper` and `cap`, and x with `LITERAL` are run.
    """
    axes = ("x", "y") if options.quick else AXES
    laws = {name: LAWS[name] for name in (("paper", "cap") if options.quick else LAWS)}
    runs = [
        Job(f"{axis}/{law}", track, (partial(make, soft=axis, eta=0.0), axis))
        for axis in axes
        for law, make in laws.items()
    ]
    runs.append(Job("x/literal", track, (partial(LITERAL, soft="x", eta=0.0), "x")))
    return runs


def measure(outcomes: Mapping[str, TrackResult]) -> Numbers:
    """Return relative and absolute errors of each run, and the tool height, by axis and law."""
    numbers: dict[str, dict[str, dict[str, float]]] = {}
    for name, run in outcomes.items():
        axis, law = name.split("/")
        numbers.setdefault(axis, {})[law] = _one(run, AXES.index(axis))
    return numbers


def _one(run: TrackResult, axis: int) -> dict[str, float]:
    trace = run.trace
    swing = trace.between(1.0, 17.0)
    error, c = trace.error[swing, axis], trace.compliance[swing, axis]
    is_far = trace.position[:, 0] > 0.40
    lowest = int(np.argmin(np.where(is_far, trace.position[:, 2], np.inf))) if is_far.any() else 0
    return {
        "share": run.share,
        "share_without_mean": metrics.rms(error - error.mean()) / AMPLITUDE[AXES[axis]],
        "other_positions": run.position,
        "other_rotations": run.rotation,
        "sunk": run.sunk,
        "left": run.left,
        "x_when_lowest": float(trace.position[lowest, 0]),
        "c_when_lowest": float(trace.compliance[lowest, axis]),
        "least_c": float(c.min()),
    }


def chapter(numbers: Numbers) -> Chapter:
    """Return the chapter with the paper's statements about Figs 6 and 7."""
    axes = [axis for axis in AXES if axis in numbers]
    rotations = [axis for axis in axes if AXES.index(axis) > 2]
    moving = [axis for axis in axes if AXES.index(axis) < 3]
    figures = [_swing(numbers, moving, "3-tracking-positions", "Fig. 6")]
    if rotations:
        figures.append(_swing(numbers, rotations, "3-tracking-rotations", "Fig. 7"))
    figures.append(_loss(numbers))
    worst = max(numbers[axis]["cap"]["share"] for axis in axes)
    return Chapter(
        number=NUMBER,
        title=TITLE,
        lead="Being soft must not mean being late: the target swings with a period of 8 s along "
        "one axis at a time, and that axis is compliant, without target adaptation (η = 0).",
        figures=tuple(figures),
        tables=(_table(numbers, axes),),
        numbers=numbers,
        headline=(
            ("cap, rms error / amplitude, worst axis", f"{worst:.3f}"),
            ("paper, x swing: z lost", mm(numbers["x"]["literal"]["sunk"])),
        ),
    )


def _swing(numbers: Numbers, axes: list[str], file: str, title: str) -> Figure:
    return Figure(
        file=file,
        title=f"Sinusoids in {listed(axes)} ({title})",
        done="The target swings twice about the vertical grasp pose, by 0.12 m in x and z, 0.15 m "
        "in y, 0.5 rad in roll and yaw, 0.4 rad in pitch. Laws: the paper's without gravity model "
        "(budget 10 N·m), the same with gravity in goals and limits (8 N·m), and cap.",
        paper="The compliant axis follows the target very well in y, z, roll, pitch and yaw.",
        caption="Above: the swinging axis and its target. Below: the farthest of the other "
        "positions.",
        statements=(*_follows(numbers, axes), *_bands(numbers, axes)),
    )


def _follows(numbers: Numbers, axes: list[str]) -> tuple[Statement, ...]:
    statements = []
    for axis in axes:
        if axis == "x":
            continue
        figures = numbers[axis]["paper"]
        share, remainder = figures["share"], figures["share_without_mean"]
        statements.append(
            Statement(
                claim=f"{axis}: follows very well.",
                outcome=f"The rms error is {share:.3f} of the amplitude; {remainder:.3f} without "
                "its constant part.",
                checks=(at_most("rms error / amplitude", share, WELL),),
                because="the constant sag of servos without a gravity model is most of the error; "
                "what swings is followed."
                if remainder <= WELL
                else "",
            )
        )
    return tuple(statements)


def _bands(numbers: Numbers, axes: list[str]) -> tuple[Statement, ...]:
    cap = {axis: numbers[axis]["cap"] for axis in axes}
    shares = listed([f"{cap[axis]['share']:.3f} ({axis})" for axis in axes])
    others = max(figures["other_positions"] for figures in cap.values())
    limit = 0.009 if {"pitch", "yaw"} & set(axes) else 0.007
    statements = [
        band(
            claim="Law cap follows within its bands and keeps the other positions.",
            outcome=f"Rms error / amplitude {shares}; other positions within {mm(others)}.",
            checks=(
                *(at_most(f"{axis}", cap[axis]["share"], CAP_BANDS[axis]) for axis in axes),
                at_most("other positions", others, limit, "m"),
            ),
        )
    ]
    if all("paper + gravity" in numbers[axis] for axis in axes):
        rec = {axis: numbers[axis]["paper + gravity"] for axis in axes}
        worst = max(figures["share"] for figures in rec.values())
        others = max(figures["other_positions"] for figures in rec.values())
        statements.append(
            band(
                claim="The paper's law with a gravity model follows within 0.035 and keeps the "
                "other positions to 5 mm.",
                outcome=f"At worst {worst:.3f}; other positions within {mm(others)}.",
                checks=(
                    at_most("worst", worst, 0.035),
                    at_most("other positions", others, 0.005, "m"),
                ),
            )
        )
    return tuple(statements)


def _loss(numbers: Numbers) -> Figure:
    literal, with_steps = numbers["x"]["literal"], numbers["x"]["paper"]
    cap = numbers["x"]["cap"]
    return Figure(
        file="3-loss-of-z",
        title="Swinging in x without a gravity model, the arm loses height",
        done="The x swing once more, under the paper's law without gravity model: as printed (no "
        "step limits, budget 10 N·m), with step limits per axis, and under law cap.",
        paper="With x compliant, the arm temporarily drops in z when it reaches far forward, "
        "because pitch joints serve both axes. The lag this causes in x lowers the compliance, the "
        "joints get more torque, and z recovers.",
        caption="From above: x and its target, height, compliance c of x, and what the shoulder "
        "pitch gives within its limit under the printed law.",
        statements=(
            Statement(
                claim="Far forward, z is lost downwards.",
                outcome=f"{mm(literal['sunk'])} lower at x = {literal['x_when_lowest']:.2f} m; "
                f"{mm(with_steps['sunk'])} with step limits per axis.",
                checks=(
                    between("z lost", literal["sunk"], 0.035, 0.140, "m"),
                    at_least("x", literal["x_when_lowest"], 0.40, "m"),
                ),
            ),
            Statement(
                claim="Compliance in x drops with it.",
                outcome=f"c falls to {literal['least_c']:.2f} ({literal['c_when_lowest']:.2f} "
                "where the tool is lowest).",
                checks=(at_most("least c", literal["least_c"], 0.9),),
            ),
            Statement(
                claim="z recovers.",
                outcome=f"{mm(literal['left'])} are left when the tool comes back toward the body.",
                checks=(
                    at_most("left", literal["left"], 0.040, "m"),
                    at_most("left over lost", literal["left"] / literal["sunk"], 0.8),
                ),
            ),
            band(
                claim="With gravity in goals and limits nothing is lost.",
                outcome=f"Law cap loses {mm(max(cap['sunk'], 0.0))} at most.",
                checks=(at_most("z lost", cap["sunk"], 0.007, "m"),),
            ),
        ),
    )


def _table(numbers: Numbers, axes: list[str]) -> Table:
    names = [law for law in LAWS if law in numbers[axes[0]]]
    rows = [
        (
            law,
            *(f"{numbers[axis][law]['share']:.3f}" for axis in axes),
            mm(max(numbers[axis][law]["other_positions"] for axis in axes)),
        )
        for law in names
    ]
    return Table(
        caption="Rms error over amplitude, and the largest deviation of the other positions.",
        columns=("law", *axes, "others"),
        rows=tuple(rows),
    )


def draw(outcomes: Mapping[str, TrackResult], options: Options) -> None:
    """Draw the motion of every tracked axis, and the loss of the tool's height with law `paper`."""
    traces = {name: run.trace for name, run in outcomes.items()}
    axes = [axis for axis in AXES if f"{axis}/cap" in traces]
    for file, group in (("3-tracking-positions", axes[:3]), ("3-tracking-rotations", axes[3:])):
        if group:
            draw_swings(traces, [a for a in group if a in axes], file, options.figures)
    draw_loss(traces, options.figures)


# --- Pictures ---

ORDER = ("paper", "paper + gravity", "cap")


def draw_swings(
    traces: Mapping[str, Trace], axes_names: Sequence[str], file: str, folder: Path
) -> None:
    """Draw for each axis the motion with its target, and the deviation of the other positions.

    Args:
        traces: Record of each run, by axis and law.
        axes_names: Names of the drawn axes, one column each.
        file: File name of the figure, without extension.
        folder: Target folder.
    """
    count = len(axes_names)
    with canvas(
        2,
        count,
        size=(WIDE, 4.6),
        sharex=True,
        sharey="row" if count > 1 else False,
        height_ratios=[1.2, 1.0],
    ) as (figure, axes):
        for column, axis in enumerate(axes_names):
            index = AXES.index(axis)
            others = [i for i in range(3) if i != index]
            scale, unit = (1e3, "mm") if index < 3 else (1.0, "rad")
            top, low = axes[:, column]
            laws = [law for law in ORDER if f"{axis}/{law}" in traces]
            for law in laws:
                trace = traces[f"{axis}/{law}"]
                step = thin(trace.t)
                t = trace.t[step]
                colour = LAW_COLOURS[law]
                top.plot(t, scale * trace.moved[step, index], color=colour, linewidth=1.4)
                deviation = np.abs(trace.error[step][:, others]).max(axis=1)
                low.plot(t, 1e3 * deviation, color=colour, linewidth=1.4)
            trace = traces[f"{axis}/{laws[0]}"]
            step = thin(trace.t)
            target = trace.moved[step, index] + trace.error[step, index]
            top.plot(trace.t[step], scale * target, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
            top.set_title(f"{axis} compliant")
            low.set_xlabel("time [s]")
            low.xaxis.set_major_locator(MultipleLocator(4.0))
            if column == 0:
                top.set_ylabel(f"along the axis [{unit}]")
                low.set_ylabel("other positions [mm]")
        axes[1, 0].set_ylim(bottom=0.0)
        entries = [("target", INK), *((law, LAW_COLOURS[law]) for law in laws)]
        names(axes[0, 0], entries, right=False, top=False)
        save(figure, folder, file)


def draw_loss(traces: Mapping[str, Trace], folder: Path) -> None:
    """Draw `3-loss-of-z`: the tool's loss of height while the target oscillates along x.

    The plots show x and z of the tool and the compliance of x with three laws, and the torque of
    the shoulder pitch with `LITERAL`.
    """
    curves = (
        ("x/literal", "paper, no step limits", RED),
        ("x/paper", "paper, step limits", ORANGE),
        ("x/cap", "cap", BLUE),
    )
    with canvas(4, 1, size=(WIDE * 0.82, 7.4), sharex=True, height_ratios=[1, 1, 0.7, 1]) as (
        figure,
        axes,
    ):
        x, z, c, torque = axes[:, 0]
        end = 0.0
        marks: list[tuple[float, str, str]] = []
        for key, name, colour in curves:
            trace = traces[key]
            step = thin(trace.t)
            t = trace.t[step]
            end = float(trace.t[-1])
            x.plot(t, trace.position[step, 0], color=colour)
            drop = 1e3 * (trace.position[step, 2] - (trace.position[0, 2]))
            z.plot(t, drop, color=colour)
            c.plot(t, trace.compliance[step, 0], color=colour)
            marks.append((float(trace.position[-1, 0]), name, colour))
        literal = traces["x/literal"]
        step = thin(literal.t)
        t = literal.t[step]
        target = literal.position[step, 0] + literal.error[step, 0]
        x.plot(t, target, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
        limit = literal.limit[step, 0]
        torque.fill_between(t, -limit, limit, color=MUTED, alpha=0.16, linewidth=0)
        torque.plot(t, literal.torque[step, 0], color=RED)
        x.set_ylabel("x [m]")
        z.set_ylabel("z, from start [mm]")
        c.set_ylabel("c of x")
        c.set_ylim(-0.05, 1.08)
        torque.set_ylabel("shoulder pitch [N·m]")
        torque.set_xlabel("time [s]")
        z.axhline(0.0, color=MUTED, linewidth=0.7)
        x.set_xlim(0.0, end)
        label_end(x, end, [*marks, (float(target[-1]), "target", INK)])
        label_end(
            torque,
            end,
            [(float(limit[-1]), "± limit", MUTED), (float(literal.torque[-1, 0]), "torque", RED)],
        )
        save(figure, folder, "3-loss-of-z")
