"""Command line of the demo, `make demo`: runs the experiments and writes a report with plots."""

from __future__ import annotations

import math
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from experiments.runner import draw_off_screen
from pliant import ConfigError, PliantError
from pliant._extras import missing
from pliant.cli import program
from pliant.cli._flags import File, Frame

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import ModuleType

    from experiments.demonstration import Demonstration, Subject
    from experiments.report import Chapter, Check

#: Maximum number of processes. More would not shorten the demo, which cannot be shorter than its
#: longest run.
MOST_JOBS = 16


def run(
    *,
    out: Path = Path("pliant-demo"),
    only: Annotated[str, tyro.conf.arg(metavar="1,3")] = "",
    quick: bool = False,
    robot: Literal["arm7", "so101", "koch"] = "arm7",
    urdf: File = None,
    base: Frame = None,
    tip: Frame = None,
    jobs: int = 2,
) -> None:
    """Run the experiments and write a report.

    Args:
        out: Folder for the report, the pictures and the numbers.
        only: Numbers of the experiments, separated by commas; all by default.
        quick: Make only a few runs, in a few seconds.
        robot: Built-in arm. Arms other than arm7 get experiments that suit any arm.
        urdf: URDF of another arm, instead of a built-in arm.
        base: First frame of the chain in the URDF; optional if there is only one choice.
        tip: Last frame of the chain in the URDF; optional if there is only one choice.
        jobs: Number of processes.
    """
    if not 1 <= jobs <= MOST_JOBS:
        raise ConfigError(f"--jobs must be from 1 to {MOST_JOBS}, got {jobs}")
    if urdf is None and (base or tip):
        raise ConfigError("--base and --tip belong to --urdf, which was not given")
    selected = numbers(only)
    draw_off_screen()
    demonstration = _load()
    subject = _subject(robot, urdf, base, tip)
    demonstration.choose(subject.experiments, selected)
    console = Console()
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=40),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("experiments", total=None)
        outcome = demonstration.run(
            out,
            subject=subject,
            only=selected,
            quick=quick,
            jobs=jobs,
            on_total=lambda steps: bar.update(task, total=steps),
            on_step=lambda _: bar.advance(task),
        )
    _close(console, outcome)


def numbers(text: str) -> tuple[int, ...]:
    """Return the numbers in a text such as `1,3`.

    Raises:
        ConfigError: The text is not a list of numbers.
    """
    parts = [part.strip() for part in text.split(",") if part.strip()]
    if not all(part.isdecimal() for part in parts):
        raise ConfigError(f"--only takes numbers of experiments such as 1,3; got {text!r}")
    return tuple(int(part) for part in parts)


def _load() -> ModuleType:
    """Import `experiments.demonstration`.

    Raises:
        PliantError: MuJoCo or Matplotlib is missing; the message has the install command.
    """
    try:
        for needed in ("mujoco", "matplotlib"):
            import_module(needed)
    except ImportError as error:
        raise PliantError(missing("the demo", "experiments")) from error
    from experiments import demonstration

    return demonstration


def _subject(robot: str, urdf: Path | None, base: str | None, tip: str | None) -> Subject:
    from experiments import demonstration
    from experiments.chapters import generic_arm

    if urdf is not None:
        return generic_arm.subject(generic_arm.Source(urdf=str(urdf), base=base, tip=tip))
    return (
        demonstration.ARM7
        if robot == "arm7"
        else generic_arm.subject(generic_arm.Source(name=robot))
    )


def missed(chapter: Chapter) -> list[str]:
    """Return a line of text for each statement of our study that failed in a chapter.

    The line has the number of the chapter, the statement, the failed checks and the known reason.
    """
    from experiments.report import Verdict

    lines = []
    for statement in chapter.statements("study"):
        if statement.verdict is Verdict.AGREES:
            continue
        failed = [
            f"{check.name} is {check.value:.3g}{check.unit and ' '}{check.unit}, "
            f"band {_band(check)}"
            for check in statement.checks
            if not check.passed
        ]
        why = f"; {statement.because}" if statement.because else ""
        text = "; ".join(failed) or statement.outcome
        lines.append(f"{chapter.number} not kept: {statement.claim} {text}{why}")
    return lines


def _band(check: Check) -> str:
    """Return the interval of a check as text."""
    if math.isinf(check.low):
        return f"up to {check.high:.3g}"
    if math.isinf(check.high):
        return f"from {check.low:.3g}"
    return f"{check.low:.3g} to {check.high:.3g}"


def _close(console: Console, demo: Demonstration) -> None:
    """Print a summary of the demonstration, with the path of the report at the end."""
    from experiments.report import Verdict

    paper = any(chapter.statements("paper") for chapter in demo.chapters)
    table = Table(box=SIMPLE_HEAD, pad_edge=False, title_justify="left")
    if paper:
        table.title = "The paper's statements beside this run, and our own bands"
    table.add_column("experiment")
    for heading in ("agrees", "differs", "does not") if paper else ():
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("bands kept", justify="right", no_wrap=True)
    facts = Table.grid(padding=(0, 2))
    for chapter in demo.chapters:
        counts = [str(chapter.count(v, "paper") or "–") for v in Verdict] if paper else []
        statements = chapter.statements("study")
        agreed = sum(s.verdict is Verdict.AGREES for s in statements)
        table.add_row(
            f"{chapter.number} {chapter.title}", *counts, f"{agreed} of {len(statements)}"
        )
        for name, value in chapter.headline:
            facts.add_row(f"[dim]{chapter.number}[/]", name, f"[bold]{value}[/]")
    console.print(table)
    for chapter in demo.chapters:
        for line in missed(chapter):
            console.print(line, highlight=False, markup=False, soft_wrap=True)
    console.print(facts)
    console.print(
        f"\n{len(demo.pictures)} figures, every number in {demo.results.name}, {demo.seconds:.0f} s"
    )
    # Print the path without rich, which would wrap it: a terminal cannot open a wrapped path.
    print(demo.report.resolve())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program.

    Args:
        arguments: Command-line arguments without the program's name; default: of this process.

    Returns:
        Exit code, as `pliant.cli.main`.
    """
    summary = "run the paper's experiments on the simulator and leave a report"
    return program(run, "python -m experiments.demo", summary, arguments)


if __name__ == "__main__":
    sys.exit(main())
