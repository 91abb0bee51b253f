"""Servo models that can be emulated: control table, encoder and motor data of each model."""

from __future__ import annotations

import difflib
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pliant._core import ConfigError
from pliant.emulator import control_tables as tables

if TYPE_CHECKING:
    from pliant.emulator.control_tables import Table

Family = Literal["dxl1", "x", "sts"]

_RPM = 2.0 * math.pi / 60.0


@dataclass(frozen=True, slots=True)
class Motor:
    """Motor and gear as seen at the output shaft, from the maker's data sheet.

    Attributes:
        volts: Supply voltage at which the other values hold [V].
        stall: Stall torque [N·m].
        amps: Current at stall torque [A].
        speed: No-load speed [rad/s].
    """

    volts: float
    stall: float
    amps: float
    speed: float

    @property
    def slope(self) -> float:
        """Torque lost per speed (back-EMF): stall torque over no-load speed [N·m·s/rad]."""
        return self.stall / self.speed

    @property
    def torque_per_amp(self) -> float:
        """Torque constant: stall torque over current at stall [N·m/A]."""
        return self.stall / self.amps

    # Friction, gear damping and rotor inertia are not published. They are assumed as shares of
    # `stall` and `slope`, chosen so that an unloaded servo stops as quickly as in videos.

    @property
    def friction(self) -> float:
        """Assumed dry friction of the gears [N·m]."""
        return 0.03 * self.stall

    @property
    def damping(self) -> float:
        """Assumed viscous friction of the gears [N·m·s/rad]."""
        return 0.15 * self.slope

    @property
    def inertia(self) -> float:
        """Assumed rotor inertia at the output [kg·m²], for a motor time constant of 0.05 s."""
        return 0.05 * self.slope


@dataclass(frozen=True, slots=True)
class Model:
    """Data of one servo type.

    Attributes:
        name: The maker's name of the model.
        family: `dxl1` (Dynamixel Protocol 1.0), `x` (Protocol 2.0) or `sts` (Feetech).
        number: Content of the register Model Number.
        table: Control table.
        count: Shaft angle of one position count [rad].
        motor: Motor and gear.
        current_unit: Current of one count of the current registers [A]; 0 without a current sensor.
    """

    name: str
    family: Family
    number: int
    table: Table
    count: float
    motor: Motor
    current_unit: float = 0.0

    @property
    def max_position(self) -> int:
        """Largest position count of one turn, or of the potentiometer's range."""
        return 1023 if self.table is tables.RX64 else 4095


def _motor(volts: float, stall: float, amps: float, rpm: float) -> Motor:
    return Motor(volts, stall, amps, rpm * _RPM)


#: Shaft angle of one count of a 12-bit encoder [rad].
_COUNT = 2.0 * math.pi / 4096

