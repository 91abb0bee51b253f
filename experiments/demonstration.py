"""The whole demonstration: run, measure, judge, draw, report."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Protocol

from experiments import provenance, report
from experiments.chapters import activation, caps, comparison, doors, static, tracking
from experiments.chapters.common import Options
from experiments.program import write_results
from experiments.runner import Job, draw_off_screen, run_by_key
from pliant import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from experiments.report import Chapter, Numbers


class Experiment(Protocol):
    """A chapter: a module, or an object that knows its robot."""

    @property
    def NUMBER(self) -> int:
        """Number, as for `--only`."""

    @property
    def TITLE(self) -> str:
        """Headline."""

    def jobs(self, options: Options) -> list[Job]:
        """Return its runs."""

    def measure(self, outcomes: Mapping[str, Any]) -> Numbers:
        """Compute its numbers from the outcomes."""

    def chapter(self, numbers: Numbers) -> Chapter:
        """Judge the numbers."""

    def draw(self, outcomes: Mapping[str, Any], options: Options) -> None:
        """Draw its figures."""


#: The chapters about the paper's arm, by number.
EXPERIMENTS: Mapping[int, Experiment] = {
    module.NUMBER: module for module in (activation, static, tracking, doors, comparison, caps)
}


@dataclass(frozen=True, kw_only=True)
class Demonstration:
    """Results of a demonstration.

    Attributes:
        chapters: Judged chapters.
        report: Path of the HTML report.
        results: Path of `results.json`.
        pictures: Paths of the PNGs.
        seconds: Duration.
    """

    chapters: tuple[Chapter, ...]
    report: Path
    results: Path
    pictures: tuple[Path, ...]
    seconds: float


@dataclass(frozen=True)
class Subject:
    """The robot of a demonstration, and its experiments.

    Attributes:
        name: Of the robot.
        experiments: By number.
        about: One sentence for the head of the report.
        notes: Facts that a reader must know about the robot, e.g. that servos were guessed.
    """

    name: str
    experiments: Mapping[int, Experiment]
    about: str
    notes: tuple[str, ...] = field(default=())


#: The arm of the paper.
ARM7 = Subject(
    "arm7",
    EXPERIMENTS,
    "The experiments of “Compliant Task-Space Control with Back-Drivable Servo Actuators” "
    "(Stückler and Behnke, RoboCup 2011) on a simulated arm of seven torque-limited position "
    "servos that is built like Cosero's.",
)


def run(
    out: Path,
    *,
    subject: Subject = ARM7,
    only: Sequence[int] = (),
    quick: bool = False,
    jobs: int = 2,
    on_total: Callable[[int], None] = lambda steps: None,
    on_step: Callable[[str], None] = lambda step: None,
) -> Demonstration:
    """Run experiments and write a report.

    Args:
        out: Folder of the report; created if it does not exist.
        subject: Robot and experiments.
        only: Numbers of the experiments; empty for all.
        quick: True: the fewest runs that exercise everything once.
        jobs: Processes.
        on_total: Called with the number of steps before the first.
        on_step: Called with the name of each completed step.

    Returns:
        Paths of all results.

    Raises:
        ConfigError: An experiment number does not exist.
    """
    begin = perf_counter()
    draw_off_screen()
    chosen = choose(subject.experiments, only)
    options = Options(quick=quick, figures=out / "figures")
    options.figures.mkdir(parents=True, exist_ok=True)
    planned = {number: module.jobs(options) for number, module in chosen.items()}
    on_total(sum(len(runs) for runs in planned.values()) + len(chosen) + 1)
    every = [
        replace(job, key=f"{number}:{job.key}") for number, runs in planned.items() for job in runs
    ]
    outcomes = run_by_key(every, jobs, progress=on_step)
    own = {
        number: {job.key: outcomes[f"{number}:{job.key}"] for job in runs}
        for number, runs in planned.items()
    }
    drawing = [
        Job(f"figures of {number}", module.draw, (own[number], options))
        for number, module in chosen.items()
    ]
    run_by_key(drawing, jobs, progress=on_step)
    chapters = tuple(module.chapter(module.measure(own[n])) for n, module in chosen.items())
    facts = provenance.collect()
    results = _write_results(out, subject, chapters, facts, quick=quick)
    seconds = perf_counter() - begin
    page = report.write(
        out / "report.html", subject, chapters, facts, options.figures, seconds=seconds, quick=quick
    )
    on_step("report")
    return Demonstration(
        chapters=chapters,
        report=page,
        results=results,
        pictures=tuple(sorted(options.figures.glob("*.png"))),
        seconds=perf_counter() - begin,
    )


def choose(experiments: Mapping[int, Experiment], only: Sequence[int]) -> dict[int, Experiment]:
    """Select experiments by number, in their own order.

    Raises:
        ConfigError: A number does not exist; the message lists the known ones.
    """
    unknown = [number for number in only if number not in experiments]
    if unknown:
        there = ", ".join(f"{n} ({module.TITLE})" for n, module in experiments.items())
        raise ConfigError(f"there is no experiment {unknown[0]}; choose from {there}")
    return {n: module for n, module in experiments.items() if not only or n in only}


def _write_results(
    out: Path,
    subject: Subject,
    chapters: Sequence[Chapter],
    facts: provenance.Facts,
    *,
    quick: bool,
) -> Path:
    """Write all numbers and verdicts as JSON; equal runs give equal files."""
    content = {
        "robot": subject.name,
        "quick": quick,
        "versions": facts.versions,
        "commit": facts.commit,
        "notes": list(subject.notes),
        "experiments": {
            str(chapter.number): {
                "title": chapter.title,
                "numbers": chapter.numbers,
                "statements": [
                    {
                        "claim": s.claim,
                        "source": s.source,
                        "verdict": s.verdict.value,
                        "outcome": s.outcome,
                        "tests": [
                            {
                                "name": t.name,
                                "value": t.value,
                                "low": t.low,
                                "high": t.high,
                                "unit": t.unit,
                            }
                            for t in s.tests
                        ],
                    }
                    for s in chapter.statements()
                ],
            }
            for chapter in chapters
        },
    }
    return write_results(out, content)
