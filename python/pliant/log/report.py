"""`pliant log report`: a log as one self-contained HTML page, and its pictures.

It shows the compliance of the axes, caps against estimated forces, saturated joints, loop and bus,
and the configuration.
"""

from __future__ import annotations

import json
import platform
from html import escape
from importlib.metadata import version
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError, __version__
from pliant._report import page
from pliant._report.page import Table
from pliant.log import felt as feeling
from pliant.log import findings, pictures

if TYPE_CHECKING:
    from pathlib import Path

    from pliant.log.felt import Felt
    from pliant.log.findings import Span
    from pliant.log.reader import Log

#: Spans shown in the table, the longest first.
MOST_SPANS = 20


def report(log: Log, folder: Path, *, title: str = "a run") -> Path:
    """Write `report.html` and PNG and SVG of its pictures.

    Args:
        log: The log.
        folder: Created if it does not exist.
        title: Title of the page, e.g. the name of the log.

    Returns:
        The page.

    Raises:
        ConfigError: The log has no ticks, or was made without a controller.
        PliantError: Matplotlib is missing.
    """
    if not len(log):
        raise ConfigError("the log has no ticks: nothing to report")
    if not log.run["axes"]:
        raise ConfigError(
            "the log was made without a controller (hand guiding): nothing was soft or firm; "
            "`pliant log plot` draws its joints"
        )
    notes = _notes(log)
    felt: Felt | None = None
    try:
        felt = feeling.feel(log)
        if felt is None:
            notes.append(
                "Forces are not shown: they need exactly one step of the controller per tick."
            )
    except ConfigError as error:
        notes.append(f"Forces are not shown: {error}.")
    bounds = findings.spans(log)
    folder.mkdir(parents=True, exist_ok=True)
    pictures.softness(folder, log, felt)
    pictures.strength(folder, log, bounds)
    pictures.loop(folder, log)
    sections = (
        ("soft", "Why it was soft, or not", _soft(log, felt, folder)),
        ("strength", "Where strength ended", _strength(log, bounds, folder)),
        ("loop", "Loop and servos", _loop(log, folder)),
        ("settings", "Configuration", _settings(log)),
    )
    return page.write(
        folder / "report.html",
        title=f"pliant: {title}",
        about=_about(log),
        notes=notes,
        contents=[(key, name) for key, name, _ in sections],
        body="\n".join(
            f'<section class="chapter" id="{key}"><h2>{escape(name)}</h2>{html}</section>'
            for key, name, html in sections
        ),
        footer=f"Recorded by pliant {log.run['pliant']}, reported by pliant {__version__}, "
        f"Python {platform.python_version()}, numpy {version('numpy')}, "
        f"matplotlib {version('matplotlib')}.",
    )


def _about(log: Log) -> str:
    span = float(findings.since(log)[-1])
    note = f" {log.run['note']}" if log.run["note"] else ""
    return (
        f"{log.model().name}: {len(log)} ticks in {span:.1f} s at {log.run['rate']:g} Hz, "
        f"axes {' '.join(log.run['axes'])}.{note}"
    )


def _notes(log: Log) -> list[str]:
    """Return notes for the top of the page."""
    notes = []
    if log.damage:
        notes.append(
            f"The log is damaged: {log.damage}; this page shows the data before the damage."
        )
    elif not log.whole:
        notes.append(
            "The log was not completed: program and writer died; this page shows the rest."
        )
    if log.missing:
        notes.append(f"{log.missing} calls of the controller are missing from the log.")
    if any(call.what == "update" for call in log.calls):
        notes.append("Settings were changed during the run; those shown are of the beginning.")
    return notes


def _figure(folder: Path, name: str, title: str, caption: str) -> str:
    picture = page.picture(folder, name, title)
    return f"<figure>{picture}<figcaption>{page.text(caption)}</figcaption></figure>"


def _list(sentences: list[str]) -> str:
    return "<ul>" + "".join(f"<li>{page.text(one)}</li>" for one in sentences) + "</ul>"


def _soft(log: Log, felt: Felt | None, folder: Path) -> str:
    axes = log.run["axes"]
    parts = [_list([findings.sentence(log, felt, k) for k in range(len(axes))])]
    parts.append(
        _figure(
            folder,
            "softness",
            "Deviation and force per axis",
            "Left: target minus actual; dashed, where the axis counts as soft (inner) and as firm "
            "(outer). Right: force of the surroundings on the tool, estimated from positions "
            "and commands, with its bound; the grey band is the cap in force. Friction of the "
            "gears comes on top of a cap.",
        )
    )
    parts.append(page.table(_caps(log, felt)))
    if felt is not None:
        when = findings.since(log)[felt.worst]
        parts.append(
            f'<p><b class="head">What the controller says of the pose at {when:.2f} s</b>, where '
            "the tool was farthest off:</p>"
        )
        parts.append(_list(felt.report.summary()))
    return "".join(parts)


