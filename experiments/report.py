"""The report of the demo: numbers, statements judged by them, figures and tables, as a page."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from html import escape
from typing import TYPE_CHECKING, Any, Literal

from pliant._report import page

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from experiments.demonstration import Subject
    from experiments.provenance import Facts
    from pliant._report.page import Table


#: Numbers, texts, lists of them and further maps by name, so that `results.json` is readable.
Numbers = Mapping[str, Any]

#: Source of a statement: the paper, or the study before the package, whose bands are our tests.
Source = Literal["paper", "study"]


class Verdict(StrEnum):
    """Verdict on a statement by the numbers of this run."""

    AGREES = "agrees"
    DIFFERS = "differs because"
    DISAGREES = "does not agree"


@dataclass(frozen=True, kw_only=True)
class Check:
    """One number and the interval in which a statement holds.

    Attributes:
        name: Name of the number.
        value: The number of this run; a non-finite number passes no test.
        low, high: The interval, bounds included.
        unit: Of all three.
    """

    name: str
    value: float
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""

    @property
    def passed(self) -> bool:
        """True if the number lies in the interval."""
        return math.isfinite(self.value) and self.low <= self.value <= self.high


@dataclass(frozen=True, kw_only=True)
class Statement:
    """A claim and the result of this run.

    Attributes:
        claim: The claim in our words.
        outcome: A sentence made from the numbers of this run.
        tests: The numbers that decide; all must pass.
        source: Source of the claim.
        because: Known reason for a failure; shown only when it fails.
    """

    claim: str
    outcome: str
    tests: tuple[Check, ...]
    source: Source = "paper"
    because: str = ""

    @property
    def verdict(self) -> Verdict:
        """Verdict, decided by the numbers alone."""
        if self.tests and all(test.passed for test in self.tests):
            return Verdict.AGREES
        return Verdict.DIFFERS if self.because else Verdict.DISAGREES


#: A statement of the study, whose bands are our tests.
band = partial(Statement, source="study")


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A picture with its explanation.

    Attributes:
        file: Stem of the picture's file.
        title: Headline.
        done: What was done.
        paper: The paper's statement about it, in our words; may be empty.
        caption: How to read the picture.
    """

    file: str
    title: str
    done: str
    caption: str
    paper: str = ""
    statements: tuple[Statement, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """One experiment in the report.

    Attributes:
        number: As in `--only`.
        title: Headline.
        lead: Its subject, in two sentences.
        figures, tables: In the order of the report.
        numbers: All measurements, for `results.json`.
        headline: The numbers for the closing table of the terminal: name and value.
    """

    number: int
    title: str
    lead: str
    figures: tuple[Figure, ...]
    numbers: Numbers
    tables: tuple[Table, ...] = ()
    headline: tuple[tuple[str, str], ...] = field(default=())

    def statements(self, source: Source | None = None) -> list[Statement]:
        """Return all statements, or those of one source."""
        found = [s for figure in self.figures for s in figure.statements]
        return [s for s in found if source is None or s.source == source]

    def count(self, verdict: Verdict, source: Source | None = None) -> int:
        """Return the number of statements with this verdict."""
        return sum(s.verdict is verdict for s in self.statements(source))


def near(
    name: str,
    value: float,
    reference: float,
    *,
    rel: float = 0.0,
    plus: float = 0.0,
    unit: str = "",
) -> Check:
    """Return a test that a number lies within ``rel |reference| + plus`` of a reference."""
    width = rel * abs(reference) + plus
    return Check(name=name, value=value, low=reference - width, high=reference + width, unit=unit)


def at_most(name: str, value: float, bound: float, unit: str = "") -> Check:
    """Return a test that a number is not above a bound."""
    return Check(name=name, value=value, high=bound, unit=unit)


def at_least(name: str, value: float, bound: float, unit: str = "") -> Check:
    """Return a test that a number is not below a bound."""
    return Check(name=name, value=value, low=bound, unit=unit)


def between(name: str, value: float, low: float, high: float, unit: str = "") -> Check:
    """Return a test that a number lies within two bounds."""
    return Check(name=name, value=value, low=low, high=high, unit=unit)


def mm(length: float) -> str:
    """Return a length [m] in millimetres, with a suitable number of digits."""
    size = abs(1e3 * length)
    digits = 0 if size >= 9.95 else 1 if size >= 0.095 else 2
    return f"{1e3 * length:.{digits}f} mm"


# --- The page ---

CHIPS = {Verdict.AGREES: "agrees", Verdict.DIFFERS: "differs", Verdict.DISAGREES: "disagrees"}


def write(
    path: Path,
    subject: Subject,
    chapters: Sequence[Chapter],
    facts: Facts,
    figures: Path,
    *,
    seconds: float,
    quick: bool = False,
) -> Path:
    """Write the report.

    Args:
        path: Of the HTML file.
        subject: The robot.
        chapters: Judged experiments.
        facts: Versions and commit.
        figures: Folder with an SVG or a PNG per figure.
        seconds: Duration of the runs.
        quick: True if runs were left out.

    Returns:
        The path.
    """
    return page.write(
        path,
        title=f"pliant: {subject.name}",
        about=subject.about,
        notes=_notes(subject, quick),
        contents=[(f"c{c.number}", f"{c.number}. {c.title}") for c in chapters],
        body="\n".join(
            [
                "<p>Each statement below is put beside the numbers of this run, and the numbers "
                "decide the verdict: <em>agrees</em>, <em>differs because</em> a known reason, or "
                f"<em>does not agree</em>. {_sources(chapters)}</p>",
                _summary(chapters),
                *(_chapter(chapter, figures) for chapter in chapters),
            ]
        ),
        footer=_footer(facts, seconds),
    )


def _notes(subject: Subject, quick: bool) -> list[str]:
    quickly = [
        "A quick run: most runs were left out, so most statements rest on one direction only."
    ]
    return [*subject.notes, *(quickly if quick else [])]


def _footer(facts: Facts, seconds: float) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in facts.versions.items())
    source = f"commit {facts.commit}" if facts.commit else "installed package"
    return (
        f"{versions}. {source}. {facts.machine}. Every run is deterministic; this one took "
        f"{seconds:.0f} s."
    )


