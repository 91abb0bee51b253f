"""Data types of the servo tables: registers, families with one control table, servo models.

Values on the wire are little-endian. A `Register` defines address, size and sign of a value; a
`ServoModel` defines the unit of the value.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from math import nan
from struct import Struct
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping

Sign = Literal["unsigned", "twos", "bit10", "bit11", "bit15"]
Protocol = Literal["p1", "p2"]
Kind = Literal["pwm", "current"]


@dataclass(frozen=True, slots=True)
class Register:
    """One entry of a control table.

    Attributes:
        address: Address of the first byte.
        size: Number of bytes: 1, 2 or 4.
        sign: Coding of the sign: `unsigned`; `twos`: two's complement; `bit10` to `bit15`: sign and
            magnitude, with the sign in that bit.
    """

    address: int
    size: int
    sign: Sign = "unsigned"

    def encode(self, value: int) -> bytes:
        """Return the bytes that encode a value; size and sign coding must be able to hold it."""
        if self.sign == "twos":
            return value.to_bytes(self.size, "little", signed=True)
        if value < 0 and self.sign != "unsigned":
            value = -value | 1 << int(self.sign[3:])
        return value.to_bytes(self.size, "little")

    def decode(self, data: bytes) -> int:
        """Return the value that these bytes of the register encode."""
        value = int.from_bytes(data, "little", signed=self.sign == "twos")
        if self.sign in {"unsigned", "twos"}:
            return value
        bit = 1 << int(self.sign[3:])
        magnitude = value & (bit - 1)
        return -magnitude if value & bit else magnitude


class Block(NamedTuple):
    """Contiguous registers that one transaction reads or writes.

    Attributes:
        address: Address of the first byte.
        size: Number of bytes.
    """

    address: int
    size: int


#: Registers of a reading and of a command, in the order that `pliant._core.ServoCodec` expects.
READING_REGISTERS = ("position", "speed", "load", "current", "voltage", "temperature")
COMMAND_REGISTERS = ("goal", "limit", "speed_cap")
#: Registers of readings and of the status, and registers that are written every cycle.
CYCLIC_REGISTERS = frozenset(
    (
        *READING_REGISTERS,
        *("torque_enable", "hardware_error", "watchdog"),
        *COMMAND_REGISTERS,
        *("goal_time", "goal_velocity", "acceleration_cap"),
    )
)


class Layout:
    """Registers within a block, which are encoded and decoded together.

    Args:
        block: The block.
        registers: Registers by name; a register that is not entirely in the block is ignored.

    Attributes:
        has_status: True if the block contains a register that is not in `READING_REGISTERS`.
    """

    def __init__(self, block: Block, registers: Mapping[str, Register]) -> None:
        end = block.address + block.size
        rows = sorted(
            (r.address, name)
            for name, r in registers.items()
            if block.address <= r.address and r.address + r.size <= end
        )
        self._names = tuple(name for _, name in rows)
        self.has_status = not set(READING_REGISTERS).issuperset(self._names)
        # Index and sign bit of the registers that are coded as magnitude and sign.
        self._sign_bits: list[tuple[int, int]] = []
        code, position = "<", block.address
        for index, (address, name) in enumerate(rows):
            register = registers[name]
            letter = {1: "B", 2: "H", 4: "I"}[register.size]
            code += "x" * (address - position) + (
                letter.lower() if register.sign == "twos" else letter
            )
            position = address + register.size
            if register.sign not in {"unsigned", "twos"}:
                self._sign_bits.append((index, 1 << int(register.sign[3:])))
        self._format = code + "x" * (end - position)
        self._struct = Struct(self._format)
        self._zeros = (0,) * len(rows)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state to pickle, with the format in place of the `Struct`."""
        return {name: value for name, value in self.__dict__.items() if name != "_struct"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore the pickled state, and make the `Struct` from its format."""
        self.__dict__.update(state)
        self._struct = Struct(self._format)

    def decode(self, data: bytes) -> dict[str, int]:
        """Return the values of the registers by name from the bytes of the block."""
        row = list(self._struct.unpack(data))
        for index, bit in self._sign_bits:
            value = row[index]
            if value >= bit:
                row[index] = -(value & (bit - 1)) if value & bit else value & (bit - 1)
        return dict(zip(self._names, row, strict=True))

    def encode(self, values: Mapping[str, int]) -> bytes:
        """Return the bytes of the block; registers without a value are 0.

        Size and sign coding of the registers must be able to hold the values.
        """
        row = list(map(values.get, self._names, self._zeros))
        for index, bit in self._sign_bits:
            if row[index] < 0:
                row[index] = -row[index] | bit
        return self._struct.pack(*row)


def nested_blocks(inner: Block, outer: Block) -> tuple[Block, ...]:
    """Return blocks of all lengths from the length of `inner` to that of `outer`, shortest first.

    Each block contains the previous one.
    """
    end = outer.address + outer.size
    sizes = range(inner.size, outer.size + 1)
    return tuple(Block(min(inner.address, end - size), size) for size in sizes)


@dataclass(frozen=True, kw_only=True)
class Family:
    """Servo models with the same control table and protocol.

    Attributes:
        name: Name of the family in the documentation.
        protocol: `p1` (Dynamixel 1.0, Feetech STS) or `p2` (Dynamixel 2.0).
        status: Encoding of the status byte, see `pliant.servo._status`.
        registers: Control table by register name.
        read: Blocks with position, speed and load, from short to long. The shortest is read; a
            longer one while a late reply with the length of the shorter may still arrive.
        write: Register names of each packet that writes limit, speed cap and goal. There are two
            packets if these registers are not contiguous.
        sync_read: True if one request can read several servos.
        full_duty: Value of the register that limits duty at 100 %.
        full_load: Value of the load register at 100 %.
        speed_max: Largest value of the speed cap register.
        ceiling: Name of the EEPROM register that bounds the limit register from above.
        multi_turn: True if goals may exceed one turn: software enforces the position limits.
        drive_values: Further RAM registers that limit torque or motion, and their values while the
            servo is driven: a number, or the register that contains it.
    """

    name: str
    protocol: Protocol
    status: Literal["p1", "p2", "feetech"]
    registers: Mapping[str, Register]
    read: tuple[Block, ...]
    write: tuple[tuple[str, ...], ...]
    sync_read: bool
    full_duty: int
    full_load: int
    speed_max: int
    ceiling: str
    multi_turn: bool = False
    drive_values: Mapping[str, int | str] = field(default_factory=dict)

    @property
    def restored_registers(self) -> tuple[str, ...]:
        """Names of the RAM registers whose initial values are restored after torque off.

        They are all registers that are written, except the goal.
        """
        cyclic = [name for names in self.write for name in names if name != "goal"]
        watchdog = ["watchdog"] if "watchdog" in self.registers else []
        return (*cyclic, *self.drive_values, *watchdog)

    def block(self, *names: str) -> Block:
        """Return the block from the first to the last of the registers `names`."""
        registers = [self.registers[name] for name in names]
        first = min(r.address for r in registers)
        return Block(first, max(r.address + r.size for r in registers) - first)

    @cached_property
    def _layouts(self) -> dict[Block, Layout]:
        """Layouts of the blocks used so far."""
        return {}

    def layout(self, block: Block) -> Layout:
        """Return the layout of those `CYCLIC_REGISTERS` that a block contains."""
        layout = self._layouts.get(block)
        if layout is None:
            registers = {n: r for n, r in self.registers.items() if n in CYCLIC_REGISTERS}
            layout = self._layouts[block] = Layout(block, registers)
        return layout

    @cached_property
    def status_blocks(self) -> tuple[Block, ...]:
        """Blocks of status registers, the block that shows faults first."""
        if self.status == "p2":
            single = ("hardware_error", "torque_enable", "watchdog")
            return (
                *(self.block(name) for name in single),
                *self.stored_command_blocks,
                self.block("voltage", "temperature"),
            )
        # Every reading contains voltage and temperature, so they need no status block.
        return (self.block("torque_enable", "limit", "goal"),)

    @cached_property
    def stored_command_blocks(self) -> tuple[Block, ...]:
        """Blocks of the goal and limit registers, to read the last command back: one per packet."""
        return tuple(
            self.block(*(name for name in names if name in {"goal", "limit"}))
            for names in self.write
        )

    @cached_property
    def read_with_status(self) -> tuple[Block, ...]:
        """Blocks of `read`, those with all status registers first; empty if none has them all."""
        if len(self.status_blocks) > 1:
            return ()
        address, size = self.status_blocks[0]
        matching = [b for b in self.read if b.address <= address and address + size <= sum(b)]
        return (*matching, *(b for b in self.read if b not in matching)) if matching else ()

    @cached_property
    def write_blocks(self) -> tuple[Block, ...]:
        """Block of each packet in `write`."""
        return tuple(self.block(*names) for names in self.write)

    @cached_property
    def codec_registers(self) -> tuple[int, ...]:
        """Registers and write packets as `pliant._core.ServoCodec.configure` takes them."""
        rows: list[int] = []
        for name in (*READING_REGISTERS, *COMMAND_REGISTERS, "torque_enable"):
            register = self.registers.get(name)
            if register is None:
                rows += (0, 0, 0)
            else:
                sign = {"unsigned": 0, "twos": -1}.get(register.sign)
                sign = 1 << int(register.sign[3:]) if sign is None else sign
                rows += (register.address, register.size, sign)
        for block in (*self.write_blocks, Block(0, 0))[:2]:
            rows += block
        return tuple(rows)

    def blocks(self, *names: str) -> tuple[Block, ...]:
        """Return the blocks that contain the registers `names`, by default all registers.

        The blocks contain no undefined addresses, of which Protocol 2.0 servos may reject reads.
        """
        registers = [self.registers[name] for name in names or self.registers]
        blocks: list[Block] = []
        for register in sorted(set(registers), key=lambda r: r.address):
            last = blocks[-1] if blocks else Block(-1, 0)
            if register.address == last.address + last.size:
                blocks[-1] = Block(last.address, last.size + register.size)
            else:
                blocks.append(Block(register.address, register.size))
        return tuple(blocks)

    def decode(self, block: Block, data: bytes, name: str) -> int:
        """Return the value of the register `name` from the bytes `data` of a block."""
        register = self.registers[name]
        start = register.address - block.address
        return register.decode(data[start : start + register.size])


@dataclass(frozen=True, slots=True, kw_only=True)
class Mechanics:
    """Friction, damping and inertia of gears and rotor, as seen at the servo's output (horn).

    Attributes:
        friction: Dry friction [N·m].
        damping: Viscous friction, without back-EMF [N·m·s/rad].
        armature: Rotor inertia [kg·m²].
    """

    friction: float
    damping: float
    armature: float


def estimated_mechanics(stall: float) -> Mechanics:
    """Return friction, damping and inertia of a servo, estimated from its stall torque [N·m].

    `stall` is the stall torque at rated voltage. The ratios are those of the Dynamixel servos that
    were identified (MX-64, MX-106, XL330); they agree within a factor of 2.5. The STS3215 has up to
    six times as much damping and five times as much inertia.
    """
    return Mechanics(friction=0.02 * stall, damping=0.005 * stall, armature=0.003 * stall)


@dataclass(frozen=True, kw_only=True)
class ServoModel:
    """Data of one servo model.

    Attributes:
        name: Model name printed on the servo.
        model_number: Value of the register Model Number.
        family: Family with its control table and protocol.
        limit_type: Quantity that the limit register limits: `pwm` (duty) or `current`.
        counts_per_turn: Encoder counts per turn of the horn.
        max_position: Largest position of the encoder [counts]; the smallest is 0.
        stall: Stall torque by supply voltage, ((V, N·m), ...), ascending.
        no_load: No-load speed by supply voltage, ((V, rpm), ...), ascending.
        gain: Motor duty [1] per radian of position error and per unit of the gain register. 0 for
            EX and RX, whose register is the position error [counts] at full duty.
        gain_default: Factory value of the gain register.
        speed_unit: One unit of the speed registers [rpm].
        current_unit: One unit of the current registers [A]; 0 without such registers.
        current_max: Largest value of the register Current Limit.
        stall_current: Current at stall torque and rated voltage [A]; NaN for servos that do not
            limit their current.
        rated: Supply voltage that the maker recommends [V].
        voltage: Lowest and highest supply voltage [V].
        overload: Share of the full torque above which overload protection acts; None if unknown.
        mechanics: Friction, damping and inertia of gears and rotor.
        aliases: Other names of the model.
    """

    name: str
    model_number: int
    family: Family
    limit_type: Kind
    counts_per_turn: float = 4096
    max_position: int = 4095
    stall: tuple[tuple[float, float], ...]
    no_load: tuple[tuple[float, float], ...]
    gain: float
    gain_default: int
    speed_unit: float
    rated: float
    voltage: tuple[float, float]
    current_unit: float = 0.0
    current_max: int = 0
    stall_current: float = nan
    overload: float | None = None
    mechanics: Mechanics
    aliases: tuple[str, ...] = ()
