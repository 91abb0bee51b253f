"""Figures of the report on a log (extra `plot`): compliance, torque limits, loop and servos."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from pliant._report import style
from pliant.log.findings import Span, elapsed_time, health, unit

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes

    from pliant._typing import Array
    from pliant.log.forces import ForceEstimates
    from pliant.log.reader import Log


#: Height of a row of plots [inch].
ROW_HEIGHT = 1.45
#: Colours of the joints' curves, from base to tip; after the last colour they start again.
COLOURS = (style.BLUE, style.ORANGE, style.GREEN, style.RED, style.PURPLE, style.SKY, style.MUTED)
#: Minimum plotted range of deviations and forces, by unit, so that noise at rest does not fill it.
MIN_RANGE = {"mm": 2.0, "mrad": 8.0, "N": 2.0, "N·m": 0.4}


def softness(folder: Path, log: Log, forces: ForceEstimates | None) -> None:
    """Write the figure `softness` to `folder`: deviation and estimated force of each task axis.

    It also shows the thresholds of the deviation and the cap of the force.
    """
    axes, time = log.run["axes"], elapsed_time(log)
    thinned = style.thin(time, rate=50.0)
    with style.canvas(len(axes), 2, size=(style.WIDE, ROW_HEIGHT * len(axes)), sharex=True) as (
        figure,
        grid,
    ):
        for k, name in enumerate(axes):
            left, right = grid[k]
            _deviation(left, name, time[thinned], 1e3 * log.deviation[thinned, k])
            if forces is not None and log.softness[:, k].max() > 0.0:
                for side in forces.report.axes[name].thresholds:
                    for threshold in (-1e3 * side, 1e3 * side):
                        left.axhline(
                            threshold, color=style.MUTED, linewidth=0.8, linestyle=(0, (4, 3))
                        )
            cap, newton = log.axis_strength[thinned, k], unit(name, force=True)
            right.fill_between(time[thinned], -cap, cap, color=style.MUTED, alpha=0.15, linewidth=0)
            largest = float(cap.max())
            if forces is not None:
                force, bound = forces.force[thinned, k], forces.bound[thinned, k]
                colour = style.AXIS_COLOURS[name]
                right.plot(time[thinned], force, color=colour)
                known = np.isfinite(bound)
                right.fill_between(
                    time[thinned][known], (force - bound)[known], (force + bound)[known],
                    color=colour, alpha=0.15, linewidth=0,
                )  # fmt: skip
                largest = max(largest, float(np.abs(force).max()))
            right.set_ylim(
                -1.15 * max(largest, MIN_RANGE[newton]), 1.15 * max(largest, MIN_RANGE[newton])
            )
            right.set_ylabel(f"{name} [{newton}]")
        grid[0, 0].set_title("deviation, with the thresholds of its strength")
        grid[0, 1].set_title("force felt with its bound, in the band of the cap")
        for ax in grid[-1]:
            ax.set_xlabel("time [s]")
            ax.set_xlim(0.0, time[-1])
        style.save(figure, folder, "softness")


def _deviation(ax: Axes, name: str, time: Array, deviation: Array) -> None:
    ax.plot(time, deviation, color=style.AXIS_COLOURS[name])
    largest = 1.15 * max(float(np.abs(deviation).max()), MIN_RANGE[unit(name)])
    ax.set_ylim(-largest, largest)
    ax.set_ylabel(f"{name} [{unit(name)}]")


def strength(folder: Path, log: Log, bounds: list[Span]) -> None:
    """Write the figure `strength` to `folder`: torque limits over time, and spans at a limit.

    Torque limits are plotted as shares of the maximum torque; `bounds` are the spans.
    """
    joints, time = log.run["joints"], elapsed_time(log)
    thinned = style.thin(time)
    usable = np.asarray(log.servos.max_torque) if log.servos is not None else np.nan
    share = 100.0 * log.torque_limit / usable
    ratios = {"height_ratios": (3.0, max(0.22 * len(joints), 1.0))}
    size = (style.WIDE, 3.4 + 0.22 * len(joints))
    with style.canvas(2, 1, size=size, sharex=True, gridspec_kw=ratios) as (figure, grid):
        top, bottom = grid[:, 0]
        for j in range(len(joints)):
            top.plot(time[thinned], share[thinned, j], color=COLOURS[j % len(COLOURS)])
        top.set_ylim(0.0, 105.0)
        top.set_xlim(0.0, time[-1])
        top.set_ylabel("torque limit [% of usable]")
        ends = [
            (float(share[-1, j]), name, COLOURS[j % len(COLOURS)]) for j, name in enumerate(joints)
        ]
        style.label_end(top, float(time[-1]), ends)
        for span in bounds:
            colour = style.RED if span.why == "torque" else style.PURPLE
            bar = [(span.start, max(span.end - span.start, 0.004 * float(time[-1])))]
            bottom.broken_barh(bar, (joints.index(span.joint) - 0.35, 0.7), color=colour)
        bottom.set_yticks(range(len(joints)), joints)
        bottom.set_ylim(len(joints) - 0.5, -0.5)
        bottom.set_xlabel("time [s]")
        bottom.set_title("at the torque ceiling (red), at a position limit (purple)")
        style.save(figure, folder, "strength")


def loop(folder: Path, log: Log) -> None:
    """Write the figure `loop` to `folder`: time between ticks, and voltage and temperature.

    Voltage or temperature is left out if no servo reports it.
    """
    time, timing = elapsed_time(log), health(log)
    reported: list[tuple[str, Array, Any]] = [
        (label, values, log.run["joints"])
        for label, values in (
            ("supply [V]", log.voltage),
            ("temperature [°C]", log.temperature),
        )
        if np.isfinite(values).any()
    ]
    size = (style.WIDE, 1.8 * (1 + len(reported)) + 0.3)
    with style.canvas(1 + len(reported), 1, size=size, sharex=True) as (figure, grid):
        ax = grid[0, 0]
        ax.plot(time[1:], 1e3 * timing.gaps, color=style.BLUE, linewidth=0.8)
        style.level(ax, 1e3 * timing.period, "as asked")
        ax.set_ylim(
            0.0, max(2.0 * 1e3 * timing.period, 1.1e3 * float(timing.gaps.max(initial=0.0)))
        )
        ax.set_ylabel("tick to tick [ms]")
        ax.set_xlim(0.0, time[-1])
        for (label, values, joints), row in zip(reported, grid[1:, 0], strict=True):
            for j in range(len(joints)):
                row.plot(time, values[:, j], color=COLOURS[j % len(COLOURS)], linewidth=1.0)
            last = [
                (float(values[-1, j]), name, COLOURS[j % len(COLOURS)])
                for j, name in enumerate(joints)
                if np.isfinite(values[-1, j])
            ]
            row.set_ylabel(label)
            style.label_end(row, float(time[-1]), last)
        grid[-1, 0].set_xlabel("time [s]")
        style.save(figure, folder, "loop")
