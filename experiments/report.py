"""HTML report of the demo: measurements, claims that they confirm or contradict, and figures."""

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


#: Measurements by name, as written to `results.json`: numbers, texts, lists and nested maps.
Numbers = Mapping[str, Any]

#: Source of a statement: the paper, or our own study of the package.
Source = Literal["paper", "study"]


class Verdict(StrEnum):
    """Verdict on a claim: the numbers agree, differ for a known reason, or do not agree."""

    AGREES = "agrees"
    DIFFERS = "differs because"
    DISAGREES = "does not agree"


@dataclass(frozen=True, kw_only=True)
class Check:
    """Check that a measured number lies in the interval in which a claim is confirmed.

    Attributes:
        name: Name of the number.
        value: Measured number; a non-finite number fails.
        low, high: Bounds of the interval, inclusive.
        unit: Unit of value and bounds.
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
    """Claim about the results, with the numbers of a run that confirm or contradict it.

    Attributes:
        claim: The claim in our words.
        outcome: Sentence with the numbers of the run.
        checks: Checks of the numbers; the claim is confirmed if all pass.
        source: Source of the claim.
        because: Known reason why a check may fail; shown only if one fails. "" if unknown.
    """

    claim: str
    outcome: str
    checks: tuple[Check, ...]
    source: Source = "paper"
    because: str = ""

    @property
    def verdict(self) -> Verdict:
        """Verdict from the checks; if one fails, it depends on whether the reason is known."""
        if self.checks and all(check.passed for check in self.checks):
            return Verdict.AGREES
        return Verdict.DIFFERS if self.because else Verdict.DISAGREES


#: Constructor of a statement whose source is our study.
band = partial(Statement, source="study")


@dataclass(frozen=True, kw_only=True)
class Figure:
    """Picture of the report with its texts and statements.

    Attributes:
        file: File name of the picture, without extension.
        title: Headline.
        done: Description of the experiment.
        caption: Explanation of the picture.
        paper: What the paper says about the experiment, in our words; may be empty.
        statements: Statements that the experiment confirms or contradicts.
    """

    file: str
    title: str
    done: str
    caption: str
    paper: str = ""
    statements: tuple[Statement, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """Chapter of the report: one experiment.

    Attributes:
        number: Number for the option `--only`.
        title: Headline.
        lead: Introduction of one to three sentences.
        figures, tables: Figures and tables, in the order of the report.
        numbers: All measurements, for `results.json`.
        headline: Name and value of the most important numbers, for the summary.
    """

    number: int
    title: str
    lead: str
    figures: tuple[Figure, ...]
    numbers: Numbers
    tables: tuple[Table, ...] = ()
    headline: tuple[tuple[str, str], ...] = field(default=())

    def statements(self, source: Source | None = None) -> list[Statement]:
        """Return the statements of all figures, or only those of one source."""
        all_statements = [s for figure in self.figures for s in figure.statements]
        return [s for s in all_statements if source is None or s.source == source]

    def count(self, verdict: Verdict, source: Source | None = None) -> int:
        """Return the number of statements with a verdict, of all sources or of one."""
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
    """Return a check that a number differs from a reference by at most rel·|reference| + plus.

    `name` and `unit` are those of `Check`.
    """
    width = rel * abs(reference) + plus
    return Check(name=name, value=value, low=reference - width, high=reference + width, unit=unit)


def at_most(name: str, value: float, bound: float, unit: str = "") -> Check:
    """Return a check that a number is not above a bound."""
    return Check(name=name, value=value, high=bound, unit=unit)


def at_least(name: str, value: float, bound: float, unit: str = "") -> Check:
    """Return a check that a number is not below a bound."""
    return Check(name=name, value=value, low=bound, unit=unit)


def between(name: str, value: float, low: float, high: float, unit: str = "") -> Check:
    """Return a check that a number lies within two bounds."""
    return Check(name=name, value=value, low=low, high=high, unit=unit)


def mm(length: float) -> str:
    """Return a length [m] as text in millimetres, with a suitable number of digits."""
    size = abs(1e3 * length)
    digits = 0 if size >= 9.95 else 1 if size >= 0.095 else 2
    return f"{1e3 * length:.{digits}f} mm"


# --- HTML page ---

#: CSS class of each verdict.
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
    """Write the report as one HTML file.

    Args:
        path: Path of the HTML file.
        subject: The robot.
        chapters: Chapters of the report.
        facts: Versions, commit and machine.
        figures: Folder with an SVG or a PNG file per figure.
        seconds: Duration of the runs [s].
        quick: True if only a part of the runs was made.

    Returns:
        Path of the HTML file.
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
    """Return a sentence about the sources of the statements."""
    if not _of_paper(chapters):
        return (
            "They are what we ask of the package on any arm; the paper knows none of these robots."
        )
    return (
        '<span class="source">our band</span> marks what we ask of ourselves; everything else is '
        "the paper’s, in our words."
    )


def _of_paper(chapters: Sequence[Chapter]) -> bool:
    """Return True if any statement is from the paper."""
    return any(chapter.statements("paper") for chapter in chapters)


def _summary(chapters: Sequence[Chapter]) -> str:
    """Return an HTML table with the verdict counts and key numbers of each chapter."""
    verdicts = tuple(Verdict) if _of_paper(chapters) else ()
    rows = []
    for chapter in chapters:
        counts = "".join(f'<td class="n">{chapter.count(v, "paper") or "–"}</td>' for v in verdicts)
        bands = chapter.statements("study")
        agreed = sum(s.verdict is Verdict.AGREES for s in bands)
        facts = "<br>".join(
            f"{escape(name)}: <b>{page.text(value)}</b>" for name, value in chapter.headline
        )
        rows.append(
            f'<tr><td><a href="#c{chapter.number}">{chapter.number}. {escape(chapter.title)}</a>'
            f"</td>{counts}"
            f'<td class="n">{agreed} of {len(bands)}</td><td class="facts">{facts}</td></tr>'
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
        checks = "; ".join(_check_text(check) for check in s.checks)
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


def _check_text(check: Check) -> str:
    low = f"{check.low:g} ≤ " if check.low > float("-inf") else ""
    high = f" ≤ {check.high:g}" if check.high < float("inf") else ""
    return f"{check.name}: {low}{check.value:.4g}{high} {check.unit}".strip()
