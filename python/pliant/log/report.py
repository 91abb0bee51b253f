"""HTML report on a log: compliance of axes, forces, joints at limits, timing, configuration."""

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
from pliant.log import findings, pictures
from pliant.log.forces import estimate_forces

if TYPE_CHECKING:
    from pathlib import Path

    from pliant.log.findings import Span
    from pliant.log.forces import ForceEstimates
    from pliant.log.reader import Log

#: Maximum number of rows in the table of time spans in which joints were at a limit.
MAX_SPANS = 20


def report(log: Log, folder: Path, *, title: str = "a run") -> Path:
    """Write `report.html` on a log, and its figures as PNG and SVG.

    Args:
        log: The log.
        folder: Folder for the files; it is created if it does not exist.
        title: Title of the page, e.g. the name of the log.

    Returns:
        Path of `report.html`.

    Raises:
        ConfigError: The log has no ticks, or was made without a controller.
        PliantError: Matplotlib is not installed.
    """
    if not len(log):
        raise ConfigError("the log has no ticks: nothing to report")
    if not log.run["axes"]:
        raise ConfigError(
            "the log was made without a controller (hand guiding): it has no softness to report; "
            "`pliant log plot` draws its joints"
        )
    notes = _notes(log)
    forces: ForceEstimates | None = None
    try:
        forces = estimate_forces(log)
        if forces is None:
            notes.append(
                "Forces are not shown: they need exactly one step of the controller per tick."
            )
    except ConfigError as error:
        notes.append(f"Forces are not shown: {error}.")
    bounds = findings.spans(log)
    folder.mkdir(parents=True, exist_ok=True)
    pictures.softness(folder, log, forces)
    pictures.strength(folder, log, bounds)
    pictures.loop(folder, log)
    sections = (
        ("soft", "Compliance of the axes", _soft(log, forces, folder)),
        ("strength", "Joints at their limits", _strength(log, bounds, folder)),
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
    span = float(findings.elapsed_time(log)[-1])
    note = f" {log.run['note']}" if log.run["note"] else ""
    return (
        f"{log.model().name}: {len(log)} ticks in {span:.1f} s at {log.run['rate']:g} Hz, "
        f"axes {' '.join(log.run['axes'])}.{note}"
    )


def _notes(log: Log) -> list[str]:
    """Return the notes at the top of the report: damage, missing data, changed settings."""
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
        notes.append(
            "Settings were changed during the run; this page shows those at its beginning."
        )
    return notes


def _figure(folder: Path, name: str, title: str, caption: str) -> str:
    picture = page.picture(folder, name, title)
    return f"<figure>{picture}<figcaption>{page.text(caption)}</figcaption></figure>"


def _list(sentences: list[str]) -> str:
    return "<ul>" + "".join(f"<li>{page.text(sentence)}</li>" for sentence in sentences) + "</ul>"


def _soft(log: Log, forces: ForceEstimates | None, folder: Path) -> str:
    axes = log.run["axes"]
    parts = [_list([findings.sentence(log, forces, k) for k in range(len(axes))])]
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
    parts.append(page.table(_caps(log, forces)))
    if forces is not None:
        when = findings.elapsed_time(log)[forces.worst]
        parts.append(
            f'<p><b class="head">Report of the controller on the pose at {when:.2f} s</b>, in '
            "which the tool was farthest from its target:</p>"
        )
        parts.append(_list(forces.report.summary()))
    return "".join(parts)


def _caps(log: Log, forces: ForceEstimates | None) -> Table:
    """Return the table with force caps and estimated forces of all task axes."""
    rows = []
    for k, name in enumerate(log.run["axes"]):
        cap, strengths = log.axis_strength[:, k], None if forces is None else forces.strengths
        row = [
            name,
            findings.describe_setting(None if strengths is None else strengths.get(name), name),
        ]
        low, high = f"{cap.min():.3g}", f"{cap.max():.3g}"
        row += [low if low == high else f"{low} to {high}"]
        if forces is None:
            row += ["–", "–", "–"]
        else:
            tick = findings.largest_force_tick(forces, k)
            if tick is None:
                row += ["below its uncertainty"]
            else:
                force, bound = forces.force[tick, k], forces.bound[tick, k]
                row += [f"{force:+.2g} ± {bound:.2g} at {findings.elapsed_time(log)[tick]:.2f} s"]
            row += [
                f"{forces.report.axes[name].friction:.2g}",
                f"{findings.exceeded_share(log, forces, k):.1%}",
            ]
        rows.append((*row, findings.unit(name, force=True)))
    return Table(
        caption="Caps and estimated forces. The column `exceeded` is the share of ticks in which "
        "the force was above cap plus friction plus uncertainty: a rigid contact, an impact, or "
        "servos that differ from their table.",
        columns=("axis", "setting", "cap", "largest force", "friction", "exceeded", "unit"),
        rows=tuple(rows),
    )


def _strength(log: Log, bounds: list[Span], folder: Path) -> str:
    figure = _figure(
        folder,
        "strength",
        "Torque limits",
        "A joint at its ceiling has no torque left: the soft part of the motion is reduced first, "
        "then the stiff part, gravity compensation never.",
    )
    if not bounds:
        return "<p>No joint was at its torque ceiling or at a position limit.</p>" + figure
    total = float(findings.elapsed_time(log)[-1]) or 1.0
    sums: dict[tuple[str, str], float] = {}
    for span in bounds:
        key = (span.joint, span.why)
        sums[key] = sums.get(key, 0.0) + span.end - span.start
    words = {"torque": "at its torque ceiling", "position": "at a position limit"}
    sentences = [
        f"{joint} was {words[why]} for {seconds:.2f} s in all ({seconds / total:.0%})."
        for (joint, why), seconds in sorted(sums.items(), key=lambda item: -item[1])
    ]
    longest = sorted(bounds, key=lambda span: span.start - span.end)[:MAX_SPANS]
    table = Table(
        caption=f"The {len(longest)} longest of {len(bounds)} time spans.",
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
    return _list(sentences) + figure + page.table(table)


def _loop(log: Log, folder: Path) -> str:
    timing = findings.health(log)
    sentences = []
    if timing.gaps.size:
        median, p99, largest = np.percentile(timing.gaps, [50.0, 99.0, 100.0])
        sentences.append(
            f"Time from tick to tick: {1e3 * median:.2f} ms (median), {1e3 * p99:.2f} ms (99 %), "
            f"{1e3 * largest:.2f} ms (maximum); {timing.late} of {len(log)} ticks began more than "
            f"{findings.LATE_PERIODS:g} periods of {1e3 * timing.period:g} ms "
            "after the previous one."
        )
    sentences.append(
        f"Positions were {_age(*timing.lag)}; the controller assumed a delay of "
        f"{1e3 * timing.delay:.1f} ms."
    )
    for name, count in timing.old.items():
        sentences.append(
            f"{name}: positions older than {findings.LATE_PERIODS:g} periods in {count} ticks."
        )
    if timing.voltage is not None:
        sentences.append(f"Supply between {timing.voltage[0]:.1f} and {timing.voltage[1]:.1f} V.")
    if timing.temperature:
        name = max(timing.temperature, key=lambda joint: timing.temperature[joint])
        sentences.append(f"Warmest: {name}, {timing.temperature[name]:.0f} °C.")
    if timing.counters:
        counted = ", ".join(f"{name} {count}" for name, count in timing.counters.items())
        sentences.append(f"Counted by the bus: {counted}.")
    else:
        sentences.append(
            "The log has no counters of the bus: it was not closed, or is an older one."
        )
    caption = "Time from one tick to the next" + (
        "; values reported by the servos" if timing.voltage or timing.temperature else ""
    )
    return _list(sentences) + _figure(folder, "loop", "Loop and servos", f"{caption}.")


def _age(median: float, largest: float) -> str:
    """Return a phrase on the age of the positions at the beginning of a tick: median, maximum [s].

    A negative median means that the positions were sampled after the beginning of the tick.
    """
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
