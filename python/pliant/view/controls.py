"""Controls of the browser page: choice of the scene, settings of the controller, simulated push."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import numpy as np
import viser

from pliant._validation import AXES
from pliant.view import html, messages
from pliant.view.settings_editor import LAWS

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.view.snapshot import SceneInfo, SettingsView, Snapshot

    Send = Callable[[messages.Message], None]

#: Value of `Axis.yields` for each label on the page.
YIELD_VALUES = {
    "holds": "none",
    "gives way": "both",
    "gives way to +": "+",
    "gives way to −": "-",
}
#: Label on the page for each value of `Axis.yields`.
YIELD_LABELS = {value: key for key, value in YIELD_VALUES.items()}
#: While the push button is held down, `Push` messages are sent at `REPEAT_RATE` [Hz]; each requests
#: a push of `HELD_PUSH_TIME` [s].
REPEAT_RATE, HELD_PUSH_TIME = 10.0, 0.4
#: Duration of the push after one click on the button for a push of fixed duration [s].
TIMED_PUSH_TIME = 2.0
#: Initial value of the slider for the push force, as a share of its maximum [1].
INITIAL_PUSH_SHARE = 0.15


class Controls:
    """Control panel of the page: sends a user's changes to the loop, and shows the settings."""

    def __init__(self, server: viser.ViserServer, info: SceneInfo, send: Send) -> None:
        """Add the controls to the current container of viser's GUI.

        `send` is called with each message for the control loop.
        """
        self._gui, self._info, self._send = server.gui, info, send
        self._edit_numbers = itertools.count(1)
        self._last_edit = 0
        #: Last known value of each control by `id(control)`, set by the loop or by a user.
        self._known: dict[int, Any] = {}
        self._scene()
        self._softness()
        if info.max_push is not None:
            self._push(info.max_push)

    # Methods that create the controls.

    def _scene(self) -> None:
        gui, info = self._gui, self._info
        with gui.add_folder("Scene" if info.scenes else "Target"):
            if info.scenes:
                scene = gui.add_dropdown("Scene", tuple(info.scenes), initial_value=info.scene)
                self._on_user_change(scene, lambda: self._send(messages.Scene(scene.value)))
                gui.add_markdown(info.scenes[info.scene])
            if info.play:
                play = gui.add_button(info.play, icon=viser.Icon.PLAYER_PLAY)
                play.on_click(lambda _: self._send(messages.Play()))
            self._positions = gui.add_html("")
            home = gui.add_button("Target back to the start", icon=viser.Icon.HOME, color="gray")
            home.on_click(lambda _: self._send(messages.Home()))

    def _softness(self) -> None:
        gui, info = self._gui, self._info
        with gui.add_folder("Softness"):
            self.preset = gui.add_dropdown("Preset", info.presets)
            self._on_edit(self.preset, lambda n: messages.Preset(n, self.preset.value))
            self.law = gui.add_dropdown("Law", LAWS)
            self._on_edit(self.law, lambda n: messages.Law(n, self.law.value))
            self.firm = gui.add_checkbox(
                "All firm", initial_value=False, hint="The same pose, all axes stiff"
            )
            self._on_edit(self.firm, lambda n: messages.Firm(n, self.firm.value))
            self.eta = gui.add_slider(
                "η",
                min=0.0,
                max=0.999,
                step=0.001,
                initial_value=0.9,
                hint="0: comes back to the target; near 1: stays where it is put",
            )
            self._on_edit(self.eta, lambda n: messages.Adaptation(n, float(self.eta.value)))
            self.yields = {}
            for name in info.axes:
                choice = gui.add_dropdown(name, tuple(YIELD_VALUES))
                self.yields[name] = choice
                self._on_edit(choice, self._make_axis_edit(name, "yields", choice))
        with gui.add_folder("Strength: pushed toward −, toward +", expand_by_default=False):
            self.strength: dict[tuple[str, str], Any] = {}
            tabs = gui.add_tab_group()
            for name in info.axes:
                with tabs.add_tab(name):
                    self._strengths(name)

    def _strengths(self, name: str) -> None:
        """Add the input fields for `soft`, `firm`, `stiffness` and `hold` of one task axis."""
        gui = self._gui
        unit = "N" if name in {"x", "y", "z"} else "N·m"
        step = 0.5 if unit == "N" else 0.05
        for key in ("soft", "firm"):
            pair = gui.add_vector2(f"{key} [{unit}]", (0.0, 0.0), min=(0.0, 0.0), step=step)
            self.strength[name, key] = pair
            self._on_edit(pair, self._make_axis_edit(name, key, pair))
        spring = gui.add_vector2(
            f"stiffness [{'N/m' if unit == 'N' else 'N·m/rad'}]",
            (0.0, 0.0),
            min=(0.0, 0.0),
            step=10.0 * step,
            visible=False,
        )
        self.strength[name, "stiffness"] = spring
        self._on_edit(spring, self._make_axis_edit(name, "stiffness", spring))
        hold = gui.add_number(f"hold [{unit}]", 0.0, min=0.0, step=step)
        self.strength[name, "hold"] = hold
        self._on_edit(hold, self._make_axis_edit(name, "hold", hold))

    def _push(self, max_push: tuple[float, float]) -> None:
        gui, axes = self._gui, self._info.axes
        with gui.add_folder("Push"):
            gui.add_markdown("Drag any part of the arm with the mouse, or:")
            sides = [f"{sign}{name}" for name in axes for sign in "+−"]
            first = "+y" if "+y" in sides else sides[0]
            self.side = gui.add_dropdown("Toward", tuple(sides), initial_value=first)
            self.force = gui.add_slider("Force [N]", min=0.0, max=1.0, step=0.1, initial_value=0.0)
            self._set_push_range(max_push)
            self._on_user_change(self.force, lambda: None)
            self.side.on_update(lambda _: self._set_push_range(max_push))
            hold_button = gui.add_button("Push while held down", icon=viser.Icon.HAND_FINGER)
            hold_button.on_hold(
                lambda _: self._send(self._push_message(HELD_PUSH_TIME)), callback_hz=REPEAT_RATE
            )
            click_button = gui.add_button(f"Push for {TIMED_PUSH_TIME:g} s", color="gray")
            click_button.on_click(lambda _: self._send(self._push_message(TIMED_PUSH_TIME)))

    def _set_push_range(self, max_push: tuple[float, float]) -> None:
        """Set range and unit of the push slider: force along or torque about the chosen axis.

        `max_push` is the maximum force [N] and the maximum torque [N·m].
        """
        rotational = self.side.value[1:] not in {"x", "y", "z"}
        label = "Torque [N·m]" if rotational else "Force [N]"
        if self.force.label != label or self.force.value == 0.0:
            largest = max_push[rotational]
            self.force.label, self.force.step = label, 10.0 ** np.floor(np.log10(largest / 40.0))
            self.force.max = float(np.round(largest, 3))
            force: Any = self.force
            force.value = float(np.round(INITIAL_PUSH_SHARE * largest, 3))

    def _push_message(self, seconds: float) -> messages.Push:
        side = self.side.value
        wrench = np.zeros(6)
        index = AXES.index(side[1:])
        wrench[index] = self.force.value if side[0] == "+" else -self.force.value
        x, y, z, *torque = wrench.tolist()
        return messages.Push((x, y, z), (torque[0], torque[1], torque[2]), seconds)

    # Sending of changes by the user, and display of values from the loop.

    def _make_axis_edit(self, axis: str, key: str, handle: Any) -> Callable[[int], messages.Edit]:
        """Return a function that, given the number of an edit, returns the `Change` message.

        The message sets the field `key` of a task axis to the value of the control `handle`.
        """

        def make_edit(number: int) -> messages.Edit:
            value = handle.value
            value = YIELD_VALUES[value] if key == "yields" else value
            fields = {key: value}
            if key == "yields" and value != "none":
                fields["adaptation"] = float(self.eta.value)
            return messages.Change(number, axis, fields)

        return make_edit

    def _on_edit(self, handle: Any, make: Callable[[int], messages.Edit]) -> None:
        """Send the message `make(number)`, with a new number, when a user changes a control."""

        def send() -> None:
            self._last_edit = next(self._edit_numbers)
            self._send(make(self._last_edit))

        self._on_user_change(handle, send)

    def _on_user_change(self, handle: Any, act: Callable[[], None]) -> None:
        """Call `act` when a user changes a control, but not when the program changes it."""
        self._known[id(handle)] = handle.value

        # A coroutine, because viser runs coroutines in order, but plain functions in a thread pool.
        async def changed(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                _clamp(handle)
                self._known[id(handle)] = handle.value
                act()

        handle.on_update(changed)

    def show(self, snapshot: Snapshot) -> None:
        """Show the positions and the settings of a snapshot.

        The settings are shown only if the loop has handled the user's last edit. A control that
        differs from its last known value keeps its value: snapshots and changes by users come in
        different threads, so the message with the user's change may not have been sent yet.
        """
        self._positions.content = html.positions(snapshot)
        if snapshot.shown is not None and snapshot.edit >= self._last_edit:
            self._show_settings(snapshot.shown)

    def _show_settings(self, shown: SettingsView) -> None:
        self._set(self.preset, shown.preset)
        self._set(self.law, shown.law)
        self._set(self.firm, shown.firm)
        yielding = [axis["adaptation"] for axis in shown.axes.values() if axis["yields"] != "none"]
        if yielding:
            self._set(self.eta, max(yielding))
        for name, axis in shown.axes.items():
            self._set(self.yields[name], YIELD_LABELS[axis["yields"]])
            self.strength[name, "stiffness"].visible = shown.law == "impedance"
            for key in ("soft", "firm", "hold", "stiffness"):
                if axis[key] is not None:
                    self._set(self.strength[name, key], axis[key])

    def _set(self, handle: Any, value: Any) -> None:
        """Set a control to a value, unless a user has changed the control in the meantime."""
        if handle.value == self._known[id(handle)]:
            handle.value = value
            self._known[id(handle)] = handle.value


def _clamp(handle: Any) -> None:
    """Bring a typed number into the range of its control, and show it; sliders do not check it."""
    low, high = getattr(handle, "min", None), getattr(handle, "max", None)
    if low is None and high is None:
        return
    clipped = np.clip(handle.value, low, high)
    value = tuple(clipped.tolist()) if isinstance(handle.value, tuple) else float(clipped)
    if value != handle.value:
        handle.value = value
