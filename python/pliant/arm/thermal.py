"""Thermal and supply budgets, which reduce torque limits before servos overheat and switch off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pliant._core import ThermalModel

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

#: Heat of a servo above which a fault is reported, as a share of its thermal budget [1]. The heat
#: exceeds 1 if the arm's weight needs more than the continuous torque.
TOO_HOT = 1.3


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Thermal and electrical budget of an arm.

    Attributes:
        continuous: Share of the usable torque that a servo can exert continuously, in (0, 1].
        seconds: Thermal time constant of a servo's winding [s]. At full torque the budget is used
            up after ``−seconds ln(1 − continuous²)``: 5.2 s by default.
        supply: Largest current of the power supply [A]; None: no limit.
        hottest: Highest temperature of the servos [°C]; the limit of a servo itself, if it is known
            and lower, takes its place.
    """

    continuous: float = 0.4
    seconds: float = 30.0
    supply: float | None = None
    hottest: float = 70.0

    def __post_init__(self) -> None:
        """Raise `ConfigError` unless all attributes are valid."""
        self.thermal_model((), ())

    def thermal_model(self, max_torque: ArrayLike, stall_current: ArrayLike | None) -> ThermalModel:
        """Return a thermal model of N cold servos.

        Args:
            max_torque: Usable torques (N,) [N·m].
            stall_current: Currents at these torques (N,) [A]; None if unknown.

        Raises:
            ConfigError: A value is out of range, or `supply` is given and the currents are unknown.
        """
        return ThermalModel(
            np.asarray(max_torque, dtype=np.float64),
            None if stall_current is None else np.asarray(stall_current, dtype=np.float64),
            continuous=self.continuous,
            seconds=self.seconds,
            supply=self.supply,
            hottest=self.hottest,
        )


def thermal_faults(
    thermal: ThermalModel, names: tuple[str, ...], temperature: ArrayLike
) -> list[str]:
    """Return a sentence for each servo that exceeds its thermal budget or temperature.

    Args:
        thermal: Thermal model of the N servos.
        names: Joint names (N,).
        temperature: Measured temperatures (N,) [°C]. If the limit of a servo is below
            `Budget.hottest`, its temperature in `thermal` is higher by the difference.
    """
    faults = []
    limits = thermal.zero_torque_temperature + np.subtract(temperature, thermal.temperature)
    rows = zip(names, thermal.heat, np.asarray(temperature), limits, strict=True)
    for name, heat, degrees, limit in rows:
        if heat > TOO_HOT:
            faults.append(
                f"{name} is at {100 * heat:.0f} % of its thermal budget: choose a pose that needs "
                "less torque there, or a smaller force if it is a gripper"
            )
        if degrees >= limit:
            faults.append(
                f"{name} is at {degrees:.0f} °C and its limit is {limit:.0f} °C: let it cool"
            )
    return faults