def _sources(chapters: Sequence[Chapter]) -> str:
    """Name the sources of the statements."""
    if not _of_paper(chapters):
        return (
            "They are what we ask of the package on any arm; the paper knows none of these robots."
        )
    return (
        '<span class="source">our band</span> marks what we ask of ourselves; everything else is '
        "the paper’s, in our words."
    )


def _of_paper(chapters: Sequence[Chapter]) -> bool:
    """Return True if any statement is the paper's."""
    return any(chapter.statements("paper") for chapter in chapters)


def _summary(chapters: Sequence[Chapter]) -> str:
    """Count the verdicts of the statements per experiment, and list the key numbers."""
    verdicts = tuple(Verdict) if _of_paper(chapters) else ()
    rows = []
    for chapter in chapters:
        counts = "".join(f'<td class="n">{chapter.count(v, "paper") or "–"}</td>' for v in verdicts)
        ours = chapter.statements("study")
        kept = sum(s.verdict is Verdict.AGREES for s in ours)
        facts = "<br>".join(
            f"{escape(name)}: <b>{page.text(value)}</b>" for name, value in chapter.headline
        )
        rows.append(
            f'<tr><td><a href="#c{chapter.number}">{chapter.number}. {escape(chapter.title)}</a>'
            f"</td>{counts}"
            f'<td class="n">{kept} of {len(ours)}</td><td class="facts">{facts}</td></tr>'
        )
    paper = '<th colspan="3">the paper’s statements</th>' if verdicts else ""
    headings = "".join(f'<th class="n">{name}</th>' for name in ("agrees", "differs", "does not"))
    return (
        f'<table class="summary"><thead><tr><th rowspan="2">experiment</th>{paper}'
        '<th rowspan="2" class="n">our bands<br>kept</th>'
        '<th rowspan="2">numbers of this run</th></tr>'
        f"<tr>{headings if verdicts else ''}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table>"
    )


def _chapter(chapter: Chapter, figures: Path) -> str:
    return (
        f'<section class="chapter" id="c{chapter.number}">'
        f"<h2><span>{chapter.number}</span>{escape(chapter.title)}</h2>"
        f'<p class="lead">{page.text(chapter.lead)}</p>'
        + "".join(_figure(figure, figures) for figure in chapter.figures)
        + "".join(page.table(table) for table in chapter.tables)
        + "</section>"
    )


def _figure(figure: Figure, folder: Path) -> str:
    parts = [f"<h3>{page.text(figure.title)}</h3>"]
    parts.append(f'<p><b class="head">What was done.</b> {page.text(figure.done)}</p>')
    if figure.paper:
        parts.append(f'<p><b class="head">What the paper says.</b> {page.text(figure.paper)}</p>')
    picture = page.picture(folder, figure.file, figure.title)
    parts.append(f"<figure>{picture}<figcaption>{page.text(figure.caption)}</figcaption></figure>")
    if figure.statements:
        parts.append('<p><b class="head">What came out.</b></p>')
        parts.append(_statements(figure.statements))
    return f'<article id="{escape(figure.file)}">{"".join(parts)}</article>'


def _statements(statements: Sequence[Statement]) -> str:
    rows = []
    for s in statements:
        because = f" {page.text(s.because)}" if s.verdict is Verdict.DIFFERS else ""
        source = "" if s.source == "paper" else '<span class="source">our band</span> '
        checks = "; ".join(_test(test) for test in s.tests)
        rows.append(
            f'<tr class="{CHIPS[s.verdict]}"><td>{source}{page.text(s.claim)}</td>'
            f"<td>{page.text(s.outcome)}</td>"
            f'<td><span class="chip" title="{escape(checks)}">{s.verdict.value}</span>'
            f"{because}</td></tr>"
        )
    return (
        '<table class="statements"><thead><tr><th>statement</th><th>this run</th>'
        "<th>verdict</th></tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table>"
    )


def _test(test: Check) -> str:
    low = f"{test.low:g} ≤ " if test.low > float("-inf") else ""
    high = f" ≤ {test.high:g}" if test.high < float("inf") else ""
    return f"{test.name}: {low}{test.value:.4g}{high} {test.unit}".strip()
