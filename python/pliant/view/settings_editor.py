"""Settings that the page can change: presets, law, single axes, soft or firm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from pliant._core import Axis, ConfigError, PliantError, Settings, Task
from pliant.view import messages
from pliant.view.snapshot import SettingsView

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant._core import Controller
    from pliant._typing import Array


LAWS = ("cap", "impedance", "paper")
#: Preset with the settings of a configuration file.
OWN = "from the file"
#: Fields of an axis that the page shows.
FIELDS = ("soft", "firm", "hold", "stiffness", "yields", "adaptation")
#: Fields that depend on the law.
OF_THE_LAW = ("soft", "firm", "hold", "stiffness", "damping")


class SettingsEditor:
    """Holds settings, applies changes to a controller, and restores the old ones after a rejection.

    Args:
        axes: Task axes, as of `pliant.Task`.
        rate: Rate of the controller [Hz].
        own: Settings of a configuration file, None without one.

    Attributes:
        settings: The settings, without the effect of `firm`.
        preset: Name of the initial preset.
        firm: True while no axis yields.
        presets: Names of presets.
    """

    def __init__(self, axes: str, rate: float, own: Settings | None = None) -> None:
        """Start with the file's settings; soft in y if the file does not define the axes."""
        self._rate = rate
        self._makers = _presets(axes)
        self.preset = next(iter(self._makers))
        if own is not None:
            self._makers = {OWN: lambda: own, **_within(self._makers, own)}
            if _is_plain(own):
                # The other settings are those of the file.
                first = self._axes(self._makers[self.preset]())
                self._makers[self.preset] = lambda: own.replace(axes=first)
            else:
                self.preset = OWN
        self.firm = False
        self.settings = self._make(self.preset)

    @property
    def presets(self) -> tuple[str, ...]:
        """Names of presets."""
        return tuple(self._makers)

    def begin(self, preset: str) -> None:
        """Start again from a preset.

        Raises:
            ConfigError: There is no preset of that name.
        """
        self.settings, self.preset, self.firm = self._make(preset), preset, False

    @property
    def effective(self) -> Settings:
        """Return the settings for the controller."""
        if not self.firm:
            return self.settings
        axes: dict[str, Axis] = {
            name: axis.replace(yields="none", adaptation=0.0)
            for name, axis in self._axes(self.settings).items()
        }
        return self.settings.replace(axes=axes)

    def apply(self, message: messages.Edit, controller: Controller) -> None:
        """Change the settings of a controller.

        Raises:
            ConfigError: They are rejected; controller and settings are as before.
        """
        before = self.settings, self.preset, self.firm
        try:
            self._change(message, controller)
            controller.update(self.effective)
        except (PliantError, TypeError, ValueError) as error:
            self.settings, self.preset, self.firm = before
            # The core names a single axis "Axis" in its errors.
            where = f"axes.{message.axis}" if isinstance(message, messages.Change) else "Axis"
            raise ConfigError(str(error).replace("Axis.", f"{where}.", 1)) from error

    def _change(self, message: messages.Edit, controller: Controller) -> None:
        axes = self._axes(self.settings)
        match message:
            case messages.Preset(name=preset):
                self.begin(preset)
            case messages.Law(law=law):
                bare: dict[str, Any] = dict.fromkeys(OF_THE_LAW)
                for name, axis in axes.items():
                    axes[name] = axis.replace(**{**bare, "yields": yields_of(axis)})
                # The core rejects an unknown law.
                known = cast("Literal['cap', 'impedance', 'paper']", law)
                self.settings = self.settings.replace(law=known, axes=axes)
            case messages.Change(axis=name, fields=fields):
                strengths: dict[str, Axis] = {n: a for n, a in controller.axes.items()}
                if name not in strengths:
                    there = ", ".join(strengths)
                    raise ConfigError(f"the task has no axis {name!r}; it has {there}")
                made: dict[str, Any] = {}
                if name in axes:
                    made = {"yields": yields_of(axes[name]), "adaptation": axes[name].adaptation}
                made |= fields
                if made.get("yields", strengths[name].yields) == "none":
                    made["adaptation"] = 0.0
                edited = strengths[name].replace(**made)
                self.settings = self.settings.replace(axes={**axes, name: edited})
            case messages.Adaptation(value=eta):
                for name, axis in axes.items():
                    if yields_of(axis) != "none":
                        axes[name] = axis.replace(adaptation=eta)
                self.settings = self.settings.replace(axes=axes)
            case messages.Firm(on=on):
                self.firm = on

    def describe(self, controller: Controller, q: Array | None = None) -> SettingsView:
        """Return the settings in force, for the controls; q (n,) [rad] if there was no step yet."""
        axes: dict[str, dict[str, Any]] = {
            name: {key: getattr(axis, key) for key in FIELDS}
            for name, axis in controller.axes.items()
        }
        if self.firm:
            for name, axis in self._axes(self.settings).items():
                axes[name]["yields"], axes[name]["adaptation"] = yields_of(axis), axis.adaptation
        return SettingsView(
            law=controller.settings.law,
            preset=self.preset,
            firm=self.firm,
            axes=axes,
            thresholds=np.array([axis.thresholds for axis in controller.report(q).axes.values()]),
        )

    @staticmethod
    def _axes(settings: Settings) -> dict[str, Axis]:
        """Return the axes of the task; `Settings.axes` lists all six, but only these may change."""
        return {name: a for name, a in settings.axes.items() if name in settings.task.names}

    def _make(self, name: str) -> Settings:
        if name not in self._makers:
            raise ConfigError(f"no preset {name!r}; there are {', '.join(self._makers)}")
        return self._makers[name]().replace(rate=self._rate)


def yields_of(axis: Axis) -> Literal["both", "+", "-", "none"]:
    """Return the pushes to which an axis yields, also if not set explicitly."""
    if axis.yields is not None:
        return axis.yields
    return "none" if axis.soft is None and axis.firm is None else "both"


def _is_plain(settings: Settings) -> bool:
    """Return True if the settings define no axis of their task."""
    return all(settings.axes[name] == Axis() for name in settings.task.names)


def _within(
    makers: dict[str, Callable[[], Settings]], own: Settings
) -> dict[str, Callable[[], Settings]]:
    """Limit the speeds of presets to those of the file."""

    def slow(make: Callable[[], Settings]) -> Callable[[], Settings]:
        def made() -> Settings:
            out = make()
            (speed, turn), (most, most_turn) = out.max_tool_speed, own.max_tool_speed
            return out.replace(max_tool_speed=(min(speed, most), min(turn, most_turn)))

        return made

    return {name: slow(make) for name, make in makers.items()}


def _presets(axes: str) -> dict[str, Callable[[], Settings]]:
    """Return the presets; presets with rotations need a task that has them."""
    task = Task(axes=axes)
    names = task.names

    def soft(which: str) -> Callable[[], Settings]:
        return lambda: Settings.soft(which, task=task)

    def ready(which: str) -> Callable[[], Settings]:
        return lambda: cast("Settings", getattr(Settings, which)(task=task))

    out = {f"soft {name}": soft(name) for name in ("y", "x", "z") if name in names}
    out["soft all"] = soft(" ".join(names))
    more = ("door", "drawer", "wipe", "plug", "paper") if len(names) == 6 else ()
    return {**out, **{name: ready(name) for name in ("firm", "hand_guiding", "hand_over", *more)}}
