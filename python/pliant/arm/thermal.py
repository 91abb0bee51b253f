"""Thermal and supply budget: limits are reduced before the hardware protects itself."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ConfigError

if TYPE_CHECKING:
    from pliant._typing import Array


#: Heat from which on limits are reduced, and heat at which a fault is reported.
WARM, TOO_HOT = 0.8, 1.3
#: Range below the last allowed temperature over which limits are reduced [°C]; and distance of that
#: temperature from the servo's own shutdown temperature [°C].
SPAN, MARGIN = 8.0, 2.0


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Thermal and electrical budget of an arm.

    Attributes:
        continuous: Share of the usable torque that a servo can exert continuously, in (0, 1].
        seconds: Thermal time constant of its winding [s]. At full torque the budget is used up
            after ``−seconds ln(1 − continuous²)``: 5.2 s by default.
        supply: Largest current of the supply [A]; None: no limit.
        hottest: Temperature at which the servos switch off [°C].
    """

    continuous: float = 0.4
    seconds: float = 30.0
    supply: float | None = None
    hottest: float = 70.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not 0.0 < self.continuous <= 1.0:
            raise ConfigError(f"Budget.continuous must be in (0, 1], got {self.continuous!r}")
        if not self.seconds > 0.0:
            raise ConfigError(f"Budget.seconds must be above 0 s, got {self.seconds!r}")
        if self.supply is not None and not self.supply > 0.0:
            raise ConfigError(f"Budget.supply must be above 0 A, or None, got {self.supply!r}")
        if not self.hottest > 0.0:
            raise ConfigError(f"Budget.hottest must be above 0 °C, got {self.hottest!r}")


class ThermalModel:
    """Thermal model of N servos, and the torque limits that follow from it.

    ``ḣ = ((τ/usable)²/continuous² − h) / seconds``, where h is the share of the thermal budget in
    use; h = 1 in steady state at the continuous torque.

    Attributes:
        heat: h (N,).
        temperature: Last known (N,) [°C]; NaN where unknown.
    """

    def __init__(self, budget: Budget, usable: Array, stall_current: Array | None) -> None:
        """Start with cold servos.

        Args:
            budget: Thermal and electrical budget.
            usable: Usable torque (N,) [N·m].
            stall_current: Current at that torque (N,) [A]; None: unknown.

        Raises:
            ConfigError: A supply is given and the currents are not known.
        """
        known = stall_current is not None and bool(np.isfinite(stall_current).all())
        if budget.supply is not None and not known:
            raise ConfigError(
                "Budget.supply needs the servos' stall currents, which this drive does not know: "
                "leave supply out"
            )
        self._budget, self._usable = budget, usable
        self._current = stall_current / usable if stall_current is not None and known else None
        self.heat = np.zeros_like(usable)
        self.temperature = np.full_like(usable, np.nan)

    def update(self, torque: Array, dt: float) -> None:
        """Update the heat with torques (N,) [N·m] exerted over dt [s]."""
        share = torque / (self._usable * self._budget.continuous)
        gain = 1.0 - np.exp(-dt / self._budget.seconds)
        self.heat += gain * (share**2 - self.heat)

    def ceiling(self) -> Array:
        """Return the largest torque limits (N,) [N·m] at the present heat and temperature."""
        over = np.clip((self.heat - WARM) / (1.0 - WARM), 0.0, 1.0)
        ceiling = self._usable * (1.0 - (1.0 - self._budget.continuous) * over)
        left = (self._budget.hottest - MARGIN - self.temperature) / SPAN
        return np.where(np.isnan(left), ceiling, ceiling * np.clip(left, 0.0, 1.0))

    def limit_current(self, torque: Array, limit: Array, support: Array) -> Array:
        """Return limits (N,) [N·m] that keep the current within the supply.

        Args:
            torque: Expected torques without limits (N,) [N·m].
            limit: Requested limits (N,) [N·m].
            support: Limits that are never reduced (N,) [N·m]: the weight of the arm.

        Returns:
            ``least + s (limit − least)`` with the largest s in [0, 1] that the supply allows.
        """
        supply = self._budget.supply
        if supply is None or self._current is None:
            return limit
        support = np.minimum(support, limit)
        low, high = 0.0, 1.0
        share = high
        for _ in range(12):
            drawn = np.minimum(np.abs(torque), support + share * (limit - support))
            if self._current @ drawn <= supply:
                low = share
            else:
                high = share
            if low == high:
                break
            share = (low + high) / 2.0
        return support + low * (limit - support)

    def faults(self, names: tuple[str, ...]) -> list[str]:
        """Return a sentence for each servo that is too hot."""
        found = []
        last = self._budget.hottest - MARGIN
        for name, heat, degrees in zip(names, self.heat, self.temperature, strict=True):
            if heat > TOO_HOT:
                found.append(
                    f"{name} has used {100 * heat:.0f} % of its thermal budget holding the arm up: "
                    "choose a pose that needs less torque there"
                )
            if degrees >= last:
                found.append(f"{name} has {degrees:.0f} °C and switches off soon: let it cool")
        return found
