"""Base class of emulated servos: memory, shaft, supply, temperature, motor request."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from pliant._core import ConfigError
from pliant.emulator.log import Write

if TYPE_CHECKING:
    from pliant.emulator.control_tables import Register
    from pliant.emulator.models import Model
    from pliant.emulator.packets import Protocol

#: Winding temperature rise above ambient at continuous stall [K], and its time constant [s]: a
#: guess that overheats a stalled servo in half a minute and allows 30 % of the stall torque
#: continuously.
HEAT_AT_STALL, HEAT_TIME = 400.0, 200.0
#: Duration of saturation at standstill that counts as overload [s]; not published by the makers.
OVERLOAD_TIME = 3.0
#: Speed below which a servo counts as at rest [rad/s].
STANDSTILL = 0.1
#: Boot time without replies after power-up or reboot [s].
BOOT_TIME = 0.3
BIT_VOLTAGE, BIT_HEAT, BIT_OVERLOAD = 0x01, 0x04, 0x20


@dataclass(slots=True)
class Shaft:
    """State of the output shaft after a physics step; angle 0 is raw count 0.

    Attributes:
        angle: [rad], unwrapped.
        speed: [rad/s].
        torque: Motor torque at the output, before gear friction [N·m].
    """

    angle: float = 0.0
    speed: float = 0.0
    torque: float = 0.0


@dataclass(slots=True)
class Load:
    """Load on the shaft of an emulated servo without a plant.

    Attributes:
        inertia: In addition to the rotor's [kg·m²].
        torque: Constant external torque [N·m].
        pendulum: Weight times lever arm of a hanging mass [N·m].
        down: Angle at which the mass hangs straight down [rad].
        stops: Hard stops [rad].
    """

    inertia: float = 0.0
    torque: float = 0.0
    pendulum: float = 0.0
    down: float = 0.0
    stops: tuple[float, float] = (-math.inf, math.inf)


@dataclass(frozen=True, slots=True)
class Drive:
    """Request of a servo's firmware to its motor.

    Attributes:
        goal: Angle to hold [rad], None for a motor without power.
        stiffness: [N·m/rad].
        ceiling: Largest torque at standstill [N·m].
        speed: Speed of the motion to the goal [rad/s].
        dead: Error below which the torque is 0 [rad].
        slope: Torque lost per speed, outside the ceiling (back-EMF of a duty limit) [N·m·s/rad].
        kv: Damping inside the ceiling, of a current loop [N·m·s/rad].
    """

    goal: float | None = None
    stiffness: float = 0.0
    ceiling: float = 0.0
    speed: float = math.inf
    dead: float = 0.0
    slope: float = 0.0
    kv: float = 0.0


OFF = Drive()


class Servo(ABC):
    """A live servo: registers, rules and protections of its family.

    Attributes:
        model: Servo model.
        memory: Present control table.
        shaft, load: Its output shaft and the load on it.
        supply: Supply voltage [V].
        temperature: [°C].
        plugged: True if bus and power are connected.
        now: Time of the emulator [s].
        registered: Registered write that waits for an action.
        stuck: Registers that read a fixed value.
        journal: Writes since it was last emptied.
    """

    protocol: ClassVar[Protocol]
    #: Speeds by the value of the register, in a family that has a list of them [bit/s].
    bauds: ClassVar[tuple[int, ...]] = ()

    def __init__(self, model: Model, id: int, *, angle: float | None, **registers: int) -> None:
        """Make a servo in factory state, except for these EEPROM values.

        Raises:
            ConfigError: A register is unknown, in RAM, or the value does not fit.
        """
        self.model, self.table = model, model.table
        self._fields = {r.name: (r.address, r.address + r.size, r.sign) for r in self.table}
        self.memory = bytearray(self.table.size)
        self.stored = bytearray(self.table.size)
        middle = (model.top + 1) / 2 * model.count
        self.shaft = Shaft(middle if angle is None else float(angle))
        self.load = Load()
        self.supply = 14.8 if model.motor.volts > 16.0 else model.motor.volts
        self.ambient = self.temperature = 25.0
        self.plugged = True
        self.now = 0.0
        self.registered: tuple[int, bytes] | None = None
        self.stuck: dict[str, int] = {}
        self.journal: list[Write] = []
        self._deaf_until = -math.inf
        self._strain = 0.0
        for register in self.table:
            self._store(register, register.initial)
        for name, value in {"model_number": model.number, "id": id, **registers}.items():
            register = self.table[name]
            if register.area != "eeprom" or not register.low <= value <= register.high:
                raise ConfigError(
                    f"{model.name}: {name} is {register.area}, {register.low} to {register.high}; "
                    f"a new servo cannot have {value}"
                )
            self._store(register, value)
        self.power_up()
        self.wake()

    def __repr__(self) -> str:
        return f"<{self.model.name} id {self.id}>"

    # Memory.

    def get(self, name: str) -> int:
        """Return a register's value in memory."""
        # Called thousands of times a second, so it avoids `Table` objects if unsigned.
        start, stop, sign = self._fields[name]
        raw = int.from_bytes(self.memory[start:stop], "little")
        return raw if sign is None else self.table[name].decode(self.memory[start:stop])

    def put(self, name: str, value: float) -> None:
        """Set a register without any checks, rounded and clipped to its range."""
        register = self.table[name]
        self.memory[register.address : register.address + register.size] = register.encode(
            round(value)
        )

    def _store(self, register: Register, value: int) -> None:
        data = register.encode(value)
        self.stored[register.address : register.address + register.size] = data

    def keep(self, address: int, length: int) -> None:
        """Store EEPROM bytes, so that they survive power off."""
        self.stored[address : address + length] = self.memory[address : address + length]

    @property
    def id(self) -> int:
        """Its id on the bus."""
        return self.get("id")

    @property
    def hears(self) -> bool:
        """True if it is plugged in and has booted."""
        return self.plugged and self.now >= self._deaf_until

    # Power.

    def power_up(self) -> None:
        """Restart: EEPROM as stored, RAM at initial values, torque off, booting."""
        self._deaf_until = self.now + BOOT_TIME
        self.memory[:] = self.stored
        self.registered, self._strain = None, 0.0
        self.on_power()
        self.refresh()

    def wake(self) -> None:
        """End the boot time immediately."""
        self._deaf_until = -math.inf

    def angle_of(self, count: float) -> float:
        """Return the shaft angle at which this count is reported, whole turns aside [rad]."""
        return self.raw_of(count) * self.model.count

    # Bus.

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Return error and bytes of a block; no bytes after an error."""
        self.refresh()
        for name, value in self.stuck.items():
            self.put(name, value)
        error = self.check_read(address, length)
        places = () if error else self.resolve(address, length)
        return error, bytes(self.memory[byte] for byte in places)

    def write(self, address: int, data: bytes, instruction: str = "write") -> int:
        """Write a block if the rules allow it, record it, and return the error.

        A block with one rejected register is rejected as a whole.
        """
        enabled = self.enabled
        places = self.resolve(address, len(data))
        runs = _runs(places, data)
        error = 0
        for start, part in runs:
            error = error or self.check_write(start, part)
        for start, part in runs:
            self.journal.append(
                Write(self.now, self.id, instruction, start, part, enabled, error, self.table)
            )
            if not error:
                self.memory[start : start + len(part)] = part
                self.on_write(start, part)
        return error

    def resolve(self, address: int, length: int) -> list[int]:
        """Return the real addresses of these bytes (indirect addressing)."""
        return list(range(address, address + length))

    # Physics.

    @property
    def stall(self) -> float:
        """Stall torque at the present voltage [N·m]."""
        return self.model.motor.stall * self.supply / self.model.motor.volts

    @property
    def duty(self) -> float:
        """Duty of the motor as a share of the supply, signed."""
        motor, speed = self.model.motor, self.shaft.speed
        share = (self.shaft.torque + motor.slope * speed) / max(self.stall, 1e-9)
        return max(-1.0, min(share, 1.0)) if self.enabled else 0.0

    @property
    def current(self) -> float:
        """Motor current, signed [A]."""
        return self.shaft.torque / self.model.motor.torque_per_amp if self.enabled else 0.0

    def update(self, seconds: float) -> None:
        """Update temperature, overload time and protections after a physics step."""
        share = self.shaft.torque / self.model.motor.stall
        target = self.ambient + HEAT_AT_STALL * share * share
        self.temperature += (target - self.temperature) * min(seconds / HEAT_TIME, 1.0)
        self.protect(seconds)

    def faults(self) -> int:
        """Return the present bits of voltage and heat, from the limits in EEPROM."""
        low, high = self.get("min_voltage_limit"), self.get("max_voltage_limit")
        bits = (
            0
            if low <= self.supply * 10.0 + 1e-6 and self.supply * 10.0 <= high + 1e-6
            else (BIT_VOLTAGE)
        )
        return bits | (BIT_HEAT if self.temperature > self.get("temperature_limit") else 0)

    def strained(self, seconds: float, threshold: float) -> bool:
        """Count the time at or above a torque at standstill; return True for an overload."""
        at_limit = self.enabled and abs(self.shaft.torque) >= threshold > 0.0
        still = abs(self.shaft.speed) < STANDSTILL
        self._strain = self._strain + seconds if at_limit and still else 0.0
        return self._strain > OVERLOAD_TIME

    # Members that a servo family implements, or overrides if its registers differ.

    @property
    def baud(self) -> int:
        """Baud rate [bit/s]."""
        return self.bauds[self.get("baud_rate")]

    @property
    def enabled(self) -> bool:
        """True if torque is on; 2 of a Feetech (damping) gives no torque here."""
        return self.get("torque_enable") == 1

    @property
    def level(self) -> int:
        """Reply level: 0 pings only, 1 also reads, 2 everything."""
        return self.get("status_return_level")

    @property
    def direction(self) -> int:
        """1, or -1 if reported counts fall as the shaft turns forward."""
        return 1

    @abstractmethod
    def raw_of(self, count: float) -> float:
        """Return the raw count behind a reported one, whole turns aside."""

    @property
    def return_delay(self) -> float:
        """Pause before a reply [s]."""
        return self.get("return_delay_time") * 2e-6

    def set_baud(self, baud: int) -> None:
        """Store a speed in EEPROM.

        Raises:
            ConfigError: The family has no such speed.
        """
        bauds = self.bauds[: self.table["baud_rate"].high + 1]
        if baud not in bauds:
            rates = ", ".join(map(str, bauds))
            raise ConfigError(f"{self.model.name} cannot do {baud} bit/s; it has {rates}")
        self.put("baud_rate", bauds.index(baud))
        self.keep(self.table["baud_rate"].address, 1)

    @abstractmethod
    def status(self) -> int:
        """Return the condition bits of every reply."""

    @abstractmethod
    def check_read(self, address: int, length: int) -> int:
        """Return the protocol's error code for a read of `length` bytes; 0 if it is accepted."""

    @abstractmethod
    def check_write(self, address: int, data: bytes) -> int:
        """Return the error code of a write: 0 if accepted, -1 if ignored without a reply."""

    @abstractmethod
    def on_write(self, address: int, data: bytes) -> None:
        """Apply the side effects of an accepted write."""

    @abstractmethod
    def on_power(self) -> None:
        """Set the RAM registers whose initial values are not constant."""

    @abstractmethod
    def refresh(self) -> None:
        """Update the present-value registers."""

    @abstractmethod
    def drive(self) -> Drive:
        """Return the request to the motor."""

    @abstractmethod
    def protect(self, seconds: float) -> None:
        """Apply the protections: trips, latches, timeouts."""

    @abstractmethod
    def trip(self, bit: int) -> None:
        """Simulate the detection of a condition (overload, heat, voltage), for tests."""


def _runs(places: list[int], data: bytes) -> list[tuple[int, bytes]]:
    """Group bytes by contiguous addresses."""
    runs: list[tuple[int, bytearray]] = []
    for place, byte in zip(places, data, strict=True):
        if runs and place == runs[-1][0] + len(runs[-1][1]):
            runs[-1][1].append(byte)
        else:
            runs.append((place, bytearray((byte,))))
    return [(start, bytes(part)) for start, part in runs]
