"""Chapter 5 of the report: control methods compared under the same hand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from string import ascii_uppercase
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.lines import Line2D

from experiments import controllers
from experiments.chapters.common import (
    LAW_COLOURS,
    RELEASE,
    RETURN_TOLERANCE,
    Options,
    drag,
    label_points,
    return_speed,
    return_time,
    seconds,
    shade,
)
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
from experiments.simulation import NOMINAL
from pliant._report.page import Table
from pliant._report.style import WIDE, canvas, label_end, save, thin
from pliant.sim.hand import DRAG_80N

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from experiments.disturbances import DragResult, Law
    from experiments.simulation import Conditions, Trace


NUMBER = 5
TITLE = "Against other ways"


@dataclass(frozen=True)
class Method:
    """Control method of the comparison, and its presentation.

    Attributes:
        name: Name in tables and figures.
        make: Factory of the control law.
        family: Family of the method, which determines its colour: a key of `LAW_COLOURS`.
        rate: Control rate [Hz]; 1000 for methods that need a torque-controlled arm.
        delay: Delays of readings and of commands [control periods].
    """

    name: str
    make: Callable[[], Law]
    family: str
    rate: float = 100.0
    delay: tuple[int, int] = (0, 0)


#: Stiffness [N/m] of the spring to the target in methods "100 N/m in y". The spring exerts 15 N
#: when the hand has moved the tool by 0.15 m.
SPRING = 100.0

METHODS: Mapping[str, Method] = {
    "stiff": Method("stiff position control", controllers.stiff_joints, "stiff"),
    "uniform 50": Method("all limits at 50 %", partial(controllers.uniform_limit, 0.5), "uniform"),
    "uniform 30": Method("all limits at 30 %", partial(controllers.uniform_limit, 0.3), "uniform"),
    "paper literal": Method(
        "paper, limits only, η 0", partial(controllers.limits_only, 10.0), "paper"
    ),
    "paper 0": Method("paper, η 0", partial(controllers.paper, 10.0, eta=0.0), "paper"),
    "paper 0.9": Method("paper, η 0.9", partial(controllers.paper, 10.0, eta=0.9), "paper"),
    "paper 0.999": Method("paper, η 0.999", partial(controllers.paper, 10.0, eta=0.999), "paper"),
    "gravity 0.999": Method("paper + gravity, η 0.999", controllers.rec, "paper + gravity"),
    "cap 0": Method("cap, η 0", partial(controllers.cap, eta=0.0), "cap"),
    "cap 0.9": Method("cap, η 0.9", partial(controllers.cap, eta=0.9), "cap"),
    "cap 0.999": Method("cap, η 0.999", controllers.cap, "cap"),
    "cap delayed": Method("cap, η 0.999, delayed", controllers.cap, "cap", delay=(1, 1)),
    "springs": Method("law impedance", controllers.impedance, "impedance"),
    "impedance": Method(
        "torque impedance, 1 kHz", controllers.torque_impedance, "impedance", 1000.0
    ),
    "impedance compensated": Method(
        "the same, friction compensated",
        partial(controllers.torque_impedance, compensated=True),
        "impedance",
        1000.0,
    ),
    "impedance spring": Method(
        "the same, 100 N/m in y",
        partial(controllers.torque_impedance, compensated=True, spring=SPRING),
        "impedance",
        1000.0,
    ),
    "admittance": Method("admittance by current", controllers.by_current, "admittance"),
    "admittance spring": Method(
        "admittance, 100 N/m in y", partial(controllers.by_current, spring=SPRING), "admittance"
    ),
}
QUICK = ("stiff", "uniform 30", "paper literal", "paper 0.999", "cap 0", "cap 0.999", "impedance")


def jobs(options: Options) -> list[Job]:
    """Return the runs: every method against a hand that drags toward +y and toward -y.

    With option `quick`, only the methods `QUICK` are run, toward +y. The runs of `stress_jobs` are
    added.
    """
    signs = (1,) if options.quick else (1, -1)
    pushes = [
        Job(
            f"{key}/{sign:+d}",
            drag,
            (METHODS[key].make, replace(DRAG_80N, distance=sign * DRAG_80N.distance)),
            {"conditions": replace(NOMINAL, rate=METHODS[key].rate, delay=METHODS[key].delay)},
        )
        for key in (QUICK if options.quick else METHODS)
        for sign in signs
    ]
    return pushes + stress_jobs(
        {key: METHODS[key] for key in METHODS if f"{key}/+1" in _keys(pushes)}
    )


def _keys(jobs: list[Job]) -> set[str]:
    return {job.key for job in jobs}


def measure(outcomes: Mapping[str, DragResult]) -> Numbers:
    """Return forces, displacements and return time by method: worse value of both directions."""
    by_method: dict[str, list[dict[str, float | None]]] = {}
    for name, run in outcomes.items():
        key, run_name = name.split("/")
        if run_name in {"+1", "-1"}:
            by_method.setdefault(key, []).append(_one(run))
    return {
        key: {**_worse(ones), **stress_measure(key, outcomes)} for key, ones in by_method.items()
    }


def _one(run: DragResult) -> dict[str, float | None]:
    trace = run.trace
    return {
        "moved": run.moved,
        "force": run.peak,
        "held": abs(run.held),
        "drift": run.drift,
        "position": run.position,
        "rotation": run.rotation,
        "returned": return_time(trace, 1),
        "left": abs(float(trace.error[-1, 1])),
        "crept": abs(float(trace.moved[-1, 1] - trace.moved[trace.at(RELEASE), 1])),
        "return_speed": return_speed(trace, 1),
    }


def _worse(ones: list[dict[str, float | None]]) -> dict[str, float | None]:
    result: dict[str, float | None] = {}
    for name in ones[0]:
        values = [entry[name] for entry in ones]
        known = [value for value in values if value is not None]
        is_minimum = name == "moved"
        result[name] = (
            None if len(known) < len(values) else min(known) if is_minimum else max(known)
        )
    return result


def chapter(numbers: Numbers) -> Chapter:
    """Return the chapter that compares the methods."""
    figure = Figure(
        file="5-comparison",
        title="Force to move it, and what the stiff axes do meanwhile",
        done="At the vertical grasp pose a strong hand (up to 80 N at the tool) moves the tool by "
        "0.15 m in y within 1.5 s, holds it, and lets go; every controller gets the same hand, in "
        "both directions. Torque impedance is an arm with torque-controlled joints at 1 kHz; "
        "admittance reads the motors' currents (1 % noise) and moves a virtual body of 1 kg; all "
        "others send goals and torque limits to the same position servos at 100 Hz; “delayed” has "
        "a tick of delay each way.",
        paper="The paper compares with no other method.",
        caption="Left: the worse of both directions, logarithmic; the lower left corner is best. "
        "Right: y over time for one method of each family, pushed toward +.",
        statements=(*_statements(numbers), *stress_statements(numbers)),
    )
    cap, stiff = numbers["cap 0.999"], numbers["stiff"]
    return Chapter(
        number=NUMBER,
        title=TITLE,
        lead="The same hand moves a stiff arm, an arm with low limits on all joints, the paper's "
        "law, the default law, springs on the same servos, an arm that can command torques, and "
        "one that estimates forces from its motors' currents.",
        figures=(figure,),
        tables=(
            _table(numbers),
            stress_table(numbers, {key: METHODS[key].name for key in numbers}),
        ),
        numbers=numbers,
        headline=(
            (
                "force to move it 0.15 m: stiff",
                f"{stiff['force']:.1f} N, {mm(stiff['drift'])} drift",
            ),
            ("the same: cap, η 0.999", f"{cap['force']:.1f} N, {mm(cap['drift'])} drift"),
        ),
    )


def _statements(numbers: Numbers) -> tuple[Statement, ...]:
    cap, torque, stiff = numbers["cap 0.999"], numbers["impedance"], numbers["stiff"]
    literal, uniform, firm = numbers["paper literal"], numbers["uniform 30"], numbers["cap 0"]
    paper = numbers["paper 0.999"]
    return (
        band(
            claim="A position-controlled arm needs no torque interface to be moved as easily as "
            "one that has it.",
            outcome=f"Law cap (η 0.999): {cap['force']:.1f} N and {mm(cap['drift'])} of drift; "
            f"torque impedance: {torque['force']:.1f} N and {mm(torque['drift'])}; stiff: "
            f"{stiff['force']:.1f} N and {mm(stiff['drift'])}.",
            checks=(
                at_most("force over torque impedance", cap["force"] / torque["force"], 1.2),
                at_most("drift", cap["drift"], 0.005, "m"),
            ),
        ),
        band(
            claim="Limits alone do not select a direction: read literally, the paper's law drags "
            "the stiff axes along about as far as simply turning all limits down does.",
            outcome=f"Drift {mm(literal['drift'])} with the paper's limits only, "
            f"{mm(uniform['drift'])} with 30 % of every limit.",
            checks=(
                at_least("drift, limits only", literal["drift"], 0.05, "m"),
                between("over uniform", literal["drift"] / uniform["drift"], 0.4, 4.0),
            ),
        ),
        band(
            claim="With strong adaptation the paper's law is soft in the chosen axis only, but "
            "gravity moves it once let go.",
            outcome=f"Paper, η 0.999: {paper['force']:.1f} N, drift {mm(paper['drift'])}; moves by "
            f"another {mm(paper['crept'])} after the release.",
            checks=(
                at_most("force", paper["force"], 9.0, "N"),
                at_most("drift", paper["drift"], 0.012, "m"),
                at_least("moves after release", paper["crept"], 0.02, "m"),
            ),
        ),
        band(
            claim="Law cap keeps its promise: with η = 0 and a cap of 15 N the hand meets 15 N, "
            "and the arm comes back.",
            outcome=f"Held with {firm['held']:.1f} N, drift {mm(firm['drift'])}; back within "
            f"{mm(RETURN_TOLERANCE[0])} after {seconds(firm['returned'])}.",
            checks=(
                between("held", firm["held"], 11.5, 18.5, "N"),
                at_most("drift", firm["drift"], 0.005, "m"),
                at_most("left", firm["left"], 0.015, "m"),
            ),
        ),
    )


def _table(numbers: Numbers) -> Table:
    rows = [
        (
            METHODS[key].name,
            f"{figures['force']:.1f} N",
            f"{figures['held']:.1f} N",
            mm(figures["drift"]),
            f"{1e3 * figures['rotation']:.0f} mrad",
            seconds(figures["returned"]),
            mm(figures["left"]),
            f"{figures['return_speed']:.2f} m/s",
        )
        for key, figures in numbers.items()
    ]
    return Table(
        caption="A strong hand moves the tool by 0.15 m in y; the worse of both directions. Force: "
        "largest of any physics step; held: mean while it holds still; drift: of x and z since the "
        "hand came; returned: until y stays below 15 mm.",
        columns=(
            "way",
            "force",
            "held",
            "drift x, z",
            "rotations",
            "returned",
            "left",
            "return speed",
        ),
        rows=tuple(rows),
    )


def draw(outcomes: Mapping[str, DragResult], options: Options) -> None:
    """Draw `5-comparison`: force against drift of each method, and y over time of some."""
    methods = {key: METHODS[key] for key in METHODS if f"{key}/+1" in outcomes}
    numbers = measure(outcomes)
    traces = {key: outcomes[f"{key}/+1"].trace for key in methods}
    draw_comparison(numbers, traces, methods, options.figures)


# --- The same hand with a stalled host, and with wrong assumptions about friction ---

#: Start and end of the time in which the host neither reads nor writes, while the hand moves [s].
STALL = (2.6, 3.6)
#: Ratios of true to assumed friction and damping: higher than assumed, and lower.
HIGH_FRICTION, LOW_FRICTION = 1.0 / 0.7, 1.0 / 1.3
#: Keys of the methods that run with a stalled host and with wrong friction, one of each kind.
STRESS_METHODS = (
    "stiff",
    "uniform 30",
    "paper 0.999",
    "cap 0.999",
    "springs",
    "impedance",
    "impedance compensated",
    "admittance",
)


def stress_jobs(methods: Mapping[str, Method]) -> list[Job]:
    """Return three runs for each method of `STRESS_METHODS` that is in `methods`.

    The host stalls in the first run. The true friction is higher than assumed in the second, and
    lower in the third.
    """
    out = []
    for key in STRESS_METHODS:
        if key not in methods:
            continue
        nominal = replace(NOMINAL, rate=methods[key].rate)
        for stress, conditions in _stresses(nominal).items():
            out.append(
                Job(
                    f"{key}/{stress}",
                    drag,
                    (methods[key].make, DRAG_80N),
                    {"conditions": conditions},
                )
            )
    return out


def _stresses(nominal: Conditions) -> dict[str, Conditions]:
    return {
        "stall": nominal.with_plant(bus_outage=STALL),
        "tight": nominal.with_plant(friction_scale=HIGH_FRICTION, damping_scale=HIGH_FRICTION),
        "loose": nominal.with_plant(friction_scale=LOW_FRICTION, damping_scale=LOW_FRICTION),
    }


def stress_measure(key: str, outcomes: Mapping[str, DragResult]) -> dict[str, float | None]:
    """Return the numbers of one method in the runs of `stress_jobs`; empty if it has none."""
    if f"{key}/stall" not in outcomes:
        return {}
    stall, high, low = (outcomes[f"{key}/{stress}"] for stress in ("stall", "tight", "loose"))
    after = stall.trace.t > STALL[0]
    return {
        "stall_force": stall.peak,
        "stall_drift": stall.drift,
        "stall_speed": float(np.abs(stall.trace.dq[after]).max()),
        "tight_force": high.peak,
        "tight_drift": high.drift,
        "loose_force": low.peak,
        "loose_walks": low.stays,
    }


def stress_table(numbers: Numbers, names: Mapping[str, str]) -> Table:
    """Return the table of the methods that have runs of `stress_jobs`."""
    rows = [
        (
            names[key],
            f"{figures['stall_force']:.1f} N",
            mm(figures["stall_drift"]),
            f"{figures['stall_speed']:.1f} rad/s",
            f"{figures['tight_force']:.1f} N",
            mm(figures["tight_drift"]),
            f"{figures['loose_force']:.1f} N",
            mm(figures["loose_walks"]),
        )
        for key, figures in numbers.items()
        if "stall_force" in figures
    ]
    return Table(
        caption="The same hand toward +y. Stall: from 2.6 to 3.6 s, in the middle of its way, the "
        "host sends nothing and reads nothing; largest force, drift of x and z, largest joint "
        "speed from then on. Tight, loose: friction and damping of the gears are 1.43 and 0.77 "
        "times what the controllers believe; walks: how far y still goes after the release.",
        columns=(
            "way",
            "stall: force",
            "drift",
            "speed",
            "tight: force",
            "drift",
            "loose: force",
            "walks",
        ),
        rows=tuple(rows),
    )


def stress_statements(numbers: Numbers) -> tuple[Statement, ...]:
    """Return the statements about the runs of `stress_jobs`; empty if a needed run is missing."""
    keys = ("cap 0.999", "admittance", "stiff", "impedance")
    if not all("stall_force" in numbers.get(key, {}) for key in keys):
        return ()
    cap, current, stiff, torque = (numbers[key] for key in keys)
    return (
        band(
            claim="While the host stalls for a second, the limits of the last tick still bound the "
            "force; a method that is soft by goals alone is stiff then, and its arm jumps when the "
            "host returns.",
            outcome=f"Largest force and joint speed: cap {cap['stall_force']:.1f} N, "
            f"{cap['stall_speed']:.1f} rad/s; admittance {current['stall_force']:.1f} N, "
            f"{current['stall_speed']:.1f} rad/s; stiff {stiff['stall_force']:.1f} N; torque "
            f"impedance {torque['stall_force']:.1f} N.",
            checks=(
                at_most("cap over admittance", cap["stall_force"] / current["stall_force"], 0.8),
                at_most("speed, cap over stiff", cap["stall_speed"] / stiff["stall_speed"], 0.5),
            ),
        ),
        band(
            claim="Gears with more friction than assumed increase the force of every method; the "
            "stiff axes stay in place.",
            outcome=f"Tight gears: cap {cap['tight_force']:.1f} N, {mm(cap['tight_drift'])}; "
            f"admittance {current['tight_force']:.1f} N, {mm(current['tight_drift'])}; torque "
            f"impedance {torque['tight_force']:.1f} N, {mm(torque['tight_drift'])}.",
            checks=(
                at_least("more force", cap["tight_force"] / cap["force"], 1.0),
                at_most("drift", cap["tight_drift"], 0.005, "m"),
            ),
        ),
    )


# --- Pictures of the comparison ---

#: Keys of the methods whose motion is drawn over time, one of each family.
OVER_TIME = ("stiff", "uniform 30", "paper 0.999", "cap 0", "cap 0.999", "impedance")


def draw_comparison(
    numbers: Numbers, traces: Mapping[str, Trace], methods: Mapping[str, Method], folder: Path
) -> None:
    """Draw `5-comparison`: force to move the arm against drift of the stiff positions, y over time.

    Args:
        numbers: Numbers of each method, from `measure`.
        traces: Record of each method against the hand that drags toward +y.
        methods: Methods by key.
        folder: Target folder.
    """
    with canvas(1, 2, size=(WIDE, 5.6), width_ratios=[1.15, 1.0]) as (figure, axes):
        ax, right_axes = axes[0]
        names: list[tuple[float, float, str, str]] = []
        key_of_letters = []
        for letter, (key, method) in zip(ascii_uppercase, methods.items(), strict=False):
            force, drift = numbers[key]["force"], 1e3 * numbers[key]["drift"]
            does_not_return = numbers[key]["returned"] is None
            colour = LAW_COLOURS[method.family]
            ax.plot(
                force,
                drift,
                "o",
                markersize=8,
                markeredgewidth=1.6,
                color=colour,
                markerfacecolor="none" if does_not_return else colour,
            )
            names.append((force, drift, letter, colour))
            key_of_letters.append(Line2D([], [], linestyle="", label=f"{letter}  {method.name}"))
        ax.set_xscale("log")
        ax.set_yscale("log")
        ax.set_xlim(2.0, 110.0)
        ax.set_ylim(0.6, 300.0)
        ax.set_xticks([3, 5, 10, 20, 50, 100], ["3", "5", "10", "20", "50", "100"])
        ax.set_yticks([1, 3, 10, 30, 100], ["1", "3", "10", "30", "100"])
        ax.minorticks_off()
        ax.set_xlabel("force to move it by 0.15 m [N]")
        ax.set_ylabel("drift of the stiff positions [mm]")
        ax.set_title("filled: comes back; open: does not")
        marks = []
        for key in OVER_TIME:
            if key in traces:
                trace, colour = traces[key], LAW_COLOURS[methods[key].family]
                step = thin(trace.t)
                dashed = key == "cap 0"
                right_axes.plot(
                    trace.t[step],
                    -1e3 * trace.error[step, 1],
                    color=colour,
                    linestyle=(0, (4, 2)) if dashed else "-",
                )
                marks.append((-1e3 * float(trace.error[-1, 1]), methods[key].name, colour))
        right_axes.set_ylim(-40.0, 260.0)
        shade(right_axes, 2.0, 5.0, "hand")
        right_axes.set_xlim(0.0, 9.0)
        right_axes.set_xlabel("time [s]")
        right_axes.set_ylabel("y, from its target [mm]")
        right_axes.set_title("pulled toward +y, let go at 5 s")
        label_end(right_axes, 9.0, marks, size=7.5)
        label_points(ax, sorted(names, key=lambda name: -name[1]), size=8.5)
        figure.legend(
            handles=key_of_letters,
            loc="outside lower left",
            ncols=4,
            handlelength=0.0,
            labelcolor=[LAW_COLOURS[method.family] for method in methods.values()],
        )
        save(figure, folder, "5-comparison")
