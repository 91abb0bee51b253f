"""Panels of the browser page: controls on the right, state of the arm on the left, STOP button."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import numpy as np
import viser
from viser._messages import GuiSetPanelCollapsedMessage

from pliant.view import html, messages
from pliant.view.controls import Controls
from pliant.view.plots import Plots

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.view.messages import Message
    from pliant.view.snapshot import Ended, SceneInfo, Snapshot

#: Widths of the left and the right panel [px].
LEFT_WIDTH, RIGHT_WIDTH = 400, 330
#: Width of a browser's window below which the left panel starts minimized [px].
NARROW_WIDTH = 1060
#: Minimum time between two updates of bars and numbers [s].
REDRAW_PERIOD = 0.12
#: Width of the panel with the STOP button, and its distance from the corner of the scene [px].
STOP_WIDTH, STOP_MARGIN = 290, 12
#: Values of `SceneInfo.where` of an arm that ends with the process of the loop.
SIMULATED = frozenset({"simulated", "sim", "emulator"})
#: Keyboard shortcut of the STOP button.
STOP_KEY: Literal["S"] = "S"


class StopPanel:
    """Panel with the phase of the run, the STOP button and the button that switches torque on."""

    def __init__(
        self, server: viser.ViserServer, info: SceneInfo, send: Callable[[Message], None]
    ) -> None:
        """Add the panel to the lower left corner of the scene; `send` sends to the control loop."""
        gui = server.gui
        self._info = info
        self._phase, self._has_ended = "starting", False
        panel = gui.add_panel()
        with panel.add_tab("Stop", viser.Icon.HAND_STOP):
            self._status = gui.add_html("")
            gui.add_html(html.big_stop())
            self.stop = gui.add_button(
                "STOP",
                color="red",
                icon=viser.Icon.HAND_STOP,
                hint=f"Lower the arm, then torque off (key {STOP_KEY})",
            )
            self.start = gui.add_button(
                "Torque on", color="green", icon=viser.Icon.PLAYER_PLAY, visible=False
            )
            self._notice = gui.add_html("")
        self.stop.on_click(lambda _: send(messages.Stop()))
        self.start.on_click(lambda _: send(messages.Start()))
        command = gui.add_command("STOP: lower the arm, torque off", hotkey=STOP_KEY)
        command.on_trigger(lambda _: send(messages.Stop()))
        panel.float(x=STOP_MARGIN, y=-STOP_MARGIN, width=STOP_WIDTH)

    def show(self, snapshot: Snapshot) -> None:
        """Show phase and message of a snapshot, and the buttons that apply in this phase."""
        self._phase = snapshot.phase
        self._status.content = html.status(self._info, snapshot.phase)
        self.stop.visible, self.start.visible = snapshot.phase != "down", snapshot.phase == "down"
        self.stop.disabled = snapshot.phase == "lowering"
        self._notice.content = html.notice(snapshot.notice.text, snapshot.notice.is_error)

    def show_end(self, end: Ended) -> None:
        """Show the final state of the arm; the buttons no longer apply."""
        self._end("down" if end.is_off else "left on")
        self._notice.content = html.notice(f"The program has ended. {end.text}", not end.is_off)

    def show_disconnected(self) -> None:
        """Show that the loop has ended without a final state: its process was killed."""
        if self._has_ended:
            return
        text = (
            "The loop has ended. Servos that still have torque keep their last goal and limit, "
            "until a guardian lowers the arm."
        )
        is_off = self._phase == "down"
        if is_off:
            text = "The loop has ended. Torque was off before."
        elif self._info.where in SIMULATED:
            text = "The loop has ended, and the simulated arm with it."
        self._end(self._phase)
        self._notice.content = html.notice(text, not is_off)

    def _end(self, phase: str) -> None:
        """Show the last phase, and hide the buttons."""
        self._has_ended = True
        self._status.content = html.status(self._info, phase)
        self.stop.visible = self.start.visible = False
        self.stop.disabled = self.start.disabled = True


class Panel:
    """All panels of the browser page for one scene."""

    def __init__(
        self, server: viser.ViserServer, info: SceneInfo, send: Callable[[Message], None]
    ) -> None:
        """Replace the panels of the last scene by new ones; `send` sends a message to the loop."""
        self._info, gui = info, server.gui
        gui.reset()
        self._last_redraw = -np.inf
        self._ranges: dict[str, float] = {}
        self._report: tuple[str, ...] = ()
        self._last_content: tuple[str, ...] | None = None
        self.stop = StopPanel(server, info, send)
        self.controls = Controls(server, info, send)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(RIGHT_WIDTH)
        side = gui.add_panel()
        with side.add_tab("Live", viser.Icon.ACTIVITY):
            self._health = gui.add_html("")
            self._axes = gui.add_html("")
            self._contact_force = gui.add_html("")
            self._joints = gui.add_html("")
            self._live_displays = self._axes, self._contact_force, self._joints
            self._plots = Plots(gui, info)
        with side.add_tab("Why", viser.Icon.QUESTION_MARK):
            self._sentences = gui.add_html("")
            gui.add_markdown("**Activation**: the share of each axis' strength a joint gets")
            self._matrix = gui.add_html("")
        side.dock_left()
        side.set_width(LEFT_WIDTH)
        self._side, self._gui = side, gui

    def fit(self, client: viser.ClientHandle) -> None:
        """Minimize the left panel for one client whose window is narrow; its user can expand it."""
        if client.camera.image_width >= NARROW_WIDTH:
            return
        # `minimize` of viser's panel would do so for all clients.
        client._websock_connection.queue_message(
            GuiSetPanelCollapsedMessage(
                self._side._placement_uuid,
                True,
                counter=self._gui._next_layout_counter(),
                run_id=self._gui._layout_run_id,
            )
        )

    def show(self, snapshot: Snapshot) -> None:
        """Show a snapshot of the arm in all panels."""
        self.stop.show(snapshot)
        self.controls.show(snapshot)
        if 0.0 <= snapshot.time - self._last_redraw < REDRAW_PERIOD:
            return
        self._last_redraw = snapshot.time
        self._health.content = html.health(snapshot.health)
        if snapshot.step is not None and snapshot.shown is not None:
            self._ranges = html.ranges(self._info, snapshot.shown, snapshot.step, self._ranges)
            self._axes.content = html.axes(self._info, snapshot.shown, snapshot.step, self._ranges)
            self._joints.content = html.joints(self._info, snapshot.step)
            self._matrix.content = html.matrix(self._info, snapshot.step)
            self._plots.show(snapshot)
            if snapshot.contact_force is not None:
                self._contact_force.content = html.contact_force(self._info, snapshot.contact_force)
            self._last_content = tuple(part.content for part in self._live_displays)
        elif self._last_content is not None:
            for part, content in zip(self._live_displays, self._last_content, strict=True):
                part.content = html.dimmed(content)
            self._last_content = None
        if snapshot.report != self._report:
            self._report = snapshot.report
            self._sentences.content = html.summary(snapshot.report)
