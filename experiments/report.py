"""The report of the demo: experiments, statements and verdicts as a page."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from experiments.result import Chapter, Check, Figure, Statement, Verdict
from pliant._report import page

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from experiments.demonstration import Subject
    from experiments.provenance import Facts

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
