"""HTML of the browser page: state, timing, task axes, joints, activation matrix, messages."""

from __future__ import annotations

import itertools
from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pliant._typing import Array
    from pliant.view.snapshot import (
        ForceEstimate,
        LoopTiming,
        SceneInfo,
        SettingsView,
        Snapshot,
        Step,
    )


#: Colours of soft axes, stiff axes, warnings, and the background of bars.
SOFT, STIFF, ALERT, BACKGROUND = "#1c64c8", "#5b6675", "#d9480f", "rgba(130,140,155,0.18)"
#: Colours of the curves of task axes and of joints, in the order of axes and joints.
COLOURS = ("#d6336c", "#2f9e44", "#1c64c8", "#e8890c", "#7048e8", "#0b8a9a", "#5b6675", "#a61e4d")
FONT = "font:12px/1.35 system-ui,sans-serif;font-variant-numeric:tabular-nums"
#: Text and colour of each phase of a run, and of torque that stays on after the last run.
PHASE_TEXTS = {
    "starting": ("torque is coming on", "#b7791f"),
    "running": ("under control", "#2f855a"),
    "lowering": ("coming down", "#b7791f"),
    "down": ("torque is off", "#5b6675"),
    "left on": ("torque is ON", "#d9480f"),
}
LINEAR = ("x", "y", "z")
#: Possible full scales of the bars that show deviations [mm or °].
BAR_SCALES = (20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0)
#: Softness (0 stiff, 1 soft) above which an axis is displayed as soft [1].
MIN_SOFTNESS = 0.01
#: For each value of `Axis.yields`: signs of the offsets at which thresholds are marked on a bar.
YIELD_SIGNS = {"both": (-1.0, 1.0), "+": (1.0,), "-": (-1.0,)}
#: An estimated force is shown as "?" if its uncertainty is above this value [N].
MAX_UNCERTAINTY = 1000.0


def status(info: SceneInfo, phase: str) -> str:
    """Return a line with the name of the arm, its backend and the phase (see `PHASE_TEXTS`)."""
    words, colour = PHASE_TEXTS[phase]
    return _box(
        f'<span style="display:inline-block;width:9px;height:9px;border-radius:50%;'
        f'background:{colour};margin-right:6px"></span>'
        f"<b>{escape(info.arm)}</b> · {escape(info.where)} · {words}"
    )


def health(h: LoopTiming) -> str:
    """Return a line with the timing of the control loop: rate, lateness, delay, missed ticks."""
    if not h.ticks:
        return _box("<span>the loop has not run yet</span>")
    hint = _hint("ticks late by", "How long after its time a tick of the loop begins")
    slow = ""
    if h.speed < 0.95:
        slow = (
            f' · <b style="color:{ALERT}">at {h.speed:.0%} of real time: the computer is busy</b>'
        )
    counts = {
        "missed ticks": h.missed,
        "ticks without positions": h.missing,
        "commands not sent": h.rejected,
        "restarts": h.restarts,
    }
    faults = [f"{count} {name}" for name, count in counts.items() if count]
    delay = "" if h.delay is None else f" · delay {1e3 * h.delay:.1f} ms"
    return _box(
        f"<b>{h.rate:g} Hz</b> · {hint} {1e3 * h.p50:.2f} ms (median), {1e3 * h.p99:.2f} ms (99 %)"
        f"{delay} · {', '.join(faults) if faults else 'no tick missed'}{slow}"
    )


def positions(snapshot: Snapshot) -> str:
    """Return two lines: the positions of the tool and of its target [mm]."""
    target = "" if snapshot.step is None else f"<br>target {_point(snapshot.step.target)}"
    return _box(f"tool {_point(snapshot.tool)}{target}")


def _point(pose: Array) -> str:
    x, y, z = (round(1e3 * value) for value in pose[:3, 3].tolist())
    return f"x {x}, y {y}, z {z} mm"


def ranges(
    info: SceneInfo, shown: SettingsView, step: Step, before: Mapping[str, float]
) -> dict[str, float]:
    """Return the full scale of the deviation bars by unit: mm and °.

    A scale covers the largest deviation of all axes with this unit, and the threshold `soft_until`
    of soft axes. It grows immediately, and shrinks only when less than a third of it is needed.

    Args:
        info: Description of the scene, with the names of the task axes.
        shown: Settings, with the thresholds of the axes.
        step: State of the controller, with deviations and softness of the axes.
        before: The scales used before, by unit.
    """
    needed: dict[str, float] = {}
    for i, name in enumerate(info.axes):
        unit, scale = unit_of(name)
        soft = step.softness[i] > MIN_SOFTNESS
        room = max(abs(step.deviation[i]), shown.thresholds[i][0] if soft else 0.0)
        needed[unit] = max(needed.get(unit, 0.0), 1.2 * scale * float(room))
    out = {}
    for unit, least in needed.items():
        last = before.get(unit, 0.0)
        fits = last >= least and (last <= BAR_SCALES[0] or 3.0 * least > last)
        out[unit] = last if fits else next((s for s in BAR_SCALES if s >= least), BAR_SCALES[-1])
    return out