def _caps(log: Log, felt: Felt | None) -> Table:
    """Return the table of caps and forces."""
    rows = []
    for k, name in enumerate(log.run["axes"]):
        cap, strengths = log.axis_strength[:, k], None if felt is None else felt.strengths
        row = [name, findings.asked(None if strengths is None else strengths.get(name), name)]
        low, high = f"{cap.min():.3g}", f"{cap.max():.3g}"
        row += [low if low == high else f"{low} to {high}"]
        if felt is None:
            row += ["–", "–", "–"]
        else:
            tick = findings.most_felt(felt, k)
            if tick is None:
                row += ["below its uncertainty"]
            else:
                force, bound = felt.force[tick, k], felt.bound[tick, k]
                row += [f"{force:+.2g} ± {bound:.2g} at {findings.since(log)[tick]:.2f} s"]
            row += [f"{felt.report.axes[name].friction:.2g}", f"{findings.above(log, felt, k):.1%}"]
        rows.append((*row, findings.unit(name, force=True)))
    return Table(
        caption="Caps against estimated forces. The last column is the share of ticks in which cap "
        "plus friction plus uncertainty were exceeded: a rigid contact, an impact, or servos "
        "unlike their table.",
        columns=("axis", "setting", "cap", "largest force", "friction", "above all", "unit"),
        rows=tuple(rows),
    )


def _strength(log: Log, bounds: list[Span], folder: Path) -> str:
    figure = _figure(
        folder,
        "strength",
        "Torque limits",
        "A joint at its ceiling has no torque left: the soft part of the motion gives way first, "
        "then the stiff part, gravity never.",
    )
    if not bounds:
        return "<p>No joint was at its torque ceiling or at a position limit.</p>" + figure
    total = float(findings.since(log)[-1]) or 1.0
    sums: dict[tuple[str, str], float] = {}
    for span in bounds:
        key = (span.joint, span.why)
        sums[key] = sums.get(key, 0.0) + span.end - span.start
    words = {"torque": "at its torque ceiling", "position": "at a position limit"}
    told = [
        f"{joint} was {words[why]} for {seconds:.2f} s in all ({seconds / total:.0%})."
        for (joint, why), seconds in sorted(sums.items(), key=lambda item: -item[1])
    ]
    longest = sorted(bounds, key=lambda span: span.start - span.end)[:MOST_SPANS]
    table = Table(
        caption=f"The {len(longest)} longest of {len(bounds)} stretches.",
        columns=("joint", "what", "from [s]", "for [s]", "main axis"),
        rows=tuple(
            (
                s.joint,
                words[s.why],
                f"{s.start:.2f}",
                f"{s.end - s.start:.2f}",
                s.axis or "–",
            )
            for s in longest
        ),
    )
    return _list(told) + figure + page.table(table)


def _loop(log: Log, folder: Path) -> str:
    of = findings.health(log)
    told = []
    if of.gaps.size:
        middle, high, most = np.percentile(of.gaps, [50.0, 99.0, 100.0])
        told.append(
            f"From tick to tick {1e3 * middle:.2f} ms in the median, {1e3 * high:.2f} ms for 99 %, "
            f"{1e3 * most:.2f} ms at most; {of.late} of {len(log)} came more than "
            f"{findings.LATE:g} periods of {1e3 * of.period:g} ms after the previous one."
        )
    told.append(
        f"Positions were {_age(*of.lag)}; the controller assumed a delay of "
        f"{1e3 * of.delay:.1f} ms."
    )
    for name, count in of.old.items():
        told.append(f"{name}: positions older than {findings.LATE:g} periods in {count} ticks.")
    if of.voltage is not None:
        told.append(f"Supply between {of.voltage[0]:.1f} and {of.voltage[1]:.1f} V.")
    if of.temperature:
        name = max(of.temperature, key=lambda joint: of.temperature[joint])
        told.append(f"Warmest: {name}, {of.temperature[name]:.0f} °C.")
    if of.counters:
        counted = ", ".join(f"{name} {count}" for name, count in of.counters.items())
        told.append(f"Counted by the bus: {counted}.")
    else:
        told.append("The log has no counters of the bus: it was not closed, or is an older one.")
    caption = "Time from one tick to the next" + (
        "; values reported by the servos" if of.voltage or of.temperature else ""
    )
    return _list(told) + _figure(folder, "loop", "Loop and servos", f"{caption}.")


def _age(median: float, largest: float) -> str:
    """Describe when positions were sampled, relative to the beginning of a tick."""
    if median < 0.0:
        return f"sampled {-1e3 * median:.2f} ms after a tick began (median)"
    return f"{1e3 * median:.2f} ms old when a tick began (median; at most {1e3 * largest:.2f} ms)"


def _settings(log: Log) -> str:
    texts = [("Settings", repr(log.settings)), ("Servos", repr(log.servos))]
    if log.run["config"]:
        texts.append(("Arm", json.dumps(json.loads(log.run["config"]), indent=1)))
    texts.append(("URDF", log.run["model"]["urdf"]))
    return "".join(
        f"<details><summary>{name}</summary><pre>{escape(text)}</pre></details>"
        for name, text in texts
    )
