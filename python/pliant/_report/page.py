"""Self-contained HTML page of text, figures and tables, for reports of a log and of the demo."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from string import Template
from typing import TYPE_CHECKING

from pliant._files import replacing

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

#: CSS variable of the page for each colour in an SVG figure; the page replaces the colours by these
#: variables, so that figures follow its dark mode.
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


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table of text cells; the page aligns columns of numbers right.

    Attributes:
        caption: Text above the table.
        columns: Headings of the columns.
        rows: Cells of each row.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


def write(
    path: Path,
    *,
    title: str,
    about: str,
    notes: Sequence[str],
    contents: Sequence[tuple[str, str]],
    body: str,
    footer: str,
) -> Path:
    """Write an HTML page and return its path.

    Args:
        path: Path of the HTML file.
        title: Headline.
        about: Summary in a few sentences.
        notes: Notes at the top of the page, one paragraph each.
        contents: HTML identifier and title of each section, for the table of contents.
        body: HTML of the sections.
        footer: Text below the sections.
    """
    template = files(__name__.rpartition(".")[0]).joinpath("page.html").read_text(encoding="utf-8")
    page = Template(template).substitute(
        title=escape(title),
        about=text(about),
        notes="".join(f'<p class="note">{text(note)}</p>' for note in notes),
        contents="".join(f'<li><a href="#{key}">{escape(name)}</a></li>' for key, name in contents),
        body=body,
        footer=escape(footer),
    )
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def text(plain: str) -> str:
    """Return text escaped for HTML, with a typographic minus sign before numbers."""
    return re.sub(r"(?<![\w−])-(?=\d)", "−", escape(plain))


def table(content: Table) -> str:
    """Return the HTML of a table with caption; columns of numbers are aligned right."""
    # The words are the texts that experiments show in place of a missing number.
    numeric = [
        all(
            re.match(r"^[−\-–±]?\d|^stays$|^not back$|^missed$|^–$", row[k]) for row in content.rows
        )
        for k in range(len(content.columns))
    ]

    def cells(tag: str, row: Sequence[str]) -> str:
        return "".join(
            f"<{tag}{' class=n' if numeric[k] else ''}>{text(cell)}</{tag}>"
            for k, cell in enumerate(row)
        )

    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in content.rows)
    return (
        f'<div class="wide"><table class="numbers"><caption>{text(content.caption)}</caption>'
        f"<thead><tr>{cells('th', content.columns)}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def picture(folder: Path, name: str, title: str) -> str:
    """Return the HTML that embeds a figure: `<name>.svg` in `folder` if it exists, else the PNG.

    `title` is the text for screen readers.
    """
    vector = folder / f"{name}.svg"
    if vector.exists():
        return _themed(vector.read_text(encoding="utf-8"), name, title)
    data = base64.b64encode((folder / f"{name}.png").read_bytes()).decode("ascii")
    return f'<img alt="{escape(title)}" src="data:image/png;base64,{data}">'


def _themed(svg: str, name: str, title: str) -> str:
    """Return an SVG as HTML to embed, with the page's CSS variables (`THEMED`) as colours.

    The prefix `name` makes the identifiers in the SVG unique on the page.
    """
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>", "", body, flags=re.DOTALL)
    body = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", body)
    # Keep the drawn width as the maximum: an enlarged figure would have larger text than others.
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