def unit_of(axis: str) -> tuple[str, float]:
    """Return the display unit of deviations along an axis, and the factor to it from m or rad."""
    return ("mm", 1e3) if axis in LINEAR else ("°", 180.0 / np.pi)


def axes(info: SceneInfo, shown: SettingsView, step: Step, full: Mapping[str, float]) -> str:
    """Return a table with one row per task axis: offset from the target, force, softness.

    The offset is tool minus target, so it is positive after a push toward +. Offset bars range from
    -full to +full, where `full` maps a unit to its scale [mm, °]; thin lines in them mark the
    thresholds `soft_until` and `firm_from`.
    """
    rows = []
    paper = shown.law == "paper"
    for i, name in enumerate(info.axes):
        linear = name in LINEAR
        unit, scale = unit_of(name)
        soft = step.softness[i] > MIN_SOFTNESS
        colour = SOFT if soft else STIFF
        offset = -scale * float(step.deviation[i])
        signs = YIELD_SIGNS.get(shown.axes[name]["yields"], ()) if soft else ()
        marks = [sign * scale * float(d) for sign in signs for d in shown.thresholds[i]]
        force = step.wrench[i] if step.wrench.size == len(info.axes) else 0.0
        cap = step.strength[i]
        push = (
            f"{cap:.2g} N·m budget"
            if paper
            else f"{abs(force):.1f} of {cap:.3g} {'N' if linear else 'N·m'}"
        )
        share = 0.0 if paper else abs(force) / max(cap, 1e-9)
        rows.append(
            "<tr>"
            f'<td style="font-weight:600;color:{colour}">{name}</td>'
            f"<td>{_offset(offset / full[unit], colour, [m / full[unit] for m in marks])}</td>"
            f'<td style="text-align:right;white-space:nowrap">{round(offset):+d} {unit}</td>'
            f"<td>{_bar(share, ALERT if share > 0.98 else colour)}</td>"
            f'<td style="text-align:right;white-space:nowrap">{push}</td>'
            f'<td style="text-align:right">{step.compliance[i] * step.softness[i]:.0%}</td>'
            "</tr>"
        )
    limits = ", ".join(f"±{value:g} {unit}" for unit, value in full.items())
    head = (
        "",
        _hint("off target", "Position of the tool minus position of its target"),
        "",
        "push-back",
        "of its cap",
        _hint("soft", "Softness times compliance: 100 % gives way, 0 % holds"),
    )
    legend = f"bars: {limits}; lines: soft_until, firm_from"
    return _table(head, rows, (32, 66, 60, 66, 80, 34)) + _box(
        f'<div style="opacity:0.6;font-size:11px">{legend}</div>'
    )


def contact_force(info: SceneInfo, estimate: ForceEstimate) -> str:
    """Return a line with the estimated force on the tool and its uncertainty [N], base axes."""
    words = []
    for i, name in enumerate(("x", "y", "z")):
        if name not in info.axes and not np.isfinite(estimate.bound[i]):
            continue
        if estimate.bound[i] > MAX_UNCERTAINTY:
            words.append(f"{name} ?")
            continue
        is_significant = abs(estimate.force[i]) > estimate.bound[i]
        number = f"{estimate.force[i]:+.1f} ± {estimate.bound[i]:.1f}"
        words.append(
            f'{name} <b style="color:{ALERT}">{number}</b>'
            if is_significant
            else f"{name} {number}"
        )
    title = _hint("force on the tool [N]", "Estimated from joint positions alone, ± its bound")
    return _box(f"{title}: {' · '.join(words)}")


def joints(info: SceneInfo, step: Step) -> str:
    """Return a table with one row per joint: torque limit, as share of the maximum and in [N·m]."""
    rows = []
    for i, name in enumerate(info.joints):
        share = float(step.limit[i] / max(info.max_torque[i], 1e-9))
        note = "at a stop" if step.locked[i] else "at its ceiling" if step.saturated[i] else ""
        rows.append(
            "<tr>"
            f'<td style="white-space:nowrap;overflow:hidden;text-overflow:ellipsis;'
            f'color:{COLOURS[i % len(COLOURS)]}">{escape(name)}</td>'
            f"<td>{_bar(share, ALERT if note else SOFT)}</td>"
            f'<td style="text-align:right">{share:.0%}</td>'
            f'<td style="text-align:right;white-space:nowrap">{step.limit[i]:.2f} N·m</td>'
            f'<td style="color:{ALERT};white-space:nowrap">{note}</td>'
            "</tr>"
        )
    return _table(("joint", "torque limit", "", "", ""), rows, (92, 90, 36, 62, 66))


