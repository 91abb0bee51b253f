"""Changes that the browser page makes to a controller's settings: presets, law, fields of axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from pliant._core import Axis, ConfigError, PliantError, Settings, Task
from pliant.view import messages
from pliant.view.snapshot import SettingsView

if TYPE_CHECKING:
    from pliant._core import Controller
    from pliant._typing import Array


LAWS = ("cap", "impedance", "paper")
#: Name of the preset that holds the settings of a configuration file.
FILE_PRESET = "from the file"
#: Fields of `pliant.Axis` that the page shows.
SHOWN_FIELDS = ("soft", "firm", "hold", "stiffness", "yields", "adaptation")


class SettingsEditor:
    """Settings of a controller; a change is undone if the controller rejects it.

    Args:
        axes: Task axes, as text for `pliant.Task`.
        rate: Control rate [Hz].
        file_settings: Settings of a configuration file; None: there is no configuration file.

    Attributes:
        settings: The settings as if `firm` were False.
        preset: Name of the last chosen preset.
        firm: True if the user has switched off the yielding of all axes.
        presets: Names of all presets.
    """

    def __init__(self, axes: str, rate: float, file_settings: Settings | None = None) -> None:
        """Start with the settings of the file, or with the first preset if there is no file.

        If the file leaves all task axes at their defaults, the first preset sets them.
        """
        presets = _presets(axes)
        first = next(iter(presets))
        if file_settings is not None:
            limited = {name: _limit_speed(each, file_settings) for name, each in presets.items()}
            presets = {FILE_PRESET: file_settings} | limited
            if all(file_settings.axes[name] == Axis() for name in file_settings.task.names):
                # Let the first preset set only the axes; all other settings are those of the file.
                presets[first] = file_settings.replace(axes=self._axes(presets[first]))
            else:
                first = FILE_PRESET
        self._presets = {name: each.replace(rate=rate) for name, each in presets.items()}
        self.begin(first)

    @property
    def presets(self) -> tuple[str, ...]:
        """Names of all presets, the settings of the file (if any) included."""
        return tuple(self._presets)

    def begin(self, preset: str) -> None:
        """Replace all settings by those of a preset, and set `firm` to False.

        Raises:
            ConfigError: No preset has this name.
        """
        if preset not in self._presets:
            raise ConfigError(f"no preset {preset!r}; there are {', '.join(self._presets)}")
        self.settings, self.preset, self.firm = self._presets[preset], preset, False

    @property
    def effective(self) -> Settings:
        """The settings for the controller; if `firm` is True, no axis yields."""
        if not self.firm:
            return self.settings
        axes: dict[str, Axis] = {
            name: axis.replace(yields="none", adaptation=0.0)
            for name, axis in self._axes(self.settings).items()
        }
        return self.settings.replace(axes=axes)

    def apply(self, message: messages.Edit, controller: Controller) -> None:
        """Apply a change requested by the page to the settings and the controller.

        Raises:
            ConfigError: The controller rejects the change; nothing has changed.
        """
        previous = self.settings, self.preset, self.firm
        try:
            self._change(message, controller)
            controller.update(self.effective)
        except (PliantError, TypeError, ValueError) as error:
            self.settings, self.preset, self.firm = previous
            # Put the name of the axis in place of "Axis." in the error texts of the core.
            where = f"axes.{message.axis}" if isinstance(message, messages.Change) else "Axis"
            raise ConfigError(str(error).replace("Axis.", f"{where}.", 1)) from error

    def _change(self, message: messages.Edit, controller: Controller) -> None:
        axes = self._axes(self.settings)
        match message:
            case messages.Preset(name=preset):
                self.begin(preset)
            case messages.Law(law=law):
                defaults: dict[str, Any] = dict.fromkeys(messages.LAW_FIELDS)
                for name, axis in axes.items():
                    axes[name] = axis.replace(**{**defaults, "yields": yields_of(axis)})
                # Cast for the type checker only; `Settings` rejects an unknown law.
                known = cast("Literal['cap', 'impedance', 'paper']", law)
                self.settings = self.settings.replace(law=known, axes=axes)
            case messages.Change(axis=name, fields=fields):
                strengths: dict[str, Axis] = {n: a for n, a in controller.axes.items()}
                if name not in strengths:
                    names = ", ".join(strengths)
                    raise ConfigError(f"the task has no axis {name!r}; it has {names}")
                changed: dict[str, Any] = {}
                if name in axes:
                    changed = {"yields": yields_of(axes[name]), "adaptation": axes[name].adaptation}
                changed |= fields
                if changed.get("yields", strengths[name].yields) == "none":
                    changed["adaptation"] = 0.0
                edited = strengths[name].replace(**changed)
                self.settings = self.settings.replace(axes={**axes, name: edited})
            case messages.Adaptation(value=eta):
                for name, axis in axes.items():
                    if yields_of(axis) != "none":
                        axes[name] = axis.replace(adaptation=eta)
                self.settings = self.settings.replace(axes=axes)
            case messages.Firm(on=on):
                self.firm = on

    def describe(self, controller: Controller, q: Array | None = None) -> SettingsView:
        """Return the settings in force, in the form of the page's controls.

        Before the first step of the controller, the joint positions q (n,) [rad] must be given.
        """
        axes: dict[str, dict[str, Any]] = {
            name: {key: getattr(axis, key) for key in SHOWN_FIELDS}
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
        """Return the entries of `Settings.axes`, which has six axes, for the axes of the task."""
        return {name: a for name, a in settings.axes.items() if name in settings.task.names}


def yields_of(axis: Axis) -> Literal["both", "+", "-", "none"]:
    """Return `Axis.yields`; if it is None, `both` if the axis has a force cap, else `none`."""
    if axis.yields is not None:
        return axis.yields
    return "none" if axis.soft is None and axis.firm is None else "both"


def _limit_speed(settings: Settings, bounds: Settings) -> Settings:
    """Return settings with the tool speeds of `bounds` as upper bounds."""
    (speed, turn), (max_speed, max_turn) = settings.max_tool_speed, bounds.max_tool_speed
    return settings.replace(max_tool_speed=(min(speed, max_speed), min(turn, max_turn)))


def _presets(axes: str) -> dict[str, Settings]:
    """Return the presets by name; some exist only for six task axes."""
    task = Task(axes=axes)
    names = task.names
    out = {f"soft {name}": Settings.soft(name, task=task) for name in "yxz" if name in names}
    out["soft all"] = Settings.soft(" ".join(names), task=task)
    further = ("door", "drawer", "wipe", "plug", "paper") if len(names) == 6 else ()
    for name in ("firm", "hand_guiding", "hand_over", *further):
        out[name] = getattr(Settings, name)(task=task)
    return out
