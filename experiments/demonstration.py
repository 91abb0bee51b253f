"""Demonstration: runs the experiments of a robot, draws the figures and writes the report."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Protocol

from experiments import provenance, report
from experiments.chapters import activation, caps, comparison, doors, static, tracking
from experiments.chapters.common import Options
from experiments.results import write_results
from experiments.runner import Job, draw_off_screen, run_by_key
from pliant import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from experiments.report import Chapter, Numbers


class Experiment(Protocol):
    """Interface of a chapter of the report; modules and objects implement it."""

    @property
    def NUMBER(self) -> int:
        """Number of the chapter, for the option `--only`."""

    @property
    def TITLE(self) -> str:
        """Headline of the chapter."""

    def jobs(self, options: Options) -> list[Job]:
        """Return the jobs that make the simulated runs of the chapter."""

    def measure(self, outcomes: Mapping[str, Any]) -> Numbers:
        """Return the numbers of the chapter, from the results of its jobs by key."""

    def chapter(self, numbers: Numbers) -> Chapter:
        """Return the chapter: its texts, and its statements with verdicts from the numbers."""

    def draw(self, outcomes: Mapping[str, Any], options: Options) -> None:
        """Draw the figures of the chapter from the results of its jobs by key."""


#: Chapters about the seven-joint arm of the paper, by number.
EXPERIMENTS: Mapping[int, Experiment] = {
    module.NUMBER: module for module in (activation, static, tracking, doors, comparison, caps)
}


@dataclass(frozen=True, kw_only=True)
class Demonstration:
    """Results of a demonstration.

    Attributes:
        chapters: Chapters of the report.
        report: Path of the HTML report.
        results: Path of `results.json`.
        pictures: Paths of the PNG files.
        seconds: Duration of the runs [s].
    """

    chapters: tuple[Chapter, ...]
    report: Path
    results: Path
    pictures: tuple[Path, ...]
    seconds: float


@dataclass(frozen=True)
class Subject:
    """Robot of a demonstration, with its experiments.

    Attributes:
        name: Name of the robot.
        experiments: Chapters by number.
        about: Sentence for the head of the report.
        notes: Notes for the reader, for example that servo parameters are estimates.
    """

    name: str
    experiments: Mapping[int, Experiment]
    about: str
    notes: tuple[str, ...] = field(default=())


#: The seven-joint arm of the paper, with the chapters `EXPERIMENTS`.
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
        quick: True makes only a few runs, which execute all code once.
        jobs: Number of processes.
        on_total: Callback with the number of steps, before the first step.
        on_step: Callback with the name of each completed step.

    Returns:
        Chapters, paths of the written files, and duration.

    Raises:
        ConfigError: An experiment number does not exist.
    """
    begin = perf_counter()
    draw_off_screen()
    experiments = choose(subject.experiments, only)
    options = Options(quick=quick, figures=out / "figures")
    options.figures.mkdir(parents=True, exist_ok=True)
    planned = {number: module.jobs(options) for number, module in experiments.items()}
    on_total(sum(len(runs) for runs in planned.values()) + len(experiments) + 1)
    all_jobs = [
        replace(job, key=f"{number}:{job.key}") for number, runs in planned.items() for job in runs
    ]
    outcomes = run_by_key(all_jobs, jobs, progress=on_step)
    chapter_outcomes = {
        number: {job.key: outcomes[f"{number}:{job.key}"] for job in runs}
        for number, runs in planned.items()
    }
    drawing = [
        Job(f"figures of {number}", module.draw, (chapter_outcomes[number], options))
        for number, module in experiments.items()
    ]
    run_by_key(drawing, jobs, progress=on_step)
    chapters = tuple(
        module.chapter(module.measure(chapter_outcomes[n])) for n, module in experiments.items()
    )
    for chapter in chapters:
        # Fail here if a measured number is not finite. `results.json` may only have infinite
        # bounds, which it contains as null.
        json.dumps(chapter.numbers, allow_nan=False)
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
    """Return the experiments with these numbers, in ascending order; all if `only` is empty.

    Raises:
        ConfigError: A number does not exist; the message lists the known ones.
    """
    unknown = [number for number in only if number not in experiments]
    if unknown:
        known = ", ".join(f"{n} ({module.TITLE})" for n, module in experiments.items())
        raise ConfigError(f"there is no experiment {unknown[0]}; choose from {known}")
    return {n: module for n, module in experiments.items() if not only or n in only}


def _write_results(
    out: Path,
    subject: Subject,
    chapters: Sequence[Chapter],
    facts: provenance.Facts,
    *,
    quick: bool,
) -> Path:
    """Write all numbers and verdicts to `results.json`; equal runs give equal files.

    Returns:
        Path of the file.
    """
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
                        "checks": [
                            {
                                "name": check.name,
                                "value": check.value,
                                "low": check.low,
                                "high": check.high,
                                "unit": check.unit,
                            }
                            for check in s.checks
                        ],
                    }
                    for s in chapter.statements()
                ],
            }
            for chapter in chapters
        },
    }
    return write_results(out, content)
