"""Conditions of an experiment: loop, bus, servos, and the controller's assumptions."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

import pliant
from experiments.setups import arm, servos
from pliant.sim import Plant

if TYPE_CHECKING:
    from collections.abc import Mapping

    from experiments.episode import Controlling
    from pliant.sim import Fixture, Hand
    from pliant.sim.friction import Friction


@runtime_checkable
class FromModel(Protocol):
    """A baseline controller, made for the arm when a run begins."""

    def __call__(self, model: pliant.Model, period: float) -> Controlling:
        """Make one for a control period [s]."""


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Loop, bus, servos and assumptions; by default 100 Hz, no delay, everything known.

    Attributes:
        rate: Control rate [Hz].
        delay: Ticks from sampling to read() and from write() to the servo; known to the controller.
        believed: Assumed over true friction and damping.
        count: Encoder count [rad], known to the controller.
        gears: Friction by speed and load in place of the table's.
        gears_known: True if the controller knows it.
        flicker: Counts by which readings toggle at random.
        plant: More options of `pliant.sim.Plant`, which override the above and are unknown to the
            controller.
    """

    rate: float = 100.0
    delay: tuple[int, int] = (0, 0)
    believed: float = 1.0
    count: float = 0.0
    gears: Friction | None = None
    gears_known: bool = False
    flicker: int = 0
    plant: Mapping[str, Any] = field(default_factory=dict)

    def with_plant(self, **options: Any) -> Conditions:
        """Return the same conditions with more options of the plant."""
        return replace(self, plant={**self.plant, **options})

    def build(self, *scene: Hand | Fixture) -> Plant:
        """Build the simulated arm with its hands and fixtures."""
        options: dict[str, Any] = {
            "rate": self.rate,
            "delay": self.delay,
            "count": self.count,
            "flicker": self.flicker,
            **({} if self.gears is None else {"friction": self.gears}),
            **self.plant,
        }
        return Plant(arm(), scene=scene, **options)

    def servos(self) -> pliant.Servos:
        """Return the servo table of `arm7` that the controller assumes."""
        true = servos()
        if self.gears is not None and self.gears_known:
            true = self.gears.assumed(true)
        return true.replace(
            friction=self.believed * np.asarray(true.friction),
            load_friction=self.believed * np.asarray(true.load_friction),
            stribeck=self.believed * np.asarray(true.stribeck),
            load_stribeck=self.believed * np.asarray(true.load_stribeck),
            damping=self.believed * np.asarray(true.damping),
            kv=self.believed * np.asarray(true.kv),
            encoder_step=self.count,
        )

    def controller(self, law: pliant.Settings | FromModel) -> Controlling:
        """Make the controller of one run: from settings, or a baseline."""
        if isinstance(law, pliant.Settings):
            delay = sum(self.delay) / self.rate
            settings = law.replace(rate=self.rate, delay=delay)
            return pliant.Controller(arm(), settings, self.servos())
        return law(arm(), 1.0 / self.rate)


#: 100 Hz, no delay, everything known.
NOMINAL = Conditions()
#: Typical hardware: a tick each way.
TICK_EACH_WAY = Conditions(delay=(1, 1))
