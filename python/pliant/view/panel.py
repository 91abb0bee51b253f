"""The page's panels: controls on the right, state of the arm on the left."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
import viser

from pliant.view import html, messages
from pliant.view.controls import Controls
from pliant.view.plots import Plots

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.view.messages import Message
    from pliant.view.snapshot import SceneInfo, Snapshot

#: Widths of the panels [px].
LEFT, RIGHT = 400, 330
#: Least redraw period of bars and numbers [s].
DRAWN = 0.12
#: Width of the stop panel, and its distance from the corner [px].
WIDTH, GAP = 290, 12
#: Keyboard shortcut.
KEY: Literal["S"] = "S"


class StopPanel:
    """A window with the arm's state, and the buttons for stop and start."""

    def __init__(
        self, server: viser.ViserServer, info: SceneInfo, send: Callable[[Message], None]
    ) -> None:
        """Place it in the lower left corner of the scene."""
        gui = server.gui
        self._info = info
        panel = gui.add_panel()
        with panel.add_tab("Stop", viser.Icon.HAND_STOP):
            self._status = gui.add_html("")
            gui.add_html(html.big_stop())
            self.stop = gui.add_button(
                "STOP",
                color="red",
                icon=viser.Icon.HAND_STOP,
                hint=f"Lower the arm, then torque off (key {KEY})",
            )
            self.start = gui.add_button(
                "Torque on", color="green", icon=viser.Icon.PLAYER_PLAY, visible=False
            )
            self._notice = gui.add_html("")
        self.stop.on_click(lambda _: send(messages.Stop()))
        self.start.on_click(lambda _: send(messages.Start()))
        command = gui.add_command("STOP: lower the arm, torque off", hotkey=KEY)
        command.on_trigger(lambda _: send(messages.Stop()))
        panel.float(x=GAP, y=-GAP, width=WIDTH)

    def show(self, now: Snapshot) -> None:
        """Show the state of the arm."""
        self._status.content = html.status(self._info, now)
        self.stop.visible, self.start.visible = now.phase != "down", now.phase == "down"
        self.stop.disabled = now.phase == "lowering"
        self._notice.content = html.notice(now.notice[1], now.notice[2])

    def show_disconnected(self) -> None:
        """Show that the loop has ended."""
        self.stop.disabled = self.start.disabled = True
        self._notice.content = html.notice(
            "The loop has ended. Servos that still have torque keep their last goal and limit.",
            wrong=True,
        )


class Panel:
    """All panels of the page, until the scene changes."""

    def __init__(
        self, server: viser.ViserServer, info: SceneInfo, send: Callable[[Message], None]
    ) -> None:
        """Build both panels."""
        self._info, gui = info, server.gui
        gui.reset()
        self._drawn = -np.inf
        self._ranges: dict[str, float] = {}
        self._report: tuple[str, ...] = ()
        self._last: tuple[str, ...] | None = None
        self.stop = StopPanel(server, info, send)
        self.controls = Controls(server, info, send)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(RIGHT)
        side = gui.add_panel()
        with side.add_tab("Live", viser.Icon.ACTIVITY):
            self._health = gui.add_html("")
            self._axes = gui.add_html("")
            self._felt = gui.add_html("")
            self._joints = gui.add_html("")
            self._fading = self._axes, self._felt, self._joints
            self._plots = Plots(gui, info)
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
        self._health.content = html.health(now.health)
        if now.step is not None and now.shown is not None:
            self._ranges = html.ranges(self._info, now.shown, now.step, self._ranges)
            self._axes.content = html.axes(self._info, now.shown, now.step, self._ranges)
            self._joints.content = html.joints(self._info, now.step)
            self._matrix.content = html.matrix(self._info, now.step)
            self._plots.show(now)
            if now.felt is not None:
                self._felt.content = html.felt(self._info, now.felt)
            self._last = tuple(part.content for part in self._fading)
        elif self._last is not None:
            for part, content in zip(self._fading, self._last, strict=True):
                part.content = html.faded(content)
            self._last = None
        if now.report != self._report:
            self._report = now.report
            self._sentences.content = html.summary(now.report)
