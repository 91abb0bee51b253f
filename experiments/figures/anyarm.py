"""Figures of the chapters that suit any arm."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MultipleLocator

from experiments.figures.activation import heat, posture, show
from experiments.figures.style import LAW_COLOURS, shade
from experiments.setups import AXES
from pliant._report.style import (
    AXIS_COLOURS,
    BLUE,
    INK,
    MUTED,
    SKY,
    WIDE,
    canvas,
    label_end,
    names,
    save,
    thin,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from experiments.chapters.anyarm import Arm
    from experiments.chapters.anyarm_runs import Promise
    from experiments.episode import Trace

    Array = NDArray[np.float64]

KINDS = (
    ("stiff 0", "all stiff", LAW_COLOURS["stiff"]),
    ("soft 0", "soft, η 0", SKY),
    ("soft 0.999", "soft, η 0.999", BLUE),
)


def activation(arm: Arm, matrix: Array, folder: Path) -> None:
    """Draw the matrix beside the posture."""
    with canvas(1, 2, size=(WIDE, 1.1 + 0.42 * matrix.shape[0]), width_ratios=[1.0, 1.75]) as (
        figure,
        axes,
    ):
        show(axes[0, 0], posture(arm.model, arm.pose, servos=arm.servos), "")
        heat(axes[0, 1], matrix, arm.model.joint_names, [*arm.axes, "null"])
        save(figure, folder, "1-activation")


def dragged(arm: Arm, traces: Mapping[str, Trace], folder: Path) -> None:
    """Draw the dragged axis, the farthest other position and the hand's force."""
    axis = AXES.index(arm.soft)
    others = [row for row in arm.rows if row < 3 and row != axis]
    with canvas(1, 3, size=(WIDE, 3.6)) as (figure, axes):
        place, away, force = axes[0]
        for kind, _, colour in KINDS:
            for sign, style in (("+1", "-"), ("-1", (0, (3.5, 2.0)))):
                trace = traces.get(f"{kind} {sign}")
                if trace is None:
                    continue
                step = thin(trace.t)
                t = trace.t[step]
                place.plot(t, -1e3 * trace.error[step, axis], color=colour, linestyle=style)
                if others:
                    far = np.abs(trace.error[step][:, others]).max(axis=1)
                    away.plot(t, 1e3 * far, color=colour, linestyle=style)
                force.plot(t, trace.force[step, axis], color=colour, linestyle=style)
        for ax in axes[0]:
            ax.margins(y=0.12)
            shade(ax, 2.0, 5.0, "hand")
            ax.set_xlabel("time [s]")
            ax.set_xlim(0.0, 9.0)
        away.set_ylim(bottom=0.0)
        place.set_ylabel(f"{arm.soft}, from its target [mm]")
        away.set_ylabel("farthest other position [mm]")
        force.set_ylabel("hand [N]")
        names(force, [(name, colour) for _, name, colour in KINDS])
        save(figure, folder, "2-dragged")


def swing(arm: Arm, trace: Trace, folder: Path) -> None:
    """Draw the axis with its target, and the other positions."""
    axis = AXES.index(arm.soft)
    step = thin(trace.t)
    t = trace.t[step]
    with canvas(2, 1, size=(WIDE * 0.8, 4.4), sharex=True, height_ratios=[1.2, 1.0]) as (
        figure,
        axes,
    ):
        top, low = axes[:, 0]
        top.plot(t, 1e3 * trace.moved[step, axis], color=BLUE)
        wanted = trace.moved[step, axis] + trace.error[step, axis]
        top.plot(t, 1e3 * wanted, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
        ends = []
        for row in arm.rows:
            if row < 3 and row != axis:
                name = AXES[row]
                low.plot(t, -1e3 * trace.error[step, row], color=AXIS_COLOURS[name])
                ends.append((-1e3 * float(trace.error[-1, row]), name, AXIS_COLOURS[name]))
        top.set_ylabel(f"{arm.soft} [mm]")
        low.set_ylabel("others, from target [mm]")
        low.set_xlabel("time [s]")
        low.xaxis.set_major_locator(MultipleLocator(4.0))
        label_end(top, float(t[-1]), [(1e3 * float(wanted[-1]), "target (dashed)", INK)])
        label_end(low, float(t[-1]), ends)
        save(figure, folder, "3-swing")


def promises(pushes: Sequence[Promise], folder: Path) -> None:
    """Draw force against promise, both in units of the cap."""
    with canvas(1, 1, size=(WIDE * 0.55, 4.8)) as (figure, axes):
        ax = axes[0, 0]
        line = np.array([0.0, 1.3])
        ax.fill_between(line, line - 0.15, line + 0.15, color=MUTED, alpha=0.12, linewidth=0)
        ax.plot(line, line, color=MUTED, linewidth=0.9, linestyle=(0, (4, 3)))
        for name in AXES:
            mine = [p for p in pushes if p.axis == name]
            if mine:
                turning = AXES.index(name) > 2
                ax.plot(
                    [p.promise / p.cap for p in mine],
                    [p.measured / p.cap for p in mine],
                    "^" if turning else "o",
                    markersize=5,
                    markerfacecolor="none" if turning else AXIS_COLOURS[name],
                    color=AXIS_COLOURS[name],
                    label=name,
                    linestyle="none",
                )
        ax.set_xlim(0.0, 1.3)
        ax.set_ylim(0.0, 1.5)
        ax.set_aspect("equal")
        ax.set_xlabel("promised / cap")
        ax.set_ylabel("felt by the hand / cap")
        ax.legend(loc="upper left", ncols=2)
        save(figure, folder, "4-promise")
