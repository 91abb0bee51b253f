"""The stop button, which floats over the scene independent of scrolling."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

import viser

from pliant.view import meters, orders

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.view.snapshot import Snapshot, Stage

#: Width of its window, and its distance from the corner [px].
WIDTH, GAP = 290, 12
#: Keyboard shortcut.
KEY: Literal["S"] = "S"


class StopPanel:
    """A window with the arm's state, and the buttons for stop and start."""

    def __init__(
        self, server: viser.ViserServer, stage: Stage, tell: Callable[[orders.Order], None]
    ) -> None:
        """Place it in the lower left corner of the scene."""
        gui = server.gui
        self._stage = stage
        panel = gui.add_panel()
        with panel.add_tab("Stop", viser.Icon.HAND_STOP):
            self._status = gui.add_html("")
            gui.add_html(meters.big_stop())
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
        self.stop.on_click(lambda _: tell(orders.Stop()))
        self.start.on_click(lambda _: tell(orders.Start()))
        command = gui.add_command("STOP: lower the arm, torque off", hotkey=KEY)
        command.on_trigger(lambda _: tell(orders.Stop()))
        panel.float(x=GAP, y=-GAP, width=WIDTH)

    def show(self, now: Snapshot) -> None:
        """Show the state of the arm."""
        self._status.content = meters.status(self._stage, now)
        self.stop.visible, self.start.visible = now.phase != "down", now.phase == "down"
        self.stop.disabled = now.phase == "lowering"
        self._notice.content = meters.notice(now.said[1], now.said[2])

    def farewell(self) -> None:
        """Show that the loop has ended."""
        self.stop.disabled = self.start.disabled = True
        self._notice.content = meters.notice(
            "The loop has ended. Servos that still have torque keep their last goal and limit.",
            wrong=True,
        )
