"""Chapter 5: six control methods under the same hand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

from experiments import admittance, baselines, laws
from experiments.chapters import comparison_stress as stress
from experiments.chapters.common import (
    BACK,
    RELEASE,
    Options,
    drag,
    return_speed,
    returned,
    seconds,
)
from experiments.conditions import NOMINAL
from experiments.result import Chapter, Figure, Numbers, Statement, at_least, at_most, between, mm
from experiments.runner import Job
from pliant._report.page import Table
from pliant.sim.hand import STRONG

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from experiments.hands import Dragged, Law

NUMBER = 5
TITLE = "Against other ways"


@dataclass(frozen=True)
class Way:
    """A control method and its presentation.

    Attributes:
        name: In tables and figures.
        make: Makes the law.
        family: Colour of the figures: stiff, uniform, paper, cap, impedance.
        rate: Control rate [Hz]; 1000 for the torque-controlled arm.
        delay: Ticks from sampling to reading, and from writing to the servo.
    """

    name: str
    make: Callable[[], Law]
    family: str
    rate: float = 100.0
    delay: tuple[int, int] = (0, 0)


#: Spring of the methods that return [N/m]: 15 N where the hand holds still.
SPRING = 100.0

WAYS: Mapping[str, Way] = {
    "stiff": Way("stiff position control", baselines.stiff_joints, "stiff"),
    "uniform 50": Way("all limits at 50 %", partial(baselines.uniform_limit, 0.5), "uniform"),
    "uniform 30": Way("all limits at 30 %", partial(baselines.uniform_limit, 0.3), "uniform"),
    "paper literal": Way("paper, limits only, η 0", partial(laws.limits_only, 10.0), "paper"),
    "paper 0": Way("paper, η 0", partial(laws.paper, 10.0, eta=0.0), "paper"),
    "paper 0.9": Way("paper, η 0.9", partial(laws.paper, 10.0, eta=0.9), "paper"),
    "paper 0.999": Way("paper, η 0.999", partial(laws.paper, 10.0, eta=0.999), "paper"),
    "gravity 0.999": Way("paper + gravity, η 0.999", laws.rec, "paper + gravity"),
    "cap 0": Way("cap, η 0", partial(laws.cap, eta=0.0), "cap"),
    "cap 0.9": Way("cap, η 0.9", partial(laws.cap, eta=0.9), "cap"),
    "cap 0.999": Way("cap, η 0.999", laws.cap, "cap"),
    "cap delayed": Way("cap, η 0.999, delayed", laws.cap, "cap", delay=(1, 1)),
    "springs": Way("law impedance", laws.impedance, "impedance"),
    "impedance": Way("torque impedance, 1 kHz", baselines.torque_impedance, "impedance", 1000.0),
    "impedance compensated": Way(
        "the same, friction compensated",
        partial(baselines.torque_impedance, compensated=True),
        "impedance",
        1000.0,
    ),
    "impedance spring": Way(
        "the same, 100 N/m in y",
        partial(baselines.torque_impedance, compensated=True, spring=SPRING),
        "impedance",
        1000.0,
    ),
    "admittance": Way("admittance by current", admittance.by_current, "admittance"),
    "admittance spring": Way(
        "admittance, 100 N/m in y", partial(admittance.by_current, spring=SPRING), "admittance"
    ),
}
QUICK = ("stiff", "uniform 30", "paper literal", "paper 0.999", "cap 0", "cap 0.999", "impedance")


def jobs(options: Options) -> list[Job]:
    """Return the runs of every method, pushed toward + and toward −."""
    signs = (1,) if options.quick else (1, -1)
    plain = [
        Job(
            f"{key}/{sign:+d}",
            drag,
            (WAYS[key].make, replace(STRONG, distance=sign * STRONG.distance)),
            {"conditions": replace(NOMINAL, rate=WAYS[key].rate, delay=WAYS[key].delay)},
        )
        for key in (QUICK if options.quick else WAYS)
        for sign in signs
    ]
    return plain + stress.jobs({key: WAYS[key] for key in WAYS if f"{key}/+1" in _keys(plain)})


def _keys(jobs: list[Job]) -> set[str]:
    return {job.key for job in jobs}


def measure(outcomes: Mapping[str, Dragged]) -> Numbers:
    """Return numbers by method: the worse of the two directions."""
    gathered: dict[str, list[dict[str, float | None]]] = {}
    for name, run in outcomes.items():
        key, what = name.split("/")
        if what in {"+1", "-1"}:
            gathered.setdefault(key, []).append(_one(run))
    return {
        key: {**_worse(ones), **stress.measure(key, outcomes)} for key, ones in gathered.items()
    }


def _one(run: Dragged) -> dict[str, float | None]:
    trace = run.trace
    return {
        "moved": run.moved,
        "force": run.peak,
        "held": abs(run.held),
        "drift": run.drift,
        "position": run.position,
        "rotation": run.rotation,
        "returned": returned(trace, 1),
        "left": abs(float(trace.error[-1, 1])),
        "crept": abs(float(trace.moved[-1, 1] - trace.moved[trace.at(RELEASE), 1])),
        "return_speed": return_speed(trace, 1),
    }


def _worse(ones: list[dict[str, float | None]]) -> dict[str, float | None]:
    worse: dict[str, float | None] = {}
    for name in ones[0]:
        values = [one[name] for one in ones]
        known = [value for value in values if value is not None]
        least = name == "moved"
        worse[name] = None if len(known) < len(values) else min(known) if least else max(known)
    return worse


def chapter(numbers: Numbers) -> Chapter:
    """Compare the methods."""
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
        caption="Left: the worse of both directions, logarithmic; the lower left corner is where "
        "one wants to be. Right: y over time for one of each family, pushed toward +.",
        statements=(*_statements(numbers), *stress.statements(numbers)),
    )
    ours, stiff = numbers["cap 0.999"], numbers["stiff"]
    return Chapter(
        number=NUMBER,
        title=TITLE,
        lead="What does the effort buy? The same hand meets a stiff arm, an arm with all its "
        "limits turned down, the paper's law, the default law, springs on the same servos, an arm "
        "that can command torques, and one that reads forces from its motors' currents.",
        figures=(figure,),
        tables=(_table(numbers), stress.table(numbers, {key: WAYS[key].name for key in numbers})),
        numbers=numbers,
        headline=(
            (
                "force to move it 0.15 m: stiff",
                f"{stiff['force']:.1f} N, {mm(stiff['drift'])} drift",
            ),
            ("the same: cap, η 0.999", f"{ours['force']:.1f} N, {mm(ours['drift'])} drift"),
        ),
    )


def _statements(numbers: Numbers) -> tuple[Statement, ...]:
    ours, torque, stiff = numbers["cap 0.999"], numbers["impedance"], numbers["stiff"]
    literal, uniform, firm = numbers["paper literal"], numbers["uniform 30"], numbers["cap 0"]
    paper = numbers["paper 0.999"]
    return (
        Statement(
            claim="A position-controlled arm needs no torque interface to be moved as easily as "
            "one that has it.",
            outcome=f"Law cap (η 0.999): {ours['force']:.1f} N and {mm(ours['drift'])} of drift; "
            f"torque impedance: {torque['force']:.1f} N and {mm(torque['drift'])}; stiff: "
            f"{stiff['force']:.1f} N and {mm(stiff['drift'])}.",
            tests=(
                at_most("force over torque impedance", ours["force"] / torque["force"], 1.2),
                at_most("drift", ours["drift"], 0.005, "m"),
            ),
            source="study",
        ),
        Statement(
            claim="Limits alone do not select a direction: read literally, the paper's law drags "
            "the stiff axes along about as far as simply turning all limits down does.",
            outcome=f"Drift {mm(literal['drift'])} with the paper's limits only, "
            f"{mm(uniform['drift'])} with 30 % of every limit.",
            tests=(
                at_least("drift, limits only", literal["drift"], 0.05, "m"),
                between("over uniform", literal["drift"] / uniform["drift"], 0.4, 4.0),
            ),
            source="study",
        ),
        Statement(
            claim="With strong adaptation the paper's law is soft in the chosen axis only, but "
            "gravity moves it once let go.",
            outcome=f"Paper, η 0.999: {paper['force']:.1f} N, drift {mm(paper['drift'])}; moves by "
            f"another {mm(paper['crept'])} after the release.",
            tests=(
                at_most("force", paper["force"], 9.0, "N"),
                at_most("drift", paper["drift"], 0.012, "m"),
                at_least("moves after release", paper["crept"], 0.02, "m"),
            ),
            source="study",
        ),
        Statement(
            claim="Law cap keeps its promise: with η = 0 and a cap of 15 N the hand meets 15 N, "
            "and the arm comes back.",
            outcome=f"Held with {firm['held']:.1f} N, drift {mm(firm['drift'])}; back within "
            f"{mm(BACK[0])} after {seconds(firm['returned'])}.",
            tests=(
                between("held", firm["held"], 11.5, 18.5, "N"),
                at_most("drift", firm["drift"], 0.005, "m"),
                at_most("left", firm["left"], 0.015, "m"),
            ),
            source="study",
        ),
    )


def _table(numbers: Numbers) -> Table:
    rows = [
        (
            WAYS[key].name,
            f"{one['force']:.1f} N",
            f"{one['held']:.1f} N",
            mm(one["drift"]),
            f"{1e3 * one['rotation']:.0f} mrad",
            seconds(one["returned"]),
            mm(one["left"]),
            f"{one['return_speed']:.2f} m/s",
        )
        for key, one in numbers.items()
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


def draw(outcomes: Mapping[str, Dragged], options: Options) -> None:
    """Draw force against drift, and y over time."""
    from experiments.figures import comparison

    shown = {key: WAYS[key] for key in WAYS if f"{key}/+1" in outcomes}
    numbers = measure(outcomes)
    traces = {key: outcomes[f"{key}/+1"].trace for key in shown}
    comparison.draw(numbers, traces, shown, options.figures)
