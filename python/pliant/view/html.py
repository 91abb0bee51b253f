"""HTML displays of the axes, the joints and the activation matrix."""

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


#: Colours shared by texts, bars and plots.
SOFT, STIFF, FULL, TRACK = "#1c64c8", "#5b6675", "#d9480f", "rgba(130,140,155,0.18)"
#: Curves of axes and joints, in their order.
COLOURS = ("#d6336c", "#2f9e44", "#1c64c8", "#e8890c", "#7048e8", "#0b8a9a", "#5b6675", "#a61e4d")
FONT = "font:12px/1.35 system-ui,sans-serif;font-variant-numeric:tabular-nums"
#: Text and colour of each phase of the arm's life.
PHASES = {
    "starting": ("torque is coming on", "#b7791f"),
    "running": ("under control", "#2f855a"),
    "lowering": ("coming down", "#b7791f"),
    "down": ("torque is off", "#5b6675"),
}
LINEAR = ("x", "y", "z")
#: Full scales of deviation bars [mm, °], softness above which an axis counts as soft, and labels of
#: the directions in which an axis yields.
STEPS = (20.0, 50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0)
SOFT_ENOUGH = 0.01
SIDES = {"both": (-1.0, 1.0), "+": (1.0,), "-": (-1.0,)}
#: Uncertainty of a force above which it is not shown [N].
UNKNOWN = 1000.0


def status(info: SceneInfo, now: Snapshot) -> str:
    """Return a line with the arm's name and its state."""
    words, colour = PHASES[now.phase]
    return _box(
        f'<span style="display:inline-block;width:9px;height:9px;border-radius:50%;'
        f'background:{colour};margin-right:6px"></span>'
        f"<b>{escape(info.arm)}</b> · {escape(info.where)} · {words}"
    )


def health(h: LoopTiming) -> str:
    """Return a line on the loop's timing."""
    if not h.ticks:
        return _box("<span>the loop has not run yet</span>")
    late = _hint("ticks late by", "How long after its time a tick of the loop begins")
    slow = ""
    if h.speed < 0.95:
        slow = f' · <b style="color:{FULL}">slow motion, {h.speed:.0%}: a busy computer</b>'
    odd = [f"{count} {name}" for name, count in _troubles(h) if count]
    delay = "" if h.delay is None else f" · delay {1e3 * h.delay:.1f} ms"
    return _box(
        f"<b>{h.rate:g} Hz</b> · {late} {1e3 * h.p50:.2f} ms (median), {1e3 * h.p99:.2f} ms (99 %)"
        f"{delay} · {', '.join(odd) if odd else 'no tick missed'}{slow}"
    )


def _troubles(h: LoopTiming) -> tuple[tuple[str, int], ...]:
    return (
        ("missed ticks", h.missed),
        ("ticks without positions", h.stale),
        ("commands not sent", h.refused),
        ("restarts", h.restarts),
    )


def places(now: Snapshot) -> str:
    """Return the positions of the tool and its target."""
    target = "" if now.step is None else f"<br>target {_point(now.step.target)}"
    return _box(f"tool {_point(now.tool)}{target}")


def _point(pose: Array) -> str:
    x, y, z = (round(1e3 * value) for value in pose[:3, 3].tolist())
    return f"x {x}, y {y}, z {z} mm"


def ranges(
    info: SceneInfo, shown: SettingsView, step: Step, before: Mapping[str, float]
) -> dict[str, float]:
    """Return the full scale of the deviation bars [mm, °], one for all axes of a unit.

    A scale holds the largest deviation and the first threshold of every soft axis. It grows
    immediately, and shrinks only when less than a third of it is used.

    Args:
        info: The axes.
        shown: Thresholds.
        step: Deviations.
        before: The scales so far, by unit.
    """
    needed: dict[str, float] = {}
    for i, name in enumerate(info.axes):
        unit, scale = unit_of(name)
        soft = step.softness[i] > SOFT_ENOUGH
        room = max(abs(step.deviation[i]), shown.thresholds[i][0] if soft else 0.0)
        needed[unit] = max(needed.get(unit, 0.0), 1.2 * scale * float(room))
    out = {}
    for unit, most in needed.items():
        held = before.get(unit, 0.0)
        fits = held >= most and (held <= STEPS[0] or 3.0 * most > held)
        out[unit] = held if fits else next((s for s in STEPS if s >= most), STEPS[-1])
    return out


def unit_of(axis: str) -> tuple[str, float]:
    """Return the unit in which a deviation is shown, and its size in m or rad."""
    return ("mm", 1e3) if axis in LINEAR else ("°", 180.0 / np.pi)


def axes(info: SceneInfo, shown: SettingsView, step: Step, full: Mapping[str, float]) -> str:
    """Return a row per task axis: offset of the tool, push-back against its cap, compliance.

    The bars of one unit have one scale, from -full to +full; thin lines mark d- and d+. The sign is
    the tool's: pushed toward +y, it is at + from its target.
    """
    rows = []
    paper = shown.law == "paper"
    for i, name in enumerate(info.axes):
        linear = name in LINEAR
        unit, scale = unit_of(name)
        soft = step.softness[i] > SOFT_ENOUGH
        colour = SOFT if soft else STIFF
        off = -scale * float(step.deviation[i])
        signs = SIDES.get(shown.axes[name]["yields"], ()) if soft else ()
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
            f"<td>{_offset(off / full[unit], colour, [m / full[unit] for m in marks])}</td>"
            f'<td style="text-align:right;white-space:nowrap">{round(off):+d} {unit}</td>'
            f"<td>{_bar(share, FULL if share > 0.98 else colour)}</td>"
            f'<td style="text-align:right;white-space:nowrap">{push}</td>'
            f'<td style="text-align:right">{step.compliance[i] * step.softness[i]:.0%}</td>'
            "</tr>"
        )
    limits = ", ".join(f"±{value:g} {unit}" for unit, value in full.items())
    head = (
        "",
        _hint("off target", "Where the tool is from its target"),
        "",
        "push-back",
        "of its cap",
        _hint("soft", "Softness times compliance: 100 % gives way, 0 % holds"),
    )
    legend = f'<div style="opacity:0.6;font-size:11px">bars: {limits}; lines: d⁻ and d⁺</div>'
    return _table(head, rows, (32, 66, 60, 66, 80, 34)) + _box(legend)


