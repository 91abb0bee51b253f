"""Arm on an emulated bus: the real servo driver and real bytes, with simulated physics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pliant.arm.checks import vector
from pliant.config import assemble, build
from pliant.emulator import Mount, emulate
from pliant.emulator.process import Remote
from pliant.servo import ServoBus, find

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from pliant import Model
    from pliant.config.schema import Config, Servo
    from pliant.emulator.arm import ArmEmulator
    from pliant.servo.calibration import Calibration

#: Minimum reply timeout [s]: the emulator runs on the same machine as the program.
PATIENCE = 0.05
#: Emulator names of calibration registers, if they differ from pliant's; second: Protocol 1.0.
REGISTERS = {"position_min": "min_position_limit", "position_max": "max_position_limit"}
REGISTERS_P1 = {"position_min": "cw_angle_limit", "position_max": "ccw_angle_limit"}


class EmulatedChain(ServoBus):
    """Servo bus of a configuration on an emulator in a separate process.

    Attributes:
        emulator: The emulator; `emulator.call("faults.inject", …)` calls its functions.
    """

    def __init__(self, config: Config, model: Model, *, q: ArrayLike | None = None) -> None:
        """Start the emulator with the arm at q (n,) [rad], by default near zero."""
        at = None if q is None else vector(model, q, "q").tolist()
        self.emulator = Remote(emulated, config, q=at)
        bauds = {self.emulator.ports[port.name]: port.baud for port in config.port}
        super().__init__(
            assemble.specs(config, self.emulator.ports),
            baudrate=bauds,
            rate=config.loop.rate,
            patience=max(PATIENCE, config.loop.patience),
        )

    def close(self) -> None:
        """Close the ports and end the emulator."""
        super().close()
        self.emulator.stop()


def emulated(config: Config, *, q: ArrayLike | None = None, **options: Any) -> ArmEmulator:
    """Return the emulator of a configuration's arm, in real time, not started yet.

    The arm stands on the configuration's table, and is held until torque comes on. The supply has
    the configuration's voltage.

    Args:
        config: The configuration.
        q: Initial joint positions (n,) [rad]; None: as in `assemble.start`.
        **options: Options of `pliant.emulator.emulate`: `timing`, `faults`, `clock`, `plant`, ...
    """
    model = config.model()
    plant = dict(options.pop("plant", None) or {})
    plant["scene"] = [*assemble.tabletop(config), *plant.get("scene", ())]
    at = assemble.start(config, model) if q is None else q
    bus = emulate(model, mounts(config), at, plant=plant, held=True, **options)
    assemble.above_table(bus.plant)
    if config.supply.voltage is not None:
        bus.supply(config.supply.voltage)
    return bus


def mounts(config: Config) -> list[Mount]:
    """Return the mounting of each emulated servo."""
    zeros, files = build.zeros(config), build.calibrations(config)
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
                secondary=None
                if servo.secondary is None
                else (servo.secondary.id, servo.secondary.sign),
                port=servo.port,
                registers=_as_set_up(servo) | _calibrated(files.get(joint), servo),
            )
        )
    return out


def _as_set_up(servo: Servo) -> dict[str, int]:
    """Return EEPROM as after `pliant servos setup`: no return delay, current-based position."""
    row = find(servo.model)
    mode = {"operating_mode": 5} if row.kind == "current" else {}
    gain = {} if servo.gain is None else {"p_coefficient": servo.gain}
    return {"return_delay_time": 0, **mode, **gain}


def _calibrated(file: Calibration | None, servo: Servo) -> dict[str, int]:
    """Return EEPROM as after LeRobot's calibration of the arm."""
    if file is None:
        return {}
    family = find(servo.model).family
    names = REGISTERS_P1 if family.status == "p1" else REGISTERS
    written = file.registers(family.registers)
    return {names.get(name, name): value for name, value in written.items()}
