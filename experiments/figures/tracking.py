"""Figs 6 and 7: sinusoids, and the loss of height while the arm swings in x."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import MultipleLocator

from experiments.figures.style import LAW_COLOURS
from experiments.setups import AXES
from pliant._report.style import (
    BLUE,
    INK,
    MUTED,
    ORANGE,
    RED,
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

    from experiments.episode import Trace

ORDER = ("paper", "paper + gravity", "cap")


def swings(traces: Mapping[str, Trace], axes_names: Sequence[str], file: str, folder: Path) -> None:
    """Draw the swinging axis with its target above, the farthest other position below."""
    count = len(axes_names)
    with canvas(
        2,
        count,
        size=(WIDE, 4.6),
        sharex=True,
        sharey="row" if count > 1 else False,
        height_ratios=[1.2, 1.0],
    ) as (figure, axes):
        for column, axis in enumerate(axes_names):
            index = AXES.index(axis)
            others = [i for i in range(3) if i != index]
            scale, unit = (1e3, "mm") if index < 3 else (1.0, "rad")
            top, low = axes[:, column]
            drawn = [law for law in ORDER if f"{axis}/{law}" in traces]
            for law in drawn:
                trace = traces[f"{axis}/{law}"]
                step = thin(trace.t)
                t = trace.t[step]
                colour = LAW_COLOURS[law]
                top.plot(t, scale * trace.moved[step, index], color=colour, linewidth=1.4)
                away = np.abs(trace.error[step][:, others]).max(axis=1)
                low.plot(t, 1e3 * away, color=colour, linewidth=1.4)
            trace = traces[f"{axis}/{drawn[0]}"]
            step = thin(trace.t)
            wanted = trace.moved[step, index] + trace.error[step, index]
            top.plot(trace.t[step], scale * wanted, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
            top.set_title(f"{axis} compliant")
            low.set_xlabel("time [s]")
            low.xaxis.set_major_locator(MultipleLocator(4.0))
            if column == 0:
                top.set_ylabel(f"along the axis [{unit}]")
                low.set_ylabel("other positions [mm]")
        axes[1, 0].set_ylim(bottom=0.0)
        entries = [("target", INK), *((law, LAW_COLOURS[law]) for law in drawn)]
        names(axes[0, 0], entries, right=False, top=False)
        save(figure, folder, file)


def loss(traces: Mapping[str, Trace], folder: Path) -> None:
    """Draw x, z, c and the shoulder's torque of the x swing."""
    shown = (
        ("x/literal", "paper, no step limits", RED),
        ("x/paper", "paper, step limits", ORANGE),
        ("x/cap", "cap", BLUE),
    )
    with canvas(4, 1, size=(WIDE * 0.82, 7.4), sharex=True, height_ratios=[1, 1, 0.7, 1]) as (
        figure,
        axes,
    ):
        x, z, c, torque = axes[:, 0]
        end = 0.0
        marks: list[tuple[float, str, str]] = []
        for key, name, colour in shown:
            trace = traces[key]
            step = thin(trace.t)
            t = trace.t[step]
            end = float(trace.t[-1])
            x.plot(t, trace.position[step, 0], color=colour)
            drop = 1e3 * (trace.position[step, 2] - (trace.position[0, 2]))
            z.plot(t, drop, color=colour)
            c.plot(t, trace.compliance[step, 0], color=colour)
            marks.append((float(trace.position[-1, 0]), name, colour))
        literal = traces["x/literal"]
        step = thin(literal.t)
        t = literal.t[step]
        wanted = literal.position[step, 0] + literal.error[step, 0]
        x.plot(t, wanted, color=INK, linewidth=0.9, linestyle=(0, (4, 3)))
        limit = literal.limit[step, 0]
        torque.fill_between(t, -limit, limit, color=MUTED, alpha=0.16, linewidth=0)
        torque.plot(t, literal.torque[step, 0], color=RED)
        x.set_ylabel("x [m]")
        z.set_ylabel("z, from start [mm]")
        c.set_ylabel("c of x")
        c.set_ylim(-0.05, 1.08)
        torque.set_ylabel("shoulder pitch [N·m]")
        torque.set_xlabel("time [s]")
        z.axhline(0.0, color=MUTED, linewidth=0.7)
        x.set_xlim(0.0, end)
        label_end(x, end, [*marks, (float(wanted[-1]), "target", INK)])
        label_end(
            torque,
            end,
            [(float(limit[-1]), "± limit", MUTED), (float(literal.torque[-1, 0]), "torque", RED)],
        )
        save(figure, folder, "3-loss-of-z")