def felt(info: SceneInfo, what: ForceEstimate) -> str:
    """Return the estimated force at the tool with its uncertainty, base axes."""
    words = []
    for i, name in enumerate(("x", "y", "z")):
        if name not in info.axes and not np.isfinite(what.bound[i]):
            continue
        if what.bound[i] > UNKNOWN:
            words.append(f"{name} ?")
            continue
        sure = abs(what.force[i]) > what.bound[i]
        number = f"{what.force[i]:+.1f} ± {what.bound[i]:.1f}"
        words.append(f'{name} <b style="color:{FULL}">{number}</b>' if sure else f"{name} {number}")
    title = _hint(
        "felt at the tool [N]", "Force on the tool, from joint positions alone, ± its bound"
    )
    return _box(f"{title}: {' · '.join(words)}")


def joints(info: SceneInfo, step: Step) -> str:
    """Return a row per joint: torque limit as a share of the usable torque."""
    rows = []
    for i, name in enumerate(info.joints):
        share = float(step.limit[i] / max(info.usable[i], 1e-9))
        note = "at a stop" if step.locked[i] else "at its ceiling" if step.saturated[i] else ""
        rows.append(
            "<tr>"
            f'<td style="white-space:nowrap;overflow:hidden;text-overflow:ellipsis;'
            f'color:{COLOURS[i % len(COLOURS)]}">{escape(name)}</td>'
            f"<td>{_bar(share, FULL if note else SOFT)}</td>"
            f'<td style="text-align:right">{share:.0%}</td>'
            f'<td style="text-align:right;white-space:nowrap">{step.limit[i]:.2f} N·m</td>'
            f'<td style="color:{FULL};white-space:nowrap">{note}</td>'
            "</tr>"
        )
    return _table(("joint", "torque limit", "", "", ""), rows, (92, 90, 36, 62, 66))


def matrix(info: SceneInfo, step: Step) -> str:
    """Return the activation matrix: share of each joint in each axis' strength."""
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
    """Return the report as a list."""
    items = "".join(f'<li style="margin:3px 0">{escape(line)}</li>' for line in lines)
    return _box(f'<ul style="margin:0;padding-left:16px">{items}</ul>')


def notice(text: str, wrong: bool) -> str:
    """Return the last error or message; empty without one."""
    if not text:
        return ""
    colour = FULL if wrong else "#2f855a"
    return _box(
        f'<div style="border-left:3px solid {colour};padding:4px 8px;background:{TRACK}">'
        f"{escape(text)}</div>"
    )


def _offset(share: float, colour: str, marks: Sequence[float] = ()) -> str:
    """Return a bar from the middle to -1 or +1, with thin lines at the marks within the scale."""
    width = 50.0 * min(abs(share), 1.0)
    left = 50.0 if share >= 0.0 else 50.0 - width
    lines = "".join(
        f'<i style="position:absolute;left:{50.0 + 50.0 * m:.1f}%;top:-2px;bottom:-2px;'
        f'width:1px;background:{"#bbb" if m == 0.0 else "#333"}"></i>'
        for m in (0.0, *marks)
        if abs(m) <= 1.0
    )
    return (
        f'<div style="position:relative;height:8px;border-radius:4px;background:{TRACK}">'
        f'<div style="position:absolute;left:{left:.1f}%;width:{width:.1f}%;height:100%;'
        f'background:{colour}"></div>{lines}</div>'
    )


def _hint(word: str, text: str) -> str:
    """Return a word with a tooltip."""
    return f'<span title="{escape(text)}" style="cursor:help">{word}</span>'


def _bar(share: float, colour: str) -> str:
    """Return a bar that is full at 1."""
    width = 100.0 * min(max(share, 0.0), 1.0)
    return (
        f'<div style="position:relative;height:8px;border-radius:4px;background:{TRACK}">'
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


def faded(content: str) -> str:
    """Return content in grey, from before torque off."""
    return f'<div style="opacity:0.35">{content}</div>'


def caption(title: str, names: Sequence[str]) -> str:
    """Return the title of a plot with the names of its curves in their colours."""
    legend = " ".join(
        f'<span style="color:{colour};white-space:nowrap">━ {escape(name)}</span>'
        for name, colour in zip(names, itertools.cycle(COLOURS), strict=False)
    )
    return _box(f'<b style="font-weight:600">{escape(title)}</b> &nbsp; {legend}')


def big_stop() -> str:
    """Return the style of the next button, the largest of the page."""
    return (
        '<i id="pliant-stop"></i><style>div:has(> #pliant-stop) + div button'
        "{height:56px;font-size:22px;font-weight:700;letter-spacing:0.12em}</style>"
    )
