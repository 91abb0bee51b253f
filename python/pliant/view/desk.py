"""The settings that a page changes: presets, law, one axis after the other, soft or firm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pliant
from pliant import ConfigError, PliantError
from pliant.view import orders
from pliant.view.snapshot import Shown

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant import Controller, Settings

LAWS = ("cap", "impedance", "paper")
#: Preset that stands for the settings of a configuration file.
OWN = "from the file"
#: All fields of an axis.
FIELDS = (
    "soft",
    "firm",
    "hold",
    "stiffness",
    "damping",
    "yields",
    "eta",
    "d_minus",
    "d_plus",
    "profile",
    "step_limit",
    "soft_step_limit",
    "deviation_limit",
    "beyond",
)
#: Those that depend on the law.
OF_THE_LAW = ("soft", "firm", "hold", "stiffness", "damping")


class Desk:
    """Holds settings, passes changes to a controller, and keeps the old ones where it refuses.

    Args:
        axes: Task axes, as of `pliant.Task`.
        rate: Of the controller [Hz].
        own: Settings of a configuration file, None without one.

    Attributes:
        settings: The settings, whatever `firm` says.
        preset: Name of the preset they began with.
        firm: Whether nothing yields for now.
        presets: Names of presets.
    """

    def __init__(self, axes: str, rate: float, own: Settings | None = None) -> None:
        """Begin with the file's settings, or soft in y."""
        self._task, self._rate = axes, rate
        self._makers = _presets(axes)
        if own is not None:
            self._makers = {OWN: lambda: own, **self._makers}
        self.firm = False
        self.preset = next(iter(self._makers))
        self.settings = self._make(self.preset)

    @property
    def presets(self) -> tuple[str, ...]:
        """Names of presets."""
        return tuple(self._makers)

    def begin(self, preset: str) -> None:
        """Start over with a preset.

        Raises:
            ConfigError: There is none of that name.
        """
        self.settings, self.preset, self.firm = self._make(preset), preset, False

    @property
    def effective(self) -> Settings:
        """The settings that a controller shall have."""
        if not self.firm:
            return self.settings
        axes = {name: _still(axis) for name, axis in self.settings.axes.items()}
        return self.settings.replace(axes=axes)

    def take(self, order: orders.Edit, controller: Controller) -> None:
        """Change the settings of a controller.

        Raises:
            PliantError: They are refused; controller and settings are as before.
        """
        before = self.settings, self.preset, self.firm
        try:
            self._change(order, controller)
            controller.update(self.effective)
        except (PliantError, TypeError, ValueError) as error:
            self.settings, self.preset, self.firm = before
            raise error if isinstance(error, PliantError) else ConfigError(str(error)) from error

    def _change(self, order: orders.Edit, controller: Controller) -> None:
        match order:
            case orders.Preset(name=name):
                self.begin(name)
            case orders.Law(law=law):
                bare: dict[str, Any] = dict.fromkeys(OF_THE_LAW)
                axes = {
                    name: pliant.Axis(**{**fields_of(axis), **bare})
                    for name, axis in controller.strengths.items()
                }
                for name, axis in self.settings.axes.items():
                    axes[name] = axes[name].replace(yields=yields_of(axis))
                self.settings = self.settings.replace(law=law, axes=axes)  # type: ignore[arg-type]
            case orders.Change(axis=name, fields=fields):
                if name not in controller.strengths:
                    there = ", ".join(controller.strengths)
                    raise ConfigError(f"the task has no axis {name!r}; it has {there}")
                filled = fields_of(controller.strengths[name])
                if name in self.settings.axes:
                    filled["yields"] = yields_of(self.settings.axes[name])
                axis = {**filled, **fields}
                if axis["yields"] == "none":
                    axis["eta"] = 0.0
                made = pliant.Axis(**axis)
                self.settings = self.settings.replace(axes={**self.settings.axes, name: made})
            case orders.Eta(value=eta):
                axes = {
                    name: axis if yields_of(axis) == "none" else axis.replace(eta=eta)
                    for name, axis in self.settings.axes.items()
                }
                self.settings = self.settings.replace(axes=axes)
            case orders.Firm(on=on):
                self.firm = on

    def show(self, controller: Controller) -> Shown:
        """The settings in force, for the controls."""
        axes = {name: fields_of(axis) for name, axis in controller.strengths.items()}
        if self.firm:
            for name, axis in self.settings.axes.items():
                if name in axes:
                    axes[name]["yields"], axes[name]["eta"] = yields_of(axis), axis.eta
        return Shown(
            law=controller.settings.law,
            preset=self.preset,
            firm=self.firm,
            axes=axes,
            thresholds=controller.report().thresholds,
        )

    def _make(self, name: str) -> Settings:
        if name not in self._makers:
            raise ConfigError(f"no preset {name!r}; there are {', '.join(self._makers)}")
        return self._makers[name]().replace(rate=self._rate)


def fields_of(axis: pliant.Axis) -> dict[str, Any]:
    """What an axis is made of."""
    return {name: getattr(axis, name) for name in FIELDS}


def _still(axis: pliant.Axis) -> pliant.Axis:
    """The same axis, giving way to nothing."""
    return axis.replace(yields="none", eta=0.0)


def yields_of(axis: pliant.Axis) -> str:
    """The pushes it gives way to, said in full."""
    if axis.yields is not None:
        return axis.yields
    return "none" if axis.soft is None and axis.firm is None else "both"


def _presets(axes: str) -> dict[str, Callable[[], Settings]]:
    """What can be chosen; presets that speak of rotations need a task that has them."""
    task = pliant.Task(axes=axes)
    names = task.names
    out: dict[str, Callable[[], Settings]] = {}
    for name in ("y", "x", "z"):
        if name in names:
            out[f"soft {name}"] = lambda name=name: pliant.Settings.soft(name, task=task)
    out["soft all"] = lambda: pliant.Settings.soft(" ".join(names), task=task)
    out["firm"] = lambda: pliant.Settings.firm(task=task)
    out["hand_guiding"] = lambda: pliant.Settings.hand_guiding(task=task)
    out["hand_over"] = lambda: pliant.Settings.hand_over(task=task)
    if len(names) == 6:
        out["door"] = lambda: pliant.Settings.door(task=task)
        out["drawer"] = lambda: pliant.Settings.drawer(task=task)
        out["wipe"] = lambda: pliant.Settings.wipe(task=task)
        out["plug"] = lambda: pliant.Settings.plug(task=task)
        out["paper"] = lambda: pliant.Settings.paper(task=task)
    return out
