"""Description of one emulated servo: `Device`."""

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
    """Description of one servo to emulate.

    Args:
        model: Name of the servo model: `STS3215`, `XM430-W350`, `MX-64`, `MX-64(2.0)`, ...
        id: Id on the bus, below 253 (Protocol 1.0 and Feetech: below 254).
        port: Name of the emulated port of the servo; a new name creates a port.
        angle: Initial shaft angle [rad], 0 at encoder count 0; by default mid-range.
        **registers: EEPROM values that differ from the factory values (`operating_mode=5`).

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
        """Create and return the emulated servo that this object describes.

        Args:
            baud: Baud rate unless `registers` sets it [bit/s]; None keeps the factory value.

        Raises:
            ConfigError: A register is unknown, its value does not fit, or the servo does not
                support the baud rate.
        """
        if not 0 <= self.id < BROADCAST_ID:
            raise ConfigError(f"id must be 0 to {BROADCAST_ID - 1}, got {self.id}")
        family = _FAMILIES[self.model.family]
        servo = family(self.model, self.id, angle=self.angle, **self.registers)
        if baud is not None and "baud_rate" not in self.registers:
            servo.set_baud(baud)
        return servo
