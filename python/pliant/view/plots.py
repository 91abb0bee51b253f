"""Plots of the last 20 seconds: deviation of the tool, softness, torque limits."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np
from viser import uplot

from pliant.view.html import COLOURS, caption

if TYPE_CHECKING:
    import viser

    from pliant._typing import Array
    from pliant.view.snapshot import SceneInfo, Snapshot


#: Length of a curve [s], and points per second.
LENGTH, POINTS = 20.0, 10.0
HEIGHT = 94
LIMITS = "Torque limits [%], joints coloured as above"


class Plot:
    """A plot with several curves over time."""

    def __init__(
        self,
        gui: viser.GuiApi,
        title: str,
        names: tuple[str, ...],
        low: float,
        high: float,
        *,
        named: bool = True,
    ) -> None:
        """Add the plot; its scale covers at least `low` to `high`."""
        self._low, self._high = low, high
        self._rows: deque[Array] = deque(maxlen=int(LENGTH * POINTS))
        empty = np.zeros(2)
        series = (
            uplot.Series(label="s"),
            *(
                uplot.Series(label=name, stroke=COLOURS[i % len(COLOURS)], width=1.6)
                for i, name in enumerate(names)
            ),
        )
        gui.add_html(caption(title, names if named else ()))
        self._plot = gui.add_uplot(
            data=(np.array((-LENGTH, 0.0)), *([empty] * len(names))),
            series=series,
            scales=self._scales(low, high),
            axes=(uplot.Axis(size=30), uplot.Axis(size=40, space=18)),
            legend=uplot.Legend(show=False),
            padding=(4, 10, 0, 0),
            height=HEIGHT,
        )

    def add(self, time: float, values: Array) -> None:
        """Add a point to every curve."""
        if self._rows and time < self._rows[-1][0]:
            self._rows.clear()
        self._rows.append(np.concatenate(((time,), values)))

    def draw(self) -> None:
        """Send the curves."""
        if len(self._rows) < 2:
            return
        table = np.array(self._rows)
        table[:, 0] -= table[-1, 0]
        self._plot.data = tuple(np.ascontiguousarray(column) for column in table.T)
        low, high = float(table[:, 1:].min()), float(table[:, 1:].max())
        room = 0.05 * (high - low)
        self._plot.scales = self._scales(min(low - room, self._low), max(high + room, self._high))

    @staticmethod
    def _scales(low: float, high: float) -> dict[str, uplot.Scale]:
        return {
            "x": uplot.Scale(time=False, range=(-LENGTH, 0.0)),
            "y": uplot.Scale(range=(low, high)),
        }


class Plots:
    """The three plots of the page."""

    def __init__(self, gui: viser.GuiApi, info: SceneInfo) -> None:
        """Add the plots, empty."""
        self._linear = [i for i, name in enumerate(info.axes) if name in {"x", "y", "z"}]
        names = tuple(info.axes[i] for i in self._linear)
        self._usable, self._last = info.usable, -np.inf
        self._away = Plot(gui, "Off target [mm]", names, -20.0, 20.0)
        self._soft = Plot(gui, "Soft [%]", info.axes, 0.0, 100.0)
        self._limit = Plot(gui, LIMITS, info.joints, 0.0, 100.0, named=False)

    def show(self, now: Snapshot) -> None:
        """Add a snapshot, at most ten per second."""
        step = now.step
        if step is None or 0.0 <= now.time - self._last < 1.0 / POINTS:
            return
        self._last = now.time
        self._away.add(now.time, -1e3 * step.deviation[self._linear])
        self._soft.add(now.time, 100.0 * step.compliance * step.softness)
        self._limit.add(now.time, 100.0 * step.limit / self._usable)
        for plot in (self._away, self._soft, self._limit):
            plot.draw()