_MODELS = (
    Model("EX-106+", "dxl1", 107, tables.EX106, math.radians(251.0) / 4096,
          _motor(18.5, 10.9, 7.0, 91.0), 0.010),
    Model("RX-64", "dxl1", 64, tables.RX64, math.radians(300.0) / 1024,
          _motor(18.5, 5.3, 2.6, 64.0)),
    Model("MX-28", "dxl1", 29, tables.MX28, _COUNT, _motor(12.0, 2.5, 1.4, 55.0)),
    Model("MX-64", "dxl1", 310, tables.MX64, _COUNT, _motor(12.0, 6.0, 4.1, 63.0), 0.0045),
    Model("MX-106", "dxl1", 320, tables.MX106, _COUNT, _motor(12.0, 8.4, 5.2, 45.0), 0.0045),
    Model("XL330-M077", "x", 1190, tables.XL330, _COUNT, _motor(5.0, 0.215, 1.47, 383.0), 0.001),
    Model("XL330-M288", "x", 1200, tables.XL330, _COUNT, _motor(5.0, 0.52, 1.47, 103.0), 0.001),
    Model("XC330-T181", "x", 1210, tables.XC330_T181, _COUNT,
          _motor(11.1, 0.76, 0.80, 104.0), 0.001),
    Model("XC330-T288", "x", 1220, tables.XC330_T288, _COUNT,
          _motor(11.1, 0.92, 0.80, 65.0), 0.001),
    Model("XL430-W250", "x", 1060, tables.XL430, _COUNT, _motor(11.1, 1.4, 1.3, 57.0)),
    Model("XC430-W150", "x", 1070, tables.XC430_W150, _COUNT, _motor(12.0, 1.6, 1.4, 106.0)),
    Model("XC430-W240", "x", 1080, tables.XC430_W240, _COUNT, _motor(12.0, 1.9, 1.4, 70.0)),
    Model("XM430-W210", "x", 1030, tables.XM430, _COUNT, _motor(12.0, 3.0, 2.3, 77.0), 0.00269),
    Model("XM430-W350", "x", 1020, tables.XM430, _COUNT, _motor(12.0, 4.1, 2.3, 46.0), 0.00269),
    Model("XM540-W150", "x", 1130, tables.XM540, _COUNT, _motor(12.0, 7.3, 4.4, 53.0), 0.00269),
    Model("XM540-W270", "x", 1120, tables.XM540, _COUNT, _motor(12.0, 10.6, 4.4, 30.0), 0.00269),
    Model("XH430-W210", "x", 1010, tables.XH430, _COUNT, _motor(12.0, 2.5, 1.3, 50.0), 0.00269),
    Model("XH430-W350", "x", 1000, tables.XH430, _COUNT, _motor(12.0, 3.4, 1.3, 30.0), 0.00269),
    Model("XH540-W150", "x", 1110, tables.XH540, _COUNT, _motor(12.0, 7.1, 4.9, 70.0), 0.00269),
    Model("XH540-W270", "x", 1100, tables.XH540, _COUNT, _motor(12.0, 9.9, 4.9, 39.0), 0.00269),
    Model("MX-28(2.0)", "x", 30, tables.MX28_2, _COUNT, _motor(12.0, 2.5, 1.4, 55.0)),
    Model("MX-64(2.0)", "x", 311, tables.MX64_2, _COUNT, _motor(12.0, 6.0, 4.1, 63.0), 0.00336),
    Model("MX-106(2.0)", "x", 321, tables.MX106_2, _COUNT, _motor(12.0, 8.4, 5.2, 45.0), 0.00336),
    Model("STS3215-7.4V", "sts", 777, tables.STS, _COUNT, _motor(7.4, 1.91, 2.5, 52.0), 0.0065),
    Model("STS3215-12V", "sts", 777, tables.STS.changed(max_voltage_limit=140), _COUNT,
          _motor(12.0, 2.94, 2.7, 45.0), 0.0065),
    # Variants for leader arms, with gear ratios 1:191 and 1:147 instead of 1:345: torque and speed
    # are scaled from the 1:345 variant.
    Model("STS3215-C044", "sts", 777, tables.STS, _COUNT, _motor(7.4, 1.06, 2.5, 94.0), 0.0065),
    Model("STS3215-C046", "sts", 777, tables.STS, _COUNT, _motor(7.4, 0.81, 2.5, 122.0), 0.0065),
)  # fmt: skip

MODELS: dict[str, Model] = {model.name: model for model in _MODELS}
#: Name in `MODELS` of each alias.
ALIASES = {"STS3215": "STS3215-7.4V", "STS3215-C001": "STS3215-7.4V", "STS3215-C018": "STS3215-12V"}


def find(name: str) -> Model:
    """Return the servo model with this name: the maker's model name, or an alias of it.

    Raises:
        ConfigError: No model has this name; the message lists the nearest names.
    """
    model = MODELS.get(ALIASES.get(name, name))
    if model is None:
        near = difflib.get_close_matches(name, [*MODELS, *ALIASES], n=4) or list(MODELS)
        raise ConfigError(f"no servo model {name!r} to emulate; nearest: {', '.join(near)}")
    return model
