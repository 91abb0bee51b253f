"""What a visitor can turn: stop, scene, settings, push."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import viser

from pliant.view import orders
from pliant.view.desk import LAWS

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant.view.snapshot import Shown, Snapshot, Stage

    Tell = Callable[[orders.Order], None]

#: What an axis gives way to: the word of the page, and that of `pliant.Axis`.
YIELDS = {
    "holds": "none",
    "gives way": "both",
    "gives way to +": "+",
    "gives way to −": "-",
}
WORDS = {value: key for key, value in YIELDS.items()}
#: How often a button that is held down says so [Hz], and how long one word counts [s].
HOLDING, COUNTS = 10.0, 0.4
#: Length of a push that needs no holding [s].
PUSH = 2.0


class Controls:
    """The panel of controls; everything in it is said to the arm and shown as the arm has it."""

    def __init__(self, server: viser.ViserServer, stage: Stage, tell: Tell) -> None:
        """Add them to the container that is open."""
        self._gui, self._stage, self._tell = server.gui, stage, tell
        self._numbers = itertools.count(1)
        self._said = 0
        self._stop()
        self._scene()
        self._softness()
        if stage.strong is not None:
            self._push(stage.strong)

    # Building.

    def _stop(self) -> None:
        gui = self._gui
        self.stop = gui.add_button(
            "STOP", color="red", icon=viser.Icon.HAND_STOP, hint="Lower the arm, then torque off"
        )
        self.stop.on_click(lambda _: self._tell(orders.Stop()))
        self.start = gui.add_button(
            "Torque on", color="green", icon=viser.Icon.PLAYER_PLAY, visible=False
        )
        self.start.on_click(lambda _: self._tell(orders.Start()))

    def _scene(self) -> None:
        gui, stage = self._gui, self._stage
        with gui.add_folder("Scene" if stage.scenes else "Target"):
            if stage.scenes:
                scene = gui.add_dropdown("Scene", tuple(stage.scenes), initial_value=stage.scene)
                self._by_hand(scene, lambda: self._tell(orders.Scene(scene.value)))
                gui.add_markdown(stage.scenes[stage.scene])
            if stage.play:
                play = gui.add_button(stage.play, icon=viser.Icon.PLAYER_PLAY)
                play.on_click(lambda _: self._tell(orders.Play()))
            home = gui.add_button("Target back to the start", icon=viser.Icon.HOME, color="gray")
            home.on_click(lambda _: self._tell(orders.Home()))

    def _softness(self) -> None:
        gui, stage = self._gui, self._stage
        with gui.add_folder("Softness"):
            self.preset = gui.add_dropdown("Preset", stage.presets)
            self._edits(self.preset, lambda n: orders.Preset(n, self.preset.value))
            self.law = gui.add_dropdown("Law", LAWS)
            self._edits(self.law, lambda n: orders.Law(n, self.law.value))
            self.firm = gui.add_checkbox(
                "All firm", initial_value=False, hint="The same pose with nothing that gives way"
            )
            self._edits(self.firm, lambda n: orders.Firm(n, self.firm.value))
            self.eta = gui.add_slider(
                "η",
                min=0.0,
                max=0.999,
                step=0.001,
                initial_value=0.9,
                hint="0: comes back to the target; near 1: stays where it is put",
            )
            self._edits(self.eta, lambda n: orders.Eta(n, float(self.eta.value)))
            self.yields = {}
            for name in stage.axes:
                choice = gui.add_dropdown(name, tuple(YIELDS))
                self.yields[name] = choice
                self._edits(choice, self._change(name, "yields", choice))
        with gui.add_folder("Strength: pushed toward −, toward +", expand_by_default=False):
            self.strength: dict[tuple[str, str], Any] = {}
            tabs = gui.add_tab_group()
            for name in stage.axes:
                with tabs.add_tab(name):
                    self._strengths(name)

    def _strengths(self, name: str) -> None:
        """Fields of one axis."""
        gui = self._gui
        unit = "N" if name in {"x", "y", "z"} else "N·m"
        step = 0.5 if unit == "N" else 0.05
        for word in ("soft", "firm"):
            pair = gui.add_vector2(f"{word} [{unit}]", (0.0, 0.0), min=(0.0, 0.0), step=step)
            self.strength[name, word] = pair
            self._edits(pair, self._change(name, word, pair))
        hold = gui.add_number(f"hold [{unit}]", 0.0, min=0.0, step=step)
        self.strength[name, "hold"] = hold
        self._edits(hold, self._change(name, "hold", hold))

    def _push(self, strong: tuple[float, float]) -> None:
        gui, axes = self._gui, self._stage.axes
        with gui.add_folder("Push"):
            gui.add_markdown("Drag any part of the arm with the mouse, or:")
            sides = [f"{sign}{name}" for name in axes for sign in "+−"]
            first = "+y" if "+y" in sides else sides[0]
            self.side = gui.add_dropdown("Toward", tuple(sides), initial_value=first)
            self.force = gui.add_slider(
                "Strength [%]", min=0, max=100, step=1, initial_value=30, hint=_most(axes, strong)
            )
            held = gui.add_button("Push while held down", icon=viser.Icon.HAND_FINGER)
            held.on_hold(lambda _: self._tell(self._pushing(strong, COUNTS)), callback_hz=HOLDING)
            timed = gui.add_button(f"Push for {PUSH:g} s", color="gray")
            timed.on_click(lambda _: self._tell(self._pushing(strong, PUSH)))

    def _pushing(self, strong: tuple[float, float], seconds: float) -> orders.Push:
        side = self.side.value
        sign, name = (1.0 if side[0] == "+" else -1.0), side[1:]
        place = ("x", "y", "z", "roll", "pitch", "yaw").index(name)
        size = sign * self.force.value / 100.0 * strong[place >= 3]
        wrench = [0.0] * 6
        wrench[place] = size
        return orders.Push((*wrench[:3],), (*wrench[3:],), seconds)  # type: ignore[arg-type]

    # Saying and showing.

    def _change(self, axis: str, word: str, handle: Any) -> Callable[[int], orders.Edit]:
        """A change of one field of an axis."""

        def made(number: int) -> orders.Edit:
            value = handle.value
            value = YIELDS[value] if word == "yields" else value
            fields = {word: value}
            if word == "yields" and value != "none":
                fields["eta"] = float(self.eta.value)
            return orders.Change(number, axis, fields)

        return made

    def _edits(self, handle: Any, make: Callable[[int], orders.Edit]) -> None:
        """Whoever moves a control tells the arm."""

        def tell() -> None:
            self._said = next(self._numbers)
            self._tell(make(self._said))

        self._by_hand(handle, tell)

    @staticmethod
    def _by_hand(handle: Any, act: Callable[[], None]) -> None:
        """Act on what a visitor changes, not on what the page itself sets."""

        @handle.on_update
        def _(event: viser.GuiEvent[Any]) -> None:
            if event.client is not None:
                act()

    def show(self, now: Snapshot) -> None:
        """Bring controls to what is in force, unless a visitor's edit is still on its way."""
        running = now.phase in {"starting", "running"}
        self.stop.visible, self.start.visible = running, now.phase == "down"
        if now.shown is not None and now.edit >= self._said:
            self._bring(now.shown)

    def _bring(self, shown: Shown) -> None:
        self.preset.value, self.law.value, self.firm.value = shown.preset, shown.law, shown.firm
        yielding = [axis["eta"] for axis in shown.axes.values() if axis["yields"] != "none"]
        if yielding:
            self.eta.value = max(yielding)
        for name, axis in shown.axes.items():
            self.yields[name].value = WORDS[axis["yields"]]
            for word in ("soft", "firm", "hold"):
                if axis[word] is not None:
                    self.strength[name, word].value = axis[word]


def _most(axes: tuple[str, ...], strong: tuple[float, float]) -> str:
    turning = f", {strong[1]:.3g} N·m" if len(axes) > 3 else ""
    return f"100 % is {strong[0]:.3g} N{turning}"
