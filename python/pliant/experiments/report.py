"""The report: one HTML file that loads nothing from anywhere."""

from __future__ import annotations

import base64
import re
from html import escape
from importlib.resources import files
from string import Template
from typing import TYPE_CHECKING

from pliant.experiments.result import Chapter, Check, Figure, Statement, Table, Verdict

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from pliant.experiments.demo import Subject
    from pliant.experiments.provenance import Facts

#: Colours of the figures that follow the page's theme, by the names of its variables.
THEMED = {
    "#1b1f24": "var(--ink)",
    "#67707b": "var(--muted)",
    "#e3e6ea": "var(--grid)",
    "#ffffff": "var(--card)",
    "#0072b2": "var(--blue)",
    "#009e73": "var(--green)",
    "#d55e00": "var(--red)",
    "#e69f00": "var(--orange)",
    "#cc79a7": "var(--purple)",
}
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
        seconds: How long the runs took.
        quick: Whether runs were left out.

    Returns:
        The path.
    """
    template = Template(
        files(__name__.rpartition(".")[0]).joinpath("report.html").read_text(encoding="utf-8")
    )
    page = template.substitute(
        title=escape(f"pliant: {subject.name}"),
        about=escape(subject.about),
        notes="".join(f'<p class="note">{_text(note)}</p>' for note in _notes(subject, quick)),
        sources=_sources(chapters),
        summary=_summary(chapters),
        contents="".join(
            f'<li><a href="#c{c.number}">{c.number}. {escape(c.title)}</a></li>' for c in chapters
        ),
        chapters="\n".join(_chapter(chapter, figures) for chapter in chapters),
        footer=escape(_footer(facts, seconds)),
    )
    path.write_text(page, encoding="utf-8")
    return path


def _text(text: str) -> str:
    """Escaped, with a proper minus before numbers."""
    return re.sub(r"(?<![\w−])-(?=\d)", "−", escape(text))


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
    """Whose the statements are."""
    if not _of_paper(chapters):
        return (
            "They are what we ask of the package on any arm; the paper knows none of these robots."
        )
    return (
        '<span class="source">our band</span> marks what we ask of ourselves; everything else is '
        "the paper’s, in our words."
    )


def _of_paper(chapters: Sequence[Chapter]) -> bool:
    """Whether any statement is the paper's."""
    return any(chapter.statements("paper") for chapter in chapters)


def _summary(chapters: Sequence[Chapter]) -> str:
    """How many statements fared how, per experiment, and the numbers to remember."""
    verdicts = tuple(Verdict) if _of_paper(chapters) else ()
    rows = []
    for chapter in chapters:
        counts = "".join(f'<td class="n">{chapter.count(v, "paper") or "–"}</td>' for v in verdicts)
        ours = chapter.statements("study")
        kept = sum(s.verdict is Verdict.AGREES for s in ours)
        facts = "<br>".join(
            f"{escape(name)}: <b>{_text(value)}</b>" for name, value in chapter.headline
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
        f'<p class="lead">{_text(chapter.lead)}</p>'
        + "".join(_figure(figure, figures) for figure in chapter.figures)
        + "".join(_table(table) for table in chapter.tables)
        + "</section>"
    )


def _figure(figure: Figure, folder: Path) -> str:
    parts = [f"<h3>{_text(figure.title)}</h3>"]
    parts.append(f'<p><b class="head">What was done.</b> {_text(figure.done)}</p>')
    if figure.paper:
        parts.append(f'<p><b class="head">What the paper says.</b> {_text(figure.paper)}</p>')
    picture = _picture(folder, figure.file, figure.title)
    parts.append(f"<figure>{picture}<figcaption>{_text(figure.caption)}</figcaption></figure>")
    if figure.statements:
        parts.append('<p><b class="head">What came out.</b></p>')
        parts.append(_statements(figure.statements))
    return f'<article id="{escape(figure.file)}">{"".join(parts)}</article>'


def _statements(statements: Sequence[Statement]) -> str:
    rows = []
    for s in statements:
        because = f" {_text(s.because)}" if s.verdict is Verdict.DIFFERS else ""
        source = "" if s.source == "paper" else '<span class="source">our band</span> '
        checks = "; ".join(_test(test) for test in s.tests)
        rows.append(
            f'<tr class="{CHIPS[s.verdict]}"><td>{source}{_text(s.claim)}</td>'
            f"<td>{_text(s.outcome)}</td>"
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


def _table(table: Table) -> str:
    numeric = [
        all(re.match(r"^[−\-–±]?\d|^stays$|^not back$|^missed$|^–$", row[k]) for row in table.rows)
        for k in range(len(table.columns))
    ]

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(
            f"<{tag}{' class=n' if numeric[k] else ''}>{_text(text)}</{tag}>"
            for k, text in enumerate(row)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in table.rows)
    return (
        f'<div class="wide"><table class="numbers"><caption>{_text(table.caption)}</caption>'
        f"<thead><tr>{cells('th', table.columns)}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _picture(folder: Path, name: str, title: str) -> str:
    """The figure itself: a themed SVG where there is one, a PNG otherwise."""
    vector = folder / f"{name}.svg"
    if vector.exists():
        return _themed(vector.read_text(encoding="utf-8"), name, title)
    data = base64.b64encode((folder / f"{name}.png").read_bytes()).decode("ascii")
    return f'<img alt="{escape(title)}" src="data:image/png;base64,{data}">'


def _themed(svg: str, name: str, title: str) -> str:
    """Make an SVG file part of the page: identifiers of its own, colours of the theme."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", body)
    # As wide as the page lets it be, yet never larger than drawn: text keeps one size.
    body = re.sub(r'(<svg[^>]*?)\swidth="([^"]*)"', r'\1 style="max-width: \2"', body, count=1)
    body = re.sub(r'(<svg[^>]*?)\sheight="[^"]*"', r"\1", body, count=1)
    body = body.replace("<svg", f'<svg role="img" aria-label="{escape(title)}"', 1)
    body = re.sub(r'\bid="', f'id="{name}-', body)
    body = re.sub(r'xlink:href="#', f'href="#{name}-', body)
    body = re.sub(r"url\(#", f"url(#{name}-", body)
    body = body.replace("xlink:href=", "href=")
    for colour, variable in THEMED.items():
        body = body.replace(colour, variable)
    return re.sub(r"\n\s*", "\n", body)