def matrix(info: SceneInfo, step: Step) -> str:
    """Return a table of the activation matrix: share of each joint in each task axis."""
    names = (*info.axes, "null")[: step.activation.shape[1]]
    rows = []
    for i, joint in enumerate(info.joints):
        cells = "".join(
            f'<td style="text-align:center;padding:2px 0;background:rgba(28,100,200,{a:.2f});'
            f'color:{"#fff" if a > 0.55 else "inherit"}">{a:.2f}</td>'
            for a in np.clip(np.abs(step.activation[i]), 0.0, 1.0)
        )
        rows.append(f'<tr><td style="white-space:nowrap">{escape(joint)}</td>{cells}</tr>')
    return _table(("", *names), rows, (92, *([36] * len(names))))


def summary(lines: Sequence[str]) -> str:
    """Return the sentences of the report on forces in the present pose as an HTML list."""
    items = "".join(f'<li style="margin:3px 0">{escape(line)}</li>' for line in lines)
    return _box(f'<ul style="margin:0;padding-left:16px">{items}</ul>')


def notice(text: str, is_error: bool) -> str:
    """Return a box with an error or a message; an empty text gives no box."""
    if not text:
        return ""
    colour = ALERT if is_error else "#2f855a"
    return _box(
        f'<div style="border-left:3px solid {colour};padding:4px 8px;background:{BACKGROUND}">'
        f"{escape(text)}</div>"
    )


def _offset(share: float, colour: str, marks: Sequence[float] = ()) -> str:
    """Return a bar from its middle to `share` (-1 to 1), with thin lines at 0 and at `marks`."""
    width = 50.0 * min(abs(share), 1.0)
    start = 50.0 if share >= 0.0 else 50.0 - width
    lines = "".join(
        f'<i style="position:absolute;left:{50.0 + 50.0 * m:.1f}%;top:-2px;bottom:-2px;'
        f'width:1px;background:{"#bbb" if m == 0.0 else "#333"}"></i>'
        for m in (0.0, *marks)
        if abs(m) <= 1.0
    )
    return (
        f'<div style="position:relative;height:8px;border-radius:4px;background:{BACKGROUND}">'
        f'<div style="position:absolute;left:{start:.1f}%;width:{width:.1f}%;height:100%;'
        f'background:{colour}"></div>{lines}</div>'
    )


def _hint(word: str, text: str) -> str:
    """Return `word` with `text` as its tooltip."""
    return f'<span title="{escape(text)}" style="cursor:help">{word}</span>'


def _bar(share: float, colour: str) -> str:
    """Return a bar filled from the left to `share` (0 to 1)."""
    width = 100.0 * min(max(share, 0.0), 1.0)
    return (
        f'<div style="position:relative;height:8px;border-radius:4px;background:{BACKGROUND}">'
        f'<div style="width:{width:.1f}%;height:100%;border-radius:4px;background:{colour}"></div>'
        "</div>"
    )


def _table(head: Sequence[str], rows: Sequence[str], widths: Sequence[int]) -> str:
    columns = "".join(f'<col style="width:{width}px">' for width in widths)
    style = "text-align:left;font-weight:500;opacity:0.6;white-space:nowrap"
    titles = "".join(f'<th style="{style}">{title}</th>' for title in head)
    return _box(
        '<table style="width:100%;border-collapse:separate;border-spacing:4px 2px;'
        f'table-layout:fixed"><colgroup>{columns}</colgroup>'
        f"<thead><tr>{titles}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
    )


def _box(content: str) -> str:
    return f'<div style="{FONT};padding:2px 10px">{content}</div>'


def dimmed(content: str) -> str:
    """Return `content` at low opacity, as a sign that it shows a past state."""
    return f'<div style="opacity:0.35">{content}</div>'


def caption(title: str, names: Sequence[str]) -> str:
    """Return the title of a plot and the names of its curves in their colours."""
    legend = " ".join(
        f'<span style="color:{colour};white-space:nowrap">━ {escape(name)}</span>'
        for name, colour in zip(names, itertools.cycle(COLOURS), strict=False)
    )
    return _box(f'<b style="font-weight:600">{escape(title)}</b> &nbsp; {legend}')


def big_stop() -> str:
    """Return an HTML style element that enlarges the button after it, which is the STOP button."""
    return (
        '<i id="pliant-stop"></i><style>div:has(> #pliant-stop) + div button'
        "{height:56px;font-size:22px;font-weight:700;letter-spacing:0.12em}</style>"
    )
