"""The page's panels: controls on the right, state of the arm on the left."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import viser

from pliant.view import meters
from pliant.view.controls import Controls
from pliant.view.plots import Plots
from pliant.view.stop import StopPanel

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.view.orders import Order
    from pliant.view.snapshot import Snapshot, Stage

#: Widths of the panels [px].
LEFT, RIGHT = 400, 330
#: Least redraw period of bars and numbers [s].
DRAWN = 0.12


class Panel:
    """All panels of the page, until the stage changes."""

    def __init__(
        self, server: viser.ViserServer, stage: Stage, tell: Callable[[Order], None]
    ) -> None:
        """Build both panels."""
        self._stage, gui = stage, server.gui
        gui.reset()
        self._drawn = -np.inf
        self._ranges: dict[str, float] = {}
        self._report: tuple[str, ...] = ()
        self._last: tuple[str, ...] | None = None
        self.stop = StopPanel(server, stage, tell)
        self.controls = Controls(server, stage, tell)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(RIGHT)
        side = gui.add_panel()
        with side.add_tab("Live", viser.Icon.ACTIVITY):
            self._health = gui.add_html("")
            self._axes = gui.add_html("")
            self._felt = gui.add_html("")
            self._joints = gui.add_html("")
            self._fading = self._axes, self._felt, self._joints
            self._plots = Plots(gui, stage)
        with side.add_tab("Why", viser.Icon.QUESTION_MARK):
            self._sentences = gui.add_html("")
            gui.add_markdown("**Activation**: the share of each axis' strength a joint gets")
            self._matrix = gui.add_html("")
        side.dock_left()
        side.set_width(LEFT)

    def show(self, now: Snapshot) -> None:
        """Update all panels to a snapshot."""
        self.stop.show(now)
        self.controls.show(now)
        if 0.0 <= now.time - self._drawn < DRAWN:
            return
        self._drawn = now.time
        self._health.content = meters.health(now.health)
        if now.step is not None and now.shown is not None:
            self._ranges = meters.ranges(self._stage, now.shown, now.step, self._ranges)
            self._axes.content = meters.axes(self._stage, now.shown, now.step, self._ranges)
            self._joints.content = meters.joints(self._stage, now.step)
            self._matrix.content = meters.matrix(self._stage, now.step)
            self._plots.show(now)
            if now.felt is not None:
                self._felt.content = meters.felt(self._stage, now.felt)
            self._last = tuple(part.content for part in self._fading)
        elif self._last is not None:
            for part, content in zip(self._fading, self._last, strict=True):
                part.content = meters.faded(content)
            self._last = None
        if now.report != self._report:
            self._report = now.report
            self._sentences.content = meters.summary(now.report)
