"""Settings that the page can change: presets, law, single axes, soft or firm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from pliant._core import Axis, ConfigError, PliantError, Settings, Task
from pliant.view import orders
from pliant.view.snapshot import Shown

if TYPE_CHECKING:
    from collections.abc import Callable

    from pliant._core import Controller
    from pliant._typing import Array


LAWS = ("cap", "impedance", "paper")
#: Preset with the settings of a configuration file.
OWN = "from the file"
#: All fields of an axis.
FIELDS = (
    "soft",
    "firm",
    "hold",
    "stiffness",
    "damping",
    "yields",
    "adaptation",
    "soft_until",
    "firm_from",
    "profile",
    "max_velocity",
    "soft_step_limit",
    "deviation_limit",
    "on_deviation_limit",
)
#: Fields that depend on the law.
OF_THE_LAW = ("soft", "firm", "hold", "stiffness", "damping")


class Desk:
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

    def take(self, order: orders.Edit, controller: Controller) -> None:
        """Change the settings of a controller.

        Raises:
            ConfigError: They are rejected; controller and settings are as before.
        """
        before = self.settings, self.preset, self.firm
        try:
            self._change(order, controller)
            controller.update(self.effective)
        except (PliantError, TypeError, ValueError) as error:
            self.settings, self.preset, self.firm = before
            # The core names a single axis "Axis" in its errors.
            where = f"axes.{order.axis}" if isinstance(order, orders.Change) else "Axis"
            raise ConfigError(str(error).replace("Axis.", f"{where}.", 1)) from error

    def _change(self, order: orders.Edit, controller: Controller) -> None:
        axes = self._axes(self.settings)
        match order:
            case orders.Preset(name=preset):
                self.begin(preset)
            case orders.Law(law=law):
                bare: dict[str, Any] = dict.fromkeys(OF_THE_LAW)
                for name, axis in axes.items():
                    axes[name] = Axis(**{**fields_of(axis), **bare, "yields": yields_of(axis)})
                # The core rejects an unknown law.
                known = cast("Literal['cap', 'impedance', 'paper']", law)
                self.settings = self.settings.replace(law=known, axes=axes)
            case orders.Change(axis=name, fields=fields):
                strengths: dict[str, Axis] = {n: a for n, a in controller.axes.items()}
                if name not in strengths:
                    there = ", ".join(strengths)
                    raise ConfigError(f"the task has no axis {name!r}; it has {there}")
                made = fields_of(strengths[name])
                if name in axes:
                    made["yields"], made["adaptation"] = (
                        yields_of(axes[name]),
                        axes[name].adaptation,
                    )
                made |= fields
                if made["yields"] == "none":
                    made["adaptation"] = 0.0
                self.settings = self.settings.replace(axes={**axes, name: Axis(**made)})
            case orders.Eta(value=eta):
                for name, axis in axes.items():
                    if yields_of(axis) != "none":
                        axes[name] = axis.replace(adaptation=eta)
                self.settings = self.settings.replace(axes=axes)
            case orders.Firm(on=on):
                self.firm = on

    def show(self, controller: Controller, q: Array | None = None) -> Shown:
        """Return the settings in force, for the controls; q (n,) [rad] if there was no step yet."""
        axes: dict[str, dict[str, Any]] = {
            name: fields_of(axis) for name, axis in controller.axes.items()
        }
        if self.firm:
            for name, axis in self._axes(self.settings).items():
                axes[name]["yields"], axes[name]["adaptation"] = yields_of(axis), axis.adaptation
        return Shown(
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


def fields_of(axis: Axis) -> dict[str, Any]:
    """Return the fields of an axis."""
    return {name: getattr(axis, name) for name in FIELDS}


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
