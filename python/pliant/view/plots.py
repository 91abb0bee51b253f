"""Plots of the last 20 s on the page: offset of the tool from the target, softness, limits."""

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


#: Time span of a plot [s], and number of its points per second [1/s].
DURATION, POINT_RATE = 20.0, 10.0
#: Height of a plot [px].
PLOT_HEIGHT = 94
#: Title of the plot of the torque limits; its curves have the colours of the joint table above it.
LIMITS_TITLE = "Torque limits [%], joints coloured as above"


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
        """Add a plot with a curve per name to viser's GUI; `named` shows the names as a legend.

        The vertical axis covers at least `low` to `high`.
        """
        self._low, self._high = low, high
        self._rows: deque[Array] = deque(maxlen=int(DURATION * POINT_RATE))
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
            data=(np.array((-DURATION, 0.0)), *([empty] * len(names))),
            series=series,
            scales=self._scales(low, high),
            axes=(uplot.Axis(size=30), uplot.Axis(size=40, space=18)),
            legend=uplot.Legend(show=False),
            padding=(4, 10, 0, 0),
            height=PLOT_HEIGHT,
        )

    def add(self, time: float, values: Array) -> None:
        """Add one point per curve at a time [s].

        If the time is before the time of the last point, as in a new run, the plot is cleared.
        """
        if self._rows and time < self._rows[-1][0]:
            self._rows.clear()
        self._rows.append(np.concatenate(((time,), values)))

    def draw(self) -> None:
        """Send the curves to the browser."""
        if len(self._rows) < 2:
            return
        table = np.array(self._rows)
        table[:, 0] -= table[-1, 0]
        self._plot.data = tuple(np.ascontiguousarray(column) for column in table.T)
        low, high = float(table[:, 1:].min()), float(table[:, 1:].max())
        margin = 0.05 * (high - low)
        self._plot.scales = self._scales(
            min(low - margin, self._low), max(high + margin, self._high)
        )

    @staticmethod
    def _scales(low: float, high: float) -> dict[str, uplot.Scale]:
        return {
            "x": uplot.Scale(time=False, range=(-DURATION, 0.0)),
            "y": uplot.Scale(range=(low, high)),
        }


class Plots:
    """The three plots of the page: offsets from the target, softness and torque limits."""

    def __init__(self, gui: viser.GuiApi, info: SceneInfo) -> None:
        """Add the three plots, still empty, to viser's GUI."""
        self._linear = [i for i, name in enumerate(info.axes) if name in {"x", "y", "z"}]
        names = tuple(info.axes[i] for i in self._linear)
        self._max_torque, self._last = info.max_torque, -np.inf
        self._offset_plot = Plot(gui, "Off target [mm]", names, -20.0, 20.0)
        self._softness_plot = Plot(gui, "Soft [%]", info.axes, 0.0, 100.0)
        self._limit_plot = Plot(gui, LIMITS_TITLE, info.joints, 0.0, 100.0, named=False)

    def show(self, snapshot: Snapshot) -> None:
        """Add the values of a snapshot to the plots, at most `POINT_RATE` times a second."""
        step = snapshot.step
        if step is None or 0.0 <= snapshot.time - self._last < 1.0 / POINT_RATE:
            return
        self._last = snapshot.time
        self._offset_plot.add(snapshot.time, -1e3 * step.deviation[self._linear])
        self._softness_plot.add(snapshot.time, 100.0 * step.compliance * step.softness)
        self._limit_plot.add(snapshot.time, 100.0 * step.limit / self._max_torque)
        for plot in (self._offset_plot, self._softness_plot, self._limit_plot):
            plot.draw()
