"""Controls of the page: scene, settings, push."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import numpy as np
import viser

from pliant.view import html, messages
from pliant.view.settings_editor import LAWS

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.view.snapshot import SceneInfo, SettingsView, Snapshot

    Tell = Callable[[messages.Message], None]

#: Labels of the page for the pushes to which an axis yields, with the values of `pliant.Axis`.
YIELDS = {
    "holds": "none",
    "gives way": "both",
    "gives way to +": "+",
    "gives way to −": "-",
}
WORDS = {value: key for key, value in YIELDS.items()}
#: Repetition rate of a held button [Hz], and the time for which one message counts [s].
HOLDING, COUNTS = 10.0, 0.4
#: Duration of a push without a held button [s].
PUSH = 2.0
#: Initial value of the push slider, as a share of the largest push.
FIRST = 0.15


class Controls:
    """The control panel: sends changes to the arm and shows the arm's present state."""

    def __init__(self, server: viser.ViserServer, info: SceneInfo, send: Tell) -> None:
        """Add the controls to the open container."""
        self._gui, self._info, self._send = server.gui, info, send
        self._numbers = itertools.count(1)
        self._last_edit = 0
        #: Last known values of the controls, set by the arm or a visitor, by id.
        self._known: dict[int, Any] = {}
        self._scene()
        self._softness()
        if info.max_push is not None:
            self._push(info.max_push)

    # Construction.

    def _scene(self) -> None:
        gui, info = self._gui, self._info
        with gui.add_folder("Scene" if info.scenes else "Target"):
            if info.scenes:
                scene = gui.add_dropdown("Scene", tuple(info.scenes), initial_value=info.scene)
                self._by_hand(scene, lambda: self._send(messages.Scene(scene.value)))
                gui.add_markdown(info.scenes[info.scene])
            if info.play:
                play = gui.add_button(info.play, icon=viser.Icon.PLAYER_PLAY)
                play.on_click(lambda _: self._send(messages.Play()))
            self._places = gui.add_html("")
            home = gui.add_button("Target back to the start", icon=viser.Icon.HOME, color="gray")
            home.on_click(lambda _: self._send(messages.Home()))

    def _softness(self) -> None:
        gui, info = self._gui, self._info
        with gui.add_folder("Softness"):
            self.preset = gui.add_dropdown("Preset", info.presets)
            self._edits(self.preset, lambda n: messages.Preset(n, self.preset.value))
            self.law = gui.add_dropdown("Law", LAWS)
            self._edits(self.law, lambda n: messages.Law(n, self.law.value))
            self.firm = gui.add_checkbox(
                "All firm", initial_value=False, hint="The same pose, all axes stiff"
            )
            self._edits(self.firm, lambda n: messages.Firm(n, self.firm.value))
            self.eta = gui.add_slider(
                "η",
                min=0.0,
                max=0.999,
                step=0.001,
                initial_value=0.9,
                hint="0: comes back to the target; near 1: stays where it is put",
            )
            self._edits(self.eta, lambda n: messages.Adaptation(n, float(self.eta.value)))
            self.yields = {}
            for name in info.axes:
                choice = gui.add_dropdown(name, tuple(YIELDS))
                self.yields[name] = choice
                self._edits(choice, self._change(name, "yields", choice))
        with gui.add_folder("Strength: pushed toward −, toward +", expand_by_default=False):
            self.strength: dict[tuple[str, str], Any] = {}
            tabs = gui.add_tab_group()
            for name in info.axes:
                with tabs.add_tab(name):
                    self._strengths(name)

    def _strengths(self, name: str) -> None:
        """Add the fields of one axis."""
        gui = self._gui
        unit = "N" if name in {"x", "y", "z"} else "N·m"
        step = 0.5 if unit == "N" else 0.05
        for word in ("soft", "firm"):
            pair = gui.add_vector2(f"{word} [{unit}]", (0.0, 0.0), min=(0.0, 0.0), step=step)
            self.strength[name, word] = pair
            self._edits(pair, self._change(name, word, pair))
        spring = gui.add_vector2(
            f"stiffness [{'N/m' if unit == 'N' else 'N·m/rad'}]",
            (0.0, 0.0),
            min=(0.0, 0.0),
            step=10.0 * step,
            visible=False,
        )
        self.strength[name, "stiffness"] = spring
        self._edits(spring, self._change(name, "stiffness", spring))
        hold = gui.add_number(f"hold [{unit}]", 0.0, min=0.0, step=step)
        self.strength[name, "hold"] = hold
        self._edits(hold, self._change(name, "hold", hold))

    def _push(self, max_push: tuple[float, float]) -> None:
        gui, axes = self._gui, self._info.axes
        with gui.add_folder("Push"):
            gui.add_markdown("Drag any part of the arm with the mouse, or:")
            sides = [f"{sign}{name}" for name in axes for sign in "+−"]
            first = "+y" if "+y" in sides else sides[0]
            self.side = gui.add_dropdown("Toward", tuple(sides), initial_value=first)
            self.force = gui.add_slider("Force [N]", min=0.0, max=1.0, step=0.1, initial_value=0.0)
            self._scale(max_push)
            self.side.on_update(lambda _: self._scale(max_push))
            held = gui.add_button("Push while held down", icon=viser.Icon.HAND_FINGER)
            held.on_hold(lambda _: self._send(self._pushing(COUNTS)), callback_hz=HOLDING)
            timed = gui.add_button(f"Push for {PUSH:g} s", color="gray")
            timed.on_click(lambda _: self._send(self._pushing(PUSH)))

    def _scale(self, max_push: tuple[float, float]) -> None:
        """Set range and unit of the push: newtons along an axis, newton metres about one."""
        turning = self.side.value[1:] not in {"x", "y", "z"}
        label = "Torque [N·m]" if turning else "Force [N]"
        if self.force.label != label or self.force.value == 0.0:
            most = max_push[turning]
            self.force.label, self.force.step = label, 10.0 ** np.floor(np.log10(most / 40.0))
            self.force.max = float(np.round(most, 3))
            force: Any = self.force
            force.value = float(np.round(FIRST * most, 3))

    def _pushing(self, seconds: float) -> messages.Push:
        side = self.side.value
        wrench = np.zeros(6)
        place = ("x", "y", "z", "roll", "pitch", "yaw").index(side[1:])
        wrench[place] = self.force.value if side[0] == "+" else -self.force.value
        x, y, z, *turn = wrench.tolist()
        return messages.Push((x, y, z), (turn[0], turn[1], turn[2]), seconds)

    # Sending and display.

    def _change(self, axis: str, word: str, handle: Any) -> Callable[[int], messages.Edit]:
        """Return a function that makes the edit of one field of an axis."""

        def made(number: int) -> messages.Edit:
            value = handle.value
            value = YIELDS[value] if word == "yields" else value
            fields = {word: value}
            if word == "yields" and value != "none":
                fields["adaptation"] = float(self.eta.value)
            return messages.Change(number, axis, fields)

        return made

    def _edits(self, handle: Any, make: Callable[[int], messages.Edit]) -> None:
        """Send an edit when a visitor moves a control."""

        def send() -> None:
            self._last_edit = next(self._numbers)
            self._send(make(self._last_edit))

        self._by_hand(handle, send)

    def _by_hand(self, handle: Any, act: Callable[[], None]) -> None:
        """Act on a visitor's change, not on a change by the page itself."""
        self._known[id(handle)] = handle.value

        # Run in the server's own thread: in order, right after the control has its new value.
        async def moved(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                self._known[id(handle)] = handle.value
                act()

        handle.on_update(moved)

    def show(self, now: Snapshot) -> None:
        """Show the settings in force, unless a visitor's edit is still pending.

        Snapshots come in another thread than the visitors' changes. If a control differs from its
        last known value, its edit is about to arrive.
        """
        self._places.content = html.places(now)
        if now.shown is not None and now.edit >= self._last_edit:
            self._show_settings(now.shown)

    def _show_settings(self, shown: SettingsView) -> None:
        self._put(self.preset, shown.preset)
        self._put(self.law, shown.law)
        self._put(self.firm, shown.firm)
        yielding = [axis["adaptation"] for axis in shown.axes.values() if axis["yields"] != "none"]
        if yielding:
            self._put(self.eta, max(yielding))
        for name, axis in shown.axes.items():
            self._put(self.yields[name], WORDS[axis["yields"]])
            self.strength[name, "stiffness"].visible = shown.law == "impedance"
            for word in ("soft", "firm", "hold", "stiffness"):
                if axis[word] is not None:
                    self._put(self.strength[name, word], axis[word])

    def _put(self, handle: Any, value: Any) -> None:
        """Show the arm's value in a control that no visitor has changed."""
        if handle.value == self._known[id(handle)]:
            handle.value = value
            self._known[id(handle)] = handle.value
