"""Figs 4 and 5: a hand pulls and lets go; an overview of both laws, and all deviations of each."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from experiments.chapters.common import RELEASE
from experiments.figures.style import LAW_COLOURS, room, shade
from experiments.setups import AXES
from pliant._report.style import (
    AXIS_COLOURS,
    INK,
    MUTED,
    WIDE,
    canvas,
    label_end,
    names,
    save,
    thin,
)

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from experiments.episode import Trace

    Array = NDArray[np.float64]

ETAS = ("0", "0.9", "0.999")
SIGNS = ("+1", "-1")
#: Time at which the hand comes [s].
GRIPPED = 2.0
#: Time between two runs drawn in a row [s].
PAUSE = 0.6


def overview(traces: Mapping[str, Trace], axis: str, folder: Path) -> None:
    """Draw the dragged axis, the farthest other position and the hand, one law over the other."""
    index = AXES.index(axis)
    turning = index > 2
    others = [i for i in range(3) if i != index]
    scale, unit = (1.0, "rad") if turning else (1e3, "mm")
    with canvas(3, 3, size=(WIDE, 6.4), sharex=True, sharey="row") as (figure, axes):
        for column, eta in enumerate(ETAS):
            for law in ("paper", "cap"):
                for sign in SIGNS:
                    trace = traces.get(f"{axis} {law} {eta} {sign}")
                    if trace is None:
                        continue
                    step = thin(trace.t)
                    line = {
                        "color": LAW_COLOURS[law],
                        "linestyle": "-" if sign == "+1" else (0, (3.5, 2.0)),
                        "linewidth": 1.6 if law == "cap" else 1.3,
                    }
                    t = trace.t[step]
                    effort = (trace.moment if turning else trace.force)[step, index % 3]
                    farthest = np.abs(trace.error[step][:, others]).max(axis=1)
                    axes[0, column].plot(t, -scale * trace.error[step, index], **line)
                    axes[1, column].plot(t, 1e3 * farthest, **line)
                    axes[2, column].plot(t, effort, **line)
            axes[0, column].set_title(f"η = {eta}")
            for row in range(3):
                shade(axes[row, column], GRIPPED, RELEASE, "hand" if row == 0 else "")
            axes[0, column].axhline(0.0, color=MUTED, linewidth=0.7)
            axes[2, column].set_xlabel("time [s]")
        axes[0, 0].set_ylabel(f"{axis}, from its target [{unit}]")
        axes[1, 0].set_ylabel("farthest other position [mm]")
        room(axes[0], 0.14)
        room(axes[1], 0.14)
        axes[1, 0].set_ylim(bottom=0.0)
        axes[2, 0].set_ylabel(f"hand [{'N·m' if turning else 'N'}]")
        names(
            axes[0, 0],
            [("paper, no gravity model", LAW_COLOURS["paper"]), ("cap", LAW_COLOURS["cap"])],
        )
        save(figure, folder, f"2-static-{axis}")


def deviations(traces: Mapping[str, Trace], axis: str, law: str, folder: Path) -> None:
    """Draw all six deviations and c of one law, the runs of both directions in a row."""
    index = AXES.index(axis)
    with canvas(
        3, 3, size=(WIDE, 6.2), sharex=True, sharey="row", height_ratios=[1.0, 1.0, 0.62]
    ) as (figure, axes):
        ends: list[float] = []
        for column, eta in enumerate(ETAS):
            start = 0.0
            for sign in SIGNS:
                trace = traces.get(f"{axis} {law} {eta} {sign}")
                if trace is None:
                    continue
                step = thin(trace.t)
                t = start + trace.t[step]
                for k, name in enumerate(AXES):
                    row, scale = (0, 1e3) if k < 3 else (1, 1.0)
                    axes[row, column].plot(
                        t, -scale * trace.error[step, k], color=AXIS_COLOURS[name]
                    )
                axes[2, column].plot(t, trace.compliance[step, index], color=INK)
                for row in range(3):
                    text = f"{'+' if sign == '+1' else '−'}{axis}" if row == 0 else ""
                    shade(axes[row, column], start + GRIPPED, start + RELEASE, text)
                start = float(t[-1]) + PAUSE
            ends.append(start - PAUSE)
            axes[0, column].set_title(f"η = {eta}", pad=14)
            axes[2, column].set_xlabel("time [s]")
            axes[2, column].set_ylim(-0.05, 1.08)
        room(axes[0], 0.14)
        axes[0, 0].set_ylabel("positions, from target [mm]")
        axes[1, 0].set_ylabel("rotations, from target [rad]")
        axes[2, 0].set_ylabel("compliance c")
        _end_names(axes, traces, axis, law, max(ends))
        save(figure, folder, f"2-static-{axis}-{law}")


def _end_names(
    axes: NDArray[np.object_], traces: Mapping[str, Trace], axis: str, law: str, end: float
) -> None:
    """Name the lines at the right edge, where the last run ends."""
    present = [s for s in SIGNS if f"{axis} {law} {ETAS[2]} {s}" in traces]
    trace = traces[f"{axis} {law} {ETAS[2]} {present[-1]}"]
    for row, group in ((0, AXES[:3]), (1, AXES[3:])):
        scale = 1e3 if row == 0 else 1.0
        ends = [
            (-scale * float(trace.error[-1, AXES.index(name)]), name, AXIS_COLOURS[name])
            for name in group
        ]
        label_end(axes[row, 2], end, ends)
