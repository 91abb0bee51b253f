"""An arm on an emulated bus: the driver that real servos get, over real bytes, on physics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pliant.config import assemble, build
from pliant.servo import ServoChain, find
from pliant.servo.emulator import Mount, emulate
from pliant.servo.emulator.process import Remote

if TYPE_CHECKING:
    from pliant import Model
    from pliant.config.schema import Config
    from pliant.servo.emulator.arm import ArmEmulator

#: Least time to wait for an answer [s]: the emulator shares the machine with its host.
PATIENCE = 0.05


class EmulatedChain(ServoChain):
    """The servos of a configuration on an emulator in a process of its own.

    Attributes:
        emulator: The emulator; `emulator.call("faults.inject", …)` reaches into it.
    """

    def __init__(self, config: Config, model: Model) -> None:
        """Start the emulator."""
        self.emulator = Remote(emulated, config)
        bauds = {self.emulator.ports[port.name]: port.baud for port in config.port}
        super().__init__(
            assemble.specs(config, self.emulator.ports),
            baudrate=bauds,
            rate=config.loop.rate,
            patience=max(PATIENCE, config.loop.patience),
        )

    def close(self) -> None:
        """Let go of the ports; the emulator ends."""
        super().close()
        self.emulator.stop()


def emulated(config: Config, **options: Any) -> ArmEmulator:
    """The emulator of a configuration's arm, in real time, not yet started.

    Somebody holds the arm until torque comes on; the supply has the configuration's voltage.

    Args:
        config: The configuration.
        **options: Of `pliant.servo.emulator.emulate`: `timing`, `faults`, `clock`, `plant`, ...
    """
    model = config.model()
    bus = emulate(model, mounts(config), assemble.start(config, model), held=True, **options)
    if config.supply.voltage is not None:
        bus.supply(config.supply.voltage)
    return bus


def mounts(config: Config) -> list[Mount]:
    """Where each emulated servo sits."""
    zeros = build.zeros(config)
    out = []
    for joint, servo in build.servos(config).items():
        zero = zeros[joint]
        out.append(
            Mount(
                joint=joint,
                model=servo.model,
                id=servo.id,
                sign=servo.sign,
                zero=None if zero is None else round(zero),
                gear=servo.gear,
                twin=None if servo.twin is None else (servo.twin.id, servo.twin.sign),
                port=servo.port,
                registers=_as_set_up(servo.model),
            )
        )
    return out


def _as_set_up(model: str) -> dict[str, int]:
    """EEPROM as `pliant setup` leaves it: answers at once, current-based position mode."""
    row = find(model)
    mode = {"operating_mode": 5} if row.kind == "current" else {}
    return {"return_delay_time": 0, **mode}
