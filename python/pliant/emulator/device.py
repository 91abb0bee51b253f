"""`Device`, the description of one emulated servo."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pliant._core import ConfigError
from pliant.emulator._dynamixel1 import Dxl1Servo
from pliant.emulator._feetech import StsServo
from pliant.emulator._x_series import XServo
from pliant.emulator.models import find

if TYPE_CHECKING:
    from pliant.emulator.servo import Servo

_FAMILIES: dict[str, type[Servo]] = {"dxl1": Dxl1Servo, "x": XServo, "sts": StsServo}
BROADCAST_ID = 254


class Device:
    """One servo to emulate.

    Args:
        model: Maker's name: `STS3215`, `XM430-W350`, `MX-64`, `MX-64(2.0)`, ...
        id: On the bus, below 253 (P1, Feetech: 254).
        port: Name of its port; a new name creates a port.
        angle: Initial shaft angle [rad], 0 at raw count 0; default the middle.
        **registers: EEPROM values that differ from a new servo's, by name (`operating_mode=5`).

    Raises:
        ConfigError: The model or a register is unknown, or a value does not fit.
    """

    def __init__(
        self,
        model: str,
        id: int = 1,
        *,
        port: str = "main",
        angle: float | None = None,
        **registers: int,
    ) -> None:
        self.model, self.id, self.port, self.angle = find(model), int(id), port, angle
        self.registers = registers
        self.build(None)

    def __repr__(self) -> str:
        return f"Device({self.model.name!r}, id={self.id})"

    def build(self, baud: int | None) -> Servo:
        """Make a live servo; without a `baud_rate` it gets this speed [bit/s].

        Raises:
            ConfigError: A register is unknown or does not fit, or the speed is not supported.
        """
        if not 0 <= self.id < BROADCAST_ID:
            raise ConfigError(f"id must be 0 to {BROADCAST_ID - 1}, got {self.id}")
        family = _FAMILIES[self.model.family]
        servo = family(self.model, self.id, angle=self.angle, **self.registers)
        if baud is not None and "baud_rate" not in self.registers:
            servo.set_baud(baud)
        return servo
