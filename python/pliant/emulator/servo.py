"""Base class of emulated servos: registers, shaft, supply, temperature, motor request."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cache
from struct import Struct
from typing import TYPE_CHECKING, ClassVar

from pliant._core import ConfigError
from pliant.emulator.log import Write

if TYPE_CHECKING:
    from pliant.emulator.control_tables import Register, Table
    from pliant.emulator.models import Model
    from pliant.emulator.packets import Protocol

#: Temperature rise above ambient at continuous stall [K] and its time constant [s]. Both are
#: assumed: a stalled servo overheats within half a minute, one at 30 % of its stall torque never.
HEAT_AT_STALL, HEAT_TIME = 400.0, 200.0
#: Time at standstill with the torque at its limit that counts as overload [s]; assumed, because
#: makers do not publish it.
OVERLOAD_TIME = 3.0
#: Speed below which a servo counts as at rest [rad/s].
STANDSTILL = 0.1
#: Time without replies after power-up or reboot [s].
BOOT_TIME = 0.3
BIT_VOLTAGE, BIT_HEAT, BIT_OVERLOAD = 0x01, 0x04, 0x20


@dataclass(slots=True)
class Shaft:
    """State of the output shaft after a physics step.

    Attributes:
        angle: Multi-turn angle, 0 at encoder count 0 [rad].
        speed: Angular velocity [rad/s].
        torque: Motor torque at the output, before gear friction [N·m].
    """

    angle: float = 0.0
    speed: float = 0.0
    torque: float = 0.0


@dataclass(slots=True)
class Load:
    """Load on the shaft of an emulated servo that moves independently of other servos.

    Attributes:
        inertia: Inertia of the load, in addition to the rotor inertia [kg·m²].
        torque: Constant external torque [N·m].
        pendulum: Weight times lever arm of a hanging mass [N·m].
        down: Shaft angle at which the mass hangs straight down [rad].
        stops: Lowest and highest shaft angle, at hard stops [rad].
    """

    inertia: float = 0.0
    torque: float = 0.0
    pendulum: float = 0.0
    down: float = 0.0
    stops: tuple[float, float] = (-math.inf, math.inf)


@dataclass(frozen=True, slots=True)
class Drive:
    """Motor request: goal and parameters of a servo's position loop, as its registers set them.

    Attributes:
        goal: Goal angle of the shaft [rad]; None for a motor without power.
        stiffness: Torque per position error [N·m/rad].
        ceiling: Largest torque at standstill [N·m].
        speed: Speed of the motion profile [rad/s].
        dead: Dead zone: the torque is 0 for a smaller position error [rad].
        slope: Torque loss per speed (back-EMF), which the ceiling does not clip [N·m·s/rad].
        kv: Damping of the current loop, which the ceiling clips [N·m·s/rad].
    """

    goal: float | None = None
    stiffness: float = 0.0
    ceiling: float = 0.0
    speed: float = math.inf
    dead: float = 0.0
    slope: float = 0.0
    kv: float = 0.0


OFF = Drive()

#: Codes of `struct` for unsigned numbers by their size [byte].
_CODES = {1: "B", 2: "H", 4: "I"}


#: Code of the raw value of a register, its address, its smallest and largest value, and the value
#: of the sign bit of sign and magnitude; 0 for other codings.
Codec = tuple[Struct, int, int, int, int]


@cache
def codecs(table: Table) -> dict[str, Codec]:
    """Return the codecs of the registers of a table by name; they code as `Register` does."""
    result: dict[str, Codec] = {}
    for register in table:
        letter, span = _CODES[register.size], 1 << 8 * register.size
        bit = 1 << register.sign if register.sign else 0
        if register.sign == 0:
            letter, low, high = letter.lower(), -span // 2, span // 2 - 1
        else:
            low, high = (1 - bit, bit - 1) if bit else (0, span - 1)
        result[register.name] = (Struct("<" + letter), register.address, low, high, bit)
    return result


class Servo(ABC):
    """Emulated servo: registers, access rules and protections; one subclass per family.

    Attributes:
        model: Servo model.
        memory: Present bytes of the control table.
        stored: Bytes that the control table has after the next power-up.
        shaft, load: Output shaft and the load on it.
        supply: Supply voltage [V].
        temperature: Winding temperature [°C].
        plugged: True if bus and power are connected.
        now: Time of the emulator [s].
        registered: Address and bytes of a REG_WRITE that waits for ACTION; None: there is none.
        stiffness_scale: Factor on the stiffness that follows from registers and supply, of a servo
            that differs from its model.
        stuck: Fixed readings of registers by register name, for tests.
        journal: Register writes that are not in the log of the bus yet.
    """

    protocol: ClassVar[Protocol]
    #: Baud rates by value of the register Baud Rate [bit/s]; empty if the family uses a formula.
    bauds: ClassVar[tuple[int, ...]] = ()

    def __init__(self, model: Model, id: int, *, angle: float | None, **registers: int) -> None:
        """Create a booted servo in factory state, except for the EEPROM values `registers`.

        Args:
            model: Servo model.
            id: Id on the bus.
            angle: Shaft angle [rad]; None: the middle of the encoder's range.
            **registers: EEPROM values by register name.

        Raises:
            ConfigError: A register is unknown or in RAM, or its value does not fit.
        """
        self.model, self.table = model, model.table
        self._codecs = codecs(self.table)
        self.memory = bytearray(self.table.size)
        self.stored = bytearray(self.table.size)
        middle = (model.max_position + 1) / 2 * model.count
        self.shaft = Shaft(middle if angle is None else float(angle))
        self.load = Load()
        self.supply = 14.8 if model.motor.volts > 16.0 else model.motor.volts
        self.ambient = self.temperature = 25.0
        self.plugged = True
        self.now = 0.0
        self.registered: tuple[int, bytes] | None = None
        self.stiffness_scale = 1.0
        self.stuck: dict[str, int] = {}
        self.journal: list[Write] = []
        self._boot_end = -math.inf
        self._overload_time = 0.0
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

    # Methods for access to the control table.

    def get(self, name: str) -> int:
        """Return the present value of the register `name`."""
        # Decode without `Register`: this runs thousands of times a second.
        code, address, _, _, bit = self._codecs[name]
        raw: int = code.unpack_from(self.memory, address)[0]
        if bit:
            return -(raw & (bit - 1)) if raw & bit else raw & (bit - 1)
        return raw

    def put(self, name: str, value: float) -> None:
        """Set a register without access checks; the value is rounded and clipped to its range."""
        try:
            code, address, low, high, bit = self._codecs[name]
        except KeyError:
            _ = self.table[name]  # raises an error that lists the registers
            raise
        number = max(low, min(round(value), high))
        code.pack_into(self.memory, address, bit - number if bit and number < 0 else number)

    def _store(self, register: Register, value: int) -> None:
        data = register.encode(value)
        self.stored[register.address : register.address + register.size] = data

    def keep(self, address: int, length: int) -> None:
        """Copy bytes of the control table to `stored`, so that they survive a power cycle."""
        self.stored[address : address + length] = self.memory[address : address + length]

    @property
    def id(self) -> int:
        """Id on the bus."""
        return self.get("id")

    @property
    def is_listening(self) -> bool:
        """True if the servo is connected and has booted, so that it receives requests."""
        return self.plugged and self.now >= self._boot_end

    # Power-up, and conversion of positions.

    def power_up(self) -> None:
        """Restart the servo with stored EEPROM and initial RAM values; start the boot time."""
        self._boot_end = self.now + BOOT_TIME
        self.memory[:] = self.stored
        self.registered, self._overload_time = None, 0.0
        self.on_power()
        self.refresh()

    def wake(self) -> None:
        """End the boot time immediately."""
        self._boot_end = -math.inf

    def angle_of(self, count: float) -> float:
        """Return the shaft angle at which the servo reports `count`, within one turn [rad]."""
        return self.raw_of(count) * self.model.count

    # Methods that execute requests from the bus.

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Return error code and bytes of a read of `length` bytes; no bytes after an error."""
        self.refresh()
        for name, value in self.stuck.items():
            self.put(name, value)
        error = self.check_read(address, length)
        addresses = () if error else self.resolve(address, length)
        return error, bytes(self.memory[byte] for byte in addresses)

    def write(self, address: int, data: bytes, instruction: str = "write") -> int:
        """Write `data` from `address` on if every register accepts it; return the error code.

        The write is recorded in `journal` as `instruction`, also if it is rejected.
        """
        enabled = self.enabled
        runs = _runs(self.resolve(address, len(data)), data)
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
        """Return the table addresses of `length` bytes from `address` on.

        Servos with indirect addressing or addresses beyond the table override this method.
        """
        return list(range(address, address + length))

    # Motor state, and updates after physics steps.

    @property
    def stall(self) -> float:
        """Stall torque at the present supply voltage [N·m]."""
        return self.stall_at(self.supply)

    def stall_at(self, volts: float) -> float:
        """Return the stall torque at a supply voltage [N·m]."""
        return self.model.motor.stall * volts / self.model.motor.volts

    @property
    def stiffness(self) -> float:
        """Torque per position error [N·m/rad] at the present gain and supply voltage."""
        gain = self.get(self.gain_register)
        return self.stiffness_scale * self.model_stiffness(gain, self.supply)

    @property
    def duty(self) -> float:
        """Duty of the motor voltage with sign, -1 to 1; 0 with torque off."""
        motor, speed = self.model.motor, self.shaft.speed
        share = (self.shaft.torque + motor.slope * speed) / max(self.stall, 1e-9)
        return max(-1.0, min(share, 1.0)) if self.enabled else 0.0

    @property
    def current(self) -> float:
        """Motor current with sign [A]; 0 with torque off."""
        return self.shaft.torque / self.model.motor.torque_per_amp if self.enabled else 0.0

    def update(self, seconds: float) -> None:
        """Update temperature and protections after physics steps of `seconds` [s] in total."""
        share = self.shaft.torque / self.model.motor.stall
        target = self.ambient + HEAT_AT_STALL * share * share
        self.temperature += (target - self.temperature) * min(seconds / HEAT_TIME, 1.0)
        self.protect(seconds)

    def faults(self) -> int:
        """Return the error bits for a voltage or temperature outside the limits in EEPROM."""
        low, high = self.get("min_voltage_limit"), self.get("max_voltage_limit")
        bits = (
            0
            if low <= self.supply * 10.0 + 1e-6 and self.supply * 10.0 <= high + 1e-6
            else (BIT_VOLTAGE)
        )
        return bits | (BIT_HEAT if self.temperature > self.get("temperature_limit") else 0)

    def is_overloaded(self, seconds: float, threshold: float) -> bool:
        """Return True after `OVERLOAD_TIME` at standstill with a torque of at least `threshold`.

        Args:
            seconds: Time since the last call [s].
            threshold: Motor torque above which time counts toward an overload [N·m].
        """
        at_limit = self.enabled and abs(self.shaft.torque) >= threshold > 0.0
        still = abs(self.shaft.speed) < STANDSTILL
        self._overload_time = self._overload_time + seconds if at_limit and still else 0.0
        return self._overload_time > OVERLOAD_TIME

    # Members that a servo family implements, or overrides if its registers differ.

    @property
    def baud(self) -> int:
        """Baud rate that the servo's registers set [bit/s]."""
        return self.bauds[self.get("baud_rate")]

    @property
    def enabled(self) -> bool:
        """True if torque is on; the damping mode of Feetech (value 2) counts as off."""
        return self.get("torque_enable") == 1

    @property
    def level(self) -> int:
        """Status Return Level: 0 replies to pings, 1 also to reads, 2 to all instructions."""
        return self.get("status_return_level")

    @property
    def direction(self) -> int:
        """1, or -1 if reported counts fall as the shaft turns forward."""
        return 1

    @property
    @abstractmethod
    def gain_register(self) -> str:
        """Name of the register with the gain of the position loop."""

    @abstractmethod
    def model_stiffness(self, gain: int, volts: float) -> float:
        """Return the torque per position error [N·m/rad] of this servo model.

        `gain` is the value of the register `gain_register`, `volts` the supply voltage [V].
        """

    @abstractmethod
    def raw_of(self, count: float) -> float:
        """Return the encoder count at which the servo reports `count`, within one turn."""

    @property
    def return_delay(self) -> float:
        """Delay between a request and the reply [s]."""
        return self.get("return_delay_time") * 2e-6

    def set_baud(self, baud: int) -> None:
        """Store the register value of the baud rate `baud` [bit/s] in EEPROM.

        Raises:
            ConfigError: The servo does not support this baud rate.
        """
        bauds = self.bauds[: self.table["baud_rate"].high + 1]
        if baud not in bauds:
            rates = ", ".join(map(str, bauds))
            raise ConfigError(f"{self.model.name} cannot do {baud} bit/s; it has {rates}")
        self.put("baud_rate", bauds.index(baud))
        self.keep(self.table["baud_rate"].address, 1)

    @abstractmethod
    def status(self) -> int:
        """Return the bits of present conditions (overheating, ...), which every reply contains."""

    @abstractmethod
    def check_read(self, address: int, length: int) -> int:
        """Return the protocol's error code for a read of `length` bytes; 0 if it is accepted."""

    @abstractmethod
    def check_write(self, address: int, data: bytes) -> int:
        """Return the error code of a write: 0 if accepted, -1 if ignored without an error reply."""

    @abstractmethod
    def on_write(self, address: int, data: bytes) -> None:
        """Apply the side effects of an accepted write of `data` from `address` on."""

    @abstractmethod
    def on_power(self) -> None:
        """At power-up, set the RAM registers whose initial values are not constant."""

    @abstractmethod
    def refresh(self) -> None:
        """Write position, speed, load, voltage and temperature to the registers for them."""

    @abstractmethod
    def drive(self) -> Drive:
        """Return the motor request that follows from the present registers."""

    @abstractmethod
    def protect(self, seconds: float) -> None:
        """Apply the servo's protections, such as overload, `seconds` [s] after the last call."""

    @abstractmethod
    def trip(self, bit: int) -> None:
        """React as if the servo had detected the condition with the error bit `bit`."""


def _runs(addresses: list[int], data: bytes) -> list[tuple[int, bytes]]:
    """Group bytes with these addresses into contiguous blocks: first address and bytes of each."""
    runs: list[tuple[int, bytearray]] = []
    for address, byte in zip(addresses, data, strict=True):
        if runs and address == runs[-1][0] + len(runs[-1][1]):
            runs[-1][1].append(byte)
        else:
            runs.append((address, bytearray((byte,))))
    return [(start, bytes(part)) for start, part in runs]
